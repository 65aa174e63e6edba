"""The league: what counts as naming a fault of a scenario."""

from __future__ import annotations

from quadftc_flight.scenario import load_scenario
from quadftc_tools.study.league import Named, truth_cell
from quadftc_tools.study.league_flights import SCENARIOS, truths


def test_fault_of_a_scenario_is_named_by_component_element_and_time():
    roll, gyro, _ = truths(load_scenario(SCENARIOS / "free_circle.yaml"))
    assert roll[1:] == ("attitude", ("roll",), 15.0, 22.0)
    assert gyro[1:3] == ("gyro", ("x",))
    assert truth_cell([Named("attitude", "roll", 15.51), Named("attitude", "roll", 15.01)], roll) == "0.01 s"
    assert truth_cell([Named("gyro", "x", 15.1)], roll) == "other"
    assert truth_cell([Named("attitude", "roll", 23.0)], roll) == "-"
