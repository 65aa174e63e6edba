"""Campaigns: what is drawn, what is refused, and that the results do not depend on how they were flown."""

import contextlib
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys

import numpy as np
import psutil
import pytest
from polars.testing import assert_frame_equal
from worker_tasks import be_killed, double

from quadftc_campaign import campaign_run
from quadftc_campaign.campaign_checks import CampaignCheck, campaign_results
from quadftc_campaign.campaign_file import load_campaign
from quadftc_campaign.campaign_run import CampaignRun, chunks_of, fly_chunk
from quadftc_campaign.distributions import distribution, plain
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flights import drawn, flight_scenario, variant_of
from quadftc_campaign.table import summary_of, table_of, with_ratios
from quadftc_campaign.workers import TAKE_ALL, devices, run_tasks, started_workers
from quadftc_flight.closed_loop import fly
from quadftc_flight.diagnosis_metrics.which_sensor import SAID, TRUE
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import ScenarioError
from quadftc_model.samples import AXES

BASE = """
duration: 1 s
rate: 250 Hz
vehicle: qball_x4
sensors: {grade: mems}
faults:
  - {kind: bias, axes: roll, value: 1 deg, start: 0.1 s, stop: 0.3 s}
schemes:
  smc: {controller: smc}
  pid: {controller: pid}
"""
CAMPAIGN = """
name: short
scenario: base.yaml
set: [duration=0.4 s]
flights: 12
seed: 7
schemes: [smc, pid]
vary:
  faults.0.start: {uniform: [0.1 s, 0.2 s]}
  faults.0.value: {uniform: [1 deg, 5 deg], sign: random}
  faults.0.axes: {choice: [roll, pitch]}
  sensors.gyro_noise: {log_uniform: [0.001, 0.01]}
  rate: {grid: [125 Hz, 250 Hz]}
"""
# The same with one structure, which each process compiles once.
ALIKE = "\n".join(
    line
    for line in CAMPAIGN.replace("[smc, pid]", "[smc]").splitlines()
    if not line.startswith(("  rate:", "  faults.0.axes:"))
)


SIZE = 3  # flights of a chunk; the same everywhere, as another number is compiled again


@pytest.fixture
def campaign(tmp_path):
    return written(tmp_path, CAMPAIGN)


@pytest.fixture
def alike(tmp_path):
    return written(tmp_path, ALIKE)


def written(tmp_path, text):
    (tmp_path / "base.yaml").write_text(BASE)
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return load_campaign(path)


@pytest.mark.parametrize(
    ("raw", "low", "high"),
    [
        ({"uniform": [1.0, 3.0]}, 1.0, 3.0),
        ({"log_uniform": ["0.1 s", "10 s"]}, 0.1, 10.0),
        ({"uniform": ["1 deg", "2 deg"], "sign": "random"}, -2.0, 2.0),
    ],
)
def test_what_is_drawn_lies_within_its_bounds(raw, low, high):
    generator = np.random.default_rng(0)
    values = np.array([plain(distribution(raw).draw(generator)) for _ in range(400)])
    assert low <= values.min() < values.max() <= high
    if "sign" in raw:
        assert not np.any(np.abs(values) < 1.0)
        assert abs(np.mean(values < 0.0) - 0.5) < 0.1


def test_a_normal_distribution_has_its_moments_and_keeps_its_unit():
    generator = np.random.default_rng(0)
    raw = distribution({"normal": ["2 deg", "0.5 deg"]})
    texts = [raw.draw(generator) for _ in range(2000)]
    assert all(text.endswith(" deg") for text in texts)
    values = np.array([plain(text) for text in texts])
    assert abs(values.mean() - 2.0) < 0.05
    assert abs(values.std() - 0.5) < 0.03


def test_a_log_uniform_distribution_has_its_median_in_the_geometric_middle():
    generator = np.random.default_rng(0)
    values = [distribution({"log_uniform": [0.01, 100.0]}).draw(generator) for _ in range(2000)]
    assert abs(np.median(np.log(values))) < 0.3


def test_a_list_is_drawn_number_by_number():
    drawn_list = distribution({"uniform": [0.0, 1.0], "size": 3}).draw(np.random.default_rng(0))
    assert len(set(drawn_list)) == 3


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (3, "expected a distribution"),
        ({}, "expected one of uniform"),
        ({"uniform": [2.0, 1.0]}, "an empty range"),
        ({"uniform": [1.0, 1.0]}, "an empty range"),
        ({"uniform": [-1e308, 1e308]}, "too large to draw from"),
        ({"uniform": [1.0]}, r"expected \[low, high\]"),
        ({"uniform": ["1 deg", "2 rad"]}, "expected one unit"),
        ({"uniform": [0.0, True]}, "expected a number"),
        ({"log_uniform": [0.0, 1.0]}, "must be positive"),
        ({"normal": [0.0, 0.0]}, "standard deviation 0: must be positive"),
        ({"choice": []}, "at least one"),
        ({"grid": 3}, "expected a list"),
        ({"grid": [1, 2], "size": 2}, "size"),
        ({"choice": [1, 2], "sign": "random"}, "sign: a choice has none"),
        ({"uniform": [0.0, 1.0], "sign": "up"}, "expected random"),
        ({"unyform": [0.0, 1.0]}, "unknown key 'unyform'.*did you mean 'uniform'"),
    ],
)
def test_a_distribution_that_is_none_is_refused(raw, message):
    with pytest.raises(ValueError, match=message):
        distribution(raw)


def test_schemes_fly_with_each_observer_that_is_named(tmp_path):
    text = CAMPAIGN.replace("schemes:", "observers: [none, threshold]\nschemes:")
    given = '"schemes.smc.observer={kind: threshold, recovery_time: 0.5 s}"'
    campaign = written(tmp_path, text.replace("duration=0.4 s", f"duration=0.4 s, {given}"))
    assert [each.name for each in campaign.variants] == [
        "smc+none",
        "smc+threshold",
        "pid+none",
        "pid+threshold",
    ]
    parts = [flight_scenario(campaign, 0, each).scheme(each.scheme) for each in campaign.variants]
    assert [(each.observer.kind, each.controller.kind) for each in parts] == [
        ("none", "smc"),
        ("threshold", "smc"),
        ("none", "pid"),
        ("threshold", "pid"),
    ]
    assert parts[1].observer.law.recovery_time == 0.5 != parts[3].observer.law.recovery_time


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("flights: 12", "flights: 0"), r"campaign.yaml:\d+: flights: 0: "),
        (("flights: 12", "flihgts: 12"), "flihgts: unknown key"),
        (("scenario: base.yaml", "scenario: nothing_such"), "scenario: no scenario 'nothing_such'"),
        (("schemes: [smc, pid]", "schemes: [smc, pdi]"), r"schemes\[1\]: no 'pdi'"),
        (("schemes: [smc, pid]", "observers: [supervized]"), r"observers\[0\]: no 'supervized'"),
        (
            ("uniform: [1 deg, 5 deg]", "uniform: [5 deg, 1 deg]"),
            r"uniform: low 5, high 1: an empty range",
        ),
        (("rate: {grid", "seed: {grid"), "'seed' cannot vary"),
        (
            ("set: [duration=0.4 s]", "set: [plant.kind=free_flight]\nsource: {kind: motion}"),
            "source.kind: motion: expected 'loop', as a free flight",
        ),
        (
            ("vary:", "checks: [{metric: tracking_rms_deg.q95, below: 1}]\nvary:"),
            r"checks\[0\].metric: no metric 'tracking_rms_deg' \(did you mean 'tracking_rmse_deg'\?\)",
        ),
        (
            ("vary:", "checks: [{metric: faults.all.mised, below: 1, variants: [pdi]}]\nvary:"),
            r"(?s)'faults.all.mised': expected one of .*variants: no 'pdi'; there are: smc",
        ),
    ],
)
def test_a_campaign_file_that_is_wrong_is_refused(tmp_path, change, message):
    text = CAMPAIGN.replace(*change)
    with pytest.raises(ScenarioError, match=message):
        written(tmp_path, text)


def test_a_path_that_leads_nowhere_is_refused_before_anything_flies(tmp_path):
    text = CAMPAIGN.replace("faults.0.value", "faults.5.value")
    with pytest.raises(ScenarioError, match=r"flight 0: .*faults.*there are: 0 to 0"):
        CampaignRun(written(tmp_path, text), tmp_path / "out").open(resume=False)
    assert not (tmp_path / "out").exists()


def test_a_fault_that_is_drawn_for_a_scenario_without_faults_is_refused(tmp_path):
    lines = (line for line in ALIKE.splitlines() if "faults.0" not in line)
    drawn_fault = "  faults.0: {choice: [{kind: stuck, axes: roll, start: 0.1 s}]}"
    text = "\n".join([*lines, drawn_fault]).replace("[duration=0.4 s]", "[duration=0.4 s, 'faults=[]']")
    campaign = written(tmp_path, text)
    del campaign.base.data["faults"]
    with pytest.raises(ScenarioError, match=r"flight 0.*faults"):
        flight_scenario(campaign, 0, campaign.variants[0])


def test_a_flight_depends_on_its_number_alone(campaign, tmp_path):
    (tmp_path / "more").mkdir()
    more = written(
        tmp_path / "more",
        CAMPAIGN.replace("flights: 12", "flights: 40").replace(
            "  rate:", "  faults.0.stop: {uniform: [0.3 s, 0.35 s]}\n  rate:"
        ),
    )
    for number in range(12):
        values, others = drawn(campaign, number), drawn(more, number)
        assert {path: others[path] for path in values} == values
    assert len({drawn(campaign, number)["seed"] for number in range(12)}) == 12


def test_grids_are_gone_through_in_turn_and_chunks_have_one_structure(campaign):
    assert [drawn(campaign, number)["rate"] for number in range(4)] == ["125 Hz", "250 Hz"] * 2
    chunks = chunks_of(campaign, size=4)
    assert sorted(number for chunk in chunks for number in chunk) == list(range(12))
    assert all(len({drawn(campaign, number)["rate"] for number in chunk}) == 1 for chunk in chunks)


def test_grids_of_numbers_share_their_chunks(tmp_path):
    """So that nothing is compiled for each value; a switch has chunks of its own."""
    grids = """  plant.inertia_factor: {grid: [0.8, 1.0, 1.25]}
  plant.motor_lag: {grid: [false, true]}
"""
    campaign = written(tmp_path, CAMPAIGN.replace("  rate: {grid: [125 Hz, 250 Hz]}\n", grids))
    chunks = chunks_of(campaign, size=4)
    assert sorted(len(chunk) for chunk in chunks) == [3, 3, 3, 3]
    for chunk in chunks:
        values = [drawn(campaign, number) for number in chunk]
        assert len({value["plant.motor_lag"] for value in values}) == 1
        assert {value["plant.inertia_factor"] for value in values} == {0.8, 1.0, 1.25}


def test_a_row_says_what_the_flight_alone_says(campaign):
    rows = table_of(fly_chunk(campaign, chunks_of(campaign, 32)[1]))
    for number in (1, 11):
        for variant in campaign.variants:
            scenario = flight_scenario(campaign, number, variant)
            flown = fly(scenario, variant.scheme)
            metrics = flight_metrics(flown, scenario.fault_windows, scenario.fault_events)
            (row,) = rows.filter(flight=number, variant=variant.name).to_dicts()
            assert row["tracking_rmse_deg.pitch"] == pytest.approx(
                metrics["tracking_rmse_deg"]["pitch"], rel=1e-9
            )
            (event,) = metrics["diagnosis"]["events"]
            assert row["fault.axis"] == event["axis"]
            assert row["fault.tracking_rmse_deg"] == pytest.approx(event["tracking_rmse_deg"], rel=1e-9)
            assert row["faults.0.value"] == pytest.approx(
                plain(drawn(campaign, number)["faults.0.value"]), rel=1e-15
            )


def test_a_campaign_in_jax_says_what_one_in_c_says(alike):
    numbers = range(SIZE)
    in_c, in_jax = (
        table_of(fly_chunk(alike.model_copy(update={"engine": engine}), numbers)) for engine in ("c", "jax")
    )
    assert_frame_equal(in_c, in_jax, rel_tol=1e-9, abs_tol=1e-9)


def flown_alone(campaign):
    """Return the table of a campaign that this process flies, without a worker."""
    table = table_of([row for chunk in chunks_of(campaign, SIZE) for row in fly_chunk(campaign, chunk)])
    return table.sort("flight", "variant", "fault")


PARENT = """
import os, time
from quadftc_campaign.workers import started_workers
if __name__ == "__main__":
    with started_workers(2) as workers:
        waiting = [workers.submit(time.sleep, seconds) for seconds in (0.5, 60.0)]
        waiting[0].result()
        print(*workers._pool._processes, flush=True)
        time.sleep(60.0)
"""


def test_workers_end_with_a_campaign_that_is_killed(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    parent = subprocess.Popen([sys.executable, tmp_path / "parent.py"], stdout=subprocess.PIPE, text=True)
    workers = [psutil.Process(int(each)) for each in parent.stdout.readline().split()]
    parent.kill()
    parent.communicate()
    assert len(workers) == 2
    assert psutil.wait_procs(workers, timeout=30.0)[1] == []


@pytest.mark.thorough
def test_results_with_two_workers_are_those_without(alike, tmp_path):
    run = CampaignRun(alike, tmp_path / "out", SIZE)
    extent = run.open(resume=False)
    assert (extent.chunks, extent.missing) == (4, 4)
    seen = []
    run.fly(2, seen.append)
    frame, summary = run.finish()
    assert frame.equals(flown_alone(alike))
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == json.loads(json.dumps(summary))
    assert sum(seen) <= extent.samples


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_workers_end_before_a_stop_is_raised(number):
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    working = []

    def stop(_samples):
        working.extend(multiprocessing.active_children())
        signal.raise_signal(number)

    def fly():
        with started_workers(1) as workers:
            list(run_tasks(workers, double, [(0,), (1,)], stop))

    with pytest.raises(KeyboardInterrupt):
        fly()
    assert len(working) >= 1
    assert not set(working) & set(multiprocessing.active_children())
    assert handlers == (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM))


def test_worker_that_is_killed_in_the_middle_loses_nothing():
    killed = []
    with started_workers(2) as workers:
        assert devices(workers, "jax") == "2 x cpu"
        assert workers.submit(os.getenv, TAKE_ALL).result() == "false"  # of a GPU's memory
        victim = workers.submit(os.getpid).result()

        def kill_once(samples):
            if not killed:
                killed.append(samples)
                os.kill(victim, signal.SIGKILL)

        found = dict(run_tasks(workers, double, [(number,) for number in range(4)], kill_once))
    assert killed
    assert {place: twice for place, (_, twice) in found.items()} == {k: 2 * k for k in range(4)}
    assert found[3][0] != victim


def test_worker_that_is_always_killed_is_said_in_one_line():
    with started_workers(1) as workers, pytest.raises(CampaignError, match=r"chunk 0: .* killed 4 times"):
        list(run_tasks(workers, be_killed, [()]))


@pytest.fixture
def in_this_process(monkeypatch):
    """Chunks are flown here; the tests that kill workers show that these fly the same."""

    def run_here(workers, function, arguments, progress):
        return enumerate(function(*each, progress) for each in arguments)

    monkeypatch.setattr(campaign_run, "started_workers", lambda count: contextlib.nullcontext())
    monkeypatch.setattr(campaign_run, "devices", lambda workers, engine: "here")
    monkeypatch.setattr(campaign_run, "run_tasks", run_here)


@pytest.mark.usefixtures("in_this_process")
def test_a_campaign_goes_on_where_it_was_and_ends_the_same(alike, tmp_path, monkeypatch):
    """Also where each flight takes so long that it is handed over by itself."""
    whole = CampaignRun(alike, tmp_path / "whole", SIZE)
    whole.open(resume=False)
    whole.fly(1, lambda samples: None)
    expected, _ = whole.finish()
    assert expected.equals(flown_alone(alike))
    chunks = sorted((tmp_path / "whole" / "chunks").iterdir())
    broken = tmp_path / "broken"
    CampaignRun(alike, broken, SIZE).open(resume=False)
    for path in chunks[:2]:
        (broken / "chunks" / path.name).write_bytes(path.read_bytes())
    (broken / "chunks" / ".00002.parquet.part").write_bytes(b"half")  # what a kill leaves
    again = CampaignRun(alike, broken, SIZE)
    assert again.open(resume=True).missing == 2
    monkeypatch.setattr(campaign_run, "PATIENCE", 0.0)
    assert {row["flight"] for row in fly_chunk(alike, range(SIZE), patience=0.0)} == {0}
    again.fly(1, lambda samples: None)
    frame, _ = again.finish()
    assert frame.equals(expected)
    for name in ("summary.json", "flights.parquet"):
        assert (broken / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_directory_with_another_campaign_is_left_alone(campaign, tmp_path):
    out = tmp_path / "out"
    CampaignRun(campaign, out).open(resume=False)
    with pytest.raises(CampaignError, match="--resume goes on"):
        CampaignRun(campaign, out).open(resume=False)
    other = written(tmp_path, CAMPAIGN.replace("seed: 7", "seed: 8"))
    with pytest.raises(CampaignError, match=r"another campaign \(seed differ\)"):
        CampaignRun(other, out).open(resume=True)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    with pytest.raises(CampaignError, match="is not empty"):
        CampaignRun(campaign, tmp_path / "full").open(resume=False)


@pytest.mark.usefixtures("in_this_process")
def test_a_full_disk_is_said_in_one_line(alike, tmp_path, monkeypatch):
    run = CampaignRun(alike, tmp_path / "out", SIZE)
    run.open(resume=False)

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CampaignError, match=r"chunks.*No space left on device.*--resume goes on"):
        run.fly(1, lambda samples: None)
    assert not list((tmp_path / "out" / "chunks").iterdir())


def test_a_variant_or_flight_that_is_not_there_is_refused(campaign):
    with pytest.raises(CampaignError, match="no variant 'x'; there are: smc"):
        variant_of(campaign, "x")
    with pytest.raises(CampaignError, match="no flight 12; there are 0 to 11"):
        flight_scenario(campaign, 12, campaign.variants[0])


def test_attitude_errors_are_related_to_those_of_the_same_flight_without_a_diagnosis():
    def row(flight, observer, controller, error, fault=None):
        parts = {"observer": observer, "disturbance_observer": "exosystem", "controller": controller}
        errors = {"attitude_error_max_deg": error, "attitude_error_rms_deg": 0.1 * error}
        return {"flight": flight, "variant": observer + controller, "fault": fault, **parts, **errors}

    rows = [row(0, "none", "ismc", 2.0, 0), row(0, "none", "ismc", 2.0, 1), row(1, "none", "ismc", 4.0)]
    rows += [row(0, "supervised", "ismc", 3.0, 0), row(1, "supervised", "ismc", 2.0)]
    rows += [row(0, "supervised", "pid", 9.0)]
    found = with_ratios(table_of(rows))
    assert found["attitude_error_max_deg_ratio"].to_list() == [1.0, 1.0, 1.0, 1.5, 0.5, None]
    assert found["attitude_error_rms_deg_ratio"].to_list() == pytest.approx([1.0, 1.0, 1.0, 1.5, 0.5, None])
    alone = table_of(rows[3:])
    assert with_ratios(alone).columns == alone.columns


def test_checks_of_a_campaign_are_held_against_every_variant_and_axis():
    quantiles = {
        f"tracking_rmse_deg.{axis}": {"q95": size} for axis, size in zip(AXES, (1, 2, 3), strict=True)
    }
    fault = {"count": 5, "judged": 4, "missed": 1, "unnamed": 0, "misnamed": 0}
    fault["metrics"] = {"fault.detection_delay_s": {"max": 0.5}}
    summary = {"flights": 9, "not_finite": 0, "lost": 2, "metrics": quantiles, "faults": {"all": fault}}
    checks = [
        CampaignCheck(metric="tracking_rmse_deg.q95", below=2.5),
        CampaignCheck(metric="faults.all.missed_share", below=0.3, variants=("one",)),
        CampaignCheck(metric="faults.all.detection_delay_s.max", below=0.1, variants=("other",)),
        CampaignCheck(metric="lost", below=1.0),
    ]
    found = campaign_results(checks, {"one": summary, "other": summary})
    passed = {
        name: [each["passed"] for each in found if each["variant"] == name] for name in ("one", "other")
    }
    assert passed["one"] == [True, True, False, True, False]
    assert passed["other"] == [True, True, False, False, False]
    assert found[3]["value"] == 0.25


def test_faults_of_several_sensors_are_told_apart_and_confusions_add_up(campaign):
    def row(flight, component, named, share):
        fault = {"fault.component": component, "fault.kind": "step", "fault.named": named}
        parts = {"observer": "supervised", "disturbance_observer": "none", "controller": "smc"}
        times = {f"sensors.confusion_s.{true}.{said}": 0.0 for true in TRUE for said in SAID}
        times["sensors.confusion_s.gyro.attitude"] = 2.0
        flown = {"flight": flight, "variant": campaign.variants[0].name, "finite": True, "lost": not named}
        return {**flown, **parts, "fault": 0, **fault, "fault.misnamed_share": share, **times}

    rows = [row(0, "gyro", True, 0.0), row(1, "gyro", False, 0.5), row(2, "attitude", True, 0.0)]
    found = summary_of(campaign, table_of(rows))["variants"][campaign.variants[0].name]
    counts = {
        kind: [part[name] for name in ("count", "unnamed", "misnamed")]
        for kind, part in found["faults"].items()
    }
    assert counts == {"gyro step": [2, 1, 1], "step": [1, 0, 0], "all": [3, 1, 1]}
    assert found["lost"] == 1
    assert found["confusion_s"]["gyro"]["attitude"] == 6.0


@pytest.mark.parametrize("harm", ["cut", "no table", "of another chunk"])
@pytest.mark.usefixtures("in_this_process")
def test_a_damaged_chunk_is_named_and_flown_again(alike, tmp_path, harm):
    run = CampaignRun(alike, tmp_path / "out", SIZE)
    run.open(resume=False)
    run.fly(1, lambda samples: None)
    expected, _ = run.finish()
    first, second, *_ = sorted((tmp_path / "out" / "chunks").iterdir())
    content = {
        "cut": second.read_bytes()[:-100],
        "no table": b"x" * 500,
        "of another chunk": first.read_bytes(),
    }
    second.write_bytes(content[harm])
    again = CampaignRun(alike, tmp_path / "out", SIZE)
    extent = again.open(resume=True)
    assert extent.missing == 1
    assert re.fullmatch(rf"{re.escape(str(second))}: .+; its \d+ flights are flown again", extent.damaged[0])
    again.fly(1, lambda samples: None)
    assert again.finish()[0].equals(expected)
