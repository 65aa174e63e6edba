"""A flight of the stand-in that somebody touches while it flies: the node, its services, the truth."""

import json
import sys
import threading
import time
from pathlib import Path

import pytest

from quadftc_bags.bag import read_bag
from quadftc_cli.live import LiveGraph
from quadftc_cli.live_page.attached import page_of_running
from quadftc_cli.live_page.player import Player, read_recorded
from quadftc_cli.live_page.server import picture_of
from quadftc_model.samples import level_sample
from quadftc_msgs.srv import ClearFault, InjectFault
from quadftc_ros.executor import StopSignals
from quadftc_sim.injection import make_injection
from quadftc_sitl import pilot
from quadftc_sitl.live import Live
from quadftc_sitl.plan import plan_of_text
from quadftc_sitl.sitl_flight import fly_sitl
from quadftc_sitl.truth import NotedInjector

HERE = Path(__file__).parent
SCENARIO = """
name: touched
duration: 60 s
rate: 400 Hz
vehicle: x500
plant: {kind: free_flight}
sensors: {grade: mems}
position_sensor: {grade: gps}
trajectories: [{kind: hover, position: [0, 0, 1]}]
"""


def test_fault_by_hand_is_in_truth_and_bag_and_ctrl_c_lands(tmp_path, monkeypatch):
    monkeypatch.setattr(pilot, "SETTLING", 0.2)
    monkeypatch.setattr(pilot, "AFTERWARDS", 0.1)
    monkeypatch.setattr(pilot, "TO_BE_READY", 0.1)
    peer = tmp_path / "peer"
    peer.write_text(f"#!{sys.executable}\n" + (HERE / "sitl_peer.py").read_text())
    peer.chmod(0o755)
    lines, pages, stop, begun = [], [], StopSignals(), threading.Event()

    def say(line):
        lines.append(line)
        if "the mission begins" in line:
            begun.set()

    def touch():
        with LiveGraph() as graph:
            assert begun.wait(300.0)
            pages.append(page_of_running(graph))
            wanted = {"kind": "bias", "channel": "gyro", "axes": ["y"], "duration": 60.0}
            wanted |= {"parameter_names": ["value"], "parameter_values": [0.3]}
            graph.call("fault_injector/inject", InjectFault, InjectFault.Request(**wanted))
            time.sleep(0.3)
            graph.call("fault_injector/clear", ClearFault, ClearFault.Request(id=1))
        stop.requested = True

    operator = threading.Thread(target=touch)
    operator.start()
    found = fly_sitl(plan_of_text(SCENARIO, "", "touched"), peer, tmp_path / "out", live=Live(stop, say))
    operator.join()
    assert pages[0].parts == "x500, observer isolating, flown by ArduPilot"
    assert found["ended"] == "landed"
    (fault,) = json.loads((tmp_path / "out" / "sitl.json").read_text())["faults"]
    assert (fault["component"], fault["elements"], fault["size"]) == ("gyro", ["y"], 0.3)
    assert 0.1 < fault["stop"] - fault["start"] < 2.0
    assert fault["observer"]["named"]
    assert fault["observer"]["delay_s"] < 0.2
    series = read_bag(tmp_path / "out" / "bag").series("fault/injected/gyro")
    faulty = series["stamp_ns"][series["vector"][:, 1] > 0.15]
    assert 1e-9 * (faulty[-1] - faulty[0]) == pytest.approx(fault["stop"] - fault["start"], abs=0.02)
    (recorded,) = read_recorded(tmp_path / "out")  # the page plays it, too
    picture = picture_of(recorded.flown)
    player = Player([recorded], [picture], 1.0)
    (event,) = recorded.events
    player.wanted = event.start + 0.25
    player.step(0.0)
    assert picture.states()["gyro"]["y"].name in ("faulty", "ambiguous")
    assert {*picture.latest.attitudes()} == {"truth", "measured"}
    assert abs(picture.latest.body_rate()[1]) < 0.2
    told = "\n".join(lines)
    for words in ("fault 1: bias channel=gyro", "observer: gyro y", "fault 1: cleared", "Ctrl-C: it lands"):
        assert words in told


def test_truth_has_what_was_on_for_as_long_as_it_was():
    injector = NotedInjector(0, (), 4)
    bias = {"channel": "gyro", "axes": "x", "value": 0.1}
    for second in range(3):
        injector.apply(second * 10**9, level_sample())
    assert injector.now == 2.0
    injector.add(make_injection("bias", bias, 1.5))
    injector.add(make_injection("bias", bias, 2.5))
    injector.add(make_injection("loss", {"rotors": [2], "value": 0.3}, 1.0, 4))
    assert injector.clear() == 3
    specs = [fault.spec for fault in injector.noted(1.0).values()]
    assert specs == [
        "bias channel=gyro axes=roll start=0.5 stop=1.0 value=0.1",
        "loss channel=rotor rotors=2 start=0.0 stop=1.0 value=0.3 rise=0.0",
    ]
