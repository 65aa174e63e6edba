"""Simulated flights as logs, for the league: what the sensors of a scenario say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import load_scenario
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_sim.assembly import EPOCH_NS

SCENARIOS = Path(__file__).resolve().parents[3] / "scenarios"
FLOWN = ("free_circle", "gyro_faults")  # without their faults


def fly_log(name: str) -> FlightLog:
    """Fly the first scheme of a scenario without its faults; return what the observers saw."""
    scenario = load_scenario(SCENARIOS / f"{name}.yaml", ["faults=[]"])
    stamps, samples = list[int](), list[ImuSample]()

    def watch(stamp_ns: int, sample: ImuSample) -> None:
        stamps.append(stamp_ns)
        samples.append(sample)

    flight = fly(scenario, watch=watch)
    time = (np.array(stamps) - EPOCH_NS) / NANOSECONDS_PER_SECOND
    q_xyzw, rate, force, *_ = (np.stack(column) for column in zip(*samples, strict=True))
    rotors, speeds = load_vehicle(scenario.vehicle).rotors, flight.rotor_speeds
    return FlightLog(
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
