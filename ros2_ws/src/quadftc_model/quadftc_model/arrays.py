"""The array namespace of an array: NumPy on board, JAX in batches, the same law in both."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

T = TypeVar("T")
Array = Any  # of any array library and shape; prefer the types with a shape

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8
else:  # importing jaxtyping would cost every node its start-up time

    class Float:
        """An array with a shape, which only a type checker reads."""

        def __class_getitem__(cls, _: object) -> Any:
            return Any

    Bool = UInt8 = Float

# Shapes for signatures. A type checker takes every array for NumPy's; arrays of JAX come in the same places.
AnyArray = np.ndarray[Any, np.dtype[Any]]
Scalar = Float[AnyArray, "*batch"] | float
Column = Float[AnyArray, "*batch 1"]
Vector = Float[AnyArray, "*batch 3"]
Quaternion = Float[AnyArray, "*batch 4"]  # x, y, z, w
Components = Float[AnyArray, "*batch n"]
Flag = Bool[Any, "*batch"]  # np.bool_ for one vehicle, which NumPy does not type as an array
Mask = Bool[AnyArray, "*batch 3"]
States = UInt8[AnyArray, "*batch 3"]


def namespace(array: Array) -> Any:
    """Return the module with the functions (``sin``, ``where``...) for an array; NumPy for a sequence."""
    if isinstance(array, np.ndarray):
        return np
    query = getattr(array, "__array_namespace__", None)
    return np if query is None else query()


def is_single(vector: Array) -> bool:
    """Whether it is one NumPy vector (n,), for which Python floats are many times faster than arrays."""
    return type(vector) is np.ndarray and vector.ndim == 1  # pyright: ignore[reportUnknownMemberType]


def components(vector: Components) -> Any:
    """Return the components along the last axis, (..., n) -> n times (...).

    Those of a single NumPy vector are Python floats: the same numbers, and many times faster.
    """
    if type(vector) is np.ndarray and vector.ndim == 1:  # as `is_single`, without the call
        return vector.tolist()
    return tuple(vector[..., index] for index in range(vector.shape[-1]))  # pyright: ignore


def stacked(parts: Sequence[Scalar]) -> Components:
    """Join components along a new last axis, the inverse of :func:`components`."""
    if isinstance(parts[0], (float, bool)):
        return np.array(parts)
    return namespace(parts[0]).stack(parts, axis=-1)


def split(*parts: Components) -> list[tuple[Any, ...]]:
    """Return the numbers of each axis of arrays (n,) of one NumPy vehicle: (n,), (n,) -> n times two numbers.

    A function of one axis is called on each: on Python numbers arithmetic is many times faster than on small
    arrays. Arrays of many vehicles are not split, as the function takes all axes at once. `join` puts
    results together.
    """
    if type(parts[0]) is np.ndarray and parts[0].ndim == 1:  # as `is_single`, without the call
        return [*zip(*[part.tolist() for part in parts], strict=True)]
    return [parts]


def join(axes: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Join what was found on each axis to arrays: the inverse of :func:`split`."""
    return axes[0] if len(axes) == 1 else tuple(map(np.array, zip(*axes, strict=True)))


def root(x: Array) -> Array:
    """Square root of an array or a float."""
    return math.sqrt(x) if isinstance(x, float) else namespace(x).sqrt(x)


def largest(vector: Components) -> Any:
    """Largest component along the last axis, (..., n) -> (...)."""
    return max(vector.tolist()) if is_single(vector) else functools.reduce(larger, components(vector))


def norm(vector: Components) -> Column:
    """Euclidean norm over the last axis, (..., n) -> (..., 1); its derivative at zero is 0, not NaN."""
    if is_single(vector):
        return np.array([math.sqrt(sum([x * x for x in vector.tolist()]))])
    xp = namespace(vector)
    square = xp.sum(vector * vector, axis=-1, keepdims=True)
    if xp is np:
        return np.sqrt(square)
    zero = square == 0.0
    return xp.where(zero, 0.0, xp.sqrt(xp.where(zero, 1.0, square)))


def length(vector: Components) -> Any:
    """Euclidean norm over the last axis as :func:`norm`, (..., n) -> (...)."""
    return math.hypot(*vector.tolist()) if is_single(vector) else norm(vector)[..., 0]


def whole_nanoseconds(time: Array) -> Array:
    """Round a time [s] to the nanosecond: 2.996 + 0.002 + 0.002 is 3, in whatever order it is added."""
    if isinstance(time, float):
        return round(time * 1e9) / 1e9
    return namespace(time).rint(time * 1e9) / 1e9


def exp(x: Array) -> Array:
    """Exponential of an array or a float."""
    return math.exp(x) if isinstance(x, float) else namespace(x).exp(x)


def log(x: Array) -> Array:
    """Natural logarithm of an array or a float."""
    return math.log(x) if isinstance(x, float) else namespace(x).log(x)


def product(a: Array, b: Array, terms: Sequence[int] | None = None) -> Array:
    """Matrix product a @ b of small matrices, (..., n, k) and (..., k, m).

    Outside NumPy the sum is written out, over the inner indices ``terms`` for which neither is zero: a
    compiler fuses it with what follows, over a whole batch at once, where it would call a routine for every
    pair of matrices.
    """
    if isinstance(a, np.ndarray):
        return a.dot(b) if a.ndim == 2 and b.ndim == 2 else a @ b  # for two matrices, `dot` is quicker
    inner = range(a.shape[-1]) if terms is None else terms
    parts = [a[..., :, k, None] * b[..., k, None, :] for k in inner]
    return sum(parts[1:], parts[0])


def clip(x: Array, low: Scalar, high: Scalar) -> Array:
    """Hold ``x``, an array or a float, within two bounds."""
    if isinstance(x, float):
        return min(max(x, low), high)
    xp = namespace(x)
    return xp.minimum(xp.maximum(x, low), high)


def larger(x: Scalar, y: Scalar) -> Array:
    """Return the larger of two arrays or floats."""
    return max(x, y) if isinstance(x, float) else namespace(x).maximum(x, y)


def smaller(x: Scalar, y: Scalar) -> Array:
    """Return the smaller of two arrays or floats."""
    return min(x, y) if isinstance(x, float) else namespace(x).minimum(x, y)


def column(x: Array) -> Array:
    """Give an array (...) an axis of length 1 at its end; a float or a bool stays as it is."""
    if isinstance(x, (float, bool, np.bool_)):
        return cast("Any", x)
    return x[..., None]


def pick(flag: Array, x: Array, y: Array) -> Array:
    """Return ``x`` where a flag holds and ``y`` elsewhere; all three may be single values."""
    if isinstance(flag, (bool, np.bool_)):
        return x if flag else y
    return namespace(flag).where(flag, x, y)


def any_of(mask: Array) -> Array:
    """Whether any is true over the last axis, kept as an axis of length 1: (..., n) bool -> (..., 1) bool."""
    if is_single(mask):
        return np.array([True in mask.tolist()])
    return mask.any(axis=-1, keepdims=True)


def changed_where(mask: Array | bool, change: Callable[[], T], unchanged: T) -> T:
    """Return ``change()``, which must equal ``unchanged`` if ``mask`` (..., n), or one bool, is false.

    Then NumPy saves the work: most of the time nothing happens. Other libraries, whose masks may have no
    values yet, always do it.
    """
    if type(mask) is np.ndarray and mask.ndim == 1:  # as `is_single`, without the call
        return change() if True in mask.tolist() else unchanged
    if isinstance(mask, (bool, np.bool_)):
        return change() if mask else unchanged
    if isinstance(mask, np.ndarray) and not mask.any():  # pyright: ignore[reportUnknownMemberType]
        return unchanged
    return change()


def chosen(mask: Array, new: Any, old: Any) -> Any:
    """Arrays of ``new`` where a mask (...,) holds, of ``old`` elsewhere; both are nested tuples alike.

    Where ``old`` has fewer arrays (a memory that fills), it is the new one. The mask may be one bool.
    """
    if isinstance(mask, (bool, np.bool_)):
        return new if mask else old
    if isinstance(new, tuple):
        parts, others = cast("tuple[Any, ...]", new), cast("tuple[Any, ...]", old)
        if len(parts) != len(others):
            return parts
        each = [chosen(mask, a, b) for a, b in zip(parts, others, strict=True)]
        kind: Any = type(parts)
        return kind(*each) if hasattr(kind, "_fields") else tuple(each)
    if new is None:
        return None
    if isinstance(new, (bool, float)):
        return pick(mask, new, old)
    return namespace(new).where(mask.reshape(mask.shape + (1,) * (new.ndim - mask.ndim)), new, old)


def rows_of(part: Any, index: Any) -> Any:
    """Return the elements at an index of every array of nested tuples; None and single flags stay so."""
    if isinstance(part, tuple):
        parts = cast("tuple[Any, ...]", part)
        kind: Any = type(parts)
        return kind(*(rows_of(each, index) for each in parts))
    return part if part is None or isinstance(part, bool) else part[index]


def cache_numbers(function: Callable[..., T]) -> Callable[..., T]:
    """Keep the results for arguments that are all floats or texts, of which a flight has few.

    Other arguments, such as parameters that JAX traces, are computed each time.
    """
    cached: Callable[..., T] = functools.lru_cache(maxsize=256)(function)

    @functools.wraps(function)
    def call(*arguments: Any) -> T:
        for each in arguments:
            if not isinstance(each, (float, str)):
                return function(*arguments)
        return cached(*arguments)

    return call
