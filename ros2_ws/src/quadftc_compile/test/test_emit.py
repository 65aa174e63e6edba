"""Every operation of the C that is generated: the numbers of JAX, from the same functions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from quadftc_compile.build import BuildError, build_library
from quadftc_compile.recipe import Function, Recipe
from quadftc_compile.runner import Call, numbers_in

jax = pytest.importorskip("jax")
jnp, lax = jax.numpy, jax.lax

RANDOM = np.random.default_rng(5)
A, B = RANDOM.normal(size=(4, 6)), RANDOM.normal(size=(4, 6))
VECTOR = RANDOM.normal(size=3)
ODD = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e300, 2.5])
INDEX = np.array([2, 0, 3])
LARGE = RANDOM.normal(size=(3, 400))  # one that is not copied


@dataclasses.dataclass(frozen=True)
class NoLaw:
    """A law without numbers."""


def _scan(x):
    def body(carry, row):
        return carry * 0.5 + row, jnp.sin(carry) + row[0]

    return lax.scan(body, jnp.zeros(6), x)


def _scan_back(x):
    return lax.scan(lambda carry, row: (carry + row[1], carry), 0.0, x, reverse=True)


def _large_branches(x, flag):
    def more(a):
        size = jnp.sqrt(jnp.abs(a))  # lies where the result goes, and is read before
        return size + size.sum()

    y = lax.cond(flag, more, lambda a: a, x)  # handed on where it is
    z = y * 2.0 - y.sum()
    w = lax.cond(flag, lambda a: jnp.where(a > 0.0, 0.0, a) + y.sum(), lambda a: a, z)  # written over
    v = lax.cond(flag, lambda a: a[::-1], lambda a: a, z + 1.0)  # not to be written over
    return w, w.max(), v, y[0, 0], z.sum()


def _large_joined(x, y):
    joined = jnp.stack([x, jnp.sin(y), x * y, 2.0 * y[::-1]])
    chosen = jnp.where(x[0] > 0.0, joined, 0.0)
    sums = jnp.einsum("pij,j->pi", joined, y[0])
    return chosen - 0.5, chosen[2], sums, joined.sum(axis=0), joined.max(), jnp.cumsum(joined, axis=0)


CASES = {
    "arithmetic": (lambda x, y: (x + y, x - y, x * y, x / y, -x, x**2, x**3, x**-2, x % y), (A, B)),
    "functions": (
        lambda x: (jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.exp(x), jnp.log(jnp.abs(x)), jnp.sqrt(jnp.abs(x))),
        (A,),
    ),
    "inverse functions": (
        lambda x: (jnp.arcsin(0.3 * x), jnp.arctan2(x, x[::-1]), jnp.cbrt(x), jnp.tanh(x), jnp.hypot(x, 2.0)),
        (A,),
    ),
    "odd numbers": (
        lambda x: (
            x + 0.0,
            0.0 * x,
            x - 0.0,
            jnp.maximum(x, 1.0),
            jnp.minimum(1.0, x),
            jnp.abs(x),
            jnp.sign(x),
        ),
        (ODD,),
    ),
    "odd comparisons": (
        lambda x: (x > 0.0, x <= x[::-1], x == x, x != x, jnp.isfinite(x), jnp.where(x > 0, x, -1.0)),
        (ODD,),
    ),
    "rounding": (lambda x: (jnp.rint(2.5 * x), jnp.floor(x), jnp.ceil(x), jnp.clip(x, -0.5, 0.5)), (A,)),
    "logic": (lambda x, y: ((x > 0) & (y > 0), (x > 0) | ~(y > 0), (x > 0) ^ (y > 0)), (A, B)),
    "integers": (
        lambda k: (
            k * 3 - 1,
            k // 2,
            k % 2,
            jnp.maximum(k, 1),
            k.astype(float) / 2,
            (k > 0).astype(jnp.uint8),
        ),
        (np.arange(-4, 5),),
    ),
    "views": (
        lambda x: (
            x.T,
            x[1:3, ::2],
            x[::-1],
            x.reshape(3, 8),
            x.T.reshape(-1),
            x[None, :, None],
            jnp.flip(x),
        ),
        (A,),
    ),
    "views of sums": (
        lambda x, y: ((x + y).T.reshape(3, 8) * 2.0, jnp.tile(x + y, (2, 1)), (x * y)[:, 1]),
        (A, B),
    ),
    "joined": (
        lambda x, y: (jnp.concatenate([x, y, x + y], axis=1), jnp.stack([x, 2 * y], axis=1), jnp.pad(x, 1)),
        (A, B),
    ),
    "joined in a loop": (lambda x, y: (jnp.concatenate([x, y]) * 2.0 + jnp.concatenate([y, x]),), (A, B)),
    "sums": (
        lambda x: (
            x.sum(),
            x.sum(axis=0),
            x.max(axis=1),
            x.min(),
            (x > 0).any(axis=1),
            (x > 0).all(),
            x.prod(axis=0),
        ),
        (RANDOM.normal(size=(9, 20)),),
    ),
    "flags": (
        lambda x: (
            jnp.isfinite(x).all(),
            jnp.isfinite(jnp.where(x == x.max(), jnp.nan, x)).all(),
            (x > x.max()).any(),
            (x >= x.max()).any(),
        ),
        (RANDOM.normal(size=(9, 20)),),
    ),
    "flags of a whole array": (
        lambda x, y, z: tuple(jnp.isfinite(each).all() for each in (1e308 * jnp.sign(x), x, y, z)),
        (LARGE, *(np.append(LARGE.flat[1:], odd).reshape(LARGE.shape) for odd in (np.nan, -np.inf))),
    ),
    "choices": (
        lambda x, f: (jnp.where(f > 0, x, 0.0), jnp.where(f > 0, x[:, :1], -x), (f > 0) & (x > 0), f > 0),
        (RANDOM.normal(size=(9, 20)), RANDOM.normal(size=20)),
    ),
    "small sums": (
        lambda x: (x.sum(), x.sum(axis=0), jnp.cumsum(x, axis=1), jnp.argmax(x, axis=1), x.mean()),
        (A,),
    ),
    "extremes": (lambda x: (jnp.argmax(x), jnp.argmin(x, axis=0), jnp.cumsum(x[::-1], axis=0)), (A,)),
    "products": (
        lambda x, y: (
            x @ y.T,
            y.T @ x,
            x[0] @ y[1],
            jnp.einsum("ij,kj->ik", x, y),
            x @ y[2],
            jnp.outer(x[0], y[0]),
        ),
        (A, B),
    ),
    "larger products": (
        lambda x: (x @ x.T, x.T @ x, jnp.einsum("ij,jk->ik", x, x.T)),
        (RANDOM.normal(size=(12, 20)),),
    ),
    "products of a batch": (
        lambda x, y: (x @ y, jnp.einsum("bij,bj->bi", x, y[..., 0])),
        (RANDOM.normal(size=(7, 3, 3)), RANDOM.normal(size=(7, 3, 2))),
    ),
    "gather": (lambda x, k: (x[k], jnp.take(x, k, axis=1), x[:, k[0]], x[(1, 3), :]), (A, INDEX)),
    "gather along": (lambda x: (jnp.take_along_axis(x, jnp.argmax(x, axis=1)[:, None], axis=1),), (A,)),
    "rows that are known": (
        lambda x: (
            x[np.array([2, 0, 0])] + 1.0,
            x[:, np.array([1, 3])] * x[:, ::2],
            jnp.cumsum(2.0 * x, axis=2)[:, np.array([3, 3, 1, 0, 2])].sum(axis=1),
            jnp.concatenate([x, -x])[np.array([0, 5, 3])] - 1.0,
            x[np.array([0, 1, 2])],
        ),
        (RANDOM.normal(size=(3, 4, 100)),),
    ),
    "gather beyond": (lambda x, k: (jnp.take(x, k + 2, axis=0), x.at[k].get(mode="clip")), (A, INDEX)),
    "scatter": (lambda x, k: (x.at[k].set(0.0), x.at[k, 0].add(1.0), x.at[1].set(2.0)), (A, INDEX)),
    "moving slices": (
        lambda x, k: (
            lax.dynamic_slice(x, (k[0], k[1]), (2, 3)),
            lax.dynamic_update_slice(x, x[:1], (k[2], 0)),
            lax.dynamic_index_in_dim(x, k[0]),
        ),
        (A, INDEX),
    ),
    "scan": (_scan, (A,)),
    "scan back": (_scan_back, (A,)),
    "branch": (lambda x: lax.cond(x[0, 0] > 0.0, lambda: (x.T, x.sum()), lambda: (2.0 * x.T, 1.0)), (A,)),
    "other branch": (
        lambda x: lax.cond(x[0, 0] <= 0.0, lambda: (x.T, x.sum()), lambda: (2.0 * x.T, 1.0)),
        (A,),
    ),
    "branches of large arrays": (_large_branches, (LARGE, np.array(True))),
    "other branches of large arrays": (_large_branches, (LARGE, np.array(False))),
    "large arrays joined": (_large_joined, (LARGE, RANDOM.normal(size=LARGE.shape))),
    "switch": (lambda k: (lax.switch(k[0], [lambda: 1.0, lambda: 2.0, lambda: 3.0]),), (INDEX,)),
    "mapped": (
        lambda x, y: (jax.vmap(lambda a, b: jnp.outer(a, b).sum() + jnp.linalg.norm(a))(x, y),),
        (A, B),
    ),
    "mapped branch": (
        lambda x: (jax.vmap(lambda a: lax.cond(a[0] > 0, lambda: a * 2.0, lambda: -a))(x),),
        (A,),
    ),
    "scalars": (lambda x: (x[0] * x[1] + x[2], jnp.float64(3.0) * x[0], x[0] > x[1]), (VECTOR,)),
    "constants": (
        lambda x: (x * np.arange(3.0), jnp.where(x > np.arange(3.0), 1, 0), jnp.arange(3), x),
        (VECTOR,),
    ),
    "empty": (lambda x: (x[:0], x[:0].sum(), jnp.concatenate([x[:0], x])), (VECTOR,)),
}


def compiled(call, arguments, name="function"):
    """Compile a function of arrays and call it once."""
    names = [f"x{k}" for k in range(len(arguments))]
    count = len(call(*map(jnp.asarray, arguments)))
    results = tuple(f"y{k}" for k in range(count))
    function = Function(lambda law, *given: call(*given), dict(zip(names, arguments, strict=True)), results)
    library = build_library(Recipe(name, NoLaw(), {"call": function}), keep=False)
    once = Call(library.entries["call"], numbers_in(library, NoLaw()), {})
    for write, argument in zip(once.writers.values(), arguments, strict=True):
        write(argument)
    once.bound()()
    return tuple(read() for read in once.readers.values())


@pytest.mark.parametrize("name", CASES)
def test_generated_c_gives_the_numbers_of_jax(name):
    call, arguments = CASES[name]
    with jax.enable_x64(True):
        wanted = [np.asarray(each) for each in call(*map(jnp.asarray, arguments))]
        found = compiled(call, arguments)
    for one, other in zip(wanted, found, strict=True):
        assert one.shape == np.shape(other)
        assert one.dtype == np.asarray(other).dtype
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-14)
        if one.dtype.kind == "f":
            zero = one == 0.0
            np.testing.assert_array_equal(
                np.signbit(other)[zero] if np.ndim(other) else other == 0,
                np.signbit(one)[zero] if one.ndim else one == 0,
            )


def test_generated_c_keeps_denormal_numbers_as_numpy_does():
    small = np.array([1e-310, -1e-310, 5e-324])  # JAX takes them for zero on some processors
    with jax.enable_x64(True):
        found = compiled(lambda x: (x * 0.5, x + x, x > 0.0, 1.0 * x), (small,))
    for one, other in zip((small * 0.5, small + small, small > 0.0, small), found, strict=True):
        np.testing.assert_array_equal(other, one)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda x: (jnp.linalg.cholesky(x),), "cholesky"),
        (lambda x: (lax.while_loop(lambda c: c.sum() < 50.0, lambda c: 2.0 * c, x),), "while"),
    ],
)
def test_what_c_does_not_know_is_named_with_its_place(call, name):
    with (
        jax.enable_x64(True),
        pytest.raises(BuildError, match=rf"test_emit.py:\d+ .*: '{name}' of JAX is not known"),
    ):
        compiled(call, (np.eye(3),))
