"""Attitude controllers, one file each."""
