"""Other simulators at the task nearest to ours: their controller holds an attitude."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module  # the packages are optional, and our import checks do not know them
from importlib.metadata import version
from typing import Any

from quadftc_tools.bench.batch_child import Job, Run, Subject, serve

RATE = 500  # Hz, of crazyflow's own benchmark
CRAZYFLOW_STEPS, ROTORPY_STEPS = 1000, 100  # of a run
LARGEST_ANGLE = 0.1  # rad; crazyflow
TILT = 0.05  # rad; RotorPy
GRAVITY = 9.81  # m/s²
ROTOR_SPEED = 1788.53  # rad/s; hovers
STATES = "position, velocity, attitude, body rate, rotor speeds (17), drag"
INTEGRATORS = {"rk4": "RK4", "euler": "Euler"}


def prepare(job: Job) -> Subject:
    """Build the ``simulator`` of a job for its ``flights``."""
    return {"crazyflow": _crazyflow, "rotorpy": _rotorpy}[job["simulator"]](job)


def _crazyflow(job: Job) -> Subject:
    """Worlds of one drone each; the job says ``integrator`` and ``steps_a_call``."""
    crazyflow: Any = import_module("crazyflow.sim")
    jax: Any = import_module("jax")
    numpy: Any = import_module("numpy")
    worlds, a_call = job["flights"], job["steps_a_call"]
    rates = {"freq": RATE, "attitude_freq": RATE, "integrator": job["integrator"]}
    kinds = {"dynamics": "first_principles", "control": "attitude", "device": "cpu"}
    simulation = crazyflow.Sim(n_worlds=worlds, n_drones=1, **rates, **kinds)
    command = numpy.zeros((worlds, 1, 4), numpy.float32)  # roll, pitch, yaw [rad], thrust [N]
    command[..., :3] = numpy.random.default_rng(0).uniform(-LARGEST_ANGLE, LARGEST_ANGLE, (worlds, 1, 3))
    command[..., 3] = GRAVITY * numpy.ravel(simulation.data.params.mass)[0]
    command = jax.numpy.asarray(command)

    def run() -> Run:
        simulation.reset()
        for _ in range(CRAZYFLOW_STEPS // a_call):
            simulation.attitude_control(command)
            simulation.step(a_call)
            jax.block_until_ready(simulation.data)
        return Run(CRAZYFLOW_STEPS // a_call * a_call * worlds)

    what = {
        "by": f"crazyflow {version('crazyflow')}, JAX {jax.__version__}, {simulation.device.platform}",
        "states": STATES,
        "integrator": f"{INTEGRATORS[job['integrator']]}, {RATE} Hz, steps a call: {a_call}",
        "control": "attitude (Mellinger), at every step, rotor mixer with limits",
        "sensors": "none",
    }
    return Subject(what, run)


def _rotorpy(job: Job) -> Subject:
    """Drones in PyTorch, or one drone in NumPy (``single``)."""
    multirotor: Any = import_module("rotorpy.vehicles.multirotor")
    params: dict[str, Any] = import_module("rotorpy.vehicles.crazyflie_params").quad_params
    build = _one_drone if job["single"] else _many_drones
    step, start, library, integrator = build(multirotor, params, job["flights"])

    def run() -> Run:
        state = start
        for _ in range(ROTORPY_STEPS):
            state = step(state)
        return Run(ROTORPY_STEPS * job["flights"])

    what = {
        "by": f"RotorPy {version('rotorpy')}, {library}",
        "states": f"{STATES}, rotor noise",
        "integrator": f"{integrator}, {RATE} Hz",
        "control": "attitude (cmd_ctatt), at every step, rotor mixer with limits",
        "sensors": "none",
    }
    return Subject(what, run)


def _state(row: Callable[..., Any]) -> tuple[dict[str, Any], Any]:
    """Hovering start and attitude to hold, each vector made by ``row``."""
    zeros, level = row(0.0, 0.0, 0.0), row(0.0, 0.0, 0.0, 1.0)
    rotors = row(*[ROTOR_SPEED] * 4)
    start = {"x": zeros, "v": zeros, "q": level, "w": zeros, "wind": zeros, "rotor_speeds": rotors}
    return start, row(0.0, math.sin(TILT / 2.0), 0.0, math.cos(TILT / 2.0))


def _many_drones(
    multirotor: Any, params: dict[str, Any], flights: int
) -> tuple[Callable[[Any], Any], Any, str, str]:
    torch: Any = import_module("torch")
    for needed in ("torchdiffeq", "roma"):  # RotorPy itself only misses them when it flies
        import_module(needed)
    torch.set_num_threads(1)
    device = torch.device("cpu")

    def rows(*values: float) -> Any:
        return torch.tensor(values, device=device).repeat(flights, 1).double()

    start, tilted = _state(rows)
    vehicle = multirotor.BatchedMultirotor(
        multirotor.BatchedMultirotorParams([dict(params)] * flights, flights, device),
        flights,
        start,
        device,
        control_abstraction="cmd_ctatt",
        integrator="rk4",
    )
    command = {"cmd_thrust": rows(params["mass"] * GRAVITY), "cmd_q": tilted}
    everyone = torch.arange(flights)  # much faster than to leave it out
    library = f"PyTorch {version('torch')}, cpu"
    return lambda state: vehicle.step(state, command, 1.0 / RATE, everyone), start, library, "RK4"


def _one_drone(multirotor: Any, params: dict[str, Any], _: int) -> tuple[Callable[[Any], Any], Any, str, str]:
    numpy: Any = import_module("numpy")
    start, tilted = _state(lambda *values: numpy.array(values))
    vehicle = multirotor.Multirotor(params, control_abstraction="cmd_ctatt")
    command = {"cmd_thrust": params["mass"] * GRAVITY, "cmd_q": tilted}
    return lambda state: vehicle.step(state, command, 1.0 / RATE), start, "NumPy, SciPy", "adaptive RK45"


if __name__ == "__main__":
    serve(prepare)
