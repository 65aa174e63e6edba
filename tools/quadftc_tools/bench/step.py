# pyright: basic
"""What one step of each law costs one vehicle: called from Python, and in a loop of C.

A law steps over samples of a simulated flight without faults, with a MEMS IMU at 250 Hz: what it got in the
closed loop. Times are processor times.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from quadftc_compile.engine import CEngine, engine_named
from quadftc_compile.runner import CRunner
from quadftc_control.controller import controllers
from quadftc_control.position_controller import position_controllers
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.closed_loop import loop_of
from quadftc_flight.loop import ClosedLoop
from quadftc_flight.loop_draws import LoopDraws
from quadftc_flight.scenario import find_scenario, load_scenario, with_duration
from quadftc_model.arrays import Array, Scalar, rows_of
from quadftc_model.composition import RunnerCalls
from quadftc_model.stepper import Engine, Runner
from quadftc_tools.bench.machine import Result
from quadftc_tools.study.page import NOTHING

RATE, DURATION = 250.0, 6.0  # Hz, s; by then observers have started
PLACES = {"test stand": "mems_faults", "free flight": "free_circle"}  # and the scenario flown there
SCHEME = {"test stand": "supervised", "free flight": "isolating"}
SEED = 1
LOOPED, CALLED = 1000, 250  # samples of a batch: in a loop of C, and called from Python
MICROSECONDS = 1e6
STEP_HEADS = ("law", "NumPy [us]", "C from Python [us]", "in a loop of C [us]", "compile [s]")


@dataclasses.dataclass(frozen=True)
class Case:
    """A law of the closed loop."""

    kind: str
    law: str  # its name in the registry
    place: str
    part: str  # its name in `quadftc_flight.loop.ClosedLoop.laws`
    changes: tuple[str, ...] = ()  # of the scenario


@dataclasses.dataclass
class Heard:
    """What a law got over the last samples of a flight."""

    law: object
    state: object  # before the first of them
    inputs: list[object]
    dt: list[float]


def cases() -> Iterator[Case]:
    """Yield every registered law."""
    for place, scheme in SCHEME.items():
        yield Case("plant with sensors", place.replace(" ", "_"), place, "vehicle")
        registries = {"observer": fault_observers, "controller": controllers}
        if place == "test stand":
            yield Case("guidance", "references", place, "guidance")
            registries["disturbance_observer"] = disturbance_observers
        else:
            registries["position_controller"] = position_controllers
        parts = {"controller": "attitude", "position_controller": "guidance"}
        for role, registry in registries.items():
            for name in registry.names():
                change = (f"schemes.{scheme}.{role}={name}",)
                yield Case(role.replace("_", " "), name, place, parts.get(role, role), change)


def step_costs(engine: str, batches: int, only: Sequence[str] = ()) -> Iterator[Result]:
    """Measure laws, those named in ``only`` or all; one result for each.

    ``best_us``, ``median_us``: of batches of steps that are called from Python, inputs and outputs included.
    C has more: ``loop_us`` is the best of a loop in C with inputs and outputs in arrays. ``statements`` and
    ``bytes`` say how large the step is, ``trace_s`` and ``compile_s`` how long it takes to make.
    """
    chosen = [case for case in cases() if not only or case.law in only]
    loops = {case: _loop_of(case.place, case.changes) for case in chosen}
    CEngine().prepare(law for loop in loops.values() for law in loop.laws.values())
    for case, loop in loops.items():
        heard = listen_to_flight(loop)[case.part]
        yield {**dataclasses.asdict(case), "engine": engine, **_measure(heard, engine, batches)}


def _loop_of(place: str, changes: tuple[str, ...]) -> ClosedLoop:
    loaded = load_scenario(find_scenario(PLACES[place]), [f"rate={RATE} Hz", "faults=[]", *changes])
    return loop_of(with_duration(loaded, DURATION), loaded.scheme(SCHEME[place]))


def listen_to_flight(loop: ClosedLoop) -> dict[str, Heard]:
    """Fly, and return what each law got over the last samples."""
    heard, count = dict[str, Heard](), round(DURATION * RATE)
    calls = _ListeningCalls(loop.laws, CEngine(), heard)
    inputs, state = LoopDraws(loop, SEED, count).next(count), loop.init(calls)
    shared = inputs.first_draws
    for row in range(count):
        calls.listens = row >= count - LOOPED
        given = rows_of(inputs._replace(first_draws=None), row)._replace(first_draws=shared)
        state, _ = loop.step(calls, state, given)
    return heard


class _ListeningCalls(RunnerCalls):
    """Calls laws, and notes what they get while it ``listens``."""

    def __init__(self, laws: Mapping[str, object], engine: Engine, heard: dict[str, Heard]) -> None:
        super().__init__(laws, engine)
        self.listens, self._heard = False, heard

    def step(self, name: str, state: object, inputs: object, dt: Scalar) -> tuple[object, Any]:
        """Step a law by ``dt`` [s]."""
        if self.listens:
            if name not in self._heard:
                self._heard[name] = Heard(self._laws[name], self._runners[name].tree(state), [], [])
            self._heard[name].inputs.append(inputs)
            self._heard[name].dt.append(float(dt))
        return super().step(name, state, inputs, dt)


def _measure(heard: Heard, engine: str, batches: int) -> Result:
    runner = engine_named(engine)(heard.law)
    costs = [_time_calls(runner, heard) for _ in range(batches)]
    found: Result = {"best_us": round(min(costs), 2), "median_us": round(statistics.median(costs), 2)}
    (library,) = CEngine().prepare([heard.law]) if engine == "c" else (None,)
    if library is None:
        return found | {"engine": "numpy"} if engine == "c" else found
    stacked, dt = jax.tree.map(lambda *each: np.stack(each), *heard.inputs), np.array(heard.dt)
    looped, facts = CRunner(heard.law, library), library.facts
    found["loop_us"] = round(min(_time_loop(looped, heard.state, stacked, dt) for _ in range(batches)), 2)
    found["statements"] = facts["statements"]["step"]
    return found | {name: facts[name] for name in ("trace_s", "compile_s", "bytes")}


def _time_calls(runner: Runner[Any, Any], heard: Heard) -> float:
    """Mean time of a step [us]."""
    state, pairs = heard.state, list(zip(heard.inputs[:CALLED], heard.dt[:CALLED], strict=True))
    begin = time.process_time()
    for inputs, dt in pairs:
        state, _ = runner.step(state, inputs, dt)
    return MICROSECONDS * (time.process_time() - begin) / len(pairs)


def _time_loop(runner: CRunner, state: object, inputs: object, dt: Array) -> float:
    begin = time.process_time()
    runner.run(state, inputs, dt)
    return MICROSECONDS * (time.process_time() - begin) / len(dt)


def step_rows(results: Sequence[Result]) -> list[list[str]]:
    """Return a row for each law: of one in both places the dearer, in free flight; by both engines."""
    found: dict[tuple[str, str], dict[str, Result]] = {}
    for item in results:  # free flight comes last
        found.setdefault((item["kind"], item["law"]), {})[item["engine"]] = item
    return [_cells(f"{kind} `{law}`", **of) for (kind, law), of in found.items()]


def _cells(law: str, numpy: Result | None = None, c: Result | None = None) -> list[str]:
    cells = [law, f"{numpy['best_us']:.0f}" if numpy else NOTHING]
    if c is None:
        return [*cells, *(NOTHING,) * 3]
    return [*cells, f"{c['best_us']:.1f}", f"{c['loop_us']:.2f}", f"{c['compile_s']:.2f}"]
