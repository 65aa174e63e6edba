"""The batch engine: the laws of the closed loop under JAX, thousands of flights at once."""
