"""Schemes that were tuned on our own plant fly on MuJoCo's, and hold what they hold on ours."""

from __future__ import annotations

import pytest

from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import find_scenario, load_scenario, with_duration

pytest.importorskip("mujoco")


def flown(plant: str, scheme: str) -> Flight:
    """The circle in gusts without faults, at full speed after 3 s."""
    changes = (f"plant.kind={plant}", "trajectories.0.start=0.5 s", "trajectories.0.rise=2 s", "faults=[]")
    return fly(with_duration(load_scenario(find_scenario("free_circle"), changes), 8.0), scheme)


@pytest.mark.parametrize("scheme", ["isolating", pytest.param("conventional", marks=pytest.mark.thorough)])
def test_scheme_holds_the_circle_on_both_plants(scheme: str):
    ours, theirs = (
        flight_metrics(flown(plant, scheme), ())["position_rmse_m"] for plant in ("free_flight", "mujoco")
    )
    assert max(ours, theirs) < 0.2
    assert theirs == pytest.approx(ours, rel=0.01)
