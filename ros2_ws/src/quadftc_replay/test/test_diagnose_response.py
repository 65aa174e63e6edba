"""A vehicle that answers its commands the wrong way from take-off is told from one that lost a rotor."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from sampling import sampled
from scipy.spatial.transform import Rotation

from quadftc_replay.flight_log import FlightLog, Floats, Signal
from quadftc_replay.inspection.flight import prepare
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.response import Motion, find_wiring, response_findings, wirings, yaw_reversed
from quadftc_replay.inspection.rotor_trim import normalised
from quadftc_replay.readers import read_log
from quadftc_replay.readers.layouts import frame_layout
from quadftc_replay.writers import WRITERS

RATE, LIFTS, SECONDS = 400.0, 3.0, 8.0  # Hz, s, s
LAYOUT = frame_layout(4, "x")
assert LAYOUT is not None
BODY = normalised(np.stack([LAYOUT.positions[:, 1], -LAYOUT.positions[:, 0], LAYOUT.yaw_signs]))
GAIN, LAG = np.array([120.0, 120.0, 12.0]), 0.04  # rad/s² of a torque, s of the rotors
HOVER, WORK, NOTHING = 0.5, np.ones(4), np.zeros(3)
WIRINGS = wirings(BODY, LAYOUT.positions)


def take_off(
    wired: Floats, works: Floats = WORK, push: Floats = NOTHING, since: float = LIFTS, seed: int = 0
) -> FlightLog:
    """A quadrotor that is held by the ground until 3 s, and then flies.

    From some time [s] on it has the layout ``wired`` (3, 4), its rotors give the share ``works`` of their
    thrust, and for half a second ``push`` [rad/s²] turns it. On its side it lies still, with rotors stopped.
    """
    rng, time = np.random.default_rng(seed), np.arange(0.0, SECONDS, 1.0 / RATE)
    turned, rate, lagged, kept = Rotation.identity(), np.zeros(3), np.zeros(4), np.zeros(3)
    rates, commands, attitudes = np.zeros((len(time), 3)), np.zeros((len(time), 4)), np.zeros((len(time), 4))
    is_over = False
    for k, now in enumerate(time):
        up = turned.inv().apply([0.0, 0.0, 1.0])
        yaw = 2.0 * np.arctan2(turned.as_quat()[2], turned.as_quat()[3])
        wanted = np.clip(np.array([-4.0 * up[1], 4.0 * up[0], -2.0 * yaw]), -3.0, 3.0)
        is_over |= bool(up[2] < 0.0)
        thrust = 0.0 if is_over or now < 1.0 else HOVER * np.clip((now - 1.0) / (LIFTS - 1.0), 0.1, 1.0)
        if now > LIFTS:
            kept = np.clip(kept + 10.0 * (wanted - rate) / RATE, -20.0, 20.0)
        asked = BODY.T @ ((10.0 * (wanted - rate) + kept) / GAIN)
        commands[k] = np.clip(thrust + asked, 0.02, 1.0) if thrust > 0.0 else 0.0
        lagged += (commands[k] - lagged) / (LAG * RATE)
        if now > LIFTS and not is_over:
            gust = 2.0 * rng.standard_normal(3) * [1.0, 1.0, 0.2]
            torque = wired @ (works * lagged) if now >= since else BODY @ lagged
            pushed = push * (since <= now < since + 0.5)
            rate = rate + (GAIN * torque + pushed + gust) / RATE
            turned = turned * Rotation.from_rotvec(rate / RATE)
        elif is_over:
            rate = np.zeros(3)
        rates[k], attitudes[k] = rate, turned.as_quat()
    force = Rotation.from_quat(attitudes).inv().apply([0.0, 0.0, 9.81])
    return FlightLog(
        path=Path("take off"),
        format="test",
        gyros={"": Signal(time, rates + 0.005 * rng.standard_normal(rates.shape))},
        accelerometers={"": Signal(time, force + 0.1 * rng.standard_normal(force.shape))},
        attitude=Signal(time, attitudes),
        attitude_from_gyro=True,
        rotor_commands=Signal(time, commands),
        battery=Signal(time, 16.0 - 0.01 * time[:, None]),
        rotor_positions=LAYOUT.positions,
        rotor_yaw_signs=LAYOUT.yaw_signs,
    )


def judge(log: FlightLog):
    return inspect(log).verdict


WRONG = {
    "the autopilot turned by 90 deg": ("roll,pitch", "exchanged"),
    "yaw reversed": ("yaw", "reversed"),
    "roll reversed": ("roll", "reversed"),
    "pitch reversed": ("pitch", "reversed"),
    "roll and pitch exchanged": ("roll,pitch", "exchanged"),
    "motors 1 and 3 exchanged": ("roll,yaw", "exchanged"),
    "motors 2 and 3 exchanged": ("pitch,yaw", "reversed"),
}


@pytest.mark.parametrize("wiring", sampled(WRONG, every=3))
def test_vehicle_that_answers_the_wrong_way_from_take_off_is_named_first(wiring: str):
    element, kind = WRONG[wiring]
    found = judge(take_off(WIRINGS[wiring])).findings[0]
    assert (found.component, found.element, found.kind) == ("response", element, kind)
    assert LIFTS < found.onset_s < LIFTS + 1.0


@pytest.mark.parametrize("autopilot", sorted(WRITERS))
def test_default_log_of_an_autopilot_tells_that_roll_is_reversed(autopilot: str, tmp_path: Path):
    path = tmp_path / "log"
    WRITERS[autopilot](take_off(WIRINGS["roll reversed"]), path)
    verdict = judge(read_log(path))
    assert verdict.outcome == "fault"
    assert verdict.sentence.startswith("Roll answers its command the wrong way from 3.")


@pytest.mark.parametrize("rotor", sampled(range(4), every=2))
def test_rotor_that_gives_no_thrust_at_take_off_is_no_wrong_answer(rotor: int):
    works = np.where(np.arange(4) == rotor, 0.0, 1.0)
    found = judge(take_off(BODY, works)).findings
    assert [(each.component, each.element) for each in found] == [("rotor", str(rotor + 1))]


def test_sound_vehicle_answers_the_right_way_even_if_something_pushes_it_over():
    assert response_findings(prepare(take_off(BODY))) == []
    pushed = take_off(BODY, push=np.array([130.0, 40.0, 0.0]))
    assert pushed.attitude is not None
    assert np.any(Rotation.from_quat(pushed.attitude.value).as_matrix()[:, 2, 2] < 0.0)  # it turns over
    assert response_findings(prepare(pushed)) == []


@pytest.mark.parametrize(("rising", "may_be_held"), [(0.0, False), (1.0, True)])
def test_ground_is_named_as_well_where_more_thrust_may_turn_the_vehicle_over(
    rising: float, may_be_held: bool
):
    time = np.linspace(0.01, 0.3, 30)
    asked = np.stack([-time, *np.zeros((2, len(time)))], axis=1)  # roll, ever more against the motion
    integral = np.cumsum(asked @ BODY + (HOVER + rising * time)[:, None], axis=0) * time[0]
    turned = -GAIN * np.cumsum(asked, axis=0) * time[0]
    wiring = find_wiring(Motion(time, turned, {0.0: integral}), BODY, LAYOUT.positions)
    assert wiring is not None
    assert wiring.wrong == (0,)
    assert ("held by the ground" in wiring.others) == may_be_held


@pytest.mark.parametrize("roll", [0.0, 0.2])
def test_vehicle_that_spins_while_a_weak_rotor_takes_a_trim_is_wired_right(roll: float):
    time = np.linspace(0.01, 0.6, 60)
    asked = np.stack([np.full(len(time), roll), np.zeros(len(time)), -time], axis=1)
    integral = np.cumsum(asked @ BODY + HOVER, axis=0) * time[0]
    turned = -GAIN * np.cumsum(asked, axis=0) * time[0] * [0.0, 0.0, 1.0]
    wiring = yaw_reversed(Motion(time, turned, {0.0: integral}), BODY, LAYOUT.positions)
    assert (wiring is None) == (roll > 0.0)


def test_vehicle_that_flew_before_it_turns_over_is_wired_right():
    log = take_off(WIRINGS["roll reversed"], push=np.array([3.0, 0.0, 0.0]), since=6.0)
    assert log.attitude is not None
    assert Rotation.from_quat(log.attitude.value).as_matrix()[-1, 2, 2] < 0.5
    assert response_findings(prepare(log)) == []


def test_wrong_answer_hides_no_sensor_that_fails_before():
    log = take_off(WIRINGS["roll reversed"])
    second = Signal(log.gyros[""].time, log.gyros[""].value.copy())
    second.value[second.time > 1.5] = second.value[second.time <= 1.5][-1]
    found = judge(dataclasses.replace(log, gyros={**log.gyros, "1": second})).findings
    assert found[0].component == "response"
    assert ("gyro 1", "stuck") in [(each.component, each.kind) for each in found]


def test_rotor_that_stands_by_its_measured_speed_explains_a_flip_alone():
    log = take_off(WIRINGS["roll reversed"])
    assert log.rotor_commands is not None
    speeds = Signal(log.rotor_commands.time, 800.0 * np.sqrt(log.rotor_commands.value))
    turning = dataclasses.replace(log, rotor_speeds=speeds)
    assert [each.finding.name for each in response_findings(prepare(turning))] == ["response roll"]
    speeds.value[:, 1] = 0.0
    assert [each.finding.name for each in response_findings(prepare(turning))] == ["rotor 2"]
