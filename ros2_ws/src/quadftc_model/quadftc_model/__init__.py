"""Rotations, rigid body, rotors and mixer, vehicles, integrators and the registry (pure)."""
