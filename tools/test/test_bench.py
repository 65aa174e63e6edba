"""The benchmarks: what they make of traces whose answer is known; that they run, and what they write."""

from __future__ import annotations

import json
import os
import time

import numpy as np
import pytest

from quadftc_cli.main import guarded
from quadftc_control.controller import controllers
from quadftc_control.position_controller import position_controllers
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_tools.bench.latency import (
    STAGES,
    TIMER,
    TOTAL,
    histogram,
    latencies,
    lost_messages,
    statistics,
    unrecorded,
)
from quadftc_tools.bench.lockstep import forms
from quadftc_tools.bench.machine import Usage, machine, slowness
from quadftc_tools.bench.step import cases

RATE, PERIOD = 100.0, 10_000_000  # Hz, ns
SLOW = 20_000_000  # ns
EPOCH, OFFSET = 1_700_000_000_000_000_000, 5_000_000_000  # ns; of the stamps, and of the monotonic clock
DELAYS = {  # ns since the sample was published, in the order of the chain
    ("plant", "given plant/imu"): 0,
    ("fault_injector", "taken plant/imu"): 20_000,
    ("fault_injector", "given imu/data"): 50_000,
    ("fault_observer", "taken imu/data"): 70_000,
    ("fault_observer", "given imu/corrected"): 270_000,
    ("disturbance_observer", "taken imu/corrected"): 300_000,
    ("controller", "taken imu/corrected"): 310_000,
    ("disturbance_observer", "given disturbance/estimate"): 340_000,
    ("controller", "given torque/command"): 400_000,
    ("plant", "taken torque/command"): 430_000,
}


def traces(count: int, lateness=0, without=(), slow=()):
    """Traces of a flight: samples published late by ``lateness``, some without an answer, some slow ones."""
    late = np.broadcast_to(lateness, count)
    found: dict[str, dict[str, np.ndarray]] = {}
    for (node, event), delay in DELAYS.items():
        rows = [
            (EPOCH + k * PERIOD, OFFSET + k * PERIOD + late[k] + delay + (SLOW if k in slow and delay else 0))
            for k in range(count)
            if not (k in without and (node != "plant" or "taken" in event))
        ]
        found.setdefault(node, {})[event] = np.array(rows, np.int64)
    return found


def test_stages_of_a_steady_flight_are_what_was_put_in():
    found = latencies(traces(400), RATE)
    assert found["samples"] == 299  # one second is left out, and the last sample
    assert (found["missed"], found["late"]) == (0, 0)
    assert found["stages"][TOTAL] == {**dict.fromkeys(("p50", "p90", "p99", "p99.9", "max", "mean"), 430.0)}
    assert found["stages"]["fault observer"]["p50"] == 200.0
    assert found["stages"]["disturbance observer"]["max"] == 40.0
    assert found["stages"]["IMU published to torque"]["max"] == 430.0
    assert found["stages"][TIMER]["max"] == 0.0
    assert set(STAGES) < set(found["stages"])


def test_late_timer_counts_in_the_total_but_not_in_the_stages():
    lateness = np.zeros(400, np.int64)
    lateness[200] = 1_000_000
    found = latencies(traces(400, lateness), RATE)
    assert found["stages"][TIMER]["max"] == 1000.0
    assert found["stages"][TOTAL]["max"] == 1430.0
    assert found["stages"]["IMU published to torque"]["max"] == 430.0


def test_missed_and_late_samples_are_counted():
    found = latencies(traces(400, without={150, 151}, slow={300}), RATE)
    assert (found["missed"], found["late"]) == (2, 1)
    assert found["stages"][TOTAL]["max"] == 20_430.0
    assert sum(found["histogram"]["counts"]) == 297


def test_answer_that_comes_twice_counts_once_and_early():
    flight = traces(400)
    torque, again = flight["plant"]["taken torque/command"], np.array([0, 5_000_000])
    flight["plant"]["taken torque/command"] = np.concatenate([torque, torque + again])
    assert latencies(flight, RATE)["stages"][TOTAL]["max"] == 430.0


def test_messages_that_do_not_reach_a_reader_are_counted_by_reader():
    flight = traces(400)
    assert lost_messages(flight)["imu/data to reference"] == 399  # it has no trace; the last does not count
    taken = flight["disturbance_observer"]["taken imu/corrected"]
    flight["disturbance_observer"]["taken imu/corrected"] = np.delete(taken, [7, 8, 200, 399], axis=0)
    lost = lost_messages(flight)
    assert lost["imu/corrected to disturbance_observer"] == 3
    assert "imu/corrected to controller" not in lost


def test_messages_that_are_not_in_the_bag_are_counted():
    flight = traces(400)
    counts = {"/plant/imu": 400, "/imu/data": 398, "/imu/corrected": 400, "/torque/command": 401}
    assert unrecorded(flight, counts) == 2 + 400  # disturbance/estimate is not in it at all


def test_slowness_is_one_at_best():
    found = slowness(40)
    assert 1.0 <= found["p50"] <= found["p90"]


def test_percentiles_and_histogram_are_in_microseconds():
    values = np.arange(1, 1001) * 1000
    found = statistics(values)
    assert found["p50"] == pytest.approx(500.5)
    assert found["max"] == 1000.0
    drawn = histogram(values)
    assert sum(drawn["counts"]) == 991  # those below 10 us are left of it
    assert len(drawn["edges_us"]) == len(drawn["counts"]) + 1


def test_machine_and_usage_are_described():
    what = machine()
    assert what["usable_cores"] >= 1
    assert what["versions"]["ros_distro"]
    usage = Usage({"this": os.getpid()})
    end = time.process_time() + 0.3  # of user and system, as reading the time costs the latter
    while time.process_time() < end:
        pass
    taken = usage.taken(1.0)["this"]
    assert 0.25 <= taken["cpu_share"] <= 1.5
    assert taken["memory_mib"] > 10.0


SHORT_FLIGHT = ["latency", "--duration", "1.5", "--rate", "100"]


@pytest.mark.parametrize(
    ("arguments", "kind"),
    [
        (["step", "--batches", "2", "--only", "sliding_mode", "--only", "exosystem"], "step"),
        (["lockstep", "--duration", "0.5", "--repeat", "1"], "lockstep"),
        (SHORT_FLIGHT, "latency"),
        pytest.param(
            [*SHORT_FLIGHT, "--graph", "processes", "--no-record"], "latency", marks=pytest.mark.thorough
        ),
    ],
)
def test_benchmark_writes_what_it_measured(tmp_path, capfd, arguments, kind):
    """How fast it was is not judged here: a machine may be busy."""
    assert guarded(["bench", *arguments, "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / f"{kind}.json").read_text(encoding="utf-8"))
    assert written["machine"]["cores"] >= 1
    assert written["results"]
    if kind == "latency":
        (result,) = written["results"]
        answered = result["samples"] - result["missed"]
        assert 0 <= result["late"] <= answered <= result["samples"]
        assert 0 < result["samples"] < 150
        assert 0 < sum(result["histogram"]["counts"]) <= answered
        assert 10.0 < result["stages"][TOTAL]["p50"] <= result["stages"][TOTAL]["max"]
        assert (tmp_path / "latency.png").stat().st_size > 5000
        assert ("recorded" in result) == ("--no-record" not in arguments)
        if "recorded" in result:
            assert result["recorded"]["stored"] > answered
    if kind == "lockstep":
        flown = [(row["form"], row["engine"]) for row in written["results"]]
        assert flown == forms(["c", "numpy"])
        for row in written["results"]:
            steps = row["rate"] * row["real_time_factor"]  # in a second
            assert row["sample_us"] * steps == pytest.approx(1e6, rel=0.02)
    if kind == "step":
        rows = {(row["law"], row["place"]): row for row in written["results"]}
        assert {law for law, _ in rows} == {"sliding_mode", "exosystem"}
        assert len(rows) == 3  # an observer of faults flies in both places
        for row in rows.values():
            assert 0.0 < row["loop_us"] < row["best_us"] <= row["median_us"]
            assert row["statements"] > 10
            assert row["bytes"] > 1000
    assert "load" in capfd.readouterr().out


def test_step_renews_the_table_of_the_document(tmp_path):
    document = tmp_path / "performance.md"
    document.write_text("<!-- table: law-costs -->\nold\n<!-- end -->\n")
    arguments = ["--batches", "2", "--only", "threshold", "--engine", "c", "--engine", "numpy"]
    assert guarded(["bench", "step", *arguments, "--docs", str(tmp_path)]) == 0
    (row,) = document.read_text().splitlines()[3:-1]  # in both places: the one in free flight
    law, *numbers = row.strip("| ").split(" | ")
    assert law == "observer `threshold`"
    numpy, called, looped, _ = map(float, numbers)
    assert numpy > called > looped > 0.0


def test_every_registered_law_has_its_costs_where_it_can_fly():
    laws = {(case.kind, case.law, case.place) for case in cases()}
    for kind, registry in (("observer", fault_observers), ("controller", controllers)):
        for name in registry.names():
            assert {(kind, name, "test stand"), (kind, name, "free flight")} <= laws
    assert {("disturbance observer", name, "test stand") for name in disturbance_observers.names()} <= laws
    assert {("position controller", name, "free flight") for name in position_controllers.names()} <= laws


@pytest.mark.parametrize(
    "arguments",
    [
        ["latency", "--rate", "-5"],
        ["step", "--only", "nobody"],
        ["lockstep", "--engine", "jax"],
        ["latency", "--observer", "nobody"],
        ["latency", "--duration", "1"],
        ["latency", "--core", "4096"],
        ["latency", "--realtime-priority", "100"],
        ["latency", "--realtime-priority", "5", "--wait", "poll"],
        ["latency", "--graph", "processes", "--wait", "poll"],
    ],
)
def test_wrong_arguments_are_refused_in_one_line(capfd, arguments):
    assert guarded(["bench", *arguments]) == 2
    assert "error: " in capfd.readouterr().err


@pytest.mark.parametrize("part", ["latency", "lockstep"])
def test_help_shows_units(capfd, part):
    assert guarded(["bench", part, "--help"]) == 0
    assert "Length of a flight [s]." in " ".join(capfd.readouterr().out.split())
