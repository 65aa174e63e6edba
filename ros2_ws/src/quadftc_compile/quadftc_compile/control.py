# pyright: basic
"""Loops and branches of a traced function in C: scan, cond.

There is no `while`: on a vehicle the data must not decide how long a step takes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from quadftc_compile.emit import WHOLE, Emitter, Storage
from quadftc_compile.graph import Graph, Node
from quadftc_compile.plan import ADDRESSED, MANY
from quadftc_compile.text import Index


def write_cond(emitter: Emitter, node: Node, targets: Mapping[int, Storage]) -> None:
    """Write a branch: the first operand says which."""
    which, *operands = node.operands
    number = emitter.at(which, [Index()] * len(which.shape)).text
    inputs = [_storage(emitter, each) for each in operands]
    results = _results(emitter, node, targets)
    graphs: list[Graph] = node.params["graphs"]
    handed = [[_handed_on(graph, each, inputs) for each in graph.outputs] for graph in graphs]
    pointers = {
        n: emitter.point(each, results[n])
        for n, each in enumerate(node.params["results"])
        if id(each) not in targets and each.size >= MANY and any(found[n] for found in handed)
    }
    for k in range(len(graphs) - 1, -1, -1):
        if k == len(graphs) - 1:
            emitter.open(f"if ({number} >= {k})")
        else:
            emitter.go_on("else" if k == 0 else f"else if ({number} == {k})")
        seen = {n: handed[k][n] for n in pointers}
        emitter.emit(graphs[k], inputs, [None if seen.get(n) else each for n, each in enumerate(results)])
        for n, pointer in pointers.items():
            emitter.line(f"{pointer.name} = {(seen[n] or results[n]).name};")
    emitter.close()


def _results(emitter: Emitter, node: Node, targets: Mapping[int, Storage]) -> list[Storage]:
    """Return where the results go."""
    nodes: list[Node] = node.params["results"]
    results = [targets.get(id(each)) or emitter.declare(each.shape, each.dtype) for each in nodes]
    for each, where in zip(nodes, results, strict=True):
        emitter.keep(each, where)
    return results


def _handed_on(graph: Graph, output: Node, inputs: Sequence[Storage]) -> Storage | None:
    """Return where an input stays that a branch hands on as it is; None of what is not."""
    for node, where in zip(graph.inputs, inputs, strict=True):
        if node is output and where.fixed and output.dtype.kind != "b":  # flags are kept in other types
            return where
    return None


def write_scan(emitter: Emitter, node: Node, targets: Mapping[int, Storage]) -> None:
    """Write a loop that carries arrays, takes an element of others each time, and gathers more."""
    params, (graph,) = node.params, node.params["graphs"]
    constants, carried, length = params["num_consts"], params["num_carry"], params["length"]
    inputs, results = [_storage(emitter, each) for each in node.operands], _results(emitter, node, targets)
    for each, where in zip(node.operands[constants : constants + carried], results, strict=False):
        emitter.copy(each, where)
    name = emitter.name("t")
    emitter.open(f"for (int {name} = 0; {name} < {length}; {name}++)")
    step = f"({length - 1} - {name})" if params["reverse"] else name
    elements = [
        _element(where, inside, step)
        for where, inside in zip(
            inputs[constants + carried :], graph.inputs[constants + carried :], strict=True
        )
    ]
    gathered = [
        _element(where, inside, step)
        for where, inside in zip(results[carried:], graph.outputs[carried:], strict=True)
    ]
    after = [emitter.declare(each.shape, each.dtype) for each in graph.outputs[:carried]]
    emitter.emit(graph, [*inputs[:constants], *results[:carried], *elements], [*after, *gathered])
    _move(emitter, graph.outputs[:carried], after, results[:carried])
    emitter.close()


def _storage(emitter: Emitter, node: Node) -> Storage:
    """Return where an operand is, as what is inside a loop reads it."""
    if node.value is not None and node.size == 1:
        return Storage(emitter.literal(node.value.flat[0]).within(0), single=True)
    return emitter.storage_of(node)


def _element(where: Storage, inside: Node, step: str) -> Storage:
    """Return an element along the first axis of what a loop takes or gathers."""
    if where.single:
        return where
    if inside.shape == ():
        return Storage(f"{where.name}[{step}]", single=True)
    return where.shifted(f"{inside.size} * {step}")


def _move(
    emitter: Emitter, nodes: Sequence[Node], before: Sequence[Storage], after: Sequence[Storage]
) -> None:
    """Write copies of arrays."""
    for node, one, other in zip(nodes, before, after, strict=True):
        held = Node("input", (), {}, node.shape, node.dtype)
        emitter.keep(held, one)
        emitter.copy(held, other)


WHOLE |= {"cond": write_cond, "scan": write_scan}
ADDRESSED.update(WHOLE)
