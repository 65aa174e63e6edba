"""A flight log judged: healthy flights give no finding, faults are named with sensor, axis and time."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from sampling import sampled
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.agreement import Agreement, parts_by
from quadftc_replay.inspection.attitude import Creep
from quadftc_replay.inspection.battery import battery_findings
from quadftc_replay.inspection.diagnosis import write_verdict, write_verdict_junit
from quadftc_replay.inspection.flight import Interval, prepare
from quadftc_replay.inspection.found import make_finding
from quadftc_replay.inspection.gyro import gyro_findings
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.inspection.verdict import Verdict, schema
from quadftc_replay.inspection.whitening import find_steps
from quadftc_replay.overlay import faults_from

ROOT = Path(__file__).resolve().parents[4]
RATE, SECONDS = 250.0, 30.0


def hover(seed: int = 0) -> FlightLog:
    """A vehicle that rocks in hover: coloured rates, sensor noise, commands that follow."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    torque = rng.standard_normal((len(time), 3))
    rate = lfilter([0.01], [1.0, -0.99], torque, axis=0)
    force = np.array([0.0, 0.0, 9.81]) + 0.2 * rng.standard_normal((len(time), 3))
    commands = 0.5 + 0.02 * torque[:, :1] * np.array([1.0, -1.0, -1.0, 1.0])
    gyro = rate + 0.005 * rng.standard_normal((len(time), 3))
    return FlightLog(
        path=Path("hover"),
        format="test",
        gyros={"": Signal(time, gyro)},
        accelerometers={"": Signal(time, force)},
        rotor_commands=Signal(time, commands),
        battery=Signal(time, 12.0 - 0.01 * time[:, None]),
    )


def findings(*specs: str, log: FlightLog | None = None):
    return inspect(overlay_faults(log or hover(), faults_from((), specs))).verdict.findings


def test_healthy_flight_has_no_finding():
    verdict = inspect(hover()).verdict
    assert verdict.outcome == "not enough to say"  # there is no attitude
    assert verdict.findings == ()
    assert {"gyro", "accelerometer", "battery"} <= set(verdict.judged)
    assert {each.component for each in verdict.not_judged} >= {"attitude"}


@pytest.mark.parametrize(("size", "axis"), sampled([0.2, -0.4], ["x", "y", "z"], every=2))
def test_gyro_step_is_named_with_axis_onset_end_and_size(axis: str, size: float):
    (found,) = findings(f"bias channel=gyro axis={axis} value={size} start=12.0s stop=15s")
    assert (found.component, found.element, found.kind) == ("gyro", axis, "offset")
    assert found.onset_s == pytest.approx(12.0, abs=0.05)
    assert found.end_s == pytest.approx(15.0, abs=0.05)
    assert found.size == pytest.approx(size, abs=4.0 * found.sigma)
    assert found.probability > 0.7


@pytest.mark.parametrize(
    ("spec", "component", "kind"),
    [
        ("stuck channel=gyro axis=y start=20s", "gyro", "stuck"),
        ("saturation channel=gyro axis=x limit=0.1", "gyro", "saturation"),
        ("noise channel=gyro axis=z sigma=0.1 start=10s stop=20s", "gyro", "noise"),
        ("dropout channel=gyro probability=1.0 start=10s stop=12s", "gyro", "absent"),
        ("bias channel=accelerometer axis=x value=3 start=10s", "accelerometer", "offset"),
        ("stuck channel=accelerometer axis=z start=20s", "accelerometer", "stuck"),
    ],
)
def test_kind_of_fault_is_named(spec: str, component: str, kind: str):
    found = findings(spec)
    assert [(each.component, each.kind) for each in found] == [(component, kind)]


def test_gyro_that_creeps_is_named_by_gravity():
    time, rng = np.arange(0.0, 60.0, 0.01), np.random.default_rng(1)
    rate, force = (level + 0.01 * rng.standard_normal((len(time), 3)) for level in (0.0, [0.0, 0.0, 9.81]))
    rate[:, 1] += 0.01 * np.maximum(time - 20.0, 0.0)
    sensors = {"gyros": {"": Signal(time, rate)}, "accelerometers": {"": Signal(time, force)}}
    (found,) = inspect(FlightLog(path=Path("still"), format="test", **sensors)).verdict.findings
    assert (found.name, found.kind) == ("gyro y", "offset")
    assert found.size == pytest.approx(0.4, abs=0.1)


def test_attitude_confirms_a_step_of_the_gyro_where_both_part():
    rng, dt = np.random.default_rng(5), np.full(5000, 1.0 / RATE)
    time = np.cumsum(dt)
    rest = 0.002 * np.diff(rng.standard_normal((5001, 3)), axis=0)  # noise of the attitude [rad]
    rest[2000:, 0] -= 0.2 * dt[2000:]
    agreement = Agreement(time, dt, rest, np.zeros(3), np.zeros((5000, 3)))
    assert parts_by(agreement, 0, float(time[2000]), 0.2)
    assert not parts_by(agreement, 0, float(time[2000]), -0.2)
    assert not parts_by(agreement, 0, float(time[3000]), 0.2)
    assert not parts_by(agreement, 1, float(time[2000]), 0.2)


def findings_at_a_creep(size: float, off: tuple[str, ...], sweep: float = 0.0):
    """What is said of two gyros, some off about x from 12 to 16 s, if the first one parts from the attitude.

    ``sweep`` [s] is how long the offset takes to begin. Returns names with onset [s], and the creeps left.
    """
    log = hover()
    gyro, rng = log.gyros[""], np.random.default_rng(1)
    offset = size * np.clip((gyro.time - 12.0) / max(sweep, 1e-9), 0.0, 1.0) * (gyro.time < 16.0)
    gyros = {
        name: Signal(gyro.time, gyro.value + 0.001 * rng.standard_normal(gyro.value.shape))
        for name in ("", "1")
    }
    for name in off:
        gyros[name].value[:, 0] += offset
    nothing = Agreement(gyro.time, gyro.time, gyro.value, np.zeros(3), gyro.value)  # nobody asks it
    creep = Creep(0, Interval(12.1, 15.9), size, 0.003, 1.5, 15.9)
    flight = prepare(dataclasses.replace(log, gyros=gyros))
    found, left = gyro_findings(flight, gyros, nothing, [creep], is_own=True)
    return [(each.finding.name, each.finding.onset_s) for each in found], left


@pytest.mark.parametrize(("size", "sweep", "onset"), [(0.1, 0.0, 12.0), (0.3, 0.0, 12.0), (0.3, 1.0, 12.1)])
def test_creep_with_a_step_of_the_gyro_where_it_begins_or_ends_is_the_gyros(size, sweep, onset):
    found, left = findings_at_a_creep(size, ("",), sweep)
    assert found == [("gyro x", pytest.approx(onset, abs=0.02))]
    assert not left


@pytest.mark.parametrize("off", [("", "1"), ("1",)], ids=["both", "other"])
def test_creep_is_no_fault_of_a_gyro_if_another_one_steps_as_well_or_alone(off):
    found, left = findings_at_a_creep(0.1, off)
    assert not found
    assert len(left) == 1


def test_knock_is_no_gyro_fault():
    log = hover()
    log.gyros[""].value[5000, 0] += 3.0  # back in the next sample
    assert not inspect(log).verdict.findings


def test_load_that_falls_off_is_no_accelerometer_fault_and_an_offset_that_stays_is():
    log = hover()
    force, late = log.accelerometers[""], log.accelerometers[""].time - 12.0
    force.value[:, 2] += np.where(late > 0.0, 3.0 * np.exp(-late / 0.5), 0.0)
    assert not inspect(log).verdict.findings
    (found,) = findings("bias channel=accelerometer axis=z value=3 start=12s")
    assert (found.component, found.element) == ("accelerometer", "z")


def test_touch_down_that_gyro_and_accelerometer_feel_is_no_gyro_fault():
    log = hover()
    log.gyros[""].value[5000:5500, 0] += 0.3
    assert [each.onset_s for each in inspect(log).verdict.findings] == [pytest.approx(20.0, abs=0.05)]
    log.accelerometers[""].value[5000:5020, 2] += 20.0
    assert [each.onset_s for each in inspect(log).verdict.findings] == [pytest.approx(22.0, abs=0.05)]


def test_accelerometer_that_gets_noisy_hits_no_ground():
    log = hover()
    rng = np.random.default_rng(2)
    log.accelerometers[""].value[4000:, 2] += 30.0 * rng.standard_normal(len(log.gyros[""]) - 4000)
    verdict = inspect(log).verdict
    assert [(each.component, each.element, each.kind) for each in verdict.findings] == [
        ("accelerometer", "z", "noise")
    ]
    assert verdict.ending.kind == "in flight"


@pytest.mark.parametrize("lands", [False, True])
def test_battery_that_takes_the_log_with_it_is_named(lands: bool):
    log = hover()
    assert log.battery is not None
    assert log.rotor_commands is not None
    log.battery.value[-50:] -= 4.0  # for the last 0.2 s
    if lands:  # it is unplugged on the ground
        log.rotor_commands.value[-400:] = 0.0
    assert [each.finding.kind for each in battery_findings(prepare(log))] == ([] if lands else ["brownout"])


def test_battery_that_breaks_down_early_is_named_and_one_that_sags_under_a_load_is_not():
    log = hover()
    assert log.battery is not None
    assert log.rotor_commands is not None
    log.battery.value[3000:] -= 3.0
    (found,) = inspect(log).verdict.findings
    assert (found.component, found.kind, found.onset_s) == (
        "battery",
        "brownout",
        pytest.approx(12.0, abs=0.1),
    )
    loaded = hover()
    assert loaded.battery is not None
    assert loaded.rotor_commands is not None
    pull = np.interp(loaded.battery.time % 10.0, [4.0, 4.5, 5.5, 6.0], [0.0, 1.0, 1.0, 0.0])
    loaded.rotor_commands.value[:] += 0.4 * pull[:, None]
    loaded.battery.value[:, 0] -= 2.5 * pull
    assert not inspect(loaded).verdict.findings


def test_battery_that_a_flight_empties_has_not_broken_down():
    log = hover()
    assert log.battery is not None
    log.battery.value[:, 0] = 16.0 - 4.5 * log.battery.time / SECONDS
    assert not inspect(log).verdict.findings


def test_accelerometers_at_two_places_agree_as_the_vehicle_turns_fast():
    log = hover()
    gyro, force = log.gyros[""], log.accelerometers[""]
    gyro.value[:, 0] += 7.0 * np.exp(-(((gyro.time % 6.0 - 3.0) / 0.4) ** 2))
    rng = np.random.default_rng(3)
    away = -(gyro.value[:, :1] ** 2) * [0.0, 0.03, 0.0] + 0.2 * rng.standard_normal(force.value.shape)
    two = {"": force, "1": Signal(force.time, force.value + away)}
    gyros = {"": gyro, "1": Signal(gyro.time, gyro.value + 0.005 * rng.standard_normal(force.value.shape))}
    log = dataclasses.replace(log, accelerometers=two, gyros=gyros)
    assert not inspect(log).verdict.findings
    two["1"].value[3000:, 1] += 2.0
    assert [each.component for each in inspect(log).verdict.findings] == ["accelerometer 1"]


def test_fault_that_cannot_act_is_refused():
    with pytest.raises(ValueError, match="has no attitude"):
        findings("bias axis=roll value=3deg start=10s")
    with pytest.raises(ValueError, match="before the end"):
        findings("bias channel=gyro value=0.3 start=100s")


def test_false_alarms_of_steps_are_rarer_than_the_level_says():
    rng = np.random.default_rng(1)
    time = np.arange(100_000) / RATE
    values = np.cumsum(rng.standard_normal(len(time))) + 3.0 * rng.standard_normal(len(time))
    steps = find_steps(time, values, np.ones(len(time), np.bool_), 0.0)
    assert np.abs(steps.size / steps.sigma).max() < 6.0
    values[50_000:] += 12.0 * steps.sigma[50_000]
    steps = find_steps(time, values, np.ones(len(time), np.bool_), 0.0)
    assert int(np.argmax(np.abs(steps.size / steps.sigma))) == 50_000


def test_published_schema_is_that_of_the_verdict(tmp_path: Path):
    assert (ROOT / "docs" / "verdict.schema.json").read_text(encoding="utf-8") == schema()
    verdict = inspect(hover()).verdict
    write_verdict(verdict, tmp_path)
    text = (tmp_path / "verdict.json").read_text(encoding="utf-8")
    assert Verdict.model_validate_json(text) == verdict
    assert set(json.loads(text)) == set(json.loads(schema())["required"])


@pytest.mark.parametrize(("lands", "names"), [(20.0, []), (SECONDS, ["gyro x"])])
def test_attitude_and_gyro_may_part_once_the_vehicle_has_landed(lands: float, names: list[str]):
    log = hover()
    assert log.rotor_commands is not None
    time = log.gyros[""].time
    log.rotor_commands.value[time > lands] = 0.0
    slip = np.interp(time, [20.1, 20.5], [0.0, 0.6])  # rad; it falls over, or the gyro is off
    turned = Rotation.from_rotvec(np.cumsum(log.gyros[""].value, axis=0) / RATE)
    attitude = Signal(time, (turned * Rotation.from_euler("x", slip[:, None])).as_quat())
    found = inspect(dataclasses.replace(log, attitude=attitude, attitude_from_gyro=True)).verdict.findings
    assert [each.name for each in found] == names


def test_junit_counts_what_failed(tmp_path: Path):
    log = overlay_faults(hover(), faults_from((), ["stuck channel=gyro axis=y start=20s"]))
    suite = ET.parse(write_verdict_junit(inspect(log).verdict, tmp_path / "verdict.xml")).getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("5", "1", "2")


def test_junit_leaves_open_what_may_be_at_fault_instead(tmp_path: Path):
    verdict = inspect(hover()).verdict
    assert "gyro" in verdict.judged
    finding = make_finding("response", "roll", "reversed", 2.0, ambiguous_with=("gyro/x",))
    verdict = verdict.model_copy(update={"findings": (finding,)})
    suite = ET.parse(write_verdict_junit(verdict, tmp_path / "verdict.xml")).getroot()
    skipped = suite.find("testcase[@name='gyro']/skipped")
    assert skipped is not None
    assert skipped.get("message") == "may be at fault instead of response roll"


PLACES = np.array([[1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
SIGNS = np.array([-1.0, 1.0, -1.0, 1.0])
GAINS = np.stack([60.0 * PLACES[:, 1], -50.0 * PLACES[:, 0], 8.0 * SIGNS], axis=1)  # rad/s² per unit


def rocking(
    lost: int | None = None, onset: float = 20.0, share: float = 1.0, seed: int = 2, after: float = 0.5
) -> FlightLog:
    """A quadrotor that a controller holds level in gusts; ``after`` a rotor lost its share, the log ends."""
    rng = np.random.default_rng(seed)
    dt, time_constant = 1.0 / 500.0, 0.03
    time = np.arange(0.0, onset + after if lost is not None else 30.0, dt)
    angle, rate, thrust, gust = np.zeros(3), np.zeros(3), np.full(4, 0.5), np.zeros(3)
    rates, commands, forces = (np.zeros((len(time), k)) for k in (3, 4, 3))
    for row, now in enumerate(time):
        gust += dt * (-gust / 0.5 + 30.0 * rng.standard_normal(3) / np.sqrt(500.0 * dt))
        wanted = -40.0 * angle - 12.0 * rate + 3.0 * rng.standard_normal(3)
        command = np.clip(0.5 + np.linalg.pinv(GAINS.T) @ wanted, 0.0, 1.0)
        thrust += dt / time_constant * (command - thrust)
        given = thrust * (1.0 - share * (np.arange(4) == lost) * (now >= onset))
        rate = rate + dt * (given @ GAINS + gust)
        angle = angle + dt * rate
        rates[row], commands[row] = rate + 0.05 * rng.standard_normal(3), command
        forces[row] = [0.0, 0.0, 4.905 * given.sum()] + 0.5 * rng.standard_normal(3)
    return FlightLog(
        path=Path("rocking"),
        format="test",
        gyros={"": Signal(time, rates)},
        accelerometers={"": Signal(time, forces)},
        rotor_commands=Signal(time, commands),
    )


@pytest.mark.parametrize(("rotor", "share"), [(0, 1.0), (3, 0.6)])
def test_rotor_lost_in_flight_is_named_without_a_vehicle_file(rotor: int, share: float):
    verdict = inspect(rocking(rotor, share=share)).verdict
    (found,) = verdict.findings
    assert (found.component, found.element) == ("rotor", str(rotor + 1))
    assert found.onset_s == pytest.approx(20.0, abs=0.15)
    assert found.size == pytest.approx(share, abs=0.3)
    assert verdict.model is not None
    assert all(verdict.model.usable[:2])


def test_rotor_lost_before_there_is_a_model_is_named_by_what_follows():
    (found,) = inspect(rocking(2, onset=2.0, share=0.6, after=13.0)).verdict.findings
    assert (found.component, found.element) == ("rotor", "3")
    assert found.onset_s == pytest.approx(2.0, abs=0.15)
    assert found.size == pytest.approx(0.6, abs=0.2)


def test_rotors_of_a_healthy_flight_are_judged_healthy():
    verdict = inspect(rocking()).verdict
    assert not verdict.findings
    assert "rotor" in verdict.judged


def shares(of: list[float], seed: int) -> FlightLog:
    """Twenty seconds of steady flight with these shares."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, 0.01)
    values = 0.6 * np.array(of) + 0.02 * rng.standard_normal((len(time), 4))
    layout = {"rotor_positions": PLACES, "rotor_yaw_signs": SIGNS}
    return FlightLog(path=Path("steady"), format="test", rotor_commands=Signal(time, values), **layout)


def test_weak_rotor_is_named_against_a_healthy_flight_alone():
    trimmed = [1.08, 0.9, 1.1, 0.92]
    weak = shares([1.06, 0.88, 1.2, 0.9], 3)
    assert not inspect(weak).verdict.findings  # the centre of mass may be anywhere
    (found,) = inspect(weak, shares(trimmed, 4)).verdict.findings
    assert (found.component, found.element, found.kind) == ("rotor", "3", "loss")
    assert found.size == pytest.approx(0.1, abs=0.04)
    assert not inspect(shares(trimmed, 5), shares(trimmed, 4)).verdict.findings


def test_weak_rotor_is_told_from_a_centre_of_mass_by_the_yaw_trim():
    (found,) = inspect(shares([0.85, 0.85, 1.45, 0.85], 3)).verdict.findings
    assert (found.component, found.element, found.kind) == ("rotor", "3", "loss")
    assert "centre of mass" in found.ambiguous_with
    assert not inspect(shares([0.7, 1.0, 1.3, 1.0], 3)).verdict.findings  # as much about roll and pitch


def test_baseline_of_rotors_without_a_layout_is_said_to_be_of_no_use():
    log, healthy = (
        dataclasses.replace(shares([1.0] * 4, seed), rotor_positions=None, rotor_yaw_signs=None)
        for seed in (3, 4)
    )
    said = [each.reason for each in inspect(log, healthy).verdict.not_judged if each.component == "rotor"]
    alone = [each.reason for each in inspect(log).verdict.not_judged if each.component == "rotor"]
    assert said == [*alone, "a baseline is of no use where their layout is not known"]


@pytest.mark.parametrize("turns", [False, True])
def test_rotor_whose_speed_is_logged_slowly_stands_if_the_vehicle_turned_since_the_last_sample(turns: bool):
    log = shares([1.0, 1.0, 1.0, 1.0], 6)
    time = np.arange(0.0, 20.0, 0.5)
    speeds = np.full((len(time), 4), 600.0) + np.random.default_rng(1).standard_normal((len(time), 4))
    speeds[time > 14.1, 1] = 3.0
    fine = np.arange(0.0, 20.0, 0.01)
    rates = 0.02 * np.random.default_rng(2).standard_normal((len(fine), 3))
    rates[:, 1] += 0.2 * np.sin(3.0 * fine)
    rates[:, 0] += 1.5 * turns * np.exp(-(((fine - 14.2) / 0.05) ** 2))  # the others hold it, at once
    log = dataclasses.replace(log, rotor_speeds=Signal(time, speeds), gyros={"": Signal(fine, rates)})
    named = {each.component for each in inspect(log).verdict.findings}
    assert named == ({"rotor"} if turns else {"speed sensor"})


def test_rotor_that_stands_still_is_named_by_its_speed():
    log = shares([1.0, 1.0, 1.0, 1.0], 6)
    assert log.rotor_commands is not None
    speeds, time = 900.0 * np.sqrt(np.abs(log.rotor_commands.value)), log.rotor_commands.time
    speeds[:, 1] *= np.exp(-np.maximum(time - 15.0, 0.0) / 0.15)
    speeds[1505:, 3] = 5.0  # stopped by a controller that flies on; this one is faster
    log = FlightLog(path=log.path, format="test", rotor_speeds=Signal(time, speeds))
    (found,) = inspect(log).verdict.findings
    assert (found.element, found.kind) == ("2", "off")
    assert found.onset_s == pytest.approx(15.0, abs=0.05)
