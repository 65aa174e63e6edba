"""Rotations, rigid body, rotors and mixer, vehicles and the registry (pure)."""
