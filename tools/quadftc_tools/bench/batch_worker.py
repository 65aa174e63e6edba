# pyright: basic
"""The batch engine in a process of its own: `python -m quadftc_tools.bench.batch_worker JOB`."""

from __future__ import annotations

import time
from typing import Any

from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    with_controller,
    with_duration,
    with_seed,
)
from quadftc_tools.bench.batch_child import Flown, Job, Subject, serve

BARE_SCENARIO, BARE_SCHEME, BARE_CONTROLLER = "paper_faults", "conventional", "pid"


def prepare(job: Job) -> Subject:
    """Build what a job wants measured.

    Parameters
    ----------
    job : dict
        ``task``: "engine" (``scenario``, ``scheme``), "bare engine" or "bare"; ``flights``, ``float32``,
        ``duration`` [s], ``first_seed``.
    """
    if job["task"] == "bare":
        from quadftc_tools.bench.batch_bare import bare_subject

        return bare_subject(bare_scenario(job["duration"], motor_lag=True), job["flights"], job["float32"])
    if job["task"] == "bare engine":
        return _engine(job, bare_scenario(job["duration"]), BARE_SCHEME)
    return _engine(job, compressed(job["scenario"], job["duration"]), job["scheme"])


def compressed(name: str, duration: float) -> Scenario:
    """A scenario cut to ``duration`` [s], its faults at the same parts of it as in the whole."""
    path = find_scenario(name)
    whole = load_scenario(path)
    scale = duration / whole.duration
    moved = [
        f"faults.{index}.{end}={getattr(fault.injection, end) * scale:.6f} s"
        for index, fault in enumerate(whole.faults)
        for end in ("start", "stop")
    ]
    return with_duration(load_scenario(path, moved), duration)


def bare_scenario(duration: float, motor_lag: bool = False) -> Scenario:
    """Plant, ideal sensor and an attitude controller; no faults, no observers."""
    path = find_scenario(BARE_SCENARIO)
    changes = ["faults=[]", f"plant.motor_lag={str(motor_lag).lower()}"]
    changes += [f"schemes.{name}.checks=[]" for name in load_scenario(path).schemes]  # of the faults
    scenario = with_duration(load_scenario(path, changes), duration)
    return with_controller(scenario, BARE_CONTROLLER, BARE_SCHEME)


def _engine(job: Job, scenario: Scenario, scheme: str) -> Subject:
    import jax

    from quadftc_campaign.batch import flown as flown_module
    from quadftc_campaign.batch.engine import Engine
    from quadftc_campaign.flights import parts_of

    seeds = range(job["first_seed"], job["first_seed"] + job["flights"])
    scenarios = (with_seed(scenario, seed) for seed in seeds)
    parts = [parts_of(each, scheme) for each in scenarios]
    events = [scenario.fault_events] * len(parts)
    drawing = _timed_supply(flown_module)
    engine = Engine(job["float32"])

    def run() -> Flown:
        before, steps = drawing[0], 0

        def count(samples: int) -> None:
            nonlocal steps
            steps += samples

        outcomes = engine.fly(parts, events, count)
        if not all(bool(outcome.marks.finite) for outcome in outcomes):
            raise ValueError("a flight has values that are no numbers")
        return Flown(steps, drawing[0] - before)

    chosen = scenario.scheme(scheme)
    laws = (chosen.observer.kind, chosen.disturbance_observer.kind, chosen.controller.kind)
    return Subject(
        {
            "by": f"quadftc, JAX {jax.__version__}, {engine.device}",
            "states": "attitude and body rate (7), observers and controller",
            "integrator": f"RK4, {scenario.rate:g} Hz",
            "control": "fault observer {}, disturbance observer {}, controller {}".format(*laws),
            "sensors": f"those of {scenario.name}, {len(scenario.faults)} sensor faults; metrics are kept",
        },
        run,
    )


def _timed_supply(flown_module: Any) -> list[float]:
    """Time the source of random numbers; the list's one number is the time spent in it so far [s]."""
    spent = [0.0]

    class TimedSupply(flown_module.Supply):
        def __init__(self, *arguments: Any) -> None:
            begin = time.perf_counter()
            super().__init__(*arguments)
            spent[0] += time.perf_counter() - begin

        def next(self, *arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            found = super().next(*arguments, **options)
            spent[0] += time.perf_counter() - begin
            return found

    flown_module.Supply = TimedSupply
    return spent


if __name__ == "__main__":
    serve(prepare)
