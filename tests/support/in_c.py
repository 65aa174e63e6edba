"""Laws over long flights, in C: sample by sample in NumPy they take tests minutes."""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np

from quadftc_compile.build import build_library
from quadftc_compile.engine import recipe_for
from quadftc_compile.runner import CRunner
from quadftc_fdi.observation import Observation, ObservationInputs
from quadftc_model.arrays import namespace, rows_of
from quadftc_model.guarded import Guarded

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def fly_arrays(law, inputs, dt, state=None):
    """Last state and outputs (n, ...) of a law over inputs (n, ...), ``dt`` [s] apart: one, or (n,).

    Without a state the law begins at the first sample. Single flags are the same at all samples.
    """
    first = rows_of(inputs, 0)
    runner = in_c(law, first)
    count = max(len(leaf) for leaf in jax.tree.leaves(inputs) if np.ndim(leaf))
    steps = np.array(np.broadcast_to(np.asarray(dt, float), count))
    if state is not None:
        state, outputs = runner.run(state, inputs, steps)
        return runner.tree(state), outputs
    state, output = runner.first(first)
    state, rest = runner.run(state, rows_of(inputs, slice(1, None)), steps[1:])
    return runner.tree(state), jax.tree.map(lambda one, more: np.concatenate([[one], more]), output, rest)


def as_flown(observer, inputs):
    """The law that flies a fault observer, compiled once for tests and flights; inputs as it receives them.

    Inputs are arrays (n, ...), or a list. The thrust is that of the rotors, or unknown.
    """
    flies = (inputs[0] if isinstance(inputs, list) else inputs).rotors is not None
    law = Guarded(Observation(observer, flies=flies))
    return law, [_received(each) for each in inputs] if isinstance(inputs, list) else _received(inputs)


def _received(seen):
    torque = seen.torque if seen.rotors is None else None
    return ObservationInputs(seen.imu, torque, seen.rotors, seen.position, seen.driven)


def fly_law(law, samples, dt, state=None):
    """The same for a sequence of inputs; outputs are a list."""
    inputs = jax.tree.map(lambda *rows: np.stack(rows), *samples)
    state, outputs = fly_arrays(law, inputs, dt, state)
    leaves, structure = jax.tree.flatten(outputs)
    return state, [structure.unflatten(row) for row in zip(*leaves, strict=True)]


def in_c(law, inputs):
    """A runner in C of a law that sees such inputs."""
    return CRunner(law, build_library(recipe_for(law, inputs)))


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """A law whose output is its state."""

    law: object

    def init(self, inputs):
        """The state of the law."""
        return self.law.init(inputs)

    def step(self, state, inputs, dt):
        """Step the law."""
        after, _ = self.law.step(state, inputs, dt)
        return after, after


class Moved(NamedTuple):
    """What moves a plant: the command that acts over a period, and when that begins [s]."""

    command: np.ndarray
    time: float


@dataclasses.dataclass(frozen=True, eq=False)
class MovedPlant:
    """A plant as a law: its output is its state."""

    plant: object

    def init(self, inputs):
        """The state at rest, level."""
        xp = namespace(inputs.command)
        return self.plant.init(xp.asarray(LEVEL), xp.zeros(3))

    def step(self, state, inputs, dt):
        """Move the plant."""
        after = self.plant.step(state, inputs.command, inputs.time, dt)
        return after, after


def moving(plant, size):
    """A function of state, command (``size``,), time [s] and ``dt`` [s]: the plant's step, in C."""
    runner = in_c(MovedPlant(plant), Moved(np.zeros(size), 0.0))
    return lambda state, command, time, dt: runner.step(state, Moved(command, time), dt)[1]
