"""The bag of a run is read whole by the library that others use."""

from __future__ import annotations

import json
from collections import Counter

import pytest
import yaml
from mcap.reader import make_reader

from quadftc_bags.bag import read_bag
from quadftc_ros.topics import GRAPHS

SAMPLES = 500  # of the busy scenario: 2 s at 250 Hz
TRUTH = ("/clock", "/plant/attitude", "/plant/rate", "/disturbance/applied")
EVERY_SAMPLE = (
    "/imu/corrected",
    "/fault/estimate",
    "/fault/status",
    "/disturbance/estimate",
    "/control/status",
)


@pytest.fixture(scope="module")
def run(fly_graph, busy_scenario):
    return fly_graph(busy_scenario, "proposed")


def expected_counts(summary):
    """Messages of each topic: one sample is still on its way at the end, some were withheld."""
    withheld = summary["samples_withheld"]
    assert withheld > 0
    published = SAMPLES - 1  # the sensor is one sample late
    counts = dict.fromkeys(TRUTH, SAMPLES)
    counts |= dict.fromkeys(("/plant/imu", "/fault/injected"), published)
    counts |= dict.fromkeys(
        (*EVERY_SAMPLE, "/imu/data", "/attitude/reference", "/torque/command"), published - withheld
    )
    counts["/fault/dropped"] = withheld
    return counts


def test_mcap_reads_every_message(run):
    directory, summary = run
    with (directory / f"{directory.name}_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        counts = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        channels = {channel.topic for channel in reader.get_summary().channels.values()}
        attachments = {item.name for item in reader.iter_attachments()}
    wanted = expected_counts(summary)
    assert {topic: counts[topic] for topic in wanted} == wanted
    assert channels == {name if name.startswith("/") else f"/{name}" for name in GRAPHS["test_stand"]}
    assert attachments == {"scenario.yaml", "parameters.yaml"}


def test_bag_holds_scenario_parameters_and_versions(run, busy_scenario):
    directory, _ = run
    bag = read_bag(directory)
    assert yaml.safe_load(bag.attachments["scenario.yaml"]) == busy_scenario.raw
    parameters = yaml.safe_load(bag.attachments["parameters.yaml"])
    assert parameters["/fault_observer"]["ros__parameters"]["observer"] == "sliding_mode"
    information = yaml.safe_load((directory / "metadata.yaml").read_text(encoding="utf-8"))
    assert information["rosbag2_bagfile_information"]["custom_data"].keys() >= {"mode", "quadftc", "numpy"}


def test_summary_lies_beside_the_bag(run):
    directory, summary = run
    assert json.loads((directory / "summary.json").read_text(encoding="utf-8")) == summary
    assert summary["samples"] == SAMPLES - 1
    assert summary["versions"].keys() >= {"quadftc", "python", "rmw_implementation"}
