# pyright: basic
"""What a process of a batch benchmark flies: the engine, or the bare loop that other simulators measure."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    with_components,
    with_duration,
    with_seed,
)
from quadftc_tools.bench.batch_child import Job, Run, Subject, serve

if TYPE_CHECKING:
    from quadftc_campaign.batch.parts import Loop

BARE_SCENARIO, BARE_SCHEME, BARE_CONTROLLER = "paper_faults", "conventional", "pid"
FREE_SCENARIO = "free_circle"
LARGEST_ANGLE = 0.1  # rad; of the attitudes that the bare loop holds, about each axis
SETTLED = 5.0  # s; from then on the attitude must be there
TOLERANCE = 1e-3  # rad


def prepare(job: Job) -> Subject:
    """Build the subject of a job, whose ``task`` is "engine", "bare engine", "bare" or "bare flight".

    ``staged`` is False for plain ``jax.vmap``; ``duration`` is in s.
    """
    if job["task"] == "bare":
        return bare_subject(bare_scenario(job["duration"], motor_lag=True), job["flights"], job["float32"])
    if job["task"] == "bare flight":
        return bare_subject(bare_flight(job["duration"]), job["flights"], job["float32"])
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
    import jax

    from quadftc_campaign.batch.engine import Engine
    from quadftc_campaign.flights import parts_of

    seeds = range(job["first_seed"], job["first_seed"] + job["flights"])
    scenarios = (with_seed(scenario, seed) for seed in seeds)
    parts = [parts_of(each, scheme) for each in scenarios]
    drawing = _time_inputs()
    engine, device = Engine(job["float32"], staged=job.get("staged")), jax.devices()[0]

    def run() -> Run:
        before, samples = drawing[0], list[int]()
        outcomes = engine.fly(parts, [scenario.fault_events] * len(parts), samples.append)
        if any(outcome.marks["unusable"] for outcome in outcomes):
            raise ValueError("a flight has non-finite values")
        return Run(sum(samples), drawing[0] - before)

    chosen = scenario.scheme(scheme)
    laws = (chosen.observer.kind, chosen.disturbance_observer.kind, chosen.controller.kind)
    what = {
        "by": f"quadftc, JAX {jax.__version__}, {device.platform} ({device.device_kind})",
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


def _time_inputs() -> list[float]:
    """Time the source of random numbers; the list's one number is the time spent in it so far [s]."""
    from quadftc_campaign.batch import compiled

    spent = [0.0]

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            try:
                return method(*arguments, **options)
            finally:
                spent[0] += time.perf_counter() - begin

        return call

    base = compiled.InputSource
    methods = {"__init__": timed(base.__init__), "next": timed(base.next)}
    compiled.InputSource = type("TimedInputSource", (base,), methods)
    return spent


def bare_subject(scenario: Scenario, flights: int, float32: bool) -> Subject:
    """Build plant and controller of many vehicles on the true state; each holds another attitude."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from quadftc_campaign.flights import parts_of
    from quadftc_model.jax_settings import settle_precision
    from quadftc_model.rotations import euler_from_quaternion
    from quadftc_model.staged_step import StagedStep
    from quadftc_model.stepper import seconds

    settle_precision(float32)
    dtype = np.dtype(np.float32 if float32 else np.float64)
    controller_kind = scenario.scheme(BARE_SCHEME).controller.kind
    loop = parts_of(scenario, BARE_SCHEME).loop
    dt = seconds(loop.period_ns)
    control = _attitude_control(loop, dt, dtype)

    def begin(angles: Any) -> Any:
        level_and_still: Any = (jnp.asarray([0.0, 0.0, 0.0, 1.0], dtype), jnp.zeros_like(angles))
        return control(loop.plant.init(*level_and_still), angles)

    def step(state: Any, angles: Any, _: tuple[()]) -> tuple[Any, tuple[()]]:
        plant, controller, command = state
        return control(loop.plant.step(plant, command, 0.0, dt), angles, controller), ()

    one = jax.ShapeDtypeStruct((3,), dtype)
    step_all = StagedStep(step, jax.eval_shape(begin, one), one, ())
    drawn = np.random.default_rng(0).uniform(-LARGEST_ANGLE, LARGEST_ANGLE, (3, flights))
    angles = jnp.asarray(drawn, dtype)
    start = jax.jit(jax.vmap(begin, in_axes=-1, out_axes=-1))(angles)

    @jax.jit
    def fly(state: Any, angles: Any) -> Any:
        return jax.lax.scan(lambda now, _: (step_all(now, angles, ())[0], None), state, length=loop.count)[0]

    def run() -> Run:
        plant, *_ = jax.block_until_ready(fly(start, angles))
        error = euler_from_quaternion(np.moveaxis(np.asarray(plant.q_xyzw), 0, -1)) - drawn.T
        if scenario.duration >= SETTLED and not float(np.abs(error).max()) < TOLERANCE:
            raise ValueError("the attitude is not what it should be")
        return Run(loop.count * flights)

    what = {
        "by": f"quadftc, JAX {jax.__version__}, {jax.default_backend()}",
        "states": _states_of(scenario) + (", drag" if scenario.plant.flies else ""),
        "integrator": f"RK4, {scenario.rate:g} Hz",
        "control": f"attitude ({controller_kind}), at every step, rotor mixer with limits",
        "sensors": "none",
    }
    return Subject(what, run)


def _attitude_control(loop: Loop, dt: float, dtype: Any) -> Callable[..., tuple[Any, Any, Any]]:
    """Return a function of plant, angles to hold and state of the controller; it adds the command."""
    import jax
    import jax.numpy as jnp

    from quadftc_control.allocation import allocate
    from quadftc_model.samples import AttitudeReference, ControllerInputs, ImuSample

    vehicle = loop.plant.vehicle

    def control(plant: Any, angles: Any, state: Any = None) -> tuple[Any, Any, Any]:
        zeros: Any = jnp.zeros_like(angles)
        there: Any = jnp.asarray(True)
        imu = ImuSample(plant.q_xyzw, plant.body_rate, zeros, there, there, there)
        inputs, law = ControllerInputs(imu, AttitudeReference(angles, zeros, zeros), zeros), loop.controller
        if state is None:
            state, output = law.step(law.init(inputs), inputs, 0.0)
        else:
            state, output = law.step(state, inputs, dt)
        command = output.torque
        if loop.plant.flies:
            thrust: Any = jnp.asarray(vehicle.weight, dtype)
            command = allocate(vehicle, thrust, command).speeds
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), (plant, state, command))

    return control


if __name__ == "__main__":
    serve(prepare)
