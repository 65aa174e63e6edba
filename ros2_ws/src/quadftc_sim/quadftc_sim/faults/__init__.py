"""Sensor faults, one file each."""
