"""Winds, one file each."""
