"""What fault observers are judged on: recordings and simulated flights, for tuning and for judging.

docs/judging.md says why each is in its set.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_campaign.campaign_file import Campaign, Variant, load_campaign
from quadftc_campaign.flights import flight_scenario
from quadftc_compile.build import build_library
from quadftc_compile.engine import engine_named
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_compile.wiring import BLOCK, flown_by
from quadftc_fdi.diagnosis import elements_of
from quadftc_fdi.fault_observer import FaultObserver, fault_observers, is_usable_estimate
from quadftc_flight.closed_loop import LoopFlyer, loop_of
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.metrics import LOST
from quadftc_flight.reported import joined
from quadftc_model.arrays import Array, rows_of
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FaultEstimate, FaultObserverInputs, ImuSample
from quadftc_model.stepper import NANOSECONDS_PER_SECOND, seconds
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.inspection.whitening import runs_of
from quadftc_replay.open_loop import OpenDraws, open_loop_of
from quadftc_replay.plan import FROM_GYRO, choose_observer, read_recording
from quadftc_sim.assembly import sample_count
from quadftc_tools.study.crazyflie_logs import VEHICLE, Mask, Recorded, read_driven, read_without_torque
from quadftc_tools.study.golden_alarms import Event, Floats, Verdict, alarms_of, two_digits

CAMPAIGNS = Path(__file__).resolve().parents[3] / "campaigns"
TUNING, JUDGING = SETS = ("tuning", "judging")
# recordings by set and kind; each set has calm and violent ones
RECORDINGS = {
    TUNING: {
        "broad": ("10_slow_translation_a", "14_slow_translation_with_breaks_b", "25_tapping_b"),
        "crazyswarm2": ("log08", "log100", "log104", "log110", "log113"),
        "sysid": ("log10",),
    },
    JUDGING: {
        "broad": ("06_fast_rotation_a", "11_slow_translation_b", "16_fast_translation_b"),
        "crazyswarm2": ("log09", "log10", "log102", "log106", "log11", "log119", "log125"),
        "sysid": ("log15",),
        "crazypad": (
            "controller_data-normal_flight-E8_log00",
            "controller_data-cut_propeller_M3_3mm-E8_log00",
        ),
    },
}
FLIGHTS = {  # how many of each campaign are flown in each set
    "which_sensor": 40,
    "which_sensor_healthy": 10,
    "mems_faults": 4,
    "free_circle": 4,
    "rotor_loss": 4,
    "two_faults": 12,
}
NEW_SEED = 100  # what the seed of a campaign is raised by for judging
WITH_ATTITUDE = "with its attitude"


class Trial(NamedTuple):
    """A recording or a flight."""

    name: str
    kind: str
    part: str  # of `SETS`
    judge: Callable[[str], Verdict]  # by the name of a fault observer


def recorded_trials(directory: Path) -> Iterator[Trial]:
    """All recordings below a directory that has ``broad/`` and ``crazyflie/``; none may be missing."""
    for part, kinds in RECORDINGS.items():
        for kind, names in kinds.items():
            for name in names:
                path = directory / ("broad" if kind == "broad" else f"crazyflie/{kind}") / name
                if not path.exists():
                    raise ValueError(f"{path}: not there; expected the recordings of docs/judging.md")
                if kind == "broad":
                    yield Trial(f"{kind}/{name}", kind, part, functools.partial(_judge_bag, path))
                    continue
                log = functools.partial(_judge_log, path)
                yield Trial(f"{kind}/{name}", kind, part, functools.partial(log, attitude=False))
                if kind == "crazyswarm2":
                    what = f"{kind} {WITH_ATTITUDE}"
                    judge = functools.partial(log, attitude=True)
                    yield Trial(f"{kind}/{name} {WITH_ATTITUDE}", what, part, judge)


def simulated_trials() -> Iterator[Trial]:
    """All simulated flights of both sets."""
    flyer = LoopFlyer()
    for part, more in zip(SETS, (0, NEW_SEED), strict=True):
        for name, count in FLIGHTS.items():
            seed = load_campaign(CAMPAIGNS / f"{name}.yaml").seed + more
            yield from flights_of(name, seed, count, part, flyer)


def flights_of(
    name: str, seed: int, count: int, part: str = "other", flyer: LoopFlyer | None = None
) -> Iterator[Trial]:
    """Flights of a campaign with a seed."""
    campaign = load_campaign(CAMPAIGNS / f"{name}.yaml", seed=seed, engine="c")
    judge = functools.partial(_judge_flight, flyer or LoopFlyer(), campaign)
    for number in range(count):
        yield Trial(f"{name} {seed}/{number}", name, part, functools.partial(judge, number))


def _judge_bag(path: Path, observer: str) -> Verdict:
    """Diagnose a bag as `quadftc replay` does."""
    recording = read_recording(path)
    law = choose_observer(recording, observer).law
    loop, draws = open_loop_of(recording, law, ()), OpenDraws(recording, (), 0)
    flown, parts = flown_by(engine_named("c"), loop, draws.example()), list[tuple[FaultEstimate]]()
    for begin in range(0, len(recording), BLOCK):
        end = min(begin + BLOCK, len(recording))
        output = flown.run(draws.rows(begin, end), end - begin)
        parts.append(joined([(output.estimate.said,)]))  # a copy: the next block takes its place
    (estimate,) = joined(parts)
    time = (recording.stamp_ns - recording.stamp_ns[0]) / NANOSECONDS_PER_SECOND
    absences = _absences(time, np.asarray(recording.imu.attitude_valid))
    return Verdict(alarms_of(law, time, estimate), judged=(0.0, float(time[-1])), absences=absences)


def _absences(time: Floats, there: Mask) -> tuple[Event, ...]:
    """Return the times in which the attitude is not there, each up to and with the first sample that is."""
    until = np.nextafter(np.append(time[1:], time[-1]), np.inf)
    return tuple(Event("attitude", float(time[run][0]), float(until[run][-1])) for run in runs_of(~there))


def _judge_log(path: Path, observer: str, attitude: bool) -> Verdict:
    """Diagnose a log of a Crazyflie. Commanded torques act behind the rotors' lag; alarms count in flight."""
    kind = fault_observers.get(observer)
    given = {FROM_GYRO: True} if attitude and hasattr(kind, FROM_GYRO) else {}
    law: FaultObserver = kind(vehicle=load_vehicle(VEHICLE), **given)
    if path.parent.name == "crazypad":
        flight, driven = read_without_torque(path), False
    else:
        flight, driven = read_driven(path, attitude), True
    estimate = _run_law(law, flight, driven)
    if not np.all(is_usable_estimate(estimate)):
        raise ValueError(f"{path}: observer '{observer}' says what is not finite")
    time, flying = flight.time - flight.time[0], np.flatnonzero(flight.flying)
    judged = float(time[flying[0]]), float(time[flying[-1]])
    return Verdict(alarms_of(law, time[1:], estimate), judged=judged)


def _run_law(law: FaultObserver, flight: Recorded, driven: bool) -> FaultEstimate:
    """Run an observer from the first row on; return what it says of each row after that (n - 1, ...)."""
    count, has_attitude = len(flight.time), flight.q_xyzw is not None
    level = np.broadcast_to(np.array([0.0, 0.0, 0.0, 1.0]), (count, 4))
    q_xyzw = level if flight.q_xyzw is None else flight.q_xyzw
    there = np.ones(count, np.bool_)
    imu = ImuSample(q_xyzw, flight.gyro, np.zeros((count, 3)), there & has_attitude, there, ~there)
    inputs = FaultObserverInputs(imu, flight.drive * law.vehicle.inertia, driven=there & driven)
    first = rows_of(inputs, 0)
    runner = CRunner(law, build_library(recipe_of(law, first)))
    state, _ = runner.first(first)
    return runner.run(state, rows_of(inputs, slice(1, None)), np.diff(flight.time))[1]


def _judge_flight(flyer: LoopFlyer, campaign: Campaign, number: int, observer: str) -> Verdict:
    """Fly a flight of a campaign in C, the observer at its defaults in the first scheme."""
    variant = Variant(observer, campaign.variants[0].scheme, observer)
    scenario = flight_scenario(campaign, number, variant)
    scheme = scenario.scheme(None)
    loop, count = loop_of(scenario, scheme), sample_count(scenario.duration, scenario.rate)
    angles, parts = np.empty((count, 3)), list[tuple[Array, ...]]()
    for rows, output in flyer.fly(loop, scenario.seed, count):
        angles[rows] = output.motion.angles
        came = np.flatnonzero(output.left & output.faulty.present)
        said = output.said.estimate.said, output.said.command.attitude.angles
        parts.append((rows.start + came - loop.vehicle.imu.delay, *rows_of(said, came)))
    taken, estimate, reference = joined(parts)
    errors = np.sqrt(np.sum(wrap(angles[taken] - reference) ** 2, axis=1))
    flown = np.flatnonzero(np.cumsum(errors > LOST) <= 1)  # what a lost vehicle says is chance
    time = taken[flown] * seconds(round(loop.clock.period_ns))
    alarms = alarms_of(scheme.observer.law, time, rows_of(estimate, flown))
    end = scenario.duration if len(flown) == len(taken) else float(time[-1])
    scheduled = (*scenario.fault_events, *scenario.rotor_events)
    events = tuple(_event_of(event) for event in scheduled if event.start < end)
    error_deg = two_digits(float(np.degrees(errors[flown].max())))
    return Verdict(alarms, error_deg, (0.0, end), events)


def _event_of(event: FaultEvent) -> Event:
    """Return a scheduled fault by the name of its element; that of a rotor is its number."""
    axis, component = event.axis, event.component
    name = elements_of(component, 0)[0][AXES.index(axis)] if axis in AXES else axis
    return Event(f"{component}/{name}", event.start, event.stop)


def trials(directory: Path | None) -> list[Trial]:
    """All simulated flights, and the recordings below a directory if one is given."""
    return [*(recorded_trials(directory) if directory else ()), *simulated_trials()]
