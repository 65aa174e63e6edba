"""The study of diagnosis: its flights, going on after an interruption, and the bound."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu

from message_objects import set_stamp
from quadftc_bags.bag import BagError
from quadftc_bags.writer import BagWriter
from quadftc_flight.diagnosis_metrics.roc import detection_scores, estimate_size, roc
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import VECTORS, Flight
from quadftc_model.samples import AXES, FAULTY
from quadftc_replay.imu_from_bag import IMU
from quadftc_replay.overlay import faults_from
from quadftc_replay.plan import choose_observer
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_tools.diagnosis_study import campaign, command
from quadftc_tools.diagnosis_study.bound import AVERAGING, attitude_std_dev, fault_bound
from quadftc_tools.diagnosis_study.campaign import Study, bags_in, fly_all, missing
from quadftc_tools.diagnosis_study.flights import (
    DrawnFault,
    FlightPlan,
    draw_faults,
    prepare,
    recording_windows,
    simulated,
    study_sensor,
)
from quadftc_tools.diagnosis_study.provenance import RUNS, closure, digest_of
from quadftc_tools.diagnosis_study.results import gather
from quadftc_tools.diagnosis_study.runs import AGES, Task, fly, profile, score_counts
from quadftc_tools.diagnosis_study.settings import RATE, RECORDINGS, SIMULATION, SIMULATION_ONE_AXIS, Variant
from quadftc_tools.diagnosis_study.store import FILE, Store
from quadftc_tools.diagnosis_study.variants import variants_of

DEG = math.pi / 180.0
SHORT = {"duration": 5.0, "windows": ((2.0, 4.0),)}
QUICK = (Variant("threshold", "threshold", ()), Variant("supervised", "threshold", (("patience", 1.0),)))


def nothing(_done: int) -> None:
    return


@pytest.fixture(autouse=True)
def little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fly two observers that take little time."""
    monkeypatch.setattr(campaign, "variants_of", lambda _setting, swept: QUICK)


@pytest.fixture
def quick() -> Study:
    """Two flights of 5 s."""
    return Study(2, (), 1, 7, **SHORT)


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What is stored of those."""
    store = Store(tmp_path_factory.mktemp("whole"))
    study = Study(2, (), 1, 7, **SHORT)
    tasks = [task._replace(variants=QUICK) for task in study.tasks()]
    fly_all(tasks, store, 1, nothing)
    return store.path.read_text().splitlines(keepends=True)


def stored(directory: Path, text: str) -> Store:
    directory.mkdir(exist_ok=True)
    (directory / FILE).write_text(text)
    return Store(directory)


# --- flights


def test_flight_is_the_same_however_many_there_are_and_no_two_are_alike():
    first, second = Study(2, (), 1, 7), Study(50, (), 1, 7)
    assert first.plans(SIMULATION) == second.plans(SIMULATION)[:2]
    flights = [prepare(plan, 7, **SHORT) for plan in (*first.plans(SIMULATION), FlightPlan(SIMULATION, 0))]
    assert flights[0][1] == flights[2][1]
    np.testing.assert_array_equal(flights[0][0].imu.q_xyzw, flights[2][0].imu.q_xyzw)
    assert flights[0][1] != flights[1][1]
    assert np.abs(flights[0][0].imu.body_rate - flights[1][0].imu.body_rate).max() > 0.01
    assert prepare(first.plans(SIMULATION)[0], 8, **SHORT)[1] != flights[0][1]  # another seed


@pytest.mark.parametrize("setting", [SIMULATION, RECORDINGS])
def test_drawn_faults_have_every_kind_within_the_ranges_and_can_be_replayed(setting):
    windows = tuple((20.0 * k, 20.0 * k + 10.0) for k in range(200))
    faults = draw_faults(np.random.default_rng(1), windows, setting.ranges, one_axis=False)
    assert [fault.axis for fault in faults] == [*AXES] * 200
    for kind in ("step", "ramp", "sine"):
        sizes = np.array([fault.size for fault in faults if fault.kind == kind])
        low, high = getattr(setting.ranges, kind)
        assert 0.4 < np.mean(sizes > 0.0) < 0.6
        assert low <= np.abs(sizes).min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < np.abs(sizes).max() <= high
    built = faults_from((), [fault.spec for fault in faults[:30]])
    assert [(fault.axes, fault.injection.start) for fault in built] == [
        ((f.axis,), f.start) for f in faults[:30]
    ]
    sine = next(index for index, fault in enumerate(faults) if fault.kind == "sine")
    assert built[sine].injection.law.amplitude[0] == pytest.approx(faults[sine].size * DEG)


def test_one_axis_at_a_time_is_faulty_where_asked():
    windows = tuple((20.0 * k, 20.0 * k + 10.0) for k in range(60))
    faults = draw_faults(np.random.default_rng(2), windows, SIMULATION_ONE_AXIS.ranges, one_axis=True)
    assert len(faults) == len(windows)
    assert {fault.axis for fault in faults} == set(AXES)


def test_simulated_samples_have_the_noise_of_the_grade():
    recording = simulated(np.random.default_rng(3), 40.0)
    grade, dt = GRADES["mems"], 1.0 / RATE
    thirds = np.diff(recording.imu.body_rate, n=3, axis=0)  # the motion is smooth: what is left is noise
    assert np.std(thirds) / math.sqrt(20.0) == pytest.approx(grade["gyro_noise"] / math.sqrt(dt), rel=0.03)
    tilt = 2.0 * np.diff(recording.imu.q_xyzw, n=3, axis=0)[:, :3]
    assert np.std(tilt) / math.sqrt(20.0) == pytest.approx(grade["attitude_noise"], rel=0.03)
    assert len(recording) == 40 * RATE
    assert recording.rate == RATE


def test_faults_on_a_recording_are_whole_and_leave_time_to_recover():
    starts = []
    for seed in range(50):
        windows = recording_windows(np.random.default_rng(seed), 194.0)
        assert np.allclose(np.diff(windows), 20.0)
        assert np.allclose(np.diff([start for start, _ in windows]), 30.0)
        assert 159.0 < windows[-1][1] <= 189.0
        starts.append(windows[0][0])
    assert 20.0 <= min(starts) < 21.0
    assert 29.0 < max(starts) <= 30.0
    assert recording_windows(np.random.default_rng(1), 30.0) == ()


# --- observers


@pytest.mark.parametrize("setting", [SIMULATION, RECORDINGS])
def test_every_variant_can_be_built(setting):
    recording = simulated(np.random.default_rng(1), 0.1)
    variants = variants_of(setting, swept=True)
    assert len({variant.name for variant in variants}) == len(variants)
    for variant in variants:
        law = choose_observer(recording, variant.observer, settings=variant.settings).law
        for name, value in variant.parameters:
            assert getattr(law, name) == value


def test_bound_averages_as_long_as_the_observer_does():
    law = choose_observer(simulated(np.random.default_rng(1), 0.1), "supervised").law
    assert getattr(law, "tracking") == AVERAGING  # noqa: B009


# --- records


def flight_with(**columns) -> Flight:
    """30 s at 100 Hz; what is not given is zero."""
    count = 3000
    stamp_ns = np.arange(1, count + 1) * 10_000_000
    return Flight(
        stamp_ns=stamp_ns,
        time=(stamp_ns - stamp_ns[0]) / 1e9,
        delivered=np.ones(count, np.bool_),
        fault_onset_ns=np.zeros((count, 3), np.int64),
        saturated=np.zeros((count, 3), np.bool_),
        **{name: np.zeros((count, 3)) for name in VECTORS}
        | {"fault_state": np.ones((count, 3), np.uint8)}
        | columns,
    )


def test_score_counts_are_the_curve_of_the_scores():
    fault = np.zeros((3000, 3))
    fault[1000:2000] = (0.005, 0.02, 0.05)
    estimate = 0.01 * np.random.default_rng(4).standard_normal((3000, 3)) + 0.5 * fault
    flight = flight_with(fault=fault, fault_estimate=estimate)
    events = [FaultEvent(axis, "step", 10.0, 20.0) for axis in AXES]
    scores = detection_scores(flight, events, estimate_size, within=0.05)
    curve = roc(np.concatenate(scores), np.repeat([False, True], [len(part) for part in scores]))
    counts = score_counts(flight, events, estimate_size, curve.threshold[:0:-1], within=0.05)
    assert len(counts["alarms"]) > 3
    assert counts["healthy"] == 3 * (3000 - 1000 - 500)  # but for the faults and the grace after them
    shares = np.array(counts["alarms"]) / counts["healthy"]
    np.testing.assert_allclose(shares, curve.false_alarm_share[:0:-1])
    np.testing.assert_allclose(np.array(counts["found"]) / 3, curve.detection_probability[:0:-1])


def test_profile_is_the_error_at_each_age_while_the_axis_is_declared():
    state, estimate, fault = np.ones((3000, 3), np.uint8), np.zeros((3000, 3)), np.zeros((3000, 3))
    fault[1000:2000, 1] = 2.0 * DEG
    state[1030:2000, 1] = FAULTY
    estimate[1000:2000, 1] = (2.0 + 0.1 * np.arange(1000) / 100.0) * DEG  # the error grows by 0.1 deg/s
    flight = flight_with(fault=fault, fault_estimate=estimate, fault_state=state)
    flight.fault_std_dev[:] = -1.0
    drawn = DrawnFault("pitch", "step", 2.0, None, 10.0, 20.0)
    found = profile(flight, drawn)
    expected = [None if age < 0.3 else 0.1 * min(age, 9.99) for age in AGES]
    assert found["errors_deg"] == [
        None if each is None else pytest.approx(each, rel=1e-4) for each in expected
    ]
    assert found["std_devs_deg"] == [None] * len(AGES)  # it gives none
    flight.fault_std_dev[:] = 0.05 * DEG
    assert profile(flight, drawn)["std_devs_deg"][-1] == pytest.approx(0.05)


def test_record_of_a_flight_is_ready_for_json_and_knows_the_faults_drawn():
    (record,) = fly(Task(FlightPlan(SIMULATION, 0), QUICK[:1], 7, **SHORT))
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    drawn = prepare(FlightPlan(SIMULATION, 0), 7, **SHORT)[1]
    for event, fault, given in zip(record["diagnosis"]["events"], record["faults"], drawn, strict=True):
        assert (event["axis"], event["kind"], event["start"]) == (given.axis, given.kind, given.start)
        assert (fault["size"], fault["frequency"]) == (given.size, given.frequency)
        if given.kind == "step":
            assert event["fault_max_deg"] == pytest.approx(abs(given.size))


# --- going on


def test_interrupted_study_goes_on_and_gives_the_same_results(quick: Study, lines: list[str], tmp_path: Path):
    assert len(lines) == 2 * 2 + 2  # two flights, and one with one faulty axis at a time
    whole = stored(tmp_path / "whole", "".join(lines))
    assert missing(quick, whole) == []
    cut = stored(tmp_path / "cut", "".join(lines[:1]) + lines[1][:100])  # killed while it wrote
    tasks = missing(quick, cut)
    assert [len(task.variants) for task in tasks] == [1, 2, 2]
    fly_all(tasks, cut, 2, nothing)  # and with another number of processes
    assert sorted(cut.path.read_text().splitlines(keepends=True)) == sorted(lines)
    assert gather(quick, Store(tmp_path / "cut")) == gather(quick, whole)


def test_stored_flights_of_other_parameters_or_seed_do_not_count(
    quick: Study, lines: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    store = stored(tmp_path, "".join(lines))
    assert len(missing(quick._replace(seed=8), store)) == 3
    assert len(missing(quick._replace(flights=3), store)) == 1
    with pytest.raises(ValueError, match="holds no flight"):
        gather(quick._replace(seed=8), store)
    assert gather(quick._replace(seed=8), store, any_code=True)["settings"]["simulation"]["observers"]
    other = (QUICK[0], Variant("supervised", "threshold", (("patience", 2.0),)))
    monkeypatch.setattr(campaign, "variants_of", lambda _setting, swept: other)
    assert [task.variants for task in missing(quick, store)] == [other[1:]] * 3


def test_digest_covers_observer_faults_and_metrics_but_no_other_observer():
    modules = closure((RUNS, "quadftc_fdi.fault_observers.threshold"))
    assert {"quadftc_fdi.fault_observers.threshold", "quadftc_fdi.dead_reckoning"} <= modules
    assert {
        "quadftc_flight.diagnosis_metrics.verdicts",
        "quadftc_sim.sensors",
        "quadftc_model.rotations",
    } <= modules
    assert not modules & {"quadftc_fdi.fault_observers.supervised", "quadftc_tools.diagnosis_study.tables"}
    assert all(name.startswith("quadftc_") for name in modules)
    task = Task(FlightPlan(SIMULATION, 0), (), 0)
    assert digest_of(task, QUICK[0]) != digest_of(task, variants_of(SIMULATION, swept=False)[0])


@pytest.mark.parametrize(
    "line", ["{}", "nonsense", '{"setting": 1, "variant": "a", "flight": "0", "digest": "x"}']
)
def test_file_of_something_else_is_refused_with_the_line(tmp_path: Path, line: str):
    (tmp_path / "flights.jsonl").write_text(line + "\n")
    with pytest.raises(ValueError, match=r"flights.jsonl: line 1: expected a record of this study"):
        Store(tmp_path)


# --- bound


def test_bound_is_the_closed_form_of_the_theory():
    grade, dt, healthy, length = GRADES["mems"], 1.0 / RATE, 20.0, 20.0
    sensor = ImuSensor(**{**grade, "gyro_bias_walk": 0.0, "delay": 0})
    noise, walk = sensor.attitude_noise, sensor.gyro_noise
    found = attitude_std_dev(sensor, dt, round(40.0 / dt), [(healthy, healthy + length)])
    memory = noise * math.sqrt(dt) / walk
    bias = walk**2 / healthy * (1.0 + 2.0 * memory / healthy)
    at_onset = walk * noise * math.sqrt(dt) * (1.0 + length / healthy)
    floor = math.sqrt(at_onset + bias * length**2 / 3.0 + walk**2 * length / 2.0)  # (T17)
    assert math.sqrt(np.mean(found[-round(length / dt) :] ** 2)) == pytest.approx(floor, rel=0.01)


def test_bound_holds_the_noise_of_the_sample_and_falls_with_healthy_time():
    sensor, dt, windows = study_sensor(), 1.0 / RATE, ((20.0, 40.0), (50.0, 70.0))
    short, long = (
        fault_bound(sensor, dt, windows, (0.0, 20.0)),
        fault_bound(sensor, dt, windows, (0.0, 20.0), 1.0),
    )
    attitude = attitude_std_dev(sensor, dt, round(70.0 / dt), windows)
    assert short[0, 0] ** 2 == pytest.approx(attitude[5000] ** 2 + sensor.attitude_noise**2)  # one sample
    assert short[0, 1] ** 2 == pytest.approx(attitude[9999] ** 2 + sensor.attitude_noise**2 / 15.0)
    assert np.all(short[:, 1] > long[:, 1])
    assert short[1, 1] < 0.95 * short[0, 1]  # the bias is better known


# --- recordings and the command


def still_bag(directory: Path) -> Path:
    """56 s at 20 Hz, at rest."""
    with BagWriter(directory, {}) as writer:
        writer.add_topic("/imu/data", IMU, QoSProfile(depth=10))
        for number in range(1120):
            stamp_ns, message = 1_000_000_000 + 50_000_000 * number, Imu()
            set_stamp(message.header, stamp_ns)
            message.orientation.w = 1.0
            writer.write("/imu/data", serialize_message(message), stamp_ns, stamp_ns)
    return directory


def test_recordings_of_a_directory_are_flown(quick: Study, tmp_path: Path):
    bag = still_bag(tmp_path / "bags" / "still")
    assert bags_in(tmp_path / "bags") == (bag,)
    assert bags_in(bag) == (bag,)
    study, store = quick._replace(flights=0, bags=(bag,)), Store(tmp_path / "out")
    fly_all(missing(study, store), store, 1, nothing)
    results = gather(study, store)
    assert set(results["settings"]) == {"recordings", "recordings_one_axis"}
    faults = results["settings"]["recordings"]["observers"]["threshold"]["faults"]
    assert [fault["axis"] for fault in faults] == [*AXES]
    assert {fault["flight"] for fault in faults} == {"still/0"}
    assert 20.0 <= faults[0]["start"] <= 30.0


def test_directory_without_bags_is_refused(tmp_path: Path):
    with pytest.raises(BagError, match="holds no bag"):
        bags_in(tmp_path)
    with pytest.raises(BagError, match="no such directory"):
        bags_in(tmp_path / "none")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--flights", "-1"], "--flights: -1: must be at least 0"),
        (["--jobs", "0"], "--jobs: 0: must be at least 1"),
        (["--recordings", "/nowhere"], "/nowhere: no such directory"),
        (["--no-flights"], "holds no flight"),
    ],
)
def test_wrong_call_is_refused_in_one_line(arguments, words, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["study_diagnosis", "--out", str(tmp_path), *arguments])
    assert command.main() == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert words in errors[0]


def test_command_writes_results_and_says_that_recordings_are_skipped(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr(command, "Study", lambda *given: Study(*given, **SHORT))
    arguments = ["--out", str(tmp_path), "--flights", "1", "--jobs", "1"]
    monkeypatch.setattr("sys.argv", ["study_diagnosis", *arguments])
    assert command.main() == 0
    assert "recordings: skipped" in capsys.readouterr().err
    results = json.loads((tmp_path / "diagnosis.json").read_text())
    assert set(results["settings"]) == {"simulation", "simulation_one_axis"}
    first = (tmp_path / "diagnosis.json").read_bytes()
    assert command.main() == 0
    assert "0 flown" in capsys.readouterr().err
    assert (tmp_path / "diagnosis.json").read_bytes() == first
