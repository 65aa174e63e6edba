"""Where the attitude shall be: the interface of references, their registry, and the filter of live setpoints.

A scenario adds up references, Euler angles with two derivatives (`quadftc_control.guidance`).
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import math
import operator
from collections.abc import Sequence

import numpy as np

from quadftc_model.arrays import Array, Column, Scalar, Vector, clip, namespace
from quadftc_model.assembly import NodeParameters, components_from
from quadftc_model.parameters import Checked, parameter
from quadftc_model.registry import Registry
from quadftc_model.rotations import wrap
from quadftc_model.samples import AttitudeReference

MAX_TILT = math.radians(80.0)  # rad, of a live setpoint; further, Euler angles are no sensible one


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Reference(Checked, abc.ABC):
    """Base of all references; those of a scenario add up."""

    @abc.abstractmethod
    def sample(self, time: Scalar | Column) -> AttitudeReference:
        """Angles [rad], rates [rad/s], accelerations [rad/s²], at a scenario time [s], () -> (3,).

        Many times at once are a column, (..., 1) -> (..., 3).
        """


def level(time: Scalar | Column) -> AttitudeReference:
    """Level and still, at a time as :meth:`Reference.sample` takes it."""
    xp = namespace(time)
    zeros = xp.zeros_like(time) + xp.zeros(3)
    return AttitudeReference(zeros, zeros, zeros)


def combined(references: Sequence[Reference], time: Scalar | Column) -> AttitudeReference:
    """Sum of references at ``time`` [s]; with none, level and still."""
    parts = [each.sample(time) for each in references] or [level(time)]
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


references: Registry[Reference] = Registry("reference", "quadftc_control.references", "quadftc.references")
register = references.register


def references_from(parameters: NodeParameters) -> tuple[Reference, ...]:
    """Build the references of a node from its list ``references``."""
    return tuple(components_from(references, parameters, "references"))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SetpointFilter(Checked):
    """Makes live setpoints smooth: second order, critically damped, with the acceleration bounded.

    acceleration = clip(w² wrap(setpoint - angle) - 2 w rate), rate and angle its integrals.
    """

    bandwidth: float = parameter(3.0, unit="rad/s", low=1e-3, high=50.0, doc="natural frequency w")
    max_acceleration: float = parameter(5.0, unit="rad/s^2", low=1e-3, doc="bound of each component")

    def example(self) -> Vector:
        """Return the setpoint of one vehicle that is level."""
        return np.zeros(3)

    def init(self, inputs: Vector) -> AttitudeReference:
        """Start at a setpoint (..., 3) [rad], still."""
        zeros = namespace(inputs).zeros_like(inputs)
        return AttitudeReference(inputs, zeros, zeros)

    def step(
        self, state: AttitudeReference, inputs: Vector, dt: float
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
