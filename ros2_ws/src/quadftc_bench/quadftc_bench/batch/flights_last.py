"""Many flights on a CPU: a step of one flight as a step of all of them, flights along the last axis, in stages.

``jax.vmap`` puts the flights first, so that a vector of three has its numbers 12 bytes apart for the machine,
and leaves it to XLA where intermediate results are kept; XLA's CPU compiler fuses a sum into everything that
uses it and computes it again for each. Here the flights are last, which fills the machine's vector registers,
and the step is cut into stages, functions that the compiler must not merge: a result that is dear and used
more than once ends a stage. The numbers are those of ``vmap`` up to rounding; on two cores it is several
times as fast (docs/performance.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core

# Relative cost of one number; what is in neither list counts as 1.
FREE = frozenset(
    [
        "slice",
        "squeeze",
        "reshape",
        "broadcast_in_dim",
        "transpose",
        "expand_dims",
        "convert_element_type",
        "concatenate",
        "stack",
        "rev",
        "copy",
        "stop_gradient",
    ]
)
DEAR = {"sin": 20.0, "cos": 20.0, "tan": 30.0, "atan2": 30.0, "asin": 30.0, "acos": 30.0, "exp": 15.0}
DEAR |= {"log": 15.0, "pow": 40.0, "div": 4.0, "sqrt": 4.0, "tanh": 20.0}
CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call")
REDUCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_and": lax.bitwise_and,
}
SHARED = 8.0  # a result used more than once is kept if it costs more than this
LARGEST = 300.0  # a result is kept if it costs more than this in any case

Var = Any  # jax.extend.core.Var
Atom = Any  # Var or Literal


@dataclasses.dataclass(frozen=True, eq=False)
class _Equation:
    """A primitive on values of one flight."""

    primitive: Any
    params: dict[str, Any]
    inputs: tuple[Atom, ...]
    outputs: tuple[Var, ...]

    @property
    def name(self) -> str:
        return str(self.primitive.name)

    @property
    def free(self) -> bool:
        return self.name in FREE


class AllFlights:
    """A step of one flight, done for many at once, every array with the flights last.

    Parameters
    ----------
    step : callable
        ``step(state, inputs, common) -> (state, output)``, of pytrees of arrays of one flight; traced once. What
        decides nothing that comes out is left out.
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
        self.equations: list[_Equation] = []
        self.outputs = self._inlined(closed, self.inputs)
        self.batched = set(self.inputs[:flown])
        self.common: set[Var] = set(self.inputs[flown:])
        self.preparations: list[_Equation] = []
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
            known.update(zip(equation.outputs, _bound(equation, known, self.constants), strict=True))
        for inputs, equations, outputs in self.stages:
            run = _stage(inputs, equations, outputs, self, flights)
            known.update(zip(outputs, run(*[known[var] for var in inputs]), strict=True))
        return [self._output(atom, known, flights) for atom in self.outputs]

    def _output(self, atom: Atom, known: dict[Var, Any], flights: int) -> Any:
        if not isinstance(atom, core.Literal) and atom in self.batched:
            return known[atom]
        value = jnp.asarray(_value(atom, known, self.constants), atom.aval.dtype)
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
                    _Equation(equation.primitive, equation.params, inputs, tuple(equation.outvars))
                )
        return [name(atom) for atom in jaxpr.outvars]

    def _fold(self) -> None:
        """Compute what does not depend on the flight."""
        remaining: list[_Equation] = []
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
                    found = _bound(equation, {}, self.constants)
                self.constants.update(zip(equation.outputs, map(np.asarray, found), strict=True))
        self.equations = remaining

    def _forget(self, carried: int, shown: Sequence[int]) -> None:
        """Leave out what decides no output, now or in a later step: of the state, it stays as it was."""
        wanted = {*shown, *range(carried, len(self.outputs))}
        while True:
            needed = {self.outputs[i] for i in wanted if not isinstance(self.outputs[i], core.Literal)}
            kept: list[_Equation] = []
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

    def _staged(self) -> list[tuple[list[Var], list[_Equation], list[Var]]]:
        """Inputs, equations and outputs of each stage."""
        stage_of = self._stage_numbers()
        last = {atom for atom in self.outputs if not isinstance(atom, core.Literal) and atom in self.batched}
        count = 1 + max(stage_of.values(), default=0)
        members: list[list[_Equation]] = [[] for _ in range(count)]
        for equation in self.equations:
            members[stage_of[equation]].append(equation)
        taken = [self._closure(equations) for equations in members]
        stages: list[tuple[list[Var], list[_Equation], list[Var]]] = []
        for number, (equations, inputs) in enumerate(taken):
            made = {var for equation in equations for var in equation.outputs}
            later = {var for _, wanted in taken[number + 1 :] for var in wanted} | last
            here = {var for var in made if var in later and stage_of[self.maker[var]] == number}
            stages.append((inputs, equations, [var for e in equations for var in e.outputs if var in here]))
        return stages

    def _closure(self, members: Sequence[_Equation]) -> tuple[list[_Equation], list[Var]]:
        """The equations of a stage with the cheap ones they need, and what has to come from outside.

        What costs little is done again where it is used.
        """
        included: dict[_Equation, None] = {}
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

        def include(equation: _Equation) -> None:
            for atom in equation.inputs:
                need(atom)
            included[equation] = None

        own = set(members)
        for equation in members:
            include(equation)
        return list(included), list(outside)

    def _stage_numbers(self) -> dict[_Equation, int]:
        """The stage of each equation: after those whose results it needs kept."""
        uses: dict[Var, int] = {}
        for equation in self.equations:
            for atom in set(a for a in equation.inputs if not isinstance(a, core.Literal)):
                uses[atom] = uses.get(atom, 0) + 1
        for atom in self.outputs:
            if not isinstance(atom, core.Literal):
                uses[atom] = uses.get(atom, 0) + 1
        stage: dict[_Equation, int] = {}
        cost, kept = self.cost, self.kept
        for equation in self.equations:
            number, total = 0, 0.0
            for atom in equation.inputs:
                maker = None if isinstance(atom, core.Literal) else self.maker.get(atom)
                if maker is None:
                    continue
                before = stage[maker]
                if cost[atom] > 0.0 and _repeats(equation, atom):
                    kept.add(atom)
                if atom in kept:
                    before += 1
                else:
                    total += cost[atom]
                number = max(number, before)
            stage[equation] = number
            own, times = _cost(equation)
            dear = own + times * total
            for var in equation.outputs:
                cost[var] = dear
                if dear > LARGEST or (dear > SHARED and uses.get(var, 0) > 1):
                    kept.add(var)
        return stage


def _cost(equation: _Equation) -> tuple[float, float]:
    """Cost of one number of the result, and how often each input is computed for it."""
    if equation.free:
        return 0.0, 1.0
    if equation.name == "dot_general":
        (contracted, _), _ = equation.params["dimension_numbers"]
        terms = float(np.prod([equation.inputs[0].aval.shape[axis] for axis in contracted]))
        return 2.0 * terms, terms
    if equation.name in REDUCTIONS:
        terms = float(np.prod([equation.inputs[0].aval.shape[axis] for axis in equation.params["axes"]]))
        return terms, terms
    return DEAR.get(equation.name, 1.0), 1.0


def _repeats(equation: _Equation, atom: Atom) -> bool:
    """Whether each number of an input goes into several of the result."""
    if equation.name in ("concatenate", "stack"):
        return False
    if equation.name == "dot_general":
        return True
    return _size(equation.outputs[0]) > _size(atom)


def _size(atom: Atom) -> int:
    return int(np.prod(atom.aval.shape, initial=1))


def _fresh(called: Any) -> Any:
    """A closed jaxpr with variables of its own: one that is called twice must not have its names twice."""
    closed = called if hasattr(called, "consts") else core.ClosedJaxpr(called, ())
    again = jax.make_jaxpr(core.jaxpr_as_fun(closed))(
        *[jax.ShapeDtypeStruct(var.aval.shape, var.aval.dtype) for var in closed.jaxpr.invars]
    )
    return again


def _stage(
    inputs: Sequence[Var],
    equations: Sequence[_Equation],
    outputs: Sequence[Var],
    program: _Program,
    flights: int,
) -> Callable[..., list[Any]]:
    """Function of one stage, which the compiler must leave as it is."""

    def run(*values: Any) -> list[Any]:
        known = dict(zip(inputs, values, strict=True))
        for equation in equations:
            found = _evaluated(equation, known, program, flights)
            known.update(zip(equation.outputs, found, strict=True))
        return [known[var] for var in outputs]

    def kept_apart(*values: Any) -> list[Any]:
        with set_xla_metadata(inlineable="false"):
            return jax.jit(run)(*values)

    return kept_apart


def _value(atom: Atom, known: dict[Var, Any], constants: dict[Var, Any]) -> Any:
    if isinstance(atom, core.Literal):
        return atom.val
    return known[atom] if atom in known else constants[atom]


def _bound(equation: _Equation, known: dict[Var, Any], constants: dict[Var, Any]) -> list[Any]:
    """Outputs of an equation that no flight is in."""
    values = [jnp.asarray(_value(atom, known, constants), atom.aval.dtype) for atom in equation.inputs]
    found = equation.primitive.bind(*values, **equation.params)
    return list(found) if equation.primitive.multiple_results else [found]


def _evaluated(equation: _Equation, known: dict[Var, Any], program: _Program, flights: int) -> list[Any]:
    """Outputs (..., flights) of an equation."""
    values = [_value(atom, known, program.constants) for atom in equation.inputs]
    varies = [not isinstance(atom, core.Literal) and atom in program.batched for atom in equation.inputs]
    name, params = equation.name, equation.params
    shape = (*equation.outputs[0].aval.shape, flights)
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
        return [_reduced(x, params["axes"], REDUCTIONS[name])]
    if name == "dot_general" and params.get("preferred_element_type") in (
        None,
        equation.outputs[0].aval.dtype,
    ):
        return [_contracted(values, varies, params["dimension_numbers"], shape)]
    if name in ELEMENTWISE:
        parts = [_aligned(v, b, shape) for v, b in zip(values, varies, strict=True)]
        if name == "integer_pow" and params["y"] == 2:
            return [parts[0] * parts[0]]
        return [equation.primitive.bind(*parts, **params)]
    over = jax.vmap(
        lambda *a: equation.primitive.bind(*a, **params),
        in_axes=[-1 if b else None for b in varies],
        out_axes=-1,
    )
    found = over(*values)
    return list(found) if equation.primitive.multiple_results else [found]


ELEMENTWISE = frozenset(
    [
        "mul",
        "add",
        "add_any",
        "sub",
        "div",
        "rem",
        "neg",
        "max",
        "min",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sinh",
        "cosh",
        "tanh",
        "exp",
        "exp2",
        "expm1",
        "log",
        "log1p",
        "pow",
        "sqrt",
        "rsqrt",
        "cbrt",
        "abs",
        "sign",
        "floor",
        "ceil",
        "round",
        "and",
        "or",
        "not",
        "xor",
        "gt",
        "lt",
        "ge",
        "le",
        "eq",
        "ne",
        "is_finite",
        "select_n",
        "convert_element_type",
        "integer_pow",
        "square",
        "clamp",
        "erf",
        "erfc",
        "logistic",
        "nextafter",
        "copy",
        "stop_gradient",
    ]
)


def _aligned(value: Any, varies: bool, shape: tuple[int, ...]) -> Any:
    """An operand of an elementwise primitive in the shape of its result."""
    array = value if varies else jnp.asarray(value)[..., None]
    return jnp.broadcast_to(array.reshape((1,) * (len(shape) - array.ndim) + array.shape), shape)


def _over_flights(value: Any, varies: bool, flights: int) -> Any:
    array = value if varies else jnp.asarray(value)[..., None]
    return jnp.broadcast_to(array, (*array.shape[:-1], flights))


def _reduced(x: Any, axes: Sequence[int], operation: Callable[[Any, Any], Any]) -> Any:
    """Reduce small axes, the sum written out."""
    kept = [axis for axis in range(x.ndim) if axis not in axes]
    terms = lax.transpose(x, (*axes, *kept)).reshape(-1, *(x.shape[axis] for axis in kept))
    total = terms[0]
    for index in range(1, terms.shape[0]):
        total = operation(total, terms[index])
    return total


def _contracted(
    values: Sequence[Any], varies: Sequence[bool], dimension_numbers: Any, shape: tuple[int, ...]
) -> Any:
    """Product of two small arrays, the sum written out; terms whose constant is zero are left out."""
    (ca, cb), (ba, bb) = dimension_numbers
    sides: list[Any] = []
    for value, batched, contracted, together, before, after in (
        (values[0], varies[0], ca, ba, False, True),
        (values[1], varies[1], cb, bb, True, False),
    ):
        array = value if batched or isinstance(value, jax.Array) else np.asarray(value)
        array = array if batched else array[..., None]
        ndim = array.ndim - 1
        free = [axis for axis in range(ndim) if axis not in contracted and axis not in together]
        ordered = array.transpose((*contracted, *together, *free, ndim))
        sizes = [array.shape[axis] for axis in free]
        other = values[1 if after else 0]
        others = np.ndim(other) - int(varies[1 if after else 0]) - len(contracted) - len(together)
        terms = int(np.prod([array.shape[axis] for axis in contracted]))
        batch = [array.shape[axis] for axis in together]
        padded = ([1] * others + sizes) if before else (sizes + [1] * others)
        sides.append(ordered.reshape(terms, *batch, *padded, array.shape[-1]))
    a, b = sides
    total: Any = None
    for index in range(a.shape[0]):
        if any(isinstance(side, np.ndarray) and not side[index].any() for side in (a, b)):
            continue
        term = a[index] * b[index]
        total = term if total is None else total + term
    if total is None:
        total = jnp.zeros((), jnp.result_type(*values))
    return jnp.broadcast_to(total, shape)
