# pyright: basic
"""What a process of a batch benchmark flies: the engine, or the bare loop that other simulators measure."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadftc_campaign.batch import engine as batch_engine
from quadftc_campaign.batch.engine import JAX, BatchFlight, Outcome, compile_laws, without_words
from quadftc_campaign.flights import batch_flight
from quadftc_campaign.open_motion import Alone
from quadftc_compile.engine import engine_named
from quadftc_compile.wiring import BLOCK, flown_by
from quadftc_control.allocation import allocate
from quadftc_control.controller import Controller
from quadftc_flight.closed_loop import plant_of
from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    with_components,
    with_duration,
    with_seed,
)
from quadftc_model.arrays import Quaternion, Vector
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import AttitudeReference, ControllerInputs, ImuSample
from quadftc_sim.assembly import sample_count
from quadftc_sim.plant import Plant
from quadftc_tools.bench.batch_child import Job, Run, Subject, serve

BARE_SCENARIO, BARE_SCHEME, BARE_CONTROLLER = "paper_faults", "conventional", "pid"
FREE_SCENARIO = "free_circle"
LARGEST_ANGLE = 0.1  # rad; of the attitudes that the bare loop holds, about each axis
SETTLED = 5.0  # s; from then on the attitude must be there
TOLERANCE = 1e-3  # rad


def prepare(job: Job) -> Subject:
    """Build the subject of a job, whose ``task`` is "engine", "bare engine", "bare" or "bare flight".

    ``engine`` is "c", or else "jax"; ``duration`` is in s.
    """
    if job["task"] == "bare":
        return bare_subject(bare_scenario(job["duration"], motor_lag=True), job["flights"])
    if job["task"] == "bare flight":
        return bare_subject(bare_flight(job["duration"]), job["flights"])
    if job["task"] == "bare engine":
        return _engine(job, bare_scenario(job["duration"]), BARE_SCHEME)
    return _engine(job, compressed(job["scenario"], job["duration"]), job["scheme"])


def compressed(name: str, duration: float) -> Scenario:
    """Cut a scenario to ``duration`` [s], its faults at the same parts of it as in the whole."""
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
    # without faults their checks have nothing to judge
    changes = ["faults=[]", f"plant.motor_lag={str(motor_lag).lower()}"]
    changes += [f"schemes.{name}.checks=[]" for name in load_scenario(path).schemes]
    scenario = with_duration(load_scenario(path, changes), duration)
    return with_components(scenario, BARE_SCHEME, controller=BARE_CONTROLLER)


def bare_flight(duration: float) -> Scenario:
    """Plant of six degrees of freedom in still air, far from the ground, as crazyflow's; 500 Hz."""
    path = find_scenario(FREE_SCENARIO)
    changes = ["faults=[]", "wind=[]", "plant.ground=false", "vehicle=crazyflie_2x", "rate=500 Hz"]
    scenario = with_duration(load_scenario(path, changes), duration)
    return with_components(scenario, BARE_SCHEME, controller=BARE_CONTROLLER)


def _engine(job: Job, scenario: Scenario, scheme: str) -> Subject:
    seeds = range(job["first_seed"], job["first_seed"] + job["flights"])
    flights = [batch_flight(with_seed(scenario, seed), scheme) for seed in seeds]
    drawing = _time_draws()
    by, fly = _flying(job, flights)

    def run() -> Run:
        before = drawing[0]
        if any(outcome.marks["unusable"] for outcome in fly()):
            raise ValueError("a flight has non-finite values")
        return Run(sum(flight.samples for flight in flights), drawing[0] - before)

    chosen = scenario.scheme(scheme)
    laws = (chosen.observer.kind, chosen.disturbance_observer.kind, chosen.controller.kind)
    what = {
        "by": by,
        "states": f"{_states_of(scenario)}, observers and controller",
        "integrator": f"RK4, {scenario.rate:g} Hz",
        "control": "fault observer {}, disturbance observer {}, controller {}".format(*laws),
        "sensors": f"those of {scenario.name}, {len(scenario.faults)} sensor faults; metrics are kept",
    }
    return Subject(what, run)


def _states_of(scenario: Scenario) -> str:
    if scenario.plant.flies:
        return "position, velocity, attitude, body rate, rotor speeds (17)"
    return f"attitude, body rate{', rotor commands (11)' if scenario.plant.motor_lag else ' (7)'}"


def _flying(job: Job, flights: list[BatchFlight]) -> tuple[str, Callable[[], list[Outcome]]]:
    """Return what flies, in words, and a function that flies."""
    if job.get("engine", "c") != JAX:
        compile_laws(flight.loop for flight in flights)
        return "quadftc, in C", lambda: batch_engine.fly_all(flights, log=without_words)
    import jax

    from quadftc_campaign.batch.jax_engine import JaxEngine

    engine, device = JaxEngine(job["float32"]), jax.devices()[0]
    words = f"quadftc, JAX {jax.__version__}, {device.platform} ({device.device_kind})"
    return words, lambda: engine.fly(flights)


def _time_draws() -> list[float]:
    """Time the source of random numbers; the list's one number is the time spent in it so far [s]."""
    spent = [0.0]

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            try:
                return method(*arguments, **options)
            finally:
                spent[0] += time.perf_counter() - begin

        return call

    base = batch_engine.LoopDraws
    methods = {"__init__": timed(base.__init__), "next": timed(base.next)}
    batch_engine.LoopDraws = type("TimedLoopDraws", (base,), methods)
    return spent


class BareState(NamedTuple):
    """A vehicle, its controller, and what that commands."""

    plant: Any
    controller: Any
    command: Any


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class BareLoop:
    """A law: a plant, and a controller of its true attitude."""

    plant: Plant
    controller: Controller

    def example(self) -> Vector:
        """Return angles to hold [rad]."""
        return np.zeros(3)

    def init(self, inputs: Vector) -> BareState:
        """Return a vehicle that is level and still."""
        plant = self.plant.init(np.array([0.0, 0.0, 0.0, 1.0]), 0.0 * inputs)
        seen = self._seen(plant, inputs)
        return self._control(plant, self.controller.init(seen), seen, 0.0)

    def step(self, state: BareState, inputs: Vector, dt: float) -> tuple[BareState, Quaternion]:
        """Fly on, and command the next step; return the attitude."""
        plant = self.plant.step(state.plant, state.command, 0.0, dt)
        return self._control(plant, state.controller, self._seen(plant, inputs), dt), plant.q_xyzw

    def _seen(self, plant: Any, angles: Vector) -> ControllerInputs:
        zeros, there = 0.0 * angles, np.True_
        imu = ImuSample(plant.q_xyzw, plant.body_rate, zeros, there, there, there)
        return ControllerInputs(imu, AttitudeReference(angles, zeros, zeros), zeros)

    def _control(self, plant: Any, state: Any, seen: ControllerInputs, dt: float) -> BareState:
        state, output = self.controller.step(state, seen, dt)
        command = output.torque
        if self.plant.flies:
            command = allocate(self.plant.vehicle, self.plant.vehicle.weight, command).speeds
        return BareState(plant, state, command)


def bare_subject(scenario: Scenario, flights: int) -> Subject:
    """Build plant and controller of many vehicles on the true state; each holds another attitude."""
    controller = scenario.scheme(BARE_SCHEME).controller
    law = BareLoop(plant=plant_of(scenario), controller=controller.law)
    flown = flown_by(engine_named("c"), Alone(law), (law.example(), 0.0))
    count = sample_count(scenario.duration, scenario.rate)
    drawn = np.random.default_rng(0).uniform(-LARGEST_ANGLE, LARGEST_ANGLE, (flights, 3))
    dt = np.where(np.arange(count) == 0, 0.0, 1.0 / scenario.rate)

    def run() -> Run:
        for angles in drawn:
            flown.begin()
            for begin in range(0, count, BLOCK):
                rows = min(BLOCK, count - begin)
                reached = flown.run((angles, dt[begin : begin + rows]), rows)[-1]
            error = euler_from_quaternion(reached) - angles
            if scenario.duration >= SETTLED and not float(np.abs(error).max()) < TOLERANCE:
                raise ValueError("the attitude is not what it should be")
        return Run(count * flights)

    what = {
        "by": "quadftc, in C",
        "states": _states_of(scenario) + (", drag" if scenario.plant.flies else ""),
        "integrator": f"RK4, {scenario.rate:g} Hz",
        "control": f"attitude ({controller.kind}), at every step, rotor mixer with limits",
        "sensors": "none",
    }
    return Subject(what, run)


if __name__ == "__main__":
    serve(prepare)
