"""The benchmark of the batch engine: what it counts and writes, what it says of others that are absent."""

from __future__ import annotations

import importlib.util
import json
import sys

import pytest

from quadftc_campaign.batch import engine
from quadftc_cli.main import guarded
from quadftc_flight.scenario import find_scenario, load_scenario
from quadftc_tools.bench.batch import OURS, THEIRS, Measurement, _summary, measure, measurements
from quadftc_tools.bench.batch_worker import bare_flight, bare_scenario, bare_subject, compressed, prepare

SAMPLES = 50  # of 0.2 s
JOB = {
    "task": "engine",
    "scenario": "mems_faults",
    "scheme": "conventional",
    "duration": 0.2,
    "first_seed": 1,
}


@pytest.fixture
def _draws_are_put_back(monkeypatch):
    monkeypatch.setattr(engine, "LoopDraws", engine.LoopDraws)  # the worker puts timed ones in their place


@pytest.mark.usefixtures("_draws_are_put_back")
@pytest.mark.parametrize("runs", ["c", "jax"])
def test_every_step_of_every_flight_is_counted_in_each_run(runs):
    flights = 3
    subject = prepare({**JOB, "engine": runs, "flights": flights, "float32": False})
    for _ in range(2):
        flown = subject.run()
        assert flown.steps == flights * SAMPLES
        assert flown.drawing > 0.0
    assert "6 sensor faults" in subject.what["sensors"]


def test_faults_come_at_the_same_parts_of_a_shorter_flight():
    whole, short = load_scenario(find_scenario("mems_faults")), compressed("mems_faults", 8.0)
    assert len(short.faults) == len(whole.faults) == 6
    for fault, expected in zip(short.faults, whole.faults, strict=True):
        assert fault.injection.start == pytest.approx(expected.injection.start * 8.0 / whole.duration)
        assert fault.injection.stop == pytest.approx(expected.injection.stop * 8.0 / whole.duration)


def test_bare_loop_holds_the_attitude_of_each_flight():
    subject = bare_subject(bare_scenario(5.0, motor_lag=True), 3)
    assert subject.run().steps == 3 * 1250  # it raises if the attitude is not there at the end


@pytest.mark.thorough  # XLA takes long for it
def test_bare_flight_holds_the_attitude_of_each_flight_too():
    """With as many states as crazyflow's."""
    subject = bare_subject(bare_flight(5.0), 3)
    assert subject.run().steps == 3 * 2500  # it raises if the attitude is not there at the end
    assert "(17)" in subject.what["states"]


def test_speed_is_that_of_the_slowest_process():
    rounds = [
        [{"steps": 600, "seconds": 1.0, "drawing": 0.5}, {"steps": 400, "seconds": 2.0, "drawing": 0.5}],
        [{"steps": 600, "seconds": 1.0, "drawing": 0.0}, {"steps": 400, "seconds": 1.0, "drawing": 0.0}],
    ]
    found = _summary([[{**one, "runs": 2} for one in each] for each in rounds])
    assert found["steps_per_second"] == {"best": 1000, "median": 750}
    assert found["repeats"] == [500, 1000]
    assert found["ns_per_step_and_core"] == pytest.approx(2e6)
    assert found["drawing_share"] == pytest.approx(0.2)
    assert found["seconds"] == {"best": 0.5, "median": 0.5}


def test_other_simulators_and_the_bare_loop_are_measured_too():
    names = {each.name for each in measurements([1], [True], [1], 8.0)}
    assert names > {"bare, in the engine", "bare", "bare, free flight", "free flight, isolating"}
    assert names > {"crazyflow", "RotorPy", "RotorPy, one drone"}


def test_all_batch_sizes_are_flown_on_the_fewest_cores_and_the_largest_on_all():
    plan = measurements([1, 8], [False, True], [1, 2], 8.0)
    plan = [each for each in plan if each.name == "supervised, jax"]
    places = {(each.flights, each.cores, each.float32) for each in plan}
    assert len(plan) == len(places) == 6
    assert {(n, c) for n, c, _ in places} == {(1, 1), (8, 1), (8, 2)}


@pytest.mark.skipif(bool(importlib.util.find_spec("crazyflow")), reason="it is installed")
def test_simulator_that_is_not_installed_gives_a_row_that_says_so():
    what = Measurement("crazyflow", THEIRS, 1, True, 1, {"simulator": "crazyflow", "steps_a_call": 1})
    row = measure(what, 1, sys.executable)
    assert row is not None
    assert row["absent"] == "crazyflow is not installed"


def test_process_that_cannot_do_its_job_says_why_in_one_line():
    job = {**JOB, "scheme": "nobody's"}
    with pytest.raises(Exception, match="nobody's") as raised:
        measure(Measurement("it", OURS, 1, True, 1, job), 1, sys.executable)
    assert type(raised.value).__name__ == "RunError"
    assert "\n" not in str(raised.value)


@pytest.fixture
def measured(tmp_path, capfd, monkeypatch):
    """Run the benchmark shortly; return its rows by name, and what it printed."""

    def run(only):
        monkeypatch.setattr("quadftc_tools.bench.batch.SCHEME", "conventional")  # quickest to compile
        monkeypatch.setattr("quadftc_tools.bench.batch.OTHER_SCHEMES", ())
        monkeypatch.setattr("quadftc_tools.bench.batch.LEAST", 0.01)
        short = ["--only", only, "--flights", "2", "--cores", "1"]
        short += ["--repeats", "2", "--duration", "0.2"]
        assert guarded(["bench", "batch", *short, "--out", str(tmp_path)]) == 0
        assert (tmp_path / "batch.png").stat().st_size > 5000
        written = json.loads((tmp_path / "batch.json").read_text(encoding="utf-8"))
        assert written["machine"]["cores"] >= 1
        return {row["name"]: row for row in written["results"]}, capfd.readouterr().out

    return run


def test_benchmark_writes_what_it_measured(measured):
    rows, printed = measured("one whole flight")
    assert set(rows) == {"conventional, one whole flight"}
    whole = rows["conventional, one whole flight"]
    assert (whole["flights"], whole["precision"], len(whole["repeats"])) == (1, "float64", 2)
    assert 0 < whole["steps_per_second"]["median"] <= whole["steps_per_second"]["best"]
    assert whole["memory_mib"] > 50.0
    assert whole["seconds"]["best"] == pytest.approx(20_000 / whole["steps_per_second"]["best"], rel=1e-3)
    assert f"conventional, one whole flight of 80 s, float64: {whole['seconds']['best']:.3f} s" in printed
    assert "load" in printed


@pytest.mark.thorough
def test_benchmark_measures_jax_and_free_flight_too(measured):
    rows, printed = measured("conventional")
    ours = {"conventional", "conventional, jax", "conventional, one whole flight"}
    assert set(rows) == {*ours, "free flight, conventional"}
    assert {rows[name]["flights"] for name in ("conventional", "conventional, jax")} == {2}
    assert "conventional: C is " in printed


@pytest.mark.parametrize(
    "arguments",
    [
        ["--flights", "0"],
        ["--precision", "float16"],
        ["--cores", "4096"],
        ["--repeats", "0"],
        ["--duration", "0"],
        ["--only", "nobody"],
        ["--others", "/nowhere/python"],
        ["--others", "true"],
    ],
)
def test_wrong_arguments_are_refused_in_one_line(capfd, arguments):
    assert guarded(["bench", "batch", *arguments]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("error: ")
