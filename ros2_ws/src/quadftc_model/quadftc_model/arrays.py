"""What laws need of an array library: NumPy, or JAX, which traces them for batches and for C.

Functions take their library from their arguments; a Python number is NumPy's.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
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

OF_NUMPY: frozenset[type] = frozenset({np.ndarray, np.float64, np.bool_, float, int, bool})  # the usual ones


def namespace(*arrays: Array) -> Any:
    """Return the module with the functions (``sin``, ``where``...) for arrays and numbers."""
    if OF_NUMPY.issuperset(map(type, arrays)):
        return np
    for array in arrays:
        if not isinstance(array, (np.ndarray, np.generic)) and hasattr(array, "__array_namespace__"):
            return array.__array_namespace__()
    return np


def components(vector: Components) -> tuple[Array, ...]:
    """Return the components along the last axis, (..., n) -> n times (...)."""
    return tuple(vector[..., index] for index in range(vector.shape[-1]))


def stacked(parts: Sequence[Scalar]) -> Components:
    """Join components along a new last axis, the inverse of :func:`components`."""
    xp = namespace(*parts)
    if xp is np and not any(map(np.ndim, parts)):
        return np.array(parts)  # ten times as fast as stack
    if len({np.shape(part) for part in parts}) > 1:
        parts = xp.broadcast_arrays(*parts)
    return xp.stack(parts, axis=-1)


def column(x: Array) -> Array:
    """Give an array (...) an axis of length 1 at its end."""
    return namespace(x).asarray(x)[..., None]


def norm(vector: Components) -> Column:
    """Euclidean norm over the last axis, (..., n) -> (..., 1); its derivative at zero is 0, not NaN."""
    xp = namespace(vector)
    square = (vector * vector).sum(axis=-1, keepdims=True)
    zero = square == 0.0
    return xp.where(zero, 0.0, xp.sqrt(xp.where(zero, 1.0, square)))


def length(vector: Components) -> Scalar:
    """Euclidean norm over the last axis as :func:`norm`, (..., n) -> (...)."""
    return norm(vector)[..., 0]


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product a x b (..., 3)."""
    (ax, ay, az), (bx, by, bz) = components(a), components(b)
    return stacked([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def largest(vector: Components) -> Scalar:
    """Largest component along the last axis, (..., n) -> (...)."""
    return functools.reduce(larger, components(vector))


def whole_nanoseconds(time: Scalar) -> Scalar:
    """Round a time [s] to the nanosecond: 2.996 + 0.002 + 0.002 is 3, in whatever order it is added."""
    return namespace(time).rint(time * 1e9) / 1e9


def product(a: Array, b: Array, terms: Sequence[int] | None = None) -> Array:
    """Matrix product a @ b, (..., n, k) and (..., k, m); over the inner indices ``terms`` alone if given."""
    if terms is None:
        return a @ b
    return functools.reduce(lambda x, y: x + y, [a[..., :, k, None] * b[..., k, None, :] for k in terms])


def diagonal(matrix: Array) -> Components:
    """Diagonal of square matrices, (..., n, n) -> (..., n)."""
    n = matrix.shape[-1]
    return matrix.reshape(*matrix.shape[:-2], n * n)[..., :: n + 1]


def solve_positive(A: Array, B: Array) -> Array:
    """X of A X = B, A (..., n, n) symmetric and positive definite, B (..., n, m): elimination, no pivots."""
    xp, n = namespace(A, B), A.shape[-1]
    rows: list[Array] = [xp.concatenate([A[..., row, :], B[..., row, :]], axis=-1) for row in range(n)]
    for row in range(n):
        unit = rows[row] / rows[row][..., row : row + 1]
        rows = [unit if k == row else each - each[..., row : row + 1] * unit for k, each in enumerate(rows)]
    return xp.stack(rows, axis=-2)[..., n:]


def sqrt(x: Array) -> Array:
    """Square root."""
    return namespace(x).sqrt(x)


def exp(x: Array) -> Array:
    """Exponential."""
    return namespace(x).exp(x)


def log(x: Array) -> Array:
    """Natural logarithm."""
    return namespace(x).log(x)


def sin(x: Array) -> Array:
    """Sine of an angle [rad]."""
    return namespace(x).sin(x)


def cos(x: Array) -> Array:
    """Cosine of an angle [rad]."""
    return namespace(x).cos(x)


def tan(x: Array) -> Array:
    """Tangent of an angle [rad]."""
    return namespace(x).tan(x)


def arctan2(y: Array, x: Array) -> Array:
    """Angle [rad] of the direction (x, y)."""
    return namespace(y, x).arctan2(y, x)


def arcsin(x: Array) -> Array:
    """Angle [rad] within pi/2 of zero whose sine is x."""
    return namespace(x).arcsin(x)


def larger(x: Scalar, y: Scalar) -> Array:
    """Return the larger of two; NaN if one is."""
    return namespace(x, y).maximum(x, y)


def smaller(x: Scalar, y: Scalar) -> Array:
    """Return the smaller of two; NaN if one is."""
    return namespace(x, y).minimum(x, y)


def clip(x: Array, low: Scalar, high: Scalar) -> Array:
    """Hold ``x`` within two bounds."""
    return smaller(larger(x, low), high)


def where(flag: Array, x: Array, y: Array) -> Array:
    """Return ``x`` where a flag holds and ``y`` elsewhere."""
    return namespace(flag, x, y).where(flag, x, y)


def any_of(mask: Array) -> Array:
    """Whether any is true over the last axis, kept as an axis of length 1: (..., n) bool -> (..., 1) bool."""
    return mask.any(axis=-1, keepdims=True)


def alike(tree: object, parts: Iterable[object]) -> Any:
    """Return a tuple of the kind of another, a NamedTuple perhaps, with parts of its own."""
    kind: Any = type(tree)
    return kind(*parts) if hasattr(kind, "_fields") else kind(parts)


def chosen(flag: Flag, new: T, old: T) -> T:
    """Arrays of ``new`` where a flag (...) holds, of ``old`` elsewhere; both are nested tuples alike."""
    if isinstance(new, tuple):
        parts, others = cast("tuple[object, ...]", new), cast("tuple[object, ...]", old)
        return alike(parts, [chosen(flag, a, b) for a, b in zip(parts, others, strict=True)])
    if new is None:
        return cast("T", None)
    xp = namespace(flag, new, old)
    one, other, given = xp.asarray(new), xp.asarray(old), xp.asarray(flag)
    return xp.where(given.reshape(given.shape + (1,) * (one.ndim - given.ndim)), one, other)


def at_largest(part: Array) -> Array:
    """Return 1 where an array (..., n) is largest along its last axis; where several are, their share."""
    best = 1.0 * (part == part.max(axis=-1, keepdims=True))
    return best / best.sum(axis=-1, keepdims=True)


def branch(flag: Flag, then: Callable[[], T], otherwise: Callable[[], T]) -> T:
    """Return ``then()`` where a flag (...) holds and ``otherwise()`` elsewhere, nested tuples alike.

    For one vehicle only the one that is wanted is computed, in NumPy as in C; for many, both are. Meant for
    what is dear and seldom; `where` is quicker for a few operations.
    """
    xp = namespace(flag)
    if xp.asarray(flag).ndim:
        return chosen(flag, then(), otherwise())
    if xp is np:
        return then() if flag else otherwise()
    import jax  # an array of JAX says that it is there

    lax: Any = jax.lax
    return lax.cond(flag, then, otherwise)


def finite(part: Any, batch: int = 0) -> Flag:
    """Whether all floats of nested tuples of arrays are finite, for each of ``batch`` leading axes."""
    if isinstance(part, tuple):
        parts = [finite(each, batch) for each in cast("tuple[object, ...]", part)]
        return functools.reduce(lambda a, b: a & b, parts, np.True_)
    xp = namespace(part)
    if part is None or xp.asarray(part).dtype.kind != "f":
        return np.True_
    return xp.isfinite(part).all(axis=tuple(range(batch, np.ndim(part))))


def rows_of(part: T, index: object) -> T:
    """Return the elements at an index of every array of nested tuples; None and single flags stay so."""
    if isinstance(part, tuple):
        parts = cast("tuple[object, ...]", part)
        return alike(parts, [rows_of(each, index) for each in parts])
    rows: Array = part
    return rows if part is None or isinstance(part, (bool, np.bool_)) else rows[index]
