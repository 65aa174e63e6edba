# pyright: basic
"""A step of one flight, rewritten for many flights on a CPU: flights along the last axis, in stages.

``jax.vmap`` puts the flights first, so that the numbers of a vector register lie apart in memory, and
leaves it to XLA where intermediate results are kept. XLA's compiler for CPUs fuses a sum into everything
that uses it, and computes it again for each use. Here the flights are last, and the step is cut into
functions that the compiler must not merge (`quadftc_model.stages`). The numbers are those of
``vmap`` up to rounding. With `supervised` this is 3.5 to 8 times as fast, depending on the machine; with the
scheme `proposed` between no gain and 1.8 times (``quadftc bench batch``, docs/performance.md).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core

from quadftc_model.stages import (
    REDUCTIONS,
    Atom,
    Equation,
    Stage,
    StageCutter,
    Var,
    bind,
    values_of,
    variables,
)

# number by number, so that flights need no treatment: ``vmap`` takes many times as long to trace
ELEMENTWISE = {
    "add",
    "sub",
    "mul",
    "div",
    "max",
    "min",
    "neg",
    "abs",
    "sqrt",
    "sin",
    "cos",
    "exp",
    "log",
    "not",
}
ELEMENTWISE |= {"and", "or", "lt", "le", "gt", "ge", "eq", "ne", "select_n", "convert_element_type"}
CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call")


class StagedStep:
    """A step of one flight, done for many at once, every array with the flights last.

    ``step(state, inputs, common) -> (state, output)``, of pytrees of arrays of one flight, is traced once,
    with these arguments or their shapes. ``common`` is the same for all flights: what follows from it alone
    is computed once. ``shown(state)`` selects the parts of a state that somebody reads in the end; everything
    that changes neither them nor an output is left out.
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
        carried, per_flight = len(jax.tree.leaves(state)), len(jax.tree.leaves((state, inputs)))
        self.shapes = shapes  # of state and output, as trees of what has a shape and a dtype
        self._structure = jax.tree.structure(shapes)
        one = [jax.ShapeDtypeStruct(var.aval.shape, var.aval.dtype) for var in closed.jaxpr.invars]
        flat = jax.make_jaxpr(functools.partial(_inline, closed))(*one)
        self._constants: dict[Var, Any] = dict(zip(flat.jaxpr.constvars, flat.consts, strict=True))
        self._equations: list[Equation] = list(flat.jaxpr.eqns)
        self._inputs: list[Var] = list(flat.jaxpr.invars)
        self._outputs: list[Atom] = list(flat.jaxpr.outvars)
        self._batched = set(self._inputs[:per_flight])
        preparations = self._fold()
        places = jax.tree.unflatten(jax.tree.structure(state), range(carried))
        needed = self._prune(carried, jax.tree.leaves(shown(places)))
        # like ``inputs``: which leaves change an output
        self.needed = jax.tree.unflatten(jax.tree.structure(inputs), needed[carried:per_flight])
        used = [*self._outputs, *(atom for equation in self._equations for atom in equation.invars)]
        self._preparations = StageCutter(preparations, used, self._constants).cut()
        self._stages = StageCutter(self._equations, self._outputs, self._constants).cut()

    def __call__(self, state: Any, inputs: Any, common: Any) -> Any:
        """Step all flights: arrays (..., flights) in, except those of ``common``, and out."""
        leaves = jax.tree.leaves((state, inputs, common))
        flights = leaves[0].shape[-1]
        known: dict[Var, Any] = self._constants | dict(zip(self._inputs, leaves, strict=True))
        for stage in self._preparations:
            known |= self._run_apart(stage, known)
        for stage in self._stages:
            known |= self._run_apart(stage, known, flights)
        values, varies = values_of(self._outputs, known), _varies(self._outputs, self._batched)
        results = [_over_flights(*pair, flights) for pair in zip(values, varies, strict=True)]
        return jax.tree.unflatten(self._structure, results)

    def _run_apart(self, stage: Stage, known: dict[Var, Any], flights: int | None = None) -> dict[Var, Any]:
        """Compute the outputs of a stage in a function that the compiler must leave as it is.

        Without ``flights`` it follows from ``common`` alone.
        """
        inputs, equations, outputs = stage

        def run(*values: Any) -> list[Any]:
            inside = self._constants | dict(zip(inputs, values, strict=True))
            for equation in equations:
                if flights is None:
                    results = bind(equation, values_of(equation.invars, inside))
                else:
                    results = _evaluate(equation, inside, self._batched, flights)
                inside.update(zip(equation.outvars, results, strict=True))
            return [inside[var] for var in outputs]

        with set_xla_metadata(inlineable="false"):
            return dict(zip(outputs, jax.jit(run)(*(known[var] for var in inputs)), strict=True))

    def _fold(self) -> list[Equation]:
        """Compute what depends on no argument; take out, and return, what depends on ``common`` alone."""
        common = set(self._inputs) - self._batched
        remaining, preparations = list[Equation](), list[Equation]()
        for equation in self._equations:
            inputs = variables(equation.invars)
            if self._batched.intersection(inputs):
                remaining.append(equation)
                self._batched.update(equation.outvars)
            elif common.intersection(inputs):
                preparations.append(equation)
                common.update(equation.outvars)
            else:
                with jax.ensure_compile_time_eval():
                    values = bind(equation, values_of(equation.invars, self._constants))
                self._constants.update(zip(equation.outvars, map(np.asarray, values), strict=True))
        self._equations = remaining
        return preparations

    def _prune(self, carried: int, shown: Sequence[int]) -> list[bool]:
        """Leave out what changes no output, now or in a later step; return which inputs do.

        The parts of a state that are left out stay as they were.
        """
        wanted = {*shown, *range(carried, len(self._outputs))}
        while True:
            needed = set(variables(self._outputs[index] for index in wanted))
            kept: list[Equation] = []
            for equation in reversed(self._equations):
                if needed.intersection(equation.outvars):
                    kept.append(equation)
                    needed.update(variables(equation.invars))
            more = {index for index in range(carried) if self._inputs[index] in needed} - wanted
            if not more:
                break
            wanted |= more
        self._equations = kept[::-1]
        for index in set(range(carried)) - wanted:
            self._outputs[index] = self._inputs[index]
        return [var in needed for var in self._inputs]


def _inline(closed: Any, *arguments: Any) -> list[Any]:
    """Evaluate a jaxpr, the functions that it calls in their places."""
    jaxpr, constants = (closed.jaxpr, closed.consts) if hasattr(closed, "consts") else (closed, ())
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))
    for equation in jaxpr.eqns:
        values, params = values_of(equation.invars, known), equation.params
        if equation.primitive.name in CALLS:
            outputs = _inline(params.get("jaxpr") or params["call_jaxpr"], *values)
        else:
            outputs = bind(equation, values)
        known.update(zip(equation.outvars, outputs, strict=True))
    return values_of(jaxpr.outvars, known)


def _evaluate(equation: Equation, known: dict[Var, Any], batched: set[Var], flights: int) -> list[Any]:
    """Compute the outputs (..., flights) of an equation; sums over small axes are written out.

    Of the ``known`` values, those that are ``batched`` are (..., flights), others as for one flight.
    """
    values = values_of(equation.invars, known)
    varies, params, name = _varies(equation.invars, batched), equation.params, equation.primitive.name
    shape = (*equation.outvars[0].aval.shape, flights)
    x = values[0]
    if name == "slice":
        strides = params["strides"] or (1,) * (x.ndim - 1)
        start, stop = (*params["start_indices"], 0), (*params["limit_indices"], flights)
        return [lax.slice(x, start, stop, (*strides, 1))]
    if name in ("squeeze", "reshape", "expand_dims"):
        return [x.reshape(shape)]
    if name == "broadcast_in_dim":
        return [lax.broadcast_in_dim(x, shape, (*params["broadcast_dimensions"], len(shape) - 1))]
    if name == "transpose":
        return [lax.transpose(x, (*params["permutation"], x.ndim - 1))]
    if name in ("concatenate", "stack"):
        axis = params.get("dimension", params.get("axis", 0)) % (len(shape) - 1)
        parts = [_over_flights(v, b, flights) for v, b in zip(values, varies, strict=True)]
        return [(jnp.concatenate if name == "concatenate" else jnp.stack)(parts, axis=axis)]
    if name in REDUCTIONS:
        return [_reduce(x, params["axes"], REDUCTIONS[name])]
    if name == "dot_general":
        total = _contract(values, varies, *params["dimension_numbers"])
        return [jnp.broadcast_to(total, shape).astype(equation.outvars[0].aval.dtype)]
    if name in ELEMENTWISE and all(varies) and all(value.shape == shape for value in values):
        return bind(equation, values)
    axes = [-1 if each else None for each in varies]
    return jax.vmap(lambda *each: bind(equation, each), in_axes=axes, out_axes=-1)(*values)


def _varies(atoms: Sequence[Atom], batched: set[Var]) -> list[bool]:
    return [not isinstance(atom, core.Literal) and atom in batched for atom in atoms]


def _over_flights(value: Any, varies: bool, flights: int) -> Any:
    array = value if varies else jnp.asarray(value)[..., None]
    return jnp.broadcast_to(array, (*array.shape[:-1], flights))


def _reduce(x: Any, axes: Sequence[int], operation: Callable[[Any, Any], Any]) -> Any:
    """Reduce small axes, the sum written out."""
    kept = [axis for axis in range(x.ndim) if axis not in axes]
    count = math.prod(x.shape[axis] for axis in axes)  # no -1 below: an axis that is kept may be empty
    terms = lax.transpose(x, (*axes, *kept)).reshape(count, *(x.shape[axis] for axis in kept))
    return functools.reduce(operation, [terms[index] for index in range(count)])


def _contract(
    values: Sequence[Any],
    varies: Sequence[bool],
    contracted: Sequence[Sequence[int]],
    together: Sequence[Sequence[int]],
) -> Any:
    """Multiply two small arrays, the sum written out; terms whose constant is zero are left out."""
    sides: list[Any] = []
    for value, batched, inner, batch in zip(values, varies, contracted, together, strict=True):
        array = value if isinstance(value, jax.Array) else np.asarray(value)
        array = array if batched else array[..., None]
        free = [axis for axis in range(array.ndim - 1) if axis not in (*inner, *batch)]
        array = array.transpose((*inner, *batch, *free, array.ndim - 1))
        count = math.prod(array.shape[: len(inner)])
        sides.append(array.reshape(count, *array.shape[len(inner) :]))
    # (terms, batch, free of a, free of b, flights)
    a, b = sides
    start = 1 + len(together[0])
    ones_a, ones_b = [1] * (a.ndim - 1 - start), [1] * (b.ndim - 1 - start)
    a = a.reshape(*a.shape[:-1], *ones_b, a.shape[-1])
    b = b.reshape(*b.shape[:start], *ones_a, *b.shape[start:])
    terms = [
        a[index] * b[index]
        for index in range(len(a))
        if all(not isinstance(side, np.ndarray) or side[index].any() for side in (a, b))
    ]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros((), jnp.result_type(*values))
