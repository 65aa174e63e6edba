"""Attitude control: controllers and references (pure core) and their nodes."""
