# pyright: basic
"""Each primitive on arrays with the flights last; sums over the small axes of one flight are written out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core

from quadftc_campaign.batch.equations import Equation, Var, value_of

OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_and": lax.bitwise_and,
}
ELEMENTWISE = frozenset(
    [
        *("mul", "add", "add_any", "sub", "div", "rem", "neg", "max", "min", "abs", "sign", "clamp"),
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "sqrt", "rsqrt"),
        *("exp", "exp2", "expm1", "log", "log1p", "pow", "integer_pow", "square", "cbrt", "erf", "erfc"),
        *("floor", "ceil", "round", "and", "or", "not", "xor", "gt", "lt", "ge", "le", "eq", "ne"),
        *("is_finite", "select_n", "convert_element_type", "copy", "logistic", "nextafter", "stop_gradient"),
    ]
)


def evaluated(
    equation: Equation, known: dict[Var, Any], constants: dict[Var, Any], batched: set[Var], flights: int
) -> list[Any]:
    """Outputs (..., flights) of an equation.

    Parameters
    ----------
    equation : Equation
    known : dict
        Values of variables: those that are ``batched`` (..., flights), others as for one flight.
    constants : dict
        Values that are the same in all flights and steps.
    batched : set
    flights : int
    """
    values = [value_of(atom, known, constants) for atom in equation.inputs]
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
    if name in OPERATIONS:
        return [_reduced(x, params["axes"], OPERATIONS[name])]
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
