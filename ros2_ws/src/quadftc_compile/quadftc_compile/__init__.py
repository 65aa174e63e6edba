"""A law's step as C: traced by JAX, written with loops over its arrays, built and kept."""
