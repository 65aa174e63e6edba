"""Vehicles with other rotors than those of their files."""

import dataclasses

import numpy as np

SIGNS = {"P": 1.0, "N": -1.0}


def with_rotors(vehicle, places, yaw_sign):
    """The vehicle with rotors at places (n, 2) [m]; ``yaw_sign``: of their torques about yaw, or P and N."""
    sign = np.array([SIGNS.get(each, each) for each in yaw_sign], float)
    rotors = dataclasses.replace(
        vehicle.rotors, positions=np.asarray(places, float), yaw_sign=sign, spin_sign=-sign
    )
    return dataclasses.replace(vehicle, rotors=rotors)


def circle(angles, radius=0.25):
    """Places on a circle [m], at angles [deg]."""
    return radius * np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)


SIXTH = 60.0 * np.arange(6)  # deg
