"""crazyflow at the task nearest to ours, attitude held by its controller; for a Python that has it."""

from __future__ import annotations

from importlib import import_module  # the package is optional, and of no concern to what checks our imports
from importlib.metadata import version
from typing import Any

from quadftc_tools.bench.batch_child import Flown, Job, Subject, serve

RATE = 500  # Hz, of its own benchmark
STEPS = 1000  # of a run
LARGEST_ANGLE = 0.1  # rad
GRAVITY = 9.81  # m/s²
INTEGRATORS = {"rk4": "RK4", "euler": "Euler"}


def prepare(job: Job) -> Subject:
    """Build the simulation: ``flights`` worlds of one drone; ``integrator``; ``steps_a_call``."""
    crazyflow: Any = import_module("crazyflow.sim")
    jax: Any = import_module("jax")
    numpy: Any = import_module("numpy")

    worlds, a_call = job["flights"], job["steps_a_call"]
    simulation = crazyflow.Sim(
        n_worlds=worlds,
        n_drones=1,
        dynamics="first_principles",
        control="attitude",
        integrator=job["integrator"],
        freq=RATE,
        attitude_freq=RATE,
        device="cpu",
    )
    command = numpy.zeros((worlds, 1, 4), numpy.float32)  # roll, pitch, yaw [rad], thrust [N]
    command[..., :3] = numpy.random.default_rng(0).uniform(-LARGEST_ANGLE, LARGEST_ANGLE, (worlds, 1, 3))
    command[..., 3] = GRAVITY * numpy.ravel(simulation.data.params.mass)[0]
    command = jax.numpy.asarray(command)

    def run() -> Flown:
        simulation.reset()
        for _ in range(STEPS // a_call):
            simulation.attitude_control(command)
            simulation.step(a_call)
            jax.block_until_ready(simulation.data)
        return Flown(STEPS // a_call * a_call * worlds)

    return Subject(
        {
            "by": f"crazyflow {version('crazyflow')}, JAX {jax.__version__}, {simulation.device.platform}",
            "states": "position, velocity, attitude, body rate, rotor speeds (17), drag",
            "integrator": f"{INTEGRATORS[job['integrator']]}, {RATE} Hz, steps a call: {a_call}",
            "control": "attitude (Mellinger), at every step, rotor mixer with limits",
            "sensors": "none",
        },
        run,
    )


if __name__ == "__main__":
    serve(prepare)
