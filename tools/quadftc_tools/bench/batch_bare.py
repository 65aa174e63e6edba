# pyright: basic
"""The plant and an attitude controller alone, many at once: what other simulators measure.

No sensor, no faults, no observers, no random numbers, nothing kept but the state; each flight holds an
attitude of its own.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadftc_campaign.batch.flights_last import AllFlights
from quadftc_campaign.batch.parts import Loop
from quadftc_campaign.batch.session import settle_precision
from quadftc_campaign.flights import parts_of
from quadftc_flight.scenario import Scenario
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import AttitudeReference, ControllerInputs, ImuSample
from quadftc_model.stepper import seconds
from quadftc_tools.bench.batch_child import Flown, Subject

LARGEST_ANGLE = 0.1  # rad; of the attitudes to hold, about each axis
SETTLED = 5.0  # s; from then on the attitude must be there
TOLERANCE = 1e-3  # rad


class BareLoop:
    """Plant and controller of one vehicle, closed over the true state.

    Parameters
    ----------
    loop : Loop
    dtype : dtype
        Of all numbers.
    """

    def __init__(self, loop: Loop, dtype: np.dtype[Any]) -> None:
        self._loop = loop
        self._dtype = dtype
        self._dt = seconds(loop.period_ns)

    def begin(self, angles: Any) -> Any:
        """State at rest and level, with angles (3,) to hold: plant, controller, torque."""
        zeros = jnp.zeros_like(angles)
        plant = self._loop.plant.init(jnp.asarray([0.0, 0.0, 0.0, 1.0], self._dtype), zeros)
        inputs = self._inputs(plant, angles)
        law = self._loop.controller
        controller, output = law.step(law.init(inputs), inputs, 0.0)
        return self._cast((plant, controller, output.torque))

    def step(self, state: Any, angles: Any, common: tuple[()]) -> tuple[Any, tuple[()]]:
        """Fly for a period."""
        plant, controller, torque = state
        plant = self._loop.plant.step(plant, torque, 0.0, self._dt)
        controller, output = self._loop.controller.step(controller, self._inputs(plant, angles), self._dt)
        return self._cast((plant, controller, output.torque)), ()

    def _inputs(self, plant: Any, angles: Any) -> ControllerInputs:
        zeros: Any = jnp.zeros_like(angles)
        there: Any = jnp.asarray(True)
        imu = ImuSample(plant.q_xyzw, plant.body_rate, zeros, there, there, there)
        return ControllerInputs(imu, AttitudeReference(angles, zeros, zeros), zeros)

    def _cast(self, state: Any) -> Any:
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, self._dtype), state)


def bare_subject(scenario: Scenario, flights: int, float32: bool) -> Subject:
    """Build the loop for as many flights as wanted, each with an attitude of its own to hold."""
    dtype = np.dtype(np.float32 if float32 else np.float64)
    controller = scenario.scheme("conventional").controller.kind
    loop = parts_of(scenario, "conventional").loop
    bare = BareLoop(loop, dtype)
    one = jax.ShapeDtypeStruct((3,), dtype)
    drawn = np.random.default_rng(0).uniform(-LARGEST_ANGLE, LARGEST_ANGLE, (3, flights))
    settle_precision(float32)
    step = AllFlights(bare.step, jax.eval_shape(bare.begin, one), one, ())
    angles = jnp.asarray(drawn, dtype)
    start = jax.jit(jax.vmap(bare.begin, in_axes=-1, out_axes=-1))(angles)

    @jax.jit
    def fly(state: Any, angles: Any) -> Any:
        return jax.lax.scan(lambda now, _: (step(now, angles, ())[0], None), state, length=loop.count)[0]

    def run() -> Flown:
        plant, *_ = jax.block_until_ready(fly(start, angles))
        error = euler_from_quaternion(np.moveaxis(np.asarray(plant.q_xyzw), 0, -1)) - drawn.T
        if scenario.duration >= SETTLED and not float(np.abs(error).max()) < TOLERANCE:
            raise ValueError("the attitude is not what it should be")
        return Flown(loop.count * flights)

    return Subject(
        {
            "by": f"quadftc, JAX {jax.__version__}, {jax.default_backend()}",
            "states": "attitude, body rate, rotor commands (11)",
            "integrator": f"RK4, {scenario.rate:g} Hz",
            "control": f"attitude, {controller}, rotor mixer with limits",
            "sensors": "none",
        },
        run,
    )
