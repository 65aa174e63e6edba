"""Disturbances, one file each."""
