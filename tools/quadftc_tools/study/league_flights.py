"""Simulated flights as logs, for the league: what the sensors of a scenario say, and what is true."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import Scenario, load_scenario
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_sim.assembly import EPOCH_NS
from quadftc_sim.rotor_fault import ROTOR

SCENARIOS = Path(__file__).resolve().parents[3] / "scenarios"
FLOWN_HEALTHY = ("free_circle", "gyro_faults")  # flown without their faults
FLOWN_FAULTY = ("free_circle", "hover_drift", "rotor_loss", "gyro_faults", "mems_faults")


class Truth(NamedTuple):
    """A fault that a scenario puts on a flight."""

    title: str
    component: str
    elements: tuple[str, ...]
    start: float  # s
    stop: float  # s


def fly_log(name: str, *changes: str) -> tuple[FlightLog, Scenario]:
    """Fly the first scheme of a scenario; return what the observers saw, and the scenario."""
    scenario = load_scenario(SCENARIOS / f"{name}.yaml", changes)
    stamps, samples = list[int](), list[ImuSample]()

    def watch(stamp_ns: int, sample: ImuSample) -> None:
        stamps.append(stamp_ns)
        samples.append(sample)

    flight = fly(scenario, watch=watch)
    time = (np.array(stamps) - EPOCH_NS) / NANOSECONDS_PER_SECOND
    q_xyzw, rate, force, *_ = (np.stack(column) for column in zip(*samples, strict=True))
    rotors, speeds = load_vehicle(scenario.vehicle).rotors, flight.rotor_speeds
    log = FlightLog(
        path=Path(name),
        format="simulation",
        gyros={"": Signal(time, rate)},
        accelerometers={"": Signal(time, force)},
        attitude=Signal(time, q_xyzw),
        attitude_from_gyro=False,
        rotor_speeds=Signal(flight.time, speeds) if speeds.shape[1] else None,
        torque_command=Signal(flight.time, flight.torque),
        vehicle=scenario.vehicle,
        rotor_positions=rotors.positions,
        rotor_yaw_signs=rotors.yaw_sign,
    )
    return log, scenario


def truths(scenario: Scenario) -> Iterator[Truth]:
    """Return the faults of a scenario, in the words of a verdict."""
    for fault in scenario.faults:
        injection = fault.injection
        names = {"attitude": ("roll", "pitch", "yaw"), ROTOR: tuple("12345678")}
        elements = names.get(injection.channel, tuple("xyz"))
        chosen = tuple(name for name, acts in zip(elements, injection.mask, strict=False) if acts)
        title = f"{scenario.name}: {injection.channel} {', '.join(chosen)}: {injection.kind}"
        yield Truth(title, injection.channel, chosen, injection.start, injection.stop)
