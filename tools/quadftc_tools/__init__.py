"""Tools beside the product, run from a clone: benchmarks, long tests of the software, studies."""
