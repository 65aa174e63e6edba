"""Logs as autopilots write them: IMU at 25 Hz, attitude and commands at 10 Hz, satellites at 5 Hz."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from sampling import sampled

from quadftc_model.rotations import to_earth, turn
from quadftc_replay.flight_log import Event, FlightLog, Signal, Watched
from quadftc_replay.inspection.agreement import Agreement
from quadftc_replay.inspection.attitude import Creep, find_creeps
from quadftc_replay.inspection.flight import Interval
from quadftc_replay.inspection.found import make_found
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.pairs import owner_by_other
from quadftc_replay.inspection.rotor_step import RotorStep, Torque, search
from quadftc_replay.inspection.rotors import first_failed
from quadftc_replay.inspection.verdict import Verdict

PLACES = np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]])
SIGNS = np.array([-1.0, -1.0, 1.0, 1.0])
GAINS = np.stack([60.0 * PLACES[:, 1], -60.0 * PLACES[:, 0], 8.0 * SIGNS], axis=1)  # rad/s² per unit
MIX = np.linalg.pinv(GAINS.T)
HOVER, DT, ONSET, GRAVITY = 0.4, 0.005, 15.0, np.array([0.0, 0.0, 9.80665])


class Flown(NamedTuple):
    """A flight as far as it was flown."""

    rng: np.random.Generator
    state: tuple[np.ndarray, ...]  # attitude, its estimate, body rate, velocity, thrust of each rotor, gust
    logged: list[np.ndarray]  # body rate, force, commands, attitude, velocity: a row for each `DT`


def at_rest(seed: int) -> Flown:
    level, still = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    state = (level, level, still, still, np.full(4, HOVER), np.zeros(3))
    return Flown(np.random.default_rng(seed), state, [np.zeros((0, k)) for k in (3, 3, 4, 4, 3)])


@functools.cache
def until_onset(seed: int, finds_back: bool) -> Flown:
    """What all flights have in common whose gyros are not deaf."""
    return steer(at_rest(seed), ONSET, finds_back=finds_back)


def steer(
    flown: Flown,
    seconds: float,
    lost: tuple[int, float] | None = None,
    gyro: np.ndarray | None = None,
    stop: float = np.inf,
    spells: Sequence[tuple[float, float]] = (),
    deaf: int | None = None,
    finds_back: bool = False,
) -> Flown:
    """Fly on; arguments as of `fly`."""
    rng, state, logged = copy.deepcopy(flown)
    q, estimate, rate, velocity, thrust, gust = state
    held, begin, time = 0.0, len(logged[0]), np.arange(0.0, seconds, DT)
    logged = [np.concatenate([part, np.zeros((len(time) - begin, part.shape[1]))]) for part in logged]
    rates, forces, commands, attitudes, velocities = logged
    for row, now in enumerate(time[begin:], begin):
        late = float(now >= ONSET)
        wanted = 0.15 * np.array([np.sin(0.9 * now), np.cos(0.7 * now), 0.0])
        believed = rate + (late * gyro if gyro is not None else 0.0)
        if deaf is not None:
            held = held if late else float(rate[deaf])
            believed[deaf] = held
        tilt = 2.0 * estimate[:3] * np.sign(estimate[3])
        asked = -30.0 * (tilt - wanted) - 10.0 * believed
        command = np.clip(HOVER + MIX @ asked, 0.0, 1.0)
        command = command * float(now < stop)
        thrust += DT / 0.04 * (command - thrust)
        given = thrust.copy()
        if lost is not None:
            given[lost[0]] *= 1.0 - lost[1] * float(any(first <= now < last for first, last in spells))
        gust += DT * (-gust / 0.5 + 2.0 * rng.standard_normal(3) / np.sqrt(DT))
        rate = rate + DT * (given @ GAINS + gust)
        back_to = (q - estimate)[:3] if finds_back else 0.0
        q, estimate = turn(q, rate * DT), turn(estimate, (believed + back_to) * DT)
        lift = np.array([0.0, 0.0, given.sum() / (4 * HOVER) * 9.80665])
        velocity = velocity + DT * (to_earth(q, lift) - GRAVITY)
        rates[row], forces[row], commands[row] = rate if deaf is None else believed, lift, command
        attitudes[row], velocities[row] = estimate, velocity
    return Flown(rng, (q, estimate, rate, velocity, thrust, gust), logged)


def fly(
    lost: tuple[int, float] | None = None,
    gyro: np.ndarray | None = None,
    force: np.ndarray | None = None,
    imus: int = 2,
    wrong: tuple[int, ...] = (0,),
    seconds: float = 25.0,
    stop: float = np.inf,
    back: float = np.inf,
    spells: Sequence[tuple[float, float]] = (),
    deaf: int | None = None,
    finds_back: bool = False,
    seed: int = 3,
) -> FlightLog:
    """A quadrotor in gusts that its own first gyro steers; from `ONSET` on the faults act.

    ``lost`` is a rotor and the share of its thrust; ``gyro`` and ``force`` are offsets of the IMUs ``wrong``.
    At ``stop`` the rotors are switched off, at ``back`` the lost one gives its thrust again, or it is lost in
    ``spells`` alone. ``deaf``: all gyros are stuck about this axis, before noise is logged.
    ``finds_back``: the estimate does, slowly.
    """
    begun = until_onset(seed, finds_back) if deaf is None else at_rest(seed)
    steered = gyro if 0 in wrong else None
    spells = spells or ((ONSET, back),)
    rng, _, logged = steer(begun, seconds, lost, steered, stop, spells, deaf, finds_back)
    rates, forces, commands, attitudes, velocities = logged
    time = np.arange(0.0, seconds, DT)

    def thinned(values: np.ndarray, period: float, noise: float = 0.0) -> Signal:
        stride = round(period / DT)
        part = values[::stride]
        return Signal(time[::stride], part + noise * rng.standard_normal(part.shape))

    late = (time >= ONSET)[:, None]
    names = ("", "1", "2")[:imus]
    sensors = {"gyros": (rates, gyro, 0.003), "accelerometers": (forces, force, 0.05)}
    imu = {
        kind: {
            name: thinned(values + late * (offset if offset is not None and k in wrong else 0.0), 0.04, noise)
            for k, name in enumerate(names)
        }
        for kind, (values, offset, noise) in sensors.items()
    }
    return FlightLog(
        path=Path("slow"),
        format="ArduPilot BIN",
        **imu,
        attitude=thinned(attitudes, 0.1),
        attitude_from_gyro=True,
        velocity=thinned(velocities, 0.4),
        gps_velocities={"": thinned(velocities, 0.2, 0.01)},
        rotor_commands=thinned(commands, 0.1),
        battery=Signal(time[::20], np.full((len(time[::20]), 1), 12.0)),
        rotor_positions=PLACES,
        rotor_yaw_signs=SIGNS,
    )


@functools.cache
def healthy(imus: int = 2) -> FlightLog:
    return fly(imus=imus)


def judge(log: FlightLog) -> Verdict:
    return inspect(log).verdict


def test_loss_in_the_last_seconds_is_named_where_speeds_are_slow():
    log = fly(lost=(1, 0.5), seconds=ONSET + 0.9)
    every = slice(None, None, 20)  # 0.5 Hz: the last comes before the loss
    speeds = Signal(log.rotor_commands.time[every], 800.0 * np.sqrt(log.rotor_commands.value[every]))
    verdict = inspect(dataclasses.replace(log, rotor_speeds=speeds)).verdict
    assert [(each.component, each.element) for each in verdict.findings] == [("rotor", "2")]


def test_healthy_flight_is_healthy_as_all_of_it_was_judged():
    verdict = judge(healthy())
    assert (verdict.outcome, verdict.findings, verdict.advice) == ("healthy", (), ())
    assert verdict.ending.kind == "in flight"


def test_torque_that_the_ground_answers_is_no_lost_rotor():
    log, rng = fly(seconds=30.0), np.random.default_rng(9)
    for sensors, rest in ((log.gyros, np.zeros(3)), (log.accelerometers, GRAVITY)):
        for sensor in sensors.values():
            down = sensor.time > 20.0
            sensor.value[down] = rest + 0.003 * rng.standard_normal((down.sum(), 3))
    assert log.attitude is not None
    assert log.velocity is not None
    assert log.rotor_commands is not None
    for signal, rest in (
        (log.attitude, [0.0, 0.0, 0.0, 1.0]),
        (log.velocity, 0.0),
        *((each, 0.0) for each in log.gps_velocities.values()),
    ):
        signal.value[signal.time > 20.0] = rest
    time, commands = log.rotor_commands
    asked = 0.04 * np.clip(time - 20.0, 0.0, 3.0)[:, None] * PLACES[:, 0]
    commands[:] = np.where(
        time[:, None] > 20.0, np.where(time[:, None] < 27.0, 0.8 * HOVER + asked, 0.0), commands
    )
    verdict = judge(log)
    assert (verdict.findings, verdict.ending.kind) == ((), "landed")
    assert verdict.flight_s == pytest.approx(19.0, abs=1.0)


def test_rotors_that_shake_a_vehicle_on_the_ground_fly_nothing():
    rng, log = np.random.default_rng(4), healthy(1)
    assert log.rotor_commands is not None
    (name, gyro), (time, commands) = next(iter(log.gyros.items())), log.rotor_commands
    turning = (gyro.time > 5.0) & (gyro.time < 20.0)
    rates = (0.005 + 0.2 * turning[:, None]) * rng.standard_normal(gyro.value.shape)
    rates[(gyro.time > 5.0) & (gyro.time < 6.0), 0] += 0.1  # it settles as they begin to turn
    uneven = 0.25 * np.array([1.5, 0.7, 1.1, 0.7])
    held = dataclasses.replace(
        log,
        gyros={name: Signal(gyro.time, rates)},
        accelerometers={name: Signal(gyro.time, GRAVITY + 0.1 * rng.standard_normal(rates.shape))},
        attitude=None,
        rotor_commands=Signal(time, ((time > 5.0) & (time < 20.0))[:, None] * (uneven + 0.0 * commands)),
        velocity=Signal(time, 0.05 * rng.standard_normal((len(time), 3))),
        gps_velocities={},
    )
    said = [each.reason for each in judge(held).not_judged if each.component == "rotor"]
    assert (judge(held).findings, said) == ((), ["the ground holds the vehicle whenever the rotors turn"])


@pytest.mark.parametrize(("rotor", "share"), sampled([0, 3], [0.4, 1.0], every=3))
def test_rotor_that_loses_thrust_is_the_first_cause(rotor: int, share: float):
    verdict = judge(fly(lost=(rotor, share), seconds=ONSET + 3.0))
    first = verdict.findings[0]
    assert (first.component, first.element) == ("rotor", str(rotor + 1))
    assert first.onset_s == pytest.approx(ONSET, abs=0.3)
    assert verdict.outcome == "fault"


@pytest.mark.parametrize(("rotor", "lasts"), sampled([0, 3], [0.8, 6.0], every=3))
def test_loss_of_a_rotor_that_ends_is_not_taken_for_one_of_the_rotor_that_faces_it(rotor: int, lasts: float):
    (found,) = judge(fly(lost=(rotor, 0.5), back=ONSET + lasts, seconds=ONSET + 15.0)).findings
    assert (found.component, found.element) == ("rotor", str(rotor + 1))
    assert (found.onset_s, found.end_s) == pytest.approx((ONSET, ONSET + lasts), abs=0.3)
    assert found.ambiguous_with == ("push from outside",)


def test_rotor_that_goes_again_and_again_is_named_from_its_first_spell_to_its_last():
    spells = ((15.0, 16.0), (18.0, 18.8), (21.0, 22.0))
    (found,) = judge(fly(lost=(1, 0.6), spells=spells, seconds=30.0)).findings
    assert (found.component, found.element, found.ambiguous_with) == ("rotor", "2", ())
    assert (found.onset_s, found.end_s) == pytest.approx((15.0, 22.0), abs=0.3)
    assert "it is gone 3 times" in " ".join(found.evidence)


def lost_for_an_instant(turns: float) -> RotorStep | None:
    """What is found if a torque is asked for that faces the second rotor, from 10 to 10.8 s.

    The vehicle turns by it, by ``turns`` [rad/s²] for a torque of 1, and the model does not know.
    """
    rng, time = np.random.default_rng(0), np.arange(0.0, 20.0, 0.02)
    layout = np.array([[0.5, -0.5, 0.5, -0.5], [-0.5, 0.5, 0.5, -0.5]])
    asked = 0.01 * rng.standard_normal((len(time), 2))
    asked[(time >= 10.0) & (time < 10.8)] += 0.4 * layout[:, 1]
    columns = np.stack([turns * asked, np.zeros_like(asked), np.zeros_like(asked)], axis=-1)
    flying = np.ones(len(time), np.bool_)
    part = Torque(time, np.full((len(time), 4), 0.5), asked, columns, flying, layout)
    return search(part, np.zeros((2, 3)), np.zeros((2, 3, 3)))


def test_inertia_that_a_model_does_not_know_is_no_loss_of_a_rotor():
    found = lost_for_an_instant(turns=0.0)
    assert found is not None
    assert (found.rotor, found.end) == (1, pytest.approx(10.8, abs=0.1))
    assert lost_for_an_instant(turns=30.0) is None


def test_gyro_that_turns_noisy_is_named_at_25_hz_and_one_that_turns_fast_is_not():
    log, late = healthy(), np.arange(0.0, 25.0, 0.04)[:, None] >= ONSET
    sensor, axis = log.gyros[""], np.array([1.0, 0.0, 0.0])
    noise = 0.3 * np.random.default_rng(1).standard_normal((len(sensor), 1))
    swing = 2.0 * np.sin(6.0 * sensor.time)[:, None]

    def both(more: np.ndarray) -> FlightLog:
        gyros = {name: Signal(each.time, each.value + late * more * axis) for name, each in log.gyros.items()}
        return dataclasses.replace(log, gyros=gyros)

    first = judge(both(noise)).findings[0]
    assert (first.component, first.element, first.kind) == ("gyro", "x", "noise")
    assert (first.onset_s, first.size) == (pytest.approx(ONSET, abs=0.5), pytest.approx(0.3, rel=0.2))
    assert all(each.kind != "noise" for each in judge(both(swing)).findings)


@pytest.mark.parametrize(("axis", "noise"), [(0, 0.0), (1, 0.05), (2, 0.05)])
def test_gyros_that_are_stuck_behind_noise_are_named_as_the_rotors_turn_the_vehicle(axis: int, noise: float):
    log, rng = fly(deaf=axis, finds_back=True, seconds=ONSET + 5.0), np.random.default_rng(4)
    for gyro in log.gyros.values():
        late = gyro.time >= ONSET
        gyro.value[late, axis] += noise * rng.standard_normal(late.sum())  # far above the usual
    first = judge(log).findings[0]
    assert (first.component, first.element, first.kind) == ("gyro", "xyz"[axis], "stuck")
    assert first.onset_s == pytest.approx(ONSET, abs=0.5)


def test_wrong_gyro_of_two_is_named_though_the_controller_follows_it():
    (found,) = judge(fly(gyro=np.array([0.0, 0.3, 0.0]))).findings
    assert (found.component, found.element, found.kind) == ("gyro", "y", "offset")
    assert found.size == pytest.approx(0.3, abs=0.02)
    assert found.onset_s == pytest.approx(ONSET, abs=0.1)


def test_wrong_accelerometer_of_two_is_named_by_the_velocity_of_satellites():
    (found,) = judge(fly(force=np.array([2.0, 0.0, 0.0]), wrong=(1,))).findings
    assert (found.component, found.element) == ("accelerometer 1", "x")
    assert found.size == pytest.approx(2.0, abs=0.1)


def test_wrong_accelerometer_of_three_is_the_one_that_differs_from_both():
    log = dataclasses.replace(fly(force=np.array([0.0, 0.0, 3.0]), imus=3, wrong=(1,)), gps_velocities={})
    (found,) = judge(log).findings
    assert (found.component, found.element) == ("accelerometer 1", "z")


def test_fault_that_all_imus_share_is_seen_by_the_path():
    (found,) = judge(fly(force=np.array([0.0, 2.0, 0.0]), wrong=(0, 1))).findings
    assert (found.component, found.element) == ("accelerometer", "y")
    assert found.size == pytest.approx(2.0, abs=0.2)
    first = judge(fly(gyro=np.array([0.15, 0.0, 0.0]), wrong=(0, 1), seconds=ONSET + 5.0)).findings[0]
    assert (first.component, first.element) == ("gyro", "x")
    assert first.size == pytest.approx(0.15, abs=0.03)


@pytest.mark.parametrize(("axis", "imus"), sampled([0, 1], [1, 2], every=3))
def test_offset_that_all_gyros_share_is_theirs_though_the_attitude_finds_back(axis: int, imus: int):
    offset = 0.1 * np.eye(3)[axis]
    log = fly(gyro=offset, wrong=(0, 1), imus=imus, seconds=45.0, finds_back=True)
    log = dataclasses.replace(log, gps_velocities={}, velocity=None)  # gyros and attitude alone tell
    first = judge(log).findings[0]
    assert (first.component, first.element, first.kind) == ("gyro", "xy"[axis], "offset")
    assert first.size == pytest.approx(0.1, rel=0.3)


@pytest.mark.parametrize(("element", "imus"), sampled(["roll", "pitch"], [1, 2], every=3))
def test_attitude_that_jumps_is_named_not_the_accelerometer_that_the_path_then_blames(
    element: str, imus: int
):
    log, tilt = healthy(imus), 0.25 * np.eye(3)[["roll", "pitch"].index(element)]
    assert log.attitude is not None
    time, q = log.attitude
    log = dataclasses.replace(
        log, attitude=Signal(time, np.where((time >= ONSET)[:, None], turn(q, tilt), q))
    )
    (found,) = judge(log).findings
    assert (found.component, found.element, found.kind) == ("attitude", element, "offset")
    assert (found.onset_s, found.size) == pytest.approx((ONSET, 0.25), abs=0.02)


@pytest.mark.parametrize(("swing", "creeps"), [(1.5, 0), (0.0, 1)])
def test_turn_that_a_lagging_attitude_shows_one_sample_late_is_no_creep(swing: float, creeps: int):
    time, dt = np.arange(0.05, 20.0, 0.05), 0.05
    rest = 0.001 * np.random.default_rng(1).standard_normal((len(time), 3))
    rest[200:202, 2] -= 0.5 * dt * 1.5  # by as much as a turn of 1.5 rad/s that begins there
    turn_ = np.zeros_like(rest)
    turn_[200:, 2] = swing * dt
    agreement = Agreement(time, np.full(len(time), dt), rest, np.zeros(3), turn_)
    assert len(find_creeps(agreement, np.ones(len(time), np.bool_), ())) == creeps


def test_log_without_rotors_is_not_enough_to_say_and_says_what_to_set():
    log = dataclasses.replace(healthy(), rotor_commands=None, events=(Event(0.0, "MSG", "Frame: QUAD/X"),))
    verdict = judge(log)
    assert (verdict.outcome, verdict.healthy) == ("not enough to say", False)
    assert verdict.sentence.startswith("Not enough to say: rotor")
    assert "LOG_BITMASK bits 0" in verdict.advice[0]


def test_voltage_that_is_not_measured_is_no_matter_of_what_is_logged():
    battery = healthy().battery
    log = dataclasses.replace(healthy(), battery=Signal(battery.time, 0.004 * battery.value))
    verdict = judge(log)
    assert verdict.outcome == "not enough to say"
    assert verdict.advice == ("connect what measures the battery, and calibrate its voltage",)


@pytest.mark.parametrize(
    ("sinks", "says"), [(4.0, "it hit the ground at 4 m/s at "), (0.0, "it hit the ground at 24.")]
)
def test_impact_is_told_with_the_speed_of_the_fall_if_there_was_one(sinks: float, says: str):
    log = healthy()
    falls = np.where(log.velocity.time > 23.0, -sinks, 0.1)[:, None] * [0.0, 0.0, 1.0]
    forces = {
        name: Signal(each.time, each.value + (np.abs(each.time - 24.5) < 0.1)[:, None] * [60.0, 0.0, 60.0])
        for name, each in log.accelerometers.items()
    }
    log = dataclasses.replace(log, velocity=Signal(log.velocity.time, falls), accelerometers=forces)
    assert judge(log).ending.sentence.startswith(says)


def test_rotors_that_are_switched_off_in_the_air_are_no_fault():
    log = fly(stop=20.0, seconds=22.0)
    force, end = log.accelerometers[""], np.array([100.0, 0.0, 0.0])
    log.accelerometers[""].value[force.time > 21.9] = end  # it hits the ground
    verdict = judge(log)
    assert (verdict.outcome, verdict.ending.kind) == ("healthy", "switched off in the air")
    assert verdict.ending.time_s == pytest.approx(20.0, abs=0.2)
    assert verdict.sentence.startswith("The rotors were stopped in the air")


def with_flown(turned: float = 0.0, moved: float = 0.0, events: tuple[Event, ...] = ()) -> FlightLog:
    """A healthy flight with the position and lean that its controller sees, wrong from `ONSET` on."""
    log = healthy()
    assert log.attitude is not None
    assert log.velocity is not None
    time = log.attitude.time
    late = (time >= ONSET)[:, None]
    up = to_earth(log.attitude.value, np.array([0.0, 0.0, 1.0]))
    lean = 9.80665 * (up[:, 0] + 1j * up[:, 1]) / up[:, 2] * np.exp(1j * turned * late[:, 0])
    position = np.cumsum(
        np.vstack([np.zeros(3), np.diff(log.velocity.time)[:, None] * log.velocity.value[1:]]), 0
    )
    own = Signal(log.velocity.time, position)
    return dataclasses.replace(
        log,
        position=own,
        flown_position=Signal(time, own.at(time) + late * [0.0, moved, 0.0]),
        flown_acceleration=Signal(time, np.stack([lean.real, lean.imag], axis=-1)),
        events=events,
    )


def test_position_that_changes_on_its_way_to_the_controller_is_named():
    assert judge(with_flown()).outcome == "healthy"
    (found,) = judge(with_flown(moved=6.0)).findings
    assert (found.component, found.element, found.ambiguous_with) == ("position", "north", ("gps",))
    assert (found.onset_s, found.size) == pytest.approx((ONSET, 6.0), abs=0.15)


def test_heading_that_changes_on_its_way_to_the_controller_is_named():
    (found,) = judge(with_flown(turned=0.4)).findings
    assert (found.component, found.element, found.size) == ("attitude", "yaw", pytest.approx(0.4, abs=0.05))


def test_words_of_the_autopilot_choose_between_causes_that_look_alike():
    said = (Event(ONSET + 0.1, "MSG", "GPS 1 glitch"),)
    (found,) = judge(with_flown(moved=6.0, events=said)).findings
    assert (found.component, found.ambiguous_with) == ("gps", ("position/north",))
    assert "GPS 1 glitch" in found.evidence[-1]


@pytest.mark.parametrize(
    ("text", "outcome"),
    [
        ("EKF variance", "not enough to say"),
        ("Radio failsafe: error 1", "healthy"),
        ("Reached waypoint 3", "healthy"),
    ],
)
def test_failure_that_the_autopilot_alone_reports_leaves_the_outcome_open(text: str, outcome: str):
    verdict = judge(dataclasses.replace(healthy(), events=(Event(10.0, "MSG", text),)))
    assert (verdict.outcome, verdict.findings) == (outcome, ())
    assert (text in verdict.sentence) == (outcome != "healthy")


def with_vibration(level: float, before: float = 1.0) -> FlightLog:
    time = np.arange(0.0, 25.0, 0.2)
    values = np.where(time[:, None] < ONSET, before, [level, level, before])
    clips = Signal(time, np.cumsum(time > 20.0)[:, None].astype(float))
    return dataclasses.replace(healthy(), vibration=Signal(time, values), clips=clips)


def test_vibration_that_rises_in_flight_is_named_with_the_samples_at_the_limit():
    assert judge(with_vibration(3.0)).outcome == "healthy"
    (found,) = judge(with_vibration(17.0)).findings
    assert (found.component, found.element, found.kind) == ("vibration", "x,y", "rise")
    assert (found.onset_s, found.size) == pytest.approx((ONSET, 12.9), abs=0.2)
    assert "24 samples are at the limit" in found.evidence[1]


def test_vibration_that_rises_and_falls_again_in_less_than_two_seconds_is_none():
    log = with_vibration(17.0)
    assert log.vibration is not None
    log.vibration.value[log.vibration.time > ONSET + 1.5] = 1.0
    assert judge(log).outcome == "healthy"


def test_vibration_rises_in_no_flight_in_which_it_never_was_lower():
    log = with_vibration(17.0, before=17.0)
    assert log.vibration is not None
    log.vibration.value[:3] = 1.0  # the autopilot's filter begins low
    assert judge(log).outcome == "healthy"
    (found,) = judge(with_vibration(40.0, before=40.0)).findings
    assert (found.component, found.kind, found.size) == ("vibration", "noise", pytest.approx(40.0))
    assert judge(with_vibration(40.0, before=40.0)).sentence.startswith("Vibration x,y,z is harmful")


def test_voltage_that_sags_step_by_step_is_dated_to_its_first_step():
    time = np.arange(0.0, 25.0, 0.2)
    volts = 12.6 - np.clip(np.ceil((time - ONSET) / 1.5), 0.0, 6.0) * 0.5
    (found,) = judge(dataclasses.replace(healthy(), battery=Signal(time, volts[:, None]))).findings
    assert (found.component, found.kind) == ("battery", "brownout")
    assert found.onset_s == pytest.approx(ONSET, abs=0.3)


def test_accelerometer_that_says_an_impossible_path_is_named_without_satellites():
    log = dataclasses.replace(fly(imus=1, seconds=60.0), gps_velocities={})
    assert judge(log).findings == ()
    force = log.accelerometers[""]
    force.value[force.time >= 40.0, 2] += 2.0  # the estimated velocity stays right
    (found,) = judge(log).findings
    assert (found.component, found.element) == ("accelerometer", "z")
    assert found.size == pytest.approx(2.0, abs=0.2)
    assert found.onset_s == pytest.approx(40.0, abs=0.5)


def test_second_gyro_tells_whether_gyro_or_attitude_creeps():
    creep = Creep(0, Interval(10.0, 20.0), 0.1, 0.01, 2.0, None)
    time = np.arange(0.0, 20.0, 0.04)
    still = Signal(time, np.zeros((len(time), 3)))
    wrong = Signal(time, np.where(time[:, None] > 10.0, [0.1, 0.0, 0.0], 0.0))
    half = Signal(time, 0.5 * wrong.value)
    owners = [
        owner_by_other(creep, {"": first, "1": still}, is_own)
        for first, is_own in ((wrong, False), (still, False), (half, False), (still, True))
    ]
    assert [each and each.component for each in owners] == ["gyro", "attitude", None, None]
    assert owner_by_other(creep, {"": wrong}, False) is None
    ended = Signal(still.time[still.time < 1.0], still.value[still.time < 1.0])
    assert owner_by_other(creep, {"": wrong, "1": ended}, False) is None


def test_what_goes_beyond_a_limit_is_told_in_the_timeline_alone():
    log = healthy()
    assert log.rotor_commands is not None
    time = np.arange(0.0, 25.0, 0.2)
    ratio = np.where((time > 12.0) & (time < 14.0), 1.4, 0.1)[:, None]
    voltage = np.where(np.abs(time - 20.0) < 0.05, 4.1, 5.0)[:, None]
    commands = log.rotor_commands.value.copy()
    commands[log.rotor_commands.time > 24.0, 1] = 1.0
    watched = (
        Watched("EKF innovation of the height", Signal(time, ratio), 1.0),
        Watched("board voltage", Signal(time, voltage), 4.3, "V", is_least=True),
        Watched("load of the processor", Signal(time, 0.5 + 0.0 * ratio), 0.95),
    )
    outputs = Signal(log.rotor_commands.time, commands)
    verdict = judge(dataclasses.replace(log, watched=watched, rotor_commands=outputs))
    told = [each.text for each in verdict.timeline if each.source == "log"]
    assert told[:2] == [
        "EKF innovation of the height: 1.4, limit 1 for 1.6 s",
        "board voltage: 4.1 V, least 4.3",
    ]
    assert told[2].startswith("rotor 2 has no more to give, command: 1, limit 0.95")
    assert {each.component for each in verdict.findings} == {"rotor"}  # and what it asks for does not come


def test_noise_of_one_gyro_of_two_ends_in_no_error():
    log = healthy()
    for seed in range(8):
        gyro = log.gyros[""]
        noise = 0.5 * np.random.default_rng(seed).standard_normal(len(gyro)) * (gyro.time > 12.0 + 0.1 * seed)
        noisy = Signal(gyro.time, gyro.value + noise[:, None] * [0.0, 1.0, 0.0])
        for found in judge(dataclasses.replace(log, gyros={**log.gyros, "": noisy})).findings:
            assert found.sigma is None or np.isfinite(found.sigma)


def test_rotor_that_two_tests_name_is_as_sure_as_the_surer_says():
    stopped = make_found("rotor", "2", "off", 15.1, probability=0.6, ambiguous_with=("command",))
    lost = make_found("rotor", "2", "off", 15.0, probability=0.98)
    (found,) = first_failed(stopped, lost)
    assert found.finding.probability == 0.98
    assert (found.finding.onset_s, found.finding.ambiguous_with) == (15.0, ())
