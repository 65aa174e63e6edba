"""Fault observers of the literature, to compare with."""
