"""The interface of rotor faults: what a fault makes of the rotors that it is on, and their registry.

A fault is a pure law of the time since its onset. What it does to thrust and speed is up to the plant.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

from quadftc_model.arrays import Components, Scalar, namespace
from quadftc_model.parameters import Checked
from quadftc_model.registry import Registry
from quadftc_model.samples import RotorCondition

ROTOR = "rotor"  # the channel


class RotorEffect(NamedTuple):
    """What a fault does to one rotor; the defaults are those of a healthy one."""

    effectiveness: Any = 1.0  # (...) [1]
    speed_limit: Any = math.inf  # (...) [rad/s]
    stuck: Any = False  # (...) bool
    unbalance: Any = 0.0  # (...) [kg m]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RotorFault(Checked, abc.ABC):
    """Base of all rotor faults."""

    has_memory: ClassVar[bool] = False
    is_random: ClassVar[bool] = False
    channels: ClassVar[tuple[str, ...]] = (ROTOR,)

    @abc.abstractmethod
    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Return what the fault does ``elapsed`` [s] (...) after its onset."""


def rotor_condition(faults: Iterable[Any], rotors: int, time: Scalar) -> RotorCondition:
    """Return the condition of ``rotors`` rotors at a scenario time [s] (...).

    The faults are injections on rotors. Losses multiply, of speed limits the lowest counts, and unbalances
    add.
    """
    xp = namespace(time)
    now: Any = xp.asarray(time)
    ones = xp.ones((*now.shape, rotors), dtype=now.dtype)
    condition = RotorCondition(ones, math.inf * ones, ones < 0.0, 0.0 * ones)
    for fault in faults:
        acts = ((fault.start <= now) & (now < fault.stop))[..., None] & fault.mask
        effect = RotorEffect(*(xp.asarray(part)[..., None] for part in fault.law.effect(now - fault.start)))
        condition = RotorCondition(
            xp.where(acts, condition.effectiveness * effect.effectiveness, condition.effectiveness),
            xp.where(acts, xp.minimum(condition.speed_limit, effect.speed_limit), condition.speed_limit),
            condition.stuck | (acts & effect.stuck),
            xp.where(acts, condition.unbalance + effect.unbalance, condition.unbalance),
        )
    return condition


def true_effectiveness(condition: RotorCondition) -> Components:
    """Return thrust over that of a healthy rotor (..., n) [1]: 0 of a rotor that is off."""
    off = condition.speed_limit <= 0.0
    return namespace(off).where(off, 0.0, condition.effectiveness)


rotor_faults: Registry[Any] = Registry("rotor fault", "quadftc_sim.rotor_faults", "quadftc.rotor_faults")
register = rotor_faults.register
