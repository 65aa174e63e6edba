"""Fault observers, one file each."""
