# pyright: basic
"""What of a graph is kept in variables, what is written where it is used, and which arrays serve again.

A result that is used once is written there, if that is no work done twice. What nobody reads any more is
where the next result of its size goes.
"""

from __future__ import annotations

import collections
from collections.abc import Iterator

from quadftc_compile.graph import VIEWS, Graph, Node
from quadftc_compile.operators import ELEMENTWISE

FEW = 4  # numbers of an array that is written number by number
MANY = 1000  # numbers of an array that it costs much to copy
LONGEST = 24  # operations in one statement
PARTS = 16  # along an axis on which arrays are joined, up to which loops of it are written part by part
CHEAP = {"add", "sub", "mul", "select_n"}  # done twice in less time than their numbers are kept and read
# operations that read their operands as arrays that lie in one piece
ADDRESSED: set[str] = set()


class Plan:
    """Which results of a graph are kept, and which are written where they are used."""

    def __init__(self, graph: Graph) -> None:
        self.inlined: set[int] = set()
        self.looped: set[int] = set()  # read inside of loops, or as an array
        self._kept: set[int] = set()  # read as an array in one piece
        self._reads: dict[int, float] = collections.defaultdict(float)  # how often each number is read
        for node in graph.outputs:
            self._reads[id(node)] += 1.0
            if node.size > FEW:
                self.looped.add(id(node))
        for node in reversed(graph.nodes):
            self._decide(node)
        self._shorten(graph)
        self.inlined -= {id(each) for each in graph.outputs if each.op not in VIEWS}
        # by node: what is read there for the last time; ``over``: each number only for that at its place
        self.last: dict[int, list[Node]] = collections.defaultdict(list)
        self.over: dict[int, list[Node]] = collections.defaultdict(list)
        self.ends: dict[int, tuple[Node, bool]] = {}  # the same of inputs
        self.shown: set[int] = set()  # what outputs are views of, which read it after all else
        self._find_last(graph)

    def takes_over(self, graph: Graph, given: Node, made: Node) -> bool:
        """Whether an output can be written where an input is, one that is no other output."""
        if id(given) in self.shown or any(each is given for each in graph.outputs if each is not made):
            return False
        if made is given or id(given) not in self.ends:
            return True
        last, in_place = self.ends[id(given)]
        order = [id(each) for each in graph.nodes]
        earlier = made.op in ELEMENTWISE and order.index(id(last)) < order.index(id(made))
        return in_place if last is made else earlier

    def taken_over(self, result: Node) -> list[Node]:
        """Return what a branch can write a result over: an operand that nobody reads any more."""
        (cond,) = result.operands
        if cond.op != "cond":
            return []
        made, graphs, given = result.params["index"], cond.params["graphs"], cond.operands[1:]
        return [
            each
            for k, each in enumerate(given)
            if each in self.last[id(cond)]
            and each.shape == result.shape
            and given.count(each) == 1
            and all(Plan(graph).takes_over(graph, graph.inputs[k], graph.outputs[made]) for graph in graphs)
        ]

    def _find_last(self, graph: Graph) -> None:
        """Find for each node that is kept which others nobody reads after it."""
        reader: dict[int, tuple[Node, Node, bool]] = {}  # of what is kept: itself, and the last that reads it
        through: dict[int, dict[Node, bool]] = {}  # of what is inlined: what it reads, and if at its place
        for node in graph.nodes:
            by_number = node.op in ELEMENTWISE
            read: dict[Node, bool] = {}
            for operand in node.operands:
                alike = node.op == "reshape" or (by_number and operand.shape == node.shape)
                for kept, in_place in through.get(id(operand), {operand: True}).items():
                    read[kept] = read.get(kept, True) and alike and in_place
            if id(node) in self.inlined or node.op == "result":
                through[id(node)] = read if node.op != "result" else {node: True}
            else:
                reader |= {id(each): (each, node, in_place) for each, in_place in read.items()}
        self.shown = {id(kept) for each in graph.outputs for kept in through.get(id(each), ())}
        outputs = self.shown | {id(each) for each in graph.outputs}
        for each, last, in_place in reader.values():
            fits = in_place and each.dtype == last.dtype and each.size == last.size
            if each.op == "input":  # those belong to who has made them
                self.ends[id(each)] = last, fits
            elif id(each) not in outputs:
                (self.over if fits else self.last)[id(last)].append(each)

    def _decide(self, node: Node) -> None:
        """Decide on a node, those that read it being decided on."""
        reads, looped = self._reads[id(node)], id(node) in self.looped
        if node.op == "reshape" and (id(node) in self._kept or (looped and not keeps_axes(node))):
            self._kept.discard(id(node))  # it lies where what it reshapes lies
            self._kept.add(id(node.operands[0]))
        inline = id(node) not in self._kept and self._is_inlined(node, reads, looped)
        loops = looped if inline else node.size > FEW
        if inline:
            self.inlined.add(id(node))
        for operand, times in self._reads_of(node, reads if inline else 1.0):
            self._reads[id(operand)] += times
            if loops or node.op not in {*VIEWS, *ELEMENTWISE}:
                self.looped.add(id(operand))
            if node.op in ADDRESSED:
                self._kept.add(id(operand))

    def _is_inlined(self, node: Node, reads: float, looped: bool) -> bool:
        if node.op == "concatenate":
            return not looped or (node.size >= MANY and node.shape[node.params["dimension"]] <= PARTS)
        if node.op in VIEWS or node.op == "result":
            return True
        most = 2.0 if node.size >= MANY and node.op in CHEAP else 1.0
        return node.op in ELEMENTWISE and reads <= most + 1e-9

    def _reads_of(self, node: Node, reads: float) -> Iterator[tuple[Node, float]]:
        """Yield how often each number of the operands is read, on average."""
        for operand in node.operands:
            if operand.op in ("constant", "input") or operand.size == 0:
                continue
            if node.op == "concatenate":
                yield operand, reads
            elif node.op in VIEWS or node.op in ELEMENTWISE:
                yield operand, reads * node.size / operand.size
            else:
                yield operand, 1.0 if node.op.startswith("reduce_") else 2.0

    def _shorten(self, graph: Graph) -> None:
        """Keep some more results, so that no statement gets too long."""
        length: dict[int, int] = {}
        for node in graph.nodes:
            own = 0 if node.op in VIEWS else 1
            total = own + sum(length.get(id(each), 0) for each in node.operands)
            if id(node) in self.inlined and node.op in ELEMENTWISE and total > LONGEST:
                self.inlined.discard(id(node))
            length[id(node)] = total if id(node) in self.inlined else 0


def keeps_axes(node: Node) -> bool:
    """Whether a reshape only adds and removes axes of length 1."""
    (x,) = node.operands
    return [n for n in x.shape if n != 1] == [n for n in node.shape if n != 1]
