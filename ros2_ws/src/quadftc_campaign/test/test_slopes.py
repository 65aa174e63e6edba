# pyright: basic
"""The derivative of a flight against differences of flights."""

import contextlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest

from quadftc_campaign.batch.engine import BatchFlight
from quadftc_campaign.batch.jax_engine import JaxEngine, SlopeFlight
from quadftc_campaign.flights import batch_flight
from quadftc_flight.scenario import find_scenario, load_scenario

PATHS = {
    "controller": "loop.attitude.law.controller",
    "disturbance_observer": "loop.disturbance_observer.law.observer",
}


def path_of(gain: str) -> str:
    """Return the path of a gain among the numbers of a flight."""
    role, _, name = gain.partition("__")
    return f"{PATHS[role]}.{name}"


FREE = tuple(map(path_of, ("controller__k_c1", "controller__phi", "disturbance_observer__bandwidth")))


def built(scheme: str, **gains: object) -> BatchFlight:
    """A flight of 8 s with a fault from the 3rd to the 5th."""
    values = [f"schemes.{scheme}.{name.replace('__', '.')}={value}" for name, value in gains.items()]
    scenario = load_scenario(
        find_scenario("mems_faults"),
        [
            "duration=8 s",
            "faults=[{kind: bias, channel: attitude, axes: roll, value: 1 deg, start: 3 s, stop: 5 s}]",
            "references=[{kind: sine, amplitude: 4 deg, frequency: 0.8, start: 1 s}]",
            f"schemes.{scheme}.checks=[]",
            *values,
        ],
    )
    return batch_flight(scenario, scheme)


@pytest.fixture(scope="module")
def engine() -> Iterator[JaxEngine]:
    """One that compiles a scheme once."""
    with careful():
        yield JaxEngine(lanes=8, free=FREE)


@contextlib.contextmanager
def careful() -> Iterator[None]:
    """Compile slopes with more care than other tests: they would be 0.1 % off."""
    make = SlopeFlight.__init__

    def make_with_care(self: SlopeFlight, *arguments: Any) -> None:
        make(self, *arguments)
        options = {"xla_backend_optimization_level": 1}
        self.fly_stretch = jax.jit(self._fly_stretch, donate_argnums=0, compiler_options=options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SlopeFlight, "__init__", make_with_care)
        yield


def test_slopes_are_those_of_differences(engine: JaxEngine) -> None:
    """Gains of the controller and of the disturbance observer, on axes of their own and together."""
    scheme = "proposed"  # compiles soonest
    base = {
        "controller__k_c1": [16.0, 16.0, 9.0],
        "controller__phi": [0.1, 0.1, 0.1],
        "disturbance_observer__bandwidth": 10.0,
    }
    steps = {
        "controller__k_c1": (np.array([0.0, 1.0, 0.5]), 1e-4),
        "controller__phi": (np.array([1.0, 0.0, 0.0]), 1e-6),
        "disturbance_observer__bandwidth": (np.array(1.0), 1e-4),
    }
    flight = built(scheme, **base)
    still = {path_of(name): np.zeros_like(direction) for name, (direction, _) in steps.items()}
    directions = [{**still, path_of(name): way} for name, (way, _) in steps.items()]
    found = engine.fly([flight] * 3, directions=directions)
    moved = [
        built(scheme, **{**base, name: (np.array(base[name]) + sign * size * way).tolist()})
        for name, (way, size) in steps.items()
        for sign in (-1, 1)
    ]
    flown = engine.fly(moved)
    for place, (_, size) in enumerate(steps.values()):
        before, after = flown[2 * place].sums, flown[2 * place + 1].sums
        for kind in ("tracking", "estimate", "disturbance", "torque", "variation", "delivered"):
            difference = (after[kind] - before[kind]) / (2.0 * size)
            slope = found[place].slope[kind]
            np.testing.assert_allclose(
                slope, difference, rtol=1e-5, atol=1e-7 * (1.0 + np.max(np.abs(difference)))
            )
        assert np.any(found[place].slope["variation"] != 0.0)
    np.testing.assert_array_equal(
        found[0].sums["tracking"], found[1].sums["tracking"]
    )  # the flight does not depend on the direction


def test_a_free_number_is_compiled_once(engine: JaxEngine) -> None:
    """Other gains, same compiled flight."""
    engine.fly([built("proposed")])
    there = len(engine._compiled)
    engine.fly([built("proposed", controller__phi=[0.2, 0.2, 0.2])])
    assert len(engine._compiled) == there


def built_flight(**gains: list[float]) -> BatchFlight:
    """A circle of 4 s through space, with a controller's gains."""
    values = [f"schemes.conventional.controller.{name}={value}" for name, value in gains.items()]
    short = ["duration=4 s", "faults=[]", "trajectories.0.start=0.5 s", "trajectories.0.stop=3.5 s"]
    scenario = load_scenario(find_scenario("free_circle"), [*short, *values])
    return batch_flight(scenario, "conventional")


@pytest.mark.thorough
def test_slopes_in_free_flight_are_those_of_differences() -> None:
    """Through position control, allocation, rotors, wind and position sensor."""
    base, ways = {"k_c2": [4.0, 4.0, 3.0], "phi": [0.5, 0.5, 0.5]}, np.eye(3)
    free = tuple(path_of(f"controller__{name}") for name in base)
    steps = {"k_c2": (ways[1], 1e-4), "phi": (ways[0] + ways[2], 1e-5)}
    with careful():
        engine = JaxEngine(lanes=8, free=free)
        flight = built_flight(**base)
        still = dict.fromkeys(free, np.zeros(3))
        directions = [{**still, path_of(f"controller__{name}"): way} for name, (way, _) in steps.items()]
        found = engine.fly([flight] * 2, directions=directions)
        moved = [
            built_flight(**{**base, name: (np.array(base[name]) + sign * size * way).tolist()})
            for name, (way, size) in steps.items()
            for sign in (-1, 1)
        ]
        flown = engine.fly(moved)
    for place, (_, size) in enumerate(steps.values()):
        before, after = flown[2 * place].sums, flown[2 * place + 1].sums
        for kind in ("tracking", "position", "torque", "variation"):
            difference = (after[kind] - before[kind]) / (2.0 * size)
            slope = found[place].slope[kind]
            assert np.any(slope != 0.0)
            np.testing.assert_allclose(slope, difference, rtol=1e-4, atol=1e-5 * np.max(np.abs(difference)))
