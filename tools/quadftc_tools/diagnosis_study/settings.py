"""What is flown: the settings of the study with the faults that they draw, and the form of an observer."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

GRADE = "mems"  # sensors of the simulation
RATE = 250.0  # Hz
DURATION = 80.0  # s
WINDOWS = ((20.0, 40.0), (50.0, 70.0))  # s; when the simulation is faulty
FAULT_TIME = 20.0  # s; length of a fault on a recording
EVERY = 30.0  # s; from the onset of a fault on a recording to that of the next
FIRST = (20.0, 30.0)  # s; within this the first fault on a recording begins


class Ranges(NamedTuple):
    """Sizes of the faults, uniform between two bounds, with a random sign."""

    step: tuple[float, float]  # deg
    ramp: tuple[float, float]  # deg/s
    sine: tuple[float, float]  # deg, amplitude
    frequency: tuple[float, float]  # rad/s, of the sine


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setting:
    """A set of flights.

    Parameters
    ----------
    name, title : str
    number : int
        Part of the seed of its flights.
    recorded : bool
        On recordings, not simulated.
    one_axis : bool
        One random axis at a time is faulty; else all three at once.
    ranges : Ranges
    """

    name: str
    title: str
    number: int
    recorded: bool
    one_axis: bool
    ranges: Ranges


class Variant(NamedTuple):
    """An observer with its parameters in a setting."""

    name: str  # of the observer; with ``@value`` behind it where its level is swept
    observer: str
    parameters: tuple[tuple[str, float], ...]  # SI; the others have their defaults

    @property
    def settings(self) -> tuple[str, ...]:
        """The parameters as `quadftc_replay.plan.choose_observer` takes them."""
        return tuple(f"observer.{name}={value!r}" for name, value in self.parameters)


SIMULATION = Setting(
    name="simulation",
    title="simulation",
    number=0,
    recorded=False,
    one_axis=False,
    ranges=Ranges(step=(0.5, 5.0), ramp=(0.05, 0.5), sine=(1.0, 3.0), frequency=(0.2, 2.0)),
)
RECORDINGS = Setting(
    name="recordings",
    title="recordings",
    number=1,
    recorded=True,
    one_axis=False,
    ranges=Ranges(step=(3.0, 10.0), ramp=(0.2, 1.0), sine=(3.0, 6.0), frequency=(0.3, 2.0)),
)
SIMULATION_ONE_AXIS = dataclasses.replace(
    SIMULATION,
    name="simulation_one_axis",
    title="simulation, one axis at a time",
    number=2,
    one_axis=True,
)
RECORDINGS_ONE_AXIS = dataclasses.replace(
    RECORDINGS,
    name="recordings_one_axis",
    title="recordings, one axis at a time",
    number=3,
    one_axis=True,
)
SETTINGS = (SIMULATION, RECORDINGS, SIMULATION_ONE_AXIS, RECORDINGS_ONE_AXIS)


def setting_of(name: str) -> Setting:
    """Return a setting by name."""
    return next(setting for setting in SETTINGS if setting.name == name)
