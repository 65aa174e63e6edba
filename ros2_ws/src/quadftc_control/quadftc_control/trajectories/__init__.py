"""Trajectories, one file each."""
