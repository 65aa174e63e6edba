"""Margins of incremental dynamic inversion, of the linear loop of one axis.

The vehicle turns by x'' = A u / (g J). A(s) = 1/(T s + 1) is the lag of the rotors, g the inertia over that
of the model. The law, with the filter H(s) = w^2 / D(s), D = s^2 + sqrt(2) w s + w^2, is

    u = H A u - J (k_rate s + k_rate k_angle + H s^2) x

so that, broken at the torque, the loop transfer function is

    L(s) = (w^2 s^2 + k_rate (s + k_angle) D) / (g s^2 ((T s + 1) D - w^2)) .

At g = 1 the motion is (T s + 1) s^2 + k_rate s + k_rate k_angle, as if there were no filter. The torque is
held for a sampling period, which delays L by half of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from quadftc_control.controllers.indi import DAMPING, Indi
from quadftc_theory.conditions import Circumstances, Condition, Floats, assess, conditions_of, pairs, per_axis
from quadftc_theory.controller_conditions import authority

SLOWEST = 0.01  # rad/s; of the frequencies looked at, up to the Nyquist frequency
FREQUENCIES = 20000


class Margins(NamedTuple):
    """What the loop of an axis stands, each by itself."""

    delay: float  # [s]
    lightest: float  # inertia over that of the model
    heaviest: float


def transfer_function(controller: Indi, axis: int) -> tuple[Floats, Floats]:
    """Numerator and denominator of L for g = 1, without delay; polynomials in s, highest power first."""
    k_angle, k_rate = controller.k_angle[axis], controller.k_rate[axis]
    square = controller.cutoff**2
    D = np.array([1.0, DAMPING * controller.cutoff, square])
    lag = np.polysub(np.polymul([1.0 / controller.rotor_bandwidth, 1.0], D), [square])
    numerator = np.polyadd([square, 0.0, 0.0], k_rate * np.polymul([1.0, k_angle], D))
    return np.asarray(numerator, np.float64), np.concatenate([lag, np.zeros(2)], dtype=np.float64)


def margins(controller: Indi, axis: int, dt: float) -> Margins:
    """Margins of an axis at a sampling period [s]; infinite or zero where nothing limits it."""
    numerator, denominator = transfer_function(controller, axis)
    omega = np.geomspace(SLOWEST, np.pi / dt, FREQUENCIES)
    s = 1j * omega
    loop = np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-0.5 * dt * s)
    size = np.abs(loop)
    # where |L| = 1: how far the phase is from -180 deg
    crossing = np.flatnonzero((size[:-1] >= 1.0) & (size[1:] < 1.0))
    phase = np.mod(np.angle(loop[crossing]) + np.pi, 2.0 * np.pi)
    delay = np.min(phase / omega[crossing], initial=np.inf)
    # where the phase is -180 deg: the factors of g that take |L| to 1
    real = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0.0) & (loop.real[:-1] < 0.0))
    factors = size[real]
    lightest = np.max(factors[factors < 1.0], initial=0.0)
    heaviest = np.min(factors[factors > 1.0], initial=np.inf)
    return Margins(float(delay), float(lightest), float(heaviest))


@conditions_of(Indi)
def indi_conditions(controller: Indi, given: Circumstances) -> Iterator[Condition]:
    """Judge the motion for a model that is right, the margins where it is not, and the authority."""
    lag = 1.0 / controller.rotor_bandwidth
    gains = zip(controller.k_rate, controller.k_angle, strict=True)
    roots = [np.roots([lag, 1.0, k_rate, k_rate * k_angle]) for k_rate, k_angle in gains]
    slowest = [float(np.max(each.real)) for each in roots]
    text = (
        f"rotors at {controller.rotor_bandwidth:.3g} rad/s: slowest pole of each axis at {per_axis(slowest)}"
    )
    poles = [*map(pairs, roots)]
    yield assess("motion with the rotors' lag Hurwitz", max(slowest) < 0.0, f"{text} rad/s", poles=poles)

    found = [margins(controller, axis, given.dt) for axis in range(3)]
    delays, lightest, heaviest = zip(*found, strict=True)
    delay = min(delays)
    text = f"{1e3 * delay:.3g} ms beside the half period for which a command is held; a period is "
    text += f"{1e3 * given.dt:.3g} ms"
    yield assess("delay margin of two periods", delay > 2.0 * given.dt, text, delay=list(delays))
    text = f"inertia {max(lightest):.2g} to {min(heaviest):.2g} times that of the model, if all else is right"
    yield assess(
        "inertia margin 0.5 to 2",
        max(lightest) < 0.5 and min(heaviest) > 2.0,
        text,
        needed=False,
        lightest=list(lightest),
        heaviest=list(heaviest),
    )

    yield authority(np.zeros(3), given)
