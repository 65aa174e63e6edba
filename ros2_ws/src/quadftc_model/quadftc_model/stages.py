# pyright: basic
"""The stages of a step: groups of its equations, each of which a compiler is to leave as one function.

A result that costs much and is used more than once ends a stage. What costs little is computed again where
it is used.
"""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from jax import lax
from jax.extend import core

Var = Any  # jax.extend.core.Var
Atom = Any  # Var or Literal
Equation = Any  # jax.extend.core.JaxprEqn: a primitive on values of one flight
Stage = tuple[list[Var], list[Equation], list[Var]]  # equations from some results to others

SHARED = 8.0  # a result used more than once is kept if it costs more than this
LARGEST = 300.0  # a result is kept if it costs more than this in any case

# Relative cost of one number of a result; every other primitive costs 1.
FREE = {"slice", "squeeze", "reshape", "broadcast_in_dim", "transpose", "expand_dims", "concatenate"}
FREE |= {"convert_element_type", "stack", "rev", "copy", "stop_gradient"}
DEAR = {"sin": 20.0, "cos": 20.0, "tan": 30.0, "atan2": 30.0, "asin": 30.0, "acos": 30.0, "exp": 15.0}
DEAR |= {"log": 15.0, "pow": 40.0, "div": 4.0, "sqrt": 4.0, "tanh": 20.0}
REDUCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_and": lax.bitwise_and,
}


def variables(atoms: Iterable[Atom]) -> list[Var]:
    """Return the atoms that are no literals."""
    return [atom for atom in atoms if not isinstance(atom, core.Literal)]


def values_of(atoms: Iterable[Atom], known: dict[Var, Any]) -> list[Any]:
    """Return the values of variables and literals."""
    return [atom.val if isinstance(atom, core.Literal) else known[atom] for atom in atoms]


def bind(equation: Equation, values: Sequence[Any]) -> list[Any]:
    """Compute the outputs of an equation from the values of its inputs."""
    outputs = equation.primitive.bind(*values, **equation.params)
    return list(outputs) if equation.primitive.multiple_results else [outputs]


class StageCutter:
    """Cuts a step into stages: its equations, in an order in which they can be computed, and its outputs."""

    def __init__(
        self, equations: Sequence[Equation], outputs: Sequence[Atom], constants: Iterable[Var]
    ) -> None:
        self._equations, self._outputs = equations, variables(outputs)
        self._constants = set(constants)  # variables that every stage knows
        self._maker = {var: equation for equation in equations for var in equation.outvars}
        self._kept: set[Var] = set()  # results that end a stage
        self._cost: dict[Var, float] = {}  # of one number of a result, from what is kept
        self._stage: dict[Equation, int] = {}

    def cut(self) -> list[Stage]:
        """Return the stages in the order in which they can be computed."""
        self._number()
        stages: list[Stage] = []
        wanted = set(self._outputs)
        for number in range(max(self._stage.values(), default=0), -1, -1):
            members = [equation for equation in self._equations if self._stage[equation] == number]
            equations, inputs = self._close(members)
            made = [var for equation in equations for var in equation.outvars]
            here = [var for var in made if var in wanted and self._stage[self._maker[var]] == number]
            stages.append((inputs, equations, here))
            wanted.update(inputs)
        return stages[::-1]

    def _number(self) -> None:
        """Give each equation its stage: after those whose kept results it needs."""
        uses = collections.Counter(self._outputs)
        for equation in self._equations:
            uses.update(set(variables(equation.invars)))
        for equation in self._equations:
            stage, total = 0, 0.0
            for atom in variables(equation.invars):
                if atom not in self._maker:  # an input of the step
                    continue
                before = self._stage[self._maker[atom]]
                if self._cost[atom] > 0.0 and _repeats(equation, atom):
                    self._kept.add(atom)
                if atom in self._kept:
                    before += 1
                else:
                    total += self._cost[atom]
                stage = max(stage, before)
            self._stage[equation] = stage
            price, times = _price(equation)
            cost = price + times * total
            for var in equation.outvars:
                self._cost[var] = cost
                if cost > LARGEST or (cost > SHARED and uses[var] > 1):
                    self._kept.add(var)

    def _close(self, members: Sequence[Equation]) -> tuple[list[Equation], list[Var]]:
        """Add the cheap equations that a stage needs; return all of its equations, and what it takes in."""
        included: dict[Equation, None] = {}
        outside: dict[Var, None] = {}
        pending = set(members)

        def include(equation: Equation) -> None:
            for atom in variables(equation.invars):
                maker = self._maker.get(atom)
                if atom in self._constants or maker in included or maker in pending:
                    continue
                if maker is not None and self._cost[atom] <= SHARED and atom not in self._kept:
                    include(maker)
                else:
                    outside[atom] = None
            included[equation] = None

        for equation in members:
            include(equation)
        return list(included), list(outside)


def _price(equation: Equation) -> tuple[float, float]:
    """Cost of one number of the result, and how often each input is computed for it."""
    name = equation.primitive.name
    if name in FREE:
        return 0.0, 1.0
    if name == "dot_general":
        (axes, _), _ = equation.params["dimension_numbers"]
    elif name in REDUCTIONS:
        axes = equation.params["axes"]
    else:
        return DEAR.get(name, 1.0), 1.0
    terms = float(np.prod([equation.invars[0].aval.shape[axis] for axis in axes]))
    return (2.0 * terms if name == "dot_general" else terms), terms


def _repeats(equation: Equation, atom: Atom) -> bool:
    """Whether each number of an input goes into several of the result."""
    name = equation.primitive.name
    if name in ("concatenate", "stack"):
        return False
    return name == "dot_general" or equation.outvars[0].aval.size > atom.aval.size
