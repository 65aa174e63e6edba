"""Replay: overlaid faults, the choice of the observer, the metrics, and the bag that is written."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader

from message_objects import ImuWriter
from quadftc_bags.bag import BagError, read_bag
from quadftc_bags.writer import BagWriter
from quadftc_fdi.fault_observers.none import NoDiagnosis
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow
from quadftc_flight.flight import Flight, flight_from_bag
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import STARTING, ImuSample
from quadftc_replay.diagnose import diagnose, flight_of, true_fault
from quadftc_replay.imu_recording import Recording, clean_samples
from quadftc_replay.overlay import faults_from, replay_events, replay_windows
from quadftc_replay.plan import Replay, ReplayOptions, choose_observer, plan_replay
from quadftc_replay.replay_bag import replay
from quadftc_ros.qos import topic_profile

PERIOD_NS = 4_000_000
START_NS = 7_000_000_000
COUNT = 250
IMU = "sensor_msgs/msg/Imu"
BIAS = "bias axis=roll value=2deg start=0.4s stop=0.8s"


def motion(count: int = COUNT) -> ImuSample:
    """Samples of a slow turn about all axes, with gyro noise."""
    time = PERIOD_NS * 1e-9 * np.arange(count)[:, None]
    angles = 0.1 * np.sin(np.array([1.0, 2.0, 3.0]) * time)
    noise = np.random.default_rng(5).standard_normal((count, 3))
    there = np.ones(count, np.bool_)
    force = np.tile([0.0, 0.0, 9.81], (count, 1))
    return ImuSample(quaternion_from_euler(angles), 0.1 + 0.01 * noise, force, there, there, there)


def recording(imu: ImuSample | None = None, **known) -> Recording:
    samples = motion() if imu is None else imu
    stamps = START_NS + PERIOD_NS * np.arange(len(samples.q_xyzw))
    return Recording(
        name="flight",
        path=Path("flight"),
        topic="/imu/data",
        namespace="/",
        stamp_ns=stamps,
        imu=clean_samples(samples, stamps, "flight")[0],
        torque=np.zeros((len(stamps), 3)),
        **known,
    )


def planned(source: Recording, *specs: str, observer: str = "none", seed: int = 0) -> Replay:
    return Replay(
        recording=source, observer=choose_observer(source, observer), faults=faults_from([], specs), seed=seed
    )


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """A bag of the motion, with nothing but the IMU."""
    directory = tmp_path_factory.mktemp("bags") / "flight"
    imu, write_imu = motion(), ImuWriter()
    with BagWriter(directory) as writer:
        writer.add_topic("/imu/data", IMU, topic_profile("sensor", "realtime"))
        for row in range(COUNT):
            stamp_ns = START_NS + row * PERIOD_NS
            sample = ImuSample(*(column[row] for column in imu))
            writer.write("/imu/data", serialize_message(write_imu(stamp_ns, sample)), stamp_ns, stamp_ns)
    return directory


def test_overlaid_fault_is_on_the_angles_that_the_observer_sees_and_is_the_truth():
    source = recording()
    diagnosed = planned(source, BIAS).diagnose()
    added = euler_from_quaternion(diagnosed.seen.q_xyzw) - euler_from_quaternion(source.imu.q_xyzw)
    expected = np.zeros((COUNT, 3))
    expected[100:200, 0] = np.radians(2.0)
    np.testing.assert_allclose(added, expected, atol=1e-12)
    np.testing.assert_allclose(true_fault(source, diagnosed, "attitude"), expected, atol=1e-12)


def test_recorded_fault_counts_beside_the_overlaid_one():
    recorded = np.zeros((COUNT, 3))
    recorded[150:, 2] = 0.05
    known = {
        "fault_windows": (FaultWindow(0.6, 1.0, ("yaw",)),),
        "fault_events": (FaultEvent("yaw", "fault", 0.6, 1.0),),
    }
    plan = planned(recording(faults={"attitude": recorded}, **known), BIAS)
    truth = true_fault(plan.recording, plan.diagnose(), "attitude")
    np.testing.assert_allclose(truth[160], [np.radians(2.0), 0.0, 0.05], atol=1e-12)
    windows = replay_windows(plan.recording, plan.faults)
    assert [window.axes for window in windows] == [("roll",), ("yaw",)]
    events = replay_events(plan.recording, plan.faults)
    assert [event[:2] for event in events] == [("roll", "step"), ("yaw", "fault")]


def test_overlay_gives_no_attitude_to_a_sample_without_one():
    imu = motion()
    imu.q_xyzw[120:130] = 0.0  # a driver without attitude, covariance unknown
    diagnosed = planned(recording(imu), BIAS).diagnose()
    assert np.flatnonzero(~diagnosed.seen.attitude_valid).tolist() == list(range(120, 130))


def test_replay_is_reproducible_and_follows_its_seed():
    noisy = "noise axes=roll,pitch sigma=1deg start=0.1s"
    first, again, other = (planned(recording(), noisy, seed=seed).diagnose() for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.seen.q_xyzw, again.seen.q_xyzw)
    assert not np.array_equal(first.seen.q_xyzw, other.seen.q_xyzw)


def test_metrics_of_an_undiagnosed_bias_are_the_bias():
    plan = planned(recording(), BIAS)
    summary = plan.summary(plan.diagnose())
    metrics = summary["metrics"]
    assert metrics["fault_estimate_rmse_inside_deg"]["roll"] == pytest.approx(2.0)
    assert metrics["fault_estimate_max_outside_deg"] == {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    assert metrics["fault_windows"][0]["fault_estimate_settling_s"]["roll"] is None
    assert not any(word in name for name in metrics for word in ("tracking", "torque", "tilt"))
    assert metrics["diagnosis"]["missed_by_kind"] == {"step": 1}
    assert metrics["diagnosis"]["events"][0]["tracking_rmse_deg"] is None
    assert summary["faults"][0].startswith("bias channel=attitude axes=roll start=0.4 stop=0.8 value=0.0349")


def test_observer_that_gives_no_number_is_started_anew_and_counted():
    @dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
    class Broken(NoDiagnosis):
        def step(self, state, inputs, dt):
            used, estimate = super().step(state, inputs, dt)
            return used, estimate._replace(fault=np.full(3, np.nan))

    source = recording()
    law = Broken(vehicle=choose_observer(source, "none").law.vehicle)
    diagnosed = diagnose(source, law)
    assert diagnosed.unusable == COUNT
    assert np.all(diagnosed.estimate.state == STARTING)
    assert np.all(diagnosed.estimate.fault == 0.0)


def test_faults_of_a_file_are_those_of_the_command_line(tmp_path):
    file = tmp_path / "faults.yaml"
    file.write_text("faults:\n  - {kind: bias, axes: roll, value: 2 deg, start: 0.4 s, stop: 0.8 s}\n")
    assert [fault.spec for fault in faults_from([file], [])] == [f.spec for f in faults_from([], [BIAS])]


def test_a_scenario_is_a_file_of_faults(busy_scenario_file):
    specs = [fault.spec for fault in faults_from([busy_scenario_file], [BIAS])]
    assert len(specs) == 11
    assert specs[0].startswith("bias channel=attitude axes=roll start=0.5")


@pytest.fixture
def busy_scenario_file() -> Path:
    return next(
        parent / "tests/scenarios/busy.yaml"
        for parent in Path(__file__).resolve().parents
        if (parent / "tests/scenarios/busy.yaml").is_file()
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("faults: []", "no faults; expected the key 'faults' with a list"),
        ("faults: [{kind: bias, axes: rol, value: 1 deg}]", "faults[0].axes: 'rol' is no axis"),
        ("faults: [{kind: bais, value: 1 deg}]", "no fault 'bais' (did you mean 'bias'?)"),
        ("faults: [{kind: bias, value: 1 deg}]\nfault: 1", "fault: unknown key (did you mean 'faults'?)"),
        ("faults: [bias]", "faults[0]: 'bias': expected a mapping with 'kind'"),
        ("- 1", "expected a mapping"),
    ],
)
def test_wrong_file_of_faults_is_refused_with_the_place(tmp_path, text, words):
    file = tmp_path / "faults.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=r"faults\.yaml:[12]: ") as caught:
        faults_from([file], [])
    assert words in str(caught.value)


def test_fault_behind_the_end_is_refused(bag):
    with pytest.raises(ValueError, match=r"start = 60 s: must be before the end of flight, 1\.000 s"):
        plan_replay(bag, ReplayOptions(observer="none", faults=("bias value=1deg start=60s",)))


def stored(**changes) -> dict:
    return {"vehicle": "qball_x4", "observer": "sliding_mode", "sliding_mode.delta": 0.002, **changes}


def test_recorded_observer_is_taken_with_its_parameters():
    chosen = choose_observer(recording(observer=stored()))
    assert chosen.parameters["sliding_mode.delta"] == 0.002
    assert chosen.parameters["sliding_mode.epsilon_s"] == 0.5  # not stored: the default


def test_observer_asked_for_has_its_defaults_and_what_is_set():
    chosen = choose_observer(
        recording(observer=stored()), "sliding_mode", settings=["observer.epsilon_s=30 deg"]
    )
    assert chosen.parameters["sliding_mode.delta"] == 0.001
    assert chosen.parameters["sliding_mode.epsilon_s"] == pytest.approx(np.radians(30.0))


@pytest.mark.parametrize(
    ("observer", "settings", "words"),
    [
        ("sliding", [], "no fault observer 'sliding'"),
        ("none", ["observer.L1=1"], "none.L1: unknown parameter"),
        ("none", ["L1=1"], "expected observer.<parameter>=value"),
        ("sliding_mode", ["observer.L1=-1"], "L1 = -1.0 1/s^2: must be within"),
    ],
)
def test_wrong_choice_of_observer_is_refused(observer, settings, words):
    with pytest.raises(ValueError, match=words.replace(".", r"\.").replace("^", r"\^")):
        choose_observer(recording(), observer, settings=settings)


def test_recorded_parameters_that_make_no_sense_matter_only_without_a_choice():
    source = recording(observer=None)
    assert choose_observer(source, "none").name == "none"
    with pytest.raises(BagError, match="choose with --observer"):
        choose_observer(source)


@pytest.fixture(scope="module")
def replayed(bag, tmp_path_factory) -> tuple[Path, ReplayOptions]:
    """A replay with faults on every channel, and samples withheld."""
    options = ReplayOptions(
        observer="sliding_mode",
        faults=(
            BIAS,
            "bias channel=gyro axis=z value=0.1 start=0.2s",
            "dropout channel=imu probability=0.2 start=0.5s",
            "nan channel=gyro axis=x start=0.9s stop=0.92s",
        ),
        seed=2,
    )
    out = tmp_path_factory.mktemp("out")
    replay(bag, options, out)
    return out / "flight-sliding_mode", options


def test_bag_holds_the_replayed_flight(bag, replayed):
    directory, options = replayed
    plan = plan_replay(bag, options)
    expected = flight_of(plan.recording, plan.diagnose())
    found = flight_from_bag(read_bag(directory))
    assert not found.delivered.all()
    for field in dataclasses.fields(Flight):
        np.testing.assert_array_equal(
            getattr(found, field.name), getattr(expected, field.name), err_msg=field.name
        )


def test_bag_passes_the_recorded_samples_on_as_they_are(bag, replayed):
    recorded = [data for _, _, data in read_bag(bag).messages(["/imu/data"])]
    assert [data for _, _, data in read_bag(replayed[0]).messages(["/plant/imu"])] == recorded


def test_bag_is_read_by_the_library_that_others_use(replayed):
    with AnyReader([replayed[0]]) as reader:
        for connection, log_time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamp = getattr(message, "header", message).stamp
            assert stamp.sec * 10**9 + stamp.nanosec == log_time
        counts = {name: topic.msgcount for name, topic in reader.topics.items()}
    withheld = counts["/fault/dropped"]
    assert 0 < withheld < COUNT
    assert counts["/plant/imu"] == counts["/fault/injected"] == counts["/fault/injected/gyro"] == COUNT
    delivered = ("/imu/data", "/imu/corrected", "/fault/estimate", "/fault/status")
    assert {counts[name] for name in delivered} == {COUNT - withheld}
    assert "/fault/injected/accelerometer" not in counts


def test_replay_of_a_replay_gives_the_same_estimates(replayed, tmp_path):
    directory, _ = replayed
    summary = replay(directory, ReplayOptions(), tmp_path)
    first, second = (
        read_bag(path).series("fault/estimate") for path in (directory, tmp_path / summary["bag"])
    )
    np.testing.assert_array_equal(first.stamp_ns, second.stamp_ns)
    np.testing.assert_array_equal(first["vector"], second["vector"])
    assert summary["truth"] == "recorded faults"


def test_two_replays_write_the_same_file(bag, replayed, tmp_path):
    directory, options = replayed
    replay(bag, options, tmp_path)
    name = f"{directory.name}/{directory.name}_0.mcap"
    assert (tmp_path / name).read_bytes() == (directory.parent / name).read_bytes()


def test_parameter_file_and_summary_say_what_was_done(replayed):
    directory, options = replayed
    nodes = yaml.safe_load((directory / "parameters.yaml").read_text())
    assert nodes["/fault_observer"]["ros__parameters"]["observer"] == "sliding_mode"
    assert len(nodes["/fault_injector"]["ros__parameters"]["faults"]) == len(options.faults)
    assert read_bag(directory).attachments["parameters.yaml"] == (directory / "parameters.yaml").read_bytes()
    summary = json.loads((directory / "summary.json").read_text())
    assert (summary["samples"], summary["seed"], summary["topic"]) == (COUNT, 2, "/imu/data")
    assert summary["metrics"]["fault_windows"][0]["axes"] == ["roll"]


def test_recording_is_never_replaced_by_its_replay(bag, tmp_path):
    inside = tmp_path / "flight-none" / "more"
    inside.mkdir(parents=True)
    (inside.parent / "metadata.yaml").write_text("")
    source = inside / "flight_0.mcap"
    source.write_bytes((bag / "flight_0.mcap").read_bytes())
    with pytest.raises(BagError, match="which the replay would replace"):
        replay(source, ReplayOptions(observer="none"), tmp_path, force=True)
    assert source.is_file()
