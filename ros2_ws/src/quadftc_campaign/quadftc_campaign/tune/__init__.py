"""Tuning gains by gradients through the closed loop."""
