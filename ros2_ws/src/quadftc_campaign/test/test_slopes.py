# pyright: basic
"""Slopes of a flight against differences of flights."""

from collections.abc import Callable

import numpy as np
import pytest

from quadftc_campaign.batch.engine import BatchFlight, fly_all
from quadftc_campaign.batch.slope import SlopedLoop, fly_with_slopes
from quadftc_campaign.flights import batch_flight
from quadftc_compile.build import key_of
from quadftc_compile.recipe import recipe_of
from quadftc_flight.scenario import find_scenario, load_scenario

CONTROLLER = "loop.attitude.law.controller"
PATHS = {
    "controller.k_c1": f"{CONTROLLER}.k_c1",
    "controller.k_c2": f"{CONTROLLER}.k_c2",
    "controller.phi": f"{CONTROLLER}.phi",
    "disturbance_observer.bandwidth": "loop.disturbance_observer.law.observer.bandwidth",
}

Gains = dict[str, np.ndarray]
Steps = list[tuple[Gains, float]]  # directions of gains, and how far to go along each for a difference


def built(gains: Gains) -> BatchFlight:
    """A flight of 8 s with a fault from the 3rd to the 5th."""
    values = [f"schemes.proposed.{name}={value.tolist()}" for name, value in gains.items()]
    scenario = load_scenario(
        find_scenario("mems_faults"),
        [
            "duration=8 s",
            "faults=[{kind: bias, channel: attitude, axes: roll, value: 1 deg, start: 3 s, stop: 5 s}]",
            "references=[{kind: sine, amplitude: 4 deg, frequency: 0.8, start: 1 s}]",
            "schemes.proposed.checks=[]",
            *values,
        ],
    )
    return batch_flight(scenario, "proposed")


def built_flight(gains: Gains) -> BatchFlight:
    """A circle of 4 s through space."""
    values = [f"schemes.conventional.{name}={value.tolist()}" for name, value in gains.items()]
    short = ["duration=4 s", "faults=[]", "trajectories.0.start=0.5 s", "trajectories.0.stop=3.5 s"]
    scenario = load_scenario(find_scenario("free_circle"), [*short, *values])
    return batch_flight(scenario, "conventional")


def check_slopes(
    build: Callable[[Gains], BatchFlight],
    base: Gains,
    steps: Steps,
    kinds: tuple[str, ...],
    rtol: float,
    atol: float,
) -> None:
    """Compare slopes with central differences."""
    directions = {
        PATHS[name]: np.stack([way.get(name, np.zeros_like(value)) for way, _ in steps])
        for name, value in base.items()
    }
    (found,) = fly_with_slopes([build(base)], directions)
    moved = [
        build({name: value + sign * size * way.get(name, 0.0) for name, value in base.items()})
        for way, size in steps
        for sign in (-1, 1)
    ]
    flown = [*fly_all(moved)]
    for place, (_, size) in enumerate(steps):
        before, after = flown[2 * place].sums, flown[2 * place + 1].sums
        for kind in kinds:
            difference = (after[kind] - before[kind]) / (2.0 * size)
            bound = atol * (1.0 + np.max(np.abs(difference)))
            np.testing.assert_allclose(found.slopes[kind][place], difference, rtol=rtol, atol=bound)
        assert np.any(found.slopes["variation"][place] != 0.0)


def test_slopes_are_those_of_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains of the controller and of the disturbance observer, more than fly together."""
    monkeypatch.setattr("quadftc_campaign.batch.slope.TOGETHER", 2)
    base = {
        "controller.k_c1": np.array([16.0, 16.0, 9.0]),
        "controller.phi": np.array([0.1, 0.1, 0.1]),
        "disturbance_observer.bandwidth": np.array(10.0),
    }
    steps: Steps = [
        ({"controller.k_c1": np.array([0.0, 1.0, 0.5])}, 1e-4),
        ({"controller.phi": np.array([1.0, 0.0, 0.0])}, 1e-6),
        ({"disturbance_observer.bandwidth": np.array(1.0)}, 1e-4),
    ]
    kinds = ("tracking", "estimate", "disturbance", "torque", "variation", "delivered")
    check_slopes(built, base, steps, kinds, rtol=1e-5, atol=1e-7)


@pytest.mark.thorough
def test_slopes_in_free_flight_are_those_of_differences() -> None:
    """Through position control, allocation, rotors, wind and position sensor."""
    base = {"controller.k_c2": np.array([4.0, 4.0, 3.0]), "controller.phi": np.array([0.5, 0.5, 0.5])}
    steps: Steps = [
        ({"controller.k_c2": np.array([0.0, 1.0, 0.0])}, 1e-4),
        ({"controller.phi": np.array([1.0, 0.0, 1.0])}, 1e-5),
    ]
    kinds = ("tracking", "position", "torque", "variation")
    check_slopes(built_flight, base, steps, kinds, rtol=1e-4, atol=1e-8)


def test_a_flight_with_other_gains_is_not_compiled_again() -> None:
    """All floats are arguments."""
    laws = [
        SlopedLoop(
            loop=built({"controller.phi": np.full(3, phi)}).loop, paths=(PATHS["controller.phi"],), count=2
        )
        for phi in (0.1, 0.2)
    ]
    one, other = (key_of(recipe_of(law, law.example())) for law in laws)
    assert one == other
