"""Rotor faults, one file each."""
