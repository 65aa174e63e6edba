"""The interface of rotor faults: what a fault makes of the rotors that it is on, and their registry.

A fault is a pure law of the time since its onset. What it does to thrust and speed is up to the plant.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from quadftc_model.arrays import Components, Flag, Scalar, column, namespace, smaller, where
from quadftc_model.parameters import Checked
from quadftc_model.registry import Registry
from quadftc_model.samples import RotorCondition

if TYPE_CHECKING:
    from quadftc_sim.injection import Injection

ROTOR = "rotor"  # the channel


class RotorEffect(NamedTuple):
    """What a fault does to one rotor; the defaults are those of a healthy one."""

    effectiveness: Scalar = 1.0  # (...) [1]
    speed_limit: Scalar = math.inf  # (...) [rad/s]
    stuck: Flag = False  # (...)
    unbalance: Scalar = 0.0  # (...) [kg m]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RotorFault(Checked, abc.ABC):
    """Base of all rotor faults."""

    has_memory: ClassVar[bool] = False
    is_random: ClassVar[bool] = False
    channels: ClassVar[tuple[str, ...]] = (ROTOR,)

    @abc.abstractmethod
    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Return what the fault does ``elapsed`` [s] (...) after its onset."""


def healthy_rotors(like: Components) -> RotorCondition:
    """Return the condition of rotors without a fault, shaped as ``like`` (..., n)."""
    xp = namespace(like)
    ones, zeros = xp.ones_like(like), xp.zeros_like(like)
    return RotorCondition(ones, xp.full_like(like, math.inf), xp.zeros_like(like, dtype=bool), zeros)


def with_fault(condition: RotorCondition, fault: Injection, time: Scalar) -> RotorCondition:
    """Return a condition with a fault, an injection on rotors, at a scenario time [s] (...).

    Losses multiply, of speed limits the lowest counts, and unbalances add.
    """
    acts = column((fault.start <= time) & (time < fault.stop)) & fault.mask
    effect = RotorEffect(*map(column, fault.law.effect(time - fault.start)))
    return RotorCondition(
        condition.effectiveness * where(acts, effect.effectiveness, 1.0),
        smaller(condition.speed_limit, where(acts, effect.speed_limit, math.inf)),
        condition.stuck | (acts & effect.stuck),
        condition.unbalance + where(acts, effect.unbalance, 0.0),
    )


def true_effectiveness(condition: RotorCondition) -> Components:
    """Return thrust over that of a healthy rotor (..., n) [1]: 0 of a rotor that is off."""
    off = condition.speed_limit <= 0.0
    return where(off, 0.0, condition.effectiveness)


rotor_faults: Registry[RotorFault] = Registry(
    "rotor fault", "quadftc_sim.rotor_faults", "quadftc.rotor_faults"
)
register = rotor_faults.register
