"""The laws of a graph, known before its nodes start: those that the nodes and the closed loop run."""

from __future__ import annotations

import pytest

from quadftc_compile.build import key_of
from quadftc_compile.engine import CEngine
from quadftc_compile.recipe import recipe_of
from quadftc_flight.closed_loop import loop_of
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.laws import graph_laws, prepare_laws
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.recommended import HOVER, LEVEL, recommended_laws
from quadftc_flight.scenario import find_scenario, load_scenario, node_parameters, parse_scenario

BOOKKEEPING = {"clock", "speeds", "trust"}  # what nodes do without a law: stamps, and whose speeds are whose


def keys_of(laws):
    words = (getattr(law, "example_words", lambda: None)() for law in laws)
    return {key_of(recipe_of(law, law.example(), each)) for law, each in zip(laws, words, strict=True)}


def live_plan(text: str) -> GraphPlan:
    """What `quadftc live` flies."""
    parameters = {node: dict(values) for node, values in node_parameters(parse_scenario(text), None).items()}
    for node in {"reference", "position_controller"} & parameters.keys():
        parameters[node]["source"] = "topic"
    return GraphPlan(parameters, "realtime")


@pytest.mark.parametrize(
    ("name", "scheme"), [("mems_faults", "supervised"), ("free_circle", "isolating"), ("free_circle", None)]
)
def test_laws_of_a_graph_are_those_of_the_closed_loop(name, scheme):
    scenario = load_scenario(find_scenario(name))
    laws = loop_of(scenario, scenario.scheme(scheme)).laws
    wanted = keys_of([law for each, law in laws.items() if each not in BOOKKEEPING])
    assert len(wanted) > 8
    assert wanted <= keys_of(graph_laws(GraphPlan(node_parameters(scenario, scheme))))


@pytest.mark.parametrize("text", [LEVEL, HOVER], ids=["stand", "free flight"])
def test_nodes_compile_nothing_once_the_laws_of_their_graph_are_prepared(text, monkeypatch):
    plan, compiled = live_plan(text), []
    prepare_laws([plan])
    monkeypatch.setattr(CEngine, "_announce", lambda _, recipes: compiled.extend(recipes))
    with ComposedGraph(plan):
        assert [recipe.name for recipe in compiled] == []


def test_recommended_laws_are_those_of_live():
    known = keys_of(recommended_laws())
    for text in (LEVEL, HOVER):
        assert keys_of(graph_laws(live_plan(text))) <= known


def test_a_wrong_parameter_is_left_to_its_node():
    plan = GraphPlan({"controller": {"controller": "ismc", "ismc.k_c1": -1.0}})
    names = [type(law).__name__ for law in graph_laws(plan)]
    assert len(names) == len(graph_laws(GraphPlan({}))) - 1
    with pytest.raises(ValueError, match="k_c1"):
        ComposedGraph(plan)
