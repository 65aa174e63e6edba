"""The affine model (6) of Wang, Huang and Zhang (2021) with matrices for any choice of outputs and faults.

    (6)  x' = A x + D f(x) + B u + W Delta_d,   y = C x + F f_s,   x = [angles, body rate]

The paper takes the angles alone as its output and leaves W open. Here W = [0; I]: disturbances are angular
accelerations. With the output of an IMU message, y = [angles; body rate].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

ANGLES = ("roll", "pitch", "yaw")
RATES = ("p", "q", "r")
OUTPUTS = {"angles": ANGLES, "imu": (*ANGLES, *RATES)}


class AffineModel(NamedTuple):
    """The matrices of (6)."""

    A: Matrix  # (n, n)
    B: Matrix  # (n, m)
    D: Matrix  # (n, s)
    W: Matrix  # (n, r)
    C: Matrix  # (p, n)
    F: Matrix  # (p, q)
    output_names: tuple[str, ...]  # (p,)
    fault_names: tuple[str, ...]  # (q,)


def attitude_model(inertia: Matrix, output: str = "imu", faulty: Sequence[str] = ANGLES) -> AffineModel:
    """Return (6)-(7) for a vehicle.

    Parameters
    ----------
    inertia : array (3,)
        Principal moments [kg m²].
    output : str
        ``imu``: angles and body rate; ``angles``: the angles alone, the paper's own choice.
    faulty : sequence of str
        The outputs with a fault: roll, pitch, yaw, p, q, r.

    Raises
    ------
    ValueError
        If there is no such output.
    """
    if output not in OUTPUTS:
        raise ValueError(f"output = {output!r}: expected one of {', '.join(OUTPUTS)}")
    names = OUTPUTS[output]
    unknown = [name for name in faulty if name not in names]
    if unknown:
        raise ValueError(f"faulty = {unknown[0]!r}: the outputs are {', '.join(names)}")
    zeros, eye = np.zeros((3, 3)), np.eye(3)
    jx, jy, jz = inertia
    gyroscopic = np.diag([(jy - jz) / jx, (jz - jx) / jy, (jx - jy) / jz])
    return AffineModel(
        A=np.block([[zeros, eye], [zeros, zeros]]),
        B=np.vstack([zeros, np.diag(1.0 / np.asarray(inertia))]),
        D=np.vstack([zeros, gyroscopic]),
        W=np.vstack([zeros, eye]),
        C=np.eye(6)[: len(names)],
        F=np.eye(len(names))[:, [names.index(name) for name in faulty]],
        output_names=names,
        fault_names=tuple(faulty),
    )
