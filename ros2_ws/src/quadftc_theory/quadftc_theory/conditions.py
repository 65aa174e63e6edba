"""Conditions of the theory: what a theorem asks for, whether it holds in a given situation, and by how much.

No law knows its theory: conditions are registered for the class of a law, and hold for its subclasses, too.

    @conditions_of(MyObserver)
    def my_conditions(observer: MyObserver, given: Circumstances) -> Iterable[Condition]: ...

Another package names the module that does so in its entry-point group ``quadftc.conditions``.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import importlib
import importlib.metadata
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadftc_model.vehicle import Vehicle

Floats = NDArray[np.float64]
DEG = math.pi / 180.0

_GROUP = "quadftc.conditions"  # entry points: a name of its own -> a module that registers conditions
_OWN = ("sliding_mode_conditions", "baseline_conditions", "controller_conditions", "indi_conditions")


class Verdict(str, enum.Enum):
    """Whether a condition holds."""

    PASS = "PASS"
    FAIL = "FAIL"
    DEPENDS = "DEPENDS"  # on something outside the model, which the text names, or for part of the time


@dataclasses.dataclass(frozen=True)
class Condition:
    """A condition with its verdict."""

    name: str  # as the source calls it
    verdict: Verdict
    text: str  # in plain words, with numbers and units
    numbers: Mapping[str, object] = dataclasses.field(default_factory=dict[str, object])  # SI units
    needed: bool = True  # by the scheme: its FAIL is a FAIL of the whole

    @property
    def failed(self) -> bool:
        """Whether the scheme lacks something it needs."""
        return self.needed and self.verdict is Verdict.FAIL


def assess(
    name: str,
    holds: bool | np.bool_,
    text: str,
    /,
    otherwise: Verdict = Verdict.FAIL,
    needed: bool = True,
    **numbers: object,
) -> Condition:
    """Return a condition that passes where it holds, with its numbers."""
    return Condition(name, Verdict.PASS if holds else otherwise, text, numbers, needed)


#: The same for what no scheme needs: where it does not hold, the outcome depends on it.
advise = functools.partial(assess, otherwise=Verdict.DEPENDS, needed=False)


@dataclasses.dataclass(frozen=True)
class Bound:
    """A bound that a condition uses, and where it comes from."""

    value: Any  # a float, or one for each axis
    unit: str  # SI
    origin: str  # given (by scenario, vehicle or sensor), trace (of a recorded run) or assumed, and how


@dataclasses.dataclass(frozen=True, eq=False)
class Series:
    """A quantity over time, known at every sample; unit and origin as of a `Bound`."""

    values: Floats  # (n, 3)
    unit: str
    origin: str

    @property
    def peak(self) -> Floats:
        """Largest magnitude of each axis (3,)."""
        return np.max(np.abs(self.values), axis=0)

    @property
    def norm(self) -> float:
        """Largest Euclidean norm."""
        return float(np.max(np.linalg.norm(self.values, axis=1)))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Circumstances:
    """What a scheme has to cope with: the bounds that the conditions of its parts are held against."""

    vehicle: Vehicle
    dt: float  # sampling period [s]
    duration: float  # [s]
    faulty_channels: tuple[str, ...]  # "attitude", "gyro", ...: those with scheduled faults
    tilt: Bound  # largest roll or pitch [rad]
    body_rate: Bound  # largest norm [rad/s]
    acceleration: Bound  # of the reference, each axis [rad/s²]
    fault: Bound  # largest norm of the attitude fault [rad]
    fault_growth: Bound  # slowest growth of an attitude fault to its peak [rad/s]; inf: there is none
    fault_length: Bound  # longest attitude fault [s]
    gyro_bias: Bound  # [rad/s]
    gyro_noise: Bound  # angle random walk [rad/sqrt(s)]
    attitude_noise: Bound  # of a sample, 1 sigma [rad]
    disturbance: Series  # lumped, d of (36) [rad/s²]
    disturbance_error: Series  # d - d^ with the scheme's disturbance observer [rad/s²]

    @property
    def bounds(self) -> dict[str, Bound]:
        """Every bound by name; of a quantity over time, the largest magnitude of each axis."""
        found = {
            name: Bound(tuple(each.peak.tolist()), each.unit, each.origin)
            if isinstance(each, Series)
            else each
            for name, each in vars(self).items()
        }
        return {name: each for name, each in found.items() if isinstance(each, Bound)}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trace:
    """A recorded run as the Lyapunov functions need it: a row for each delivered sample, with the truth."""

    stamp_ns: NDArray[np.int64]  # (n,)
    q_xyzw: Floats  # (n, 4) measured attitude
    gyro: Floats  # (n, 3) [rad/s]
    torque: Floats  # (n, 3) command of the sample [N m]
    angles: Floats  # (n, 3) true [rad]
    body_rate: Floats  # (n, 3) true [rad/s]
    sliding_variable: Floats  # (n, 3) S [rad/s]
    saturated: NDArray[np.bool_]  # (n, 3)


def falls(
    name: str,
    values: Floats,
    stamp_ns: NDArray[np.int64],
    required: Floats,
    outside: NDArray[np.bool_],
    note: str = "",
    **numbers: object,
) -> Condition:
    """Judge a Lyapunov derivative along a run, outside the boundary layers only.

    ``values`` (n,) or (n, k) are the Lyapunov functions at the samples, each by itself. ``required`` are the
    rates at which they have to fall at least, negative. ``outside`` says where the state is outside its
    layer. The condition says ``note`` and ``numbers``, too.
    """

    def said(outcome: Verdict, text: str, **shares: float | None) -> Condition:
        return Condition(name, outcome, text + note, {**shares, **numbers}, needed=False)

    slope = (np.diff(values.T) / (np.diff(stamp_ns) / 1e9)).T
    known = np.isfinite(slope)
    if not known.any():
        return said(Verdict.DEPENDS, "the bag lacks the truth that this needs")
    counted = outside[:-1] & known & np.isfinite(required[:-1])
    share = int(counted.sum()) / int(known.sum())
    if not counted.any():
        text = "never outside the boundary layer: nothing has to fall"
        return said(Verdict.PASS, text, share_outside=share, share_holding=None)
    holding = float(np.mean(slope[counted] <= required[:-1][counted]))
    text = f"outside the boundary layer for {100.0 * share:.3g} % of the run; falls fast enough in "
    text += f"{100.0 * holding:.4g} % of that"
    outcome = Verdict.PASS if holding == 1.0 else Verdict.DEPENDS if holding >= 0.95 else Verdict.FAIL
    return said(outcome, text, share_outside=share, share_holding=holding)


def per_axis(values: Iterable[float], digits: int = 3) -> str:
    """Numbers of roll, pitch and yaw as ``1.2/1.2/0.4``."""
    return "/".join(f"{value:.{digits}g}" for value in values)


def pairs(values: ArrayLike) -> list[object]:
    """Complex numbers as [real, imaginary], for JSON."""
    numbers: NDArray[np.complex128] = np.asarray(values, np.complex128)
    return np.stack([numbers.real, numbers.imag], axis=-1).tolist()


@functools.singledispatch
def _judge(law: object, given: Circumstances) -> Iterable[Condition]:
    """The one condition of a law for which none are registered."""
    text = f"no conditions are registered for {type(law).__name__}; @conditions_of does so"
    return [Condition("theory", Verdict.DEPENDS, text, needed=False)]


@functools.singledispatch
def _judge_along(law: object, trace: Trace, given: Circumstances) -> Iterable[Condition]:
    """Most laws have no Lyapunov function here."""
    return []


conditions_of = _judge.register  #: decorates a function of (law, circumstances) for the class of a law
conditions_along_of = _judge_along.register  #: decorates a function of (law, trace, circumstances)


def judge(law: object, given: Circumstances, along: Trace | None = None) -> list[Condition]:
    """Judge what the theory of a law asks for; with a recorded run, its Lyapunov functions ``along`` that."""
    load_conditions()
    return list(_judge(law, given) if along is None else _judge_along(law, along, given))


@functools.cache
def load_conditions() -> None:
    """Import what registers conditions, here and in other packages."""
    for name in _OWN:
        importlib.import_module(f"quadftc_theory.{name}")
    for entry in importlib.metadata.entry_points(group=_GROUP):
        entry.load()
