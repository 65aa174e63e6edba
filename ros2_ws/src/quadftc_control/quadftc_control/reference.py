"""Where the attitude shall be: the interface of references, their registry, and two sources of them.

A scenario adds up references, Euler angles with two derivatives; live setpoints go through a filter.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from quadftc_model.arrays import Array, Vector, clip, namespace
from quadftc_model.assembly import NodeParameters, components_from
from quadftc_model.parameters import Checked, parameter
from quadftc_model.registry import Registry
from quadftc_model.rotations import wrap
from quadftc_model.samples import AttitudeReference, is_usable
from quadftc_model.stepper import seconds


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Reference(Checked, abc.ABC):
    """Base of all references; those of a scenario add up."""

    @abc.abstractmethod
    def sample(self, time: Array) -> AttitudeReference:
        """Angles [rad], rates [rad/s], accelerations [rad/s²], at a scenario time [s], () -> (3,).

        Many times at once are a column, (n, 1) -> (n, 3).
        """


def combined(references: Sequence[Reference], time: Array) -> AttitudeReference:
    """Sum of references at ``time`` [s]; with none, level and still."""
    parts = [each.sample(time) for each in references] or [AttitudeReference(*np.zeros((3, 3)))]
    return functools.reduce(lambda a, b: AttitudeReference(*map(operator.add, a, b)), parts)


def smooth_rise(fraction: Array) -> tuple[Array, Array, Array]:
    """Quintic rise from 0 to 1 over a fraction of 0 to 1, held outside; with two derivatives.

    The polynomial of least degree whose first and second derivatives vanish at both ends.
    """
    s = clip(fraction, 0.0, 1.0)
    value = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    slope = 30.0 * s * s * (1.0 - s) * (1.0 - s)
    curvature = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return value, slope, curvature


references: Registry[Any] = Registry("reference", "quadftc_control.references", "quadftc.references")
register = references.register


class ReferenceGenerator:
    """The reference of a scenario on a stream of stamps; the first stamp is scenario time 0.

    A reference that cannot be used, such as one with absurd accelerations, is replaced by the last one.
    """

    def __init__(self, parts: Sequence[Reference]) -> None:
        self.parts = tuple(parts)
        self._last = combined((), 0.0)
        self._epoch_ns: int | None = None

    def at(self, stamp_ns: int) -> AttitudeReference:
        """Return the reference at a stamp [ns]."""
        if self._epoch_ns is None:
            self._epoch_ns = stamp_ns
        reference = combined(self.parts, seconds(stamp_ns - self._epoch_ns))
        if is_usable(*reference):
            self._last = reference
        return self._last


def reference_from(parameters: NodeParameters) -> ReferenceGenerator:
    """Build the reference of a node from its list ``references``; level without any."""
    return ReferenceGenerator(components_from(references, parameters, "references"))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SetpointFilter(Checked):
    """Makes live setpoints smooth: second order, critically damped, with the acceleration bounded.

    acceleration = clip(w² wrap(setpoint - angle) - 2 w rate), rate and angle its integrals.
    """

    bandwidth: float = parameter(3.0, unit="rad/s", low=1e-3, high=50.0, doc="natural frequency w")
    max_acceleration: float = parameter(5.0, unit="rad/s^2", low=1e-3, doc="bound of each component")

    def init(self, inputs: Array) -> AttitudeReference:
        """Start at a setpoint (..., 3) [rad], still."""
        zeros = namespace(inputs).zeros_like(inputs)
        return AttitudeReference(inputs, zeros, zeros)

    def step(
        self, state: AttitudeReference, inputs: Array, dt: float
    ) -> tuple[AttitudeReference, AttitudeReference]:
        """Advance by ``dt`` [s] towards a setpoint (..., 3) [rad]; the state is the last reference."""
        reference = filtered(state, inputs, self.bandwidth, self.max_acceleration, dt)
        return reference, reference


def filtered(
    last: AttitudeReference, setpoint: Vector, bandwidth: float, bound: float | Vector, dt: float
) -> AttitudeReference:
    """Reference ``dt`` [s] after the ``last`` on the way to angles [rad] (..., 3), as `SetpointFilter` says.

    ``bound`` [rad/s²] is that of the acceleration, one for all components or (3,).
    """
    wanted = bandwidth * bandwidth * wrap(setpoint - last.angles) - 2.0 * bandwidth * last.rates
    acceleration = clip(wanted, -bound, bound)
    rates = last.rates + dt * acceleration
    return AttitudeReference(last.angles + 0.5 * dt * (last.rates + rates), rates, acceleration)
