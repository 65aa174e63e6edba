"""Parts of the observer ``supervised``: filter, anchors, residual tests, tracked fault, recovery."""
