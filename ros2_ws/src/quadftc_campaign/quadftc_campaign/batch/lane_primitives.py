# pyright: basic
"""Each primitive on arrays with the flights last; sums over the small axes of one flight are written out."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core

from quadftc_campaign.batch.stages import Equation, Var, value_of

REDUCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_and": lax.bitwise_and,
}


def evaluate(equation: Equation, known: dict[Var, Any], batched: set[Var], flights: int) -> list[Any]:
    """Compute the outputs (..., flights) of an equation.

    Of the ``known`` values, those that are ``batched`` are (..., flights), others as for one flight.
    """
    values = [value_of(atom, known) for atom in equation.inputs]
    varies = [not isinstance(atom, core.Literal) and atom in batched for atom in equation.inputs]
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
        return [_reduce(x, params["axes"], REDUCTIONS[name])]
    if name == "dot_general":
        total = _contract(values, varies, *params["dimension_numbers"])
        return [jnp.broadcast_to(total, shape).astype(equation.outputs[0].aval.dtype)]
    over = jax.vmap(
        lambda *arguments: equation.primitive.bind(*arguments, **params),
        in_axes=[-1 if each else None for each in varies],
        out_axes=-1,
    )
    outputs = over(*values)
    return list(outputs) if equation.primitive.multiple_results else [outputs]


def _over_flights(value: Any, varies: bool, flights: int) -> Any:
    array = value if varies else jnp.asarray(value)[..., None]
    return jnp.broadcast_to(array, (*array.shape[:-1], flights))


def _reduce(x: Any, axes: Sequence[int], operation: Callable[[Any, Any], Any]) -> Any:
    """Reduce small axes, the sum written out."""
    kept = [axis for axis in range(x.ndim) if axis not in axes]
    terms = lax.transpose(x, (*axes, *kept)).reshape(-1, *(x.shape[axis] for axis in kept))
    return functools.reduce(operation, [terms[index] for index in range(terms.shape[0])])


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
        sides.append(array.reshape(-1, *array.shape[len(inner) :]))
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
