"""RotorPy at the task nearest to ours, attitude held by its controller; for a Python that has it."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import import_module  # the package is optional, and of no concern to what checks our imports
from importlib.metadata import version
from typing import Any

from quadftc_tools.bench.batch_child import Flown, Job, Subject, serve

RATE = 500  # Hz
STEPS = 100  # of a run
TILT = 0.05  # rad; of the attitude to hold
TILTED = (0.0, math.sin(TILT / 2.0), 0.0, math.cos(TILT / 2.0))  # as a quaternion, xyzw
GRAVITY = 9.81  # m/s²
ROTOR_SPEED = 1788.53  # rad/s; that which hovers


def prepare(job: Job) -> Subject:
    """Build the simulation: ``flights`` drones in PyTorch, or one drone in NumPy (``single``)."""
    step, start, integrator = _single() if job["single"] else _batched(job["flights"])

    def run() -> Flown:
        state = start
        for _ in range(STEPS):
            state = step(state)
        return Flown(STEPS * job["flights"])

    library = "NumPy, SciPy" if job["single"] else f"PyTorch {version('torch')}, cpu"
    return Subject(
        {
            "by": f"RotorPy {version('rotorpy')}, {library}",
            "states": "position, velocity, attitude, body rate, rotor speeds (17), drag, rotor noise",
            "integrator": f"{integrator}, {RATE} Hz",
            "control": "attitude (cmd_ctatt), at every step, rotor mixer with limits",
            "sensors": "none",
        },
        run,
    )


def _batched(flights: int) -> tuple[Callable[[Any], Any], Any, str]:
    torch: Any = import_module("torch")
    for needed in ("torchdiffeq", "roma"):  # RotorPy itself only misses them when it flies
        import_module(needed)
    multirotor: Any = import_module("rotorpy.vehicles.multirotor")
    params: dict[str, Any] = import_module("rotorpy.vehicles.crazyflie_params").quad_params
    torch.set_num_threads(1)
    device = torch.device("cpu")

    def rows(*values: float) -> Any:
        return torch.tensor(values, device=device).repeat(flights, 1).double()

    zeros, level = rows(0.0, 0.0, 0.0), rows(0.0, 0.0, 0.0, 1.0)
    rotors = rows(*[ROTOR_SPEED] * 4)
    start = {"x": zeros, "v": zeros, "q": level, "w": zeros, "wind": zeros, "rotor_speeds": rotors}
    vehicle = multirotor.BatchedMultirotor(
        multirotor.BatchedMultirotorParams([dict(params)] * flights, flights, device),
        flights,
        start,
        device,
        control_abstraction="cmd_ctatt",
        integrator="rk4",
    )
    command = {"cmd_thrust": rows(params["mass"] * GRAVITY), "cmd_q": rows(*TILTED)}
    everyone = torch.arange(flights)  # much faster than to leave it out
    return lambda state: vehicle.step(state, command, 1.0 / RATE, everyone), start, "RK4"


def _single() -> tuple[Callable[[Any], Any], Any, str]:
    numpy: Any = import_module("numpy")
    multirotor: Any = import_module("rotorpy.vehicles.multirotor")
    params: dict[str, Any] = import_module("rotorpy.vehicles.crazyflie_params").quad_params
    zeros, level = numpy.zeros(3), numpy.array([0.0, 0.0, 0.0, 1.0])
    rotors = numpy.full(4, ROTOR_SPEED)
    start = {"x": zeros, "v": zeros, "q": level, "w": zeros, "wind": zeros, "rotor_speeds": rotors}
    vehicle = multirotor.Multirotor(params, control_abstraction="cmd_ctatt")
    command = {"cmd_thrust": params["mass"] * GRAVITY, "cmd_q": numpy.array(TILTED)}
    return lambda state: vehicle.step(state, command, 1.0 / RATE), start, "adaptive RK45"


if __name__ == "__main__":
    serve(prepare)
