"""Disturbance observers, one file each."""
