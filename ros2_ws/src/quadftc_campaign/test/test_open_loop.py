"""Campaigns without a control loop: simulated and recorded samples with drawn faults, diagnosed."""

import dataclasses
import math

import numpy as np
import pytest
from accusing_observer import registered
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu

from message_objects import set_stamp
from quadftc_bags.writer import BagWriter
from quadftc_campaign.campaign_file import bags_in, load_campaign
from quadftc_campaign.campaign_run import chunks_of, fly_chunk
from quadftc_campaign.distributions import distribution, plain
from quadftc_campaign.flights import flight_scenario
from quadftc_campaign.open_loop import prepare, simulate
from quadftc_campaign.table import summary_of, table_of
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.scenario import ScenarioError, parse_scenario, with_seed
from quadftc_sim.sensors import GRADES

DEG = math.pi / 180.0
BASE = """
duration: 4 s
rate: 100 Hz
vehicle: qball_x4
sensors: {grade: mems}
references:
  - {kind: sine, amplitude: 2 deg, frequency: 0.5}
faults:
  - {kind: bias, axes: roll, value: 1 deg, start: 1 s, stop: 2 s}
  - {kind: bias, axes: pitch, value: 1 deg, start: 1 s, stop: 2 s}
schemes:
  diagnosis: {observer: supervised, controller: smc}
"""
CAMPAIGN = """
name: short
scenario: base.yaml
source: {kind: motion}
flights: 3
seed: 7
observers: [threshold]
vary:
  references.*.amplitude: {uniform: [1 deg, 4 deg], size: 3}
  faults.*:
    choice:
      - {kind: bias, value: {uniform: [1 deg, 5 deg], sign: random}}
      - {kind: drift, rate: {uniform: [1 deg/s, 2 deg/s], sign: random}}
"""


def written(tmp_path, text, recordings=None, engine=None, base=BASE):
    (tmp_path / "base.yaml").write_text(base)
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return load_campaign(path, recordings=recordings, engine=engine)


def test_drawn_components_keep_the_axes_and_times_of_the_faults_in_their_place(tmp_path):
    campaign = written(tmp_path, CAMPAIGN.replace("flights: 3", "flights: 40"))
    assert set(campaign.vary) == {"references.0.amplitude", "faults.0", "faults.1"}
    kinds = set()
    for number in range(40):
        faults = flight_scenario(campaign, number, campaign.variants[0]).faults
        assert [fault.axes for fault in faults] == [("roll",), ("pitch",)]
        assert {(fault.injection.start, fault.injection.stop) for fault in faults} == {(1.0, 2.0)}
        kinds |= {(faults[0].injection.kind, faults[1].injection.kind)}
    assert len(kinds) == 4  # each fault for itself


def test_a_component_is_drawn_with_its_parameters():
    drawn = distribution({"choice": [{"kind": "bias", "value": {"uniform": ["1 deg", "2 deg"]}}]})
    value = drawn.draw(np.random.default_rng(0))
    assert value["kind"] == "bias"
    assert 1.0 < plain(value["value"]) < 2.0
    assert plain(value).startswith("bias value=1")
    with pytest.raises(ValueError, match="an empty range"):
        distribution({"choice": [{"kind": "bias", "value": {"uniform": [2.0, 1.0]}}]})


def test_simulated_samples_have_the_noise_of_the_grade():
    text = BASE.replace("duration: 4 s", "duration: 40 s").replace("100 Hz", "250 Hz")
    recording = simulate(parse_scenario(text))
    grade, dt = GRADES["mems"], 1.0 / 250.0
    thirds = np.diff(recording.imu.body_rate[600:], n=3, axis=0)  # smooth motion: what is left is noise
    assert np.std(thirds) / math.sqrt(20.0) == pytest.approx(grade["gyro_noise"] / math.sqrt(dt), rel=0.03)
    tilt = 2.0 * np.diff(recording.imu.q_xyzw[600:], n=3, axis=0)[:, :3]
    assert np.std(tilt) / math.sqrt(20.0) == pytest.approx(grade["attitude_noise"], rel=0.03)
    assert len(recording) == 40 * 250


def test_samples_simulated_in_c_are_those_in_numpy():
    scenarios = [with_seed(parse_scenario(BASE), seed) for seed in range(2)]
    for scenario in scenarios:
        one, other = simulate(scenario), simulate(scenario, "numpy")
        for name in ("q_xyzw", "body_rate", "specific_force"):
            pair = getattr(one.imu, name), getattr(other.imu, name)
            np.testing.assert_allclose(*pair, rtol=0.0, atol=1e-13, err_msg=name)
    rates = [simulate(each).imu.body_rate for each in scenarios]
    assert not np.array_equal(*rates)


FAULTS = """
faults:
  - {kind: bias, axes: roll, value: 20 deg, start: 1 s, stop: 2 s}
  - {kind: noise, axes: [roll, yaw], sigma: 1 deg, start: 1.5 s, stop: 3 s}
  - {kind: spikes, axes: pitch, amplitude: 5 deg, rate: 5, start: 1 s, stop: 3 s}
  - {kind: nan, axes: pitch, start: 2.5 s, stop: 2.6 s}
  - {kind: nan, channel: attitude, start: 0 s, stop: 0.2 s}
  - {kind: delay, delay: 0.05 s, start: 1 s, stop: 2 s}
  - {kind: drift, channel: gyro, rate: 1 deg/s^2, start: 1 s, stop: 3 s}
schemes:
  diagnosis: {observer: OBSERVER, controller: smc}
"""
FLOWN = """
name: short
scenario: base.yaml
source: {kind: motion}
flights: 2
vary:
  references.*.amplitude: {uniform: [1 deg, 4 deg], size: 3}
"""


def rows_with(tmp_path, observer, engine="c"):
    """Rows of a campaign with something of everything."""
    base = BASE.partition("faults:")[0] + FAULTS.replace("OBSERVER", observer)
    campaign = written(tmp_path, FLOWN, engine=engine, base=base)
    return fly_chunk(campaign, range(2))


def assert_same_rows(rows, others):
    assert len(rows) == len(others) > 2
    assert any(row["fault.detected"] for row in rows)
    for row, other in zip(rows, others, strict=True):
        assert row.keys() == other.keys()
        for name, value in row.items():
            if isinstance(value, list) and None not in value:
                assert value == pytest.approx(other[name], rel=1e-9, abs=1e-9), name
            elif isinstance(value, float):
                assert value == pytest.approx(other[name], rel=1e-9, abs=1e-9, nan_ok=True), name
            elif name != "observer":
                assert value == other[name] or isinstance(value, list), name


@pytest.mark.parametrize("observer", ["threshold", pytest.param("supervised", marks=pytest.mark.thorough)])
def test_a_campaign_in_c_says_what_one_in_numpy_says(tmp_path, observer):
    assert_same_rows(rows_with(tmp_path, observer), rows_with(tmp_path, observer, "numpy"))


Threshold = fault_observers.get("threshold")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Untraceable(Threshold):
    """Needs numbers, so that JAX cannot trace it."""

    def step(self, state, inputs, dt):
        assert float(np.sum(inputs.imu.body_rate)) < 1e9
        return super().step(state, inputs, dt)


def test_an_observer_that_cannot_be_traced_takes_part_all_the_same(tmp_path):
    expected = rows_with(tmp_path, "threshold")
    with registered(Untraceable) as observer:
        assert_same_rows(rows_with(tmp_path, observer), expected)


def test_each_fault_of_each_observer_is_a_row(tmp_path):
    campaign = written(tmp_path, CAMPAIGN)
    assert [variant.name for variant in campaign.variants] == ["threshold"]
    frame = table_of(fly_chunk(campaign, range(3)))
    assert frame.height == 3 * 2
    assert frame["fault.kind"].is_in(["step", "ramp"]).all()
    assert set(frame["observer"]) == {"threshold"}
    steps = frame.filter(frame["fault.kind"] == "step")
    assert steps["fault.fault_max_deg"].is_between(1.0, 5.0).all()
    summary = summary_of(campaign, frame)["variants"]["threshold"]
    assert summary["flights"] == 3
    assert summary["faults"]["all"]["judged"] == 6


def test_an_observer_without_edit_of_any_list_takes_part(tmp_path):
    text = CAMPAIGN.replace("observers: [threshold]", "observers: all")
    names = {variant.name for variant in written(tmp_path, text).variants}
    assert {"supervised", "sliding_mode", "threshold"} <= names
    assert "none" not in names


# --- recordings


def still_bag(directory):
    """56 s at 20 Hz, at rest."""
    with BagWriter(directory, {}) as writer:
        writer.add_topic("/imu/data", "sensor_msgs/msg/Imu", QoSProfile(depth=10))
        for number in range(1120):
            stamp_ns, message = 1_000_000_000 + 50_000_000 * number, Imu()
            set_stamp(message.header, stamp_ns)
            message.orientation.w = 1.0
            writer.write("/imu/data", serialize_message(message), stamp_ns, stamp_ns)
    return directory


def test_recordings_are_flown_in_turn_and_faults_come_later(tmp_path):
    bag = still_bag(tmp_path / "bags" / "still")
    assert bags_in(tmp_path / "bags") == (bag,)
    assert bags_in(bag) == (bag,)
    text = CAMPAIGN.replace("{kind: motion}", "{kind: recordings, delay: {uniform: [0 s, 10 s]}}")
    campaign = written(tmp_path, text, recordings=tmp_path / "bags")
    rows = fly_chunk(campaign, [0, 1])
    assert {row["recording"] for row in rows} == {"still"}
    for row in rows:
        assert 0.0 < row["source.delay"] < 10.0
        assert row["fault.start"] == pytest.approx(1.0 + row["source.delay"], abs=1e-8)
    assert chunks_of(campaign) == [[0, 1, 2]]  # flights on one recording stay together
    scenario = flight_scenario(campaign, 0, campaign.variants[0])
    _, faults, _ = prepare(campaign, 0, scenario)
    assert len(faults) == 2


def test_faults_that_a_recording_is_too_short_for_are_left_out(tmp_path):
    still_bag(tmp_path / "bags" / "still")  # 56 s
    text = CAMPAIGN.replace("{kind: motion}", "{kind: recordings}").replace(
        "flights: 3", "set: [duration=80 s, faults.1.stop=52 s]\nflights: 1"
    )
    campaign = written(tmp_path, text, recordings=tmp_path / "bags")
    scenario = flight_scenario(campaign, 0, campaign.variants[0])
    assert [fault.axes for fault in prepare(campaign, 0, scenario)[1]] == [("roll",)]


def test_samples_alone_do_not_fly_in_jax(tmp_path):
    with pytest.raises(
        ScenarioError, match=r"source.kind: motion: expected 'loop', which alone flies in JAX"
    ):
        written(tmp_path, CAMPAIGN, engine="jax")


def test_recordings_of_a_campaign_that_flies_none_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"source.kind: 'motion'; expected 'recordings' for --recordings"):
        written(tmp_path, CAMPAIGN, recordings=tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("kind: motion", "kind: recordings"), "source.directory: no directory is named.*--recordings"),
        (("kind: motion", "kind: recordings, directory: nowhere"), "nowhere: holds no bag"),
        (("kind: motion", "kind: motion, delay: 3"), "source.delay: 3: expected a distribution"),
        (("kind: motion", "kind: orbit"), "source.kind: 'orbit'"),
        (("[threshold]", "[treshold]"), r"observers\[0\]: no 'treshold'"),
        (("faults.*:", "duration.*:"), "'duration' is no list of the scenario"),
    ],
)
def test_a_source_that_is_wrong_is_refused(tmp_path, change, message):
    with pytest.raises(ScenarioError, match=message):
        written(tmp_path, CAMPAIGN.replace(*change))
