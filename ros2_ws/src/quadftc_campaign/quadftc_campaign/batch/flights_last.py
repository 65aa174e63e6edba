# pyright: basic
"""Many flights on a CPU: a step of one as a step of all of them, flights along the last axis, in stages.

``jax.vmap`` puts the flights first, so that a vector of three has its numbers 12 bytes apart for the machine,
and leaves it to XLA where intermediate results are kept; XLA's CPU compiler fuses a sum into everything that
uses it and computes it again for each. Here the flights are last, which fills the machine's vector registers,
and the step is cut into stages, functions that the compiler must not merge: a result that is dear and used
more than once ends a stage. The numbers are those of ``vmap`` up to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core

from quadftc_campaign.batch.equations import Atom, Equation, Var, bound, cost_of, repeats, value_of
from quadftc_campaign.batch.primitives import evaluated

CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call")
SHARED = 8.0  # a result used more than once is kept if it costs more than this
LARGEST = 300.0  # a result is kept if it costs more than this in any case


class AllFlights:
    """A step of one flight, done for many at once, every array with the flights last.

    Parameters
    ----------
    step : callable
        ``step(state, inputs, common) -> (state, output)``, of pytrees of arrays of one flight; traced
        once. What decides nothing that comes out is left out.
    state, inputs, common : pytrees
        Arguments of ``step``, or their shapes (``jax.ShapeDtypeStruct``); ``common`` is the same for all
        flights, and what follows from it alone is computed once.
    shown : callable
        ``shown(state)`` returns the parts of a state that are looked at in the end.
    """

    def __init__(
        self,
        step: Callable[..., Any],
        state: Any,
        inputs: Any,
        common: Any,
        shown: Callable[[Any], Any] = lambda state: state,
    ) -> None:
        closed, shapes = jax.make_jaxpr(step, return_shape=True)(state, inputs, common)
        if jax.tree.structure(shapes[0]) != jax.tree.structure(state):
            raise ValueError("the state after a step has other parts than before")
        carried, all_inputs = len(jax.tree.leaves(state)), len(jax.tree.leaves((state, inputs)))
        self._structure = jax.tree.structure(shapes)
        places = jax.tree.unflatten(jax.tree.structure(state), range(carried))
        self._program = _Program(closed, carried, all_inputs, jax.tree.leaves(shown(places)))
        self.needed = jax.tree.unflatten(
            jax.tree.structure(inputs), self._program.needed[carried:all_inputs]
        )  # like ``inputs``: which leaves decide anything

    def __call__(self, state: Any, inputs: Any, common: Any) -> Any:
        """Step all flights: arrays (..., flights) in, but for those of ``common``, and out."""
        leaves = jax.tree.leaves((state, inputs, common))
        return jax.tree.unflatten(self._structure, self._program(leaves))


class _Program:
    """The equations of a step, and the stage each belongs to."""

    def __init__(self, closed: Any, carried: int, flown: int, shown: Sequence[int]) -> None:
        self.inputs: list[Var] = list(closed.jaxpr.invars)
        self.constants: dict[Var, Any] = {}
        self.equations: list[Equation] = []
        self.outputs = self._inlined(closed, self.inputs)
        self.batched = set(self.inputs[:flown])
        self.common: set[Var] = set(self.inputs[flown:])
        self.preparations: list[Equation] = []
        self._fold()
        self._forget(carried, shown)
        self.maker = {var: equation for equation in self.equations for var in equation.outputs}
        self.kept: set[Var] = set()  # results that end a stage
        self.cost: dict[Var, float] = {}  # of one number of a result, from what is kept
        self.stages = self._staged()

    def __call__(self, leaves: Sequence[Any]) -> list[Any]:
        flights = leaves[0].shape[-1]
        known: dict[Var, Any] = dict(zip(self.inputs, leaves, strict=True))
        for equation in self.preparations:
            known.update(zip(equation.outputs, bound(equation, known, self.constants), strict=True))
        for inputs, equations, outputs in self.stages:
            run = _stage(inputs, equations, outputs, self, flights)
            known.update(zip(outputs, run(*[known[var] for var in inputs]), strict=True))
        return [self._output(atom, known, flights) for atom in self.outputs]

    def _output(self, atom: Atom, known: dict[Var, Any], flights: int) -> Any:
        if not isinstance(atom, core.Literal) and atom in self.batched:
            return known[atom]
        value = jnp.asarray(value_of(atom, known, self.constants), atom.aval.dtype)  # pyright: ignore
        return jnp.broadcast_to(value[..., None], (*value.shape, flights))

    def _inlined(self, closed: Any, arguments: Sequence[Atom]) -> list[Atom]:
        """Append the equations of a closed jaxpr, those of the functions it calls in their place."""
        jaxpr = closed.jaxpr
        self.constants.update(zip(jaxpr.constvars, closed.consts, strict=True))
        renamed: dict[Var, Atom] = dict(zip(jaxpr.invars, arguments, strict=True))

        def name(atom: Atom) -> Atom:
            return atom if isinstance(atom, core.Literal) else renamed.get(atom, atom)

        for equation in jaxpr.eqns:
            inputs = tuple(map(name, equation.invars))
            if equation.primitive.name in CALLS:
                called = equation.params.get("jaxpr") or equation.params["call_jaxpr"]
                fresh = _fresh(called)
                renamed.update(zip(equation.outvars, self._inlined(fresh, inputs), strict=True))
            else:
                self.equations.append(
                    Equation(equation.primitive, equation.params, inputs, tuple(equation.outvars))
                )
        return [name(atom) for atom in jaxpr.outvars]

    def _fold(self) -> None:
        """Compute what does not depend on the flight."""
        remaining: list[Equation] = []
        for equation in self.equations:
            inputs = [atom for atom in equation.inputs if not isinstance(atom, core.Literal)]
            if self.batched.intersection(inputs):
                remaining.append(equation)
                self.batched.update(equation.outputs)
            elif self.common.intersection(inputs):
                self.preparations.append(equation)
                self.common.update(equation.outputs)
            else:
                with jax.ensure_compile_time_eval():
                    found = bound(equation, {}, self.constants)
                self.constants.update(zip(equation.outputs, map(np.asarray, found), strict=True))
        self.equations = remaining

    def _forget(self, carried: int, shown: Sequence[int]) -> None:
        """Leave out what decides no output, now or in a later step: of the state, it stays as it was."""
        wanted = {*shown, *range(carried, len(self.outputs))}
        while True:
            needed = {self.outputs[i] for i in wanted if not isinstance(self.outputs[i], core.Literal)}
            kept: list[Equation] = []
            for equation in reversed(self.equations):
                if needed.intersection(equation.outputs):
                    kept.append(equation)
                    needed.update(atom for atom in equation.inputs if not isinstance(atom, core.Literal))
            more = {i for i in range(carried) if self.inputs[i] in needed} - wanted
            if not more:
                break
            wanted |= more
        self.equations = kept[::-1]
        self.needed = [var in needed for var in self.inputs]
        for index in set(range(carried)) - wanted:
            self.outputs[index] = self.inputs[index]

    def _staged(self) -> list[tuple[list[Var], list[Equation], list[Var]]]:
        """Inputs, equations and outputs of each stage."""
        stage_of = self._stage_numbers()
        last = {atom for atom in self.outputs if not isinstance(atom, core.Literal) and atom in self.batched}
        count = 1 + max(stage_of.values(), default=0)
        members: list[list[Equation]] = [[] for _ in range(count)]
        for equation in self.equations:
            members[stage_of[equation]].append(equation)
        taken = [self._closure(equations) for equations in members]
        stages: list[tuple[list[Var], list[Equation], list[Var]]] = []
        for number, (equations, inputs) in enumerate(taken):
            made = {var for equation in equations for var in equation.outputs}
            later = {var for _, wanted in taken[number + 1 :] for var in wanted} | last
            here = {var for var in made if var in later and stage_of[self.maker[var]] == number}
            stages.append((inputs, equations, [var for e in equations for var in e.outputs if var in here]))
        return stages

    def _closure(self, members: Sequence[Equation]) -> tuple[list[Equation], list[Var]]:
        """The equations of a stage with the cheap ones they need, and what has to come from outside.

        What costs little is done again where it is used.
        """
        included: dict[Equation, None] = {}
        outside: dict[Var, None] = {}

        def need(atom: Atom) -> None:
            if isinstance(atom, core.Literal) or atom in self.constants:
                return
            maker = self.maker.get(atom)
            if maker is None:
                outside[atom] = None
            elif maker not in included and maker not in own:
                if self.cost[atom] <= SHARED and atom not in self.kept:
                    include(maker)
                else:
                    outside[atom] = None

        def include(equation: Equation) -> None:
            for atom in equation.inputs:
                need(atom)
            included[equation] = None

        own = set(members)
        for equation in members:
            include(equation)
        return list(included), list(outside)

    def _uses(self) -> dict[Var, int]:
        """How many equations need each result, and the end."""
        uses: dict[Var, int] = {}
        for equation in self.equations:
            for atom in {each for each in equation.inputs if not isinstance(each, core.Literal)}:
                uses[atom] = uses.get(atom, 0) + 1
        for atom in self.outputs:
            if not isinstance(atom, core.Literal):
                uses[atom] = uses.get(atom, 0) + 1
        return uses

    def _stage_numbers(self) -> dict[Equation, int]:
        """The stage of each equation: after those whose results it needs kept."""
        uses = self._uses()
        stage: dict[Equation, int] = {}
        cost, kept = self.cost, self.kept
        for equation in self.equations:
            number, total = self._needs(equation, stage)
            stage[equation] = number
            own, times = cost_of(equation)
            dear = own + times * total
            for var in equation.outputs:
                cost[var] = dear
                if dear > LARGEST or (dear > SHARED and uses.get(var, 0) > 1):
                    kept.add(var)
        return stage

    def _needs(self, equation: Equation, stage: dict[Equation, int]) -> tuple[int, float]:
        """The first stage an equation can be in, and what its inputs cost that are not kept."""
        number, total = 0, 0.0
        for atom in equation.inputs:
            maker = None if isinstance(atom, core.Literal) else self.maker.get(atom)
            if maker is None:
                continue
            before = stage[maker]
            if self.cost[atom] > 0.0 and repeats(equation, atom):
                self.kept.add(atom)
            if atom in self.kept:
                before += 1
            else:
                total += self.cost[atom]
            number = max(number, before)
        return number, total


def _fresh(called: Any) -> Any:
    """A closed jaxpr with variables of its own: one that is called twice must not have its names twice."""
    closed = called if hasattr(called, "consts") else core.ClosedJaxpr(called, ())
    shapes = [jax.ShapeDtypeStruct(var.aval.shape, var.aval.dtype) for var in closed.jaxpr.invars]
    return jax.make_jaxpr(core.jaxpr_as_fun(closed))(*shapes)


def _stage(
    inputs: Sequence[Var],
    equations: Sequence[Equation],
    outputs: Sequence[Var],
    program: _Program,
    flights: int,
) -> Callable[..., list[Any]]:
    """Function of one stage, which the compiler must leave as it is."""

    def run(*values: Any) -> list[Any]:
        known = dict(zip(inputs, values, strict=True))
        for equation in equations:
            found = evaluated(equation, known, program.constants, program.batched, flights)
            known.update(zip(equation.outputs, found, strict=True))
        return [known[var] for var in outputs]

    def kept_apart(*values: Any) -> list[Any]:
        with set_xla_metadata(inlineable="false"):
            return jax.jit(run)(*values)

    return kept_apart
