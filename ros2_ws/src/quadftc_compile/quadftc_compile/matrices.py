# pyright: basic
"""What JAX leaves to LAPACK, in C for small matrices: factors, triangular systems; and sorting."""

from __future__ import annotations

import math
from collections.abc import Sequence

from quadftc_compile.emit import WHOLE, Emitter, Storage, statement
from quadftc_compile.graph import Node, UntraceableError
from quadftc_compile.text import Index, variable

# functions of C by name; {real} is the type of a number, {f} the suffix of its functions
FUNCTIONS = {
    "cholesky_factor": """\
static inline void cholesky_factor(int n, const {real} *a, {real} *l) {{
    for (int i = 0; i < n; i++) {{
        for (int j = 0; j < n; j++) {{
            {real} rest = a[i * n + j];
            for (int k = 0; k < j && j <= i; k++) rest -= l[i * n + k] * l[j * n + k];
            l[i * n + j] = j > i ? 0 : j == i ? sqrt{f}(rest) : rest / l[j * n + j];
        }}
    }}
}}
""",
    "lu_factor": """\
static inline void lu_factor(int n, const {real} *a, {real} *lu, int32_t *pivots, int32_t *order) {{
    for (int k = 0; k < n * n; k++) lu[k] = a[k];
    for (int k = 0; k < n; k++) order[k] = k;
    for (int k = 0; k < n; k++) {{
        int best = k;
        for (int i = k + 1; i < n; i++) {{
            if (fabs{f}(lu[i * n + k]) > fabs{f}(lu[best * n + k])) best = i;
        }}
        pivots[k] = best;
        if (best != k) {{
            for (int j = 0; j < n; j++) {{
                const {real} held = lu[k * n + j];
                lu[k * n + j] = lu[best * n + j];
                lu[best * n + j] = held;
            }}
            const int32_t held = order[k];
            order[k] = order[best];
            order[best] = held;
        }}
        for (int i = k + 1; i < n; i++) {{
            lu[i * n + k] /= lu[k * n + k];
            for (int j = k + 1; j < n; j++) lu[i * n + j] -= lu[i * n + k] * lu[k * n + j];
        }}
    }}
}}
""",
    "solve_triangular": """\
static inline void solve_triangular(int n, int m, const {real} *a, const {real} *b, {real} *x, bool lower,
                                    bool transposed, bool unit) {{
    const bool forward = lower != transposed;
    for (int step = 0; step < n; step++) {{
        const int i = forward ? step : n - 1 - step;
        for (int c = 0; c < m; c++) {{
            {real} rest = b[i * m + c];
            for (int k = 0; k < step; k++) {{
                const int j = forward ? k : n - 1 - k;
                rest -= (transposed ? a[j * n + i] : a[i * n + j]) * x[j * m + c];
            }}
            x[i * m + c] = unit ? rest : rest / a[i * n + i];
        }}
    }}
}}
""",
}


def _each_matrix(emitter: Emitter, shape: Sequence[int], calls: str) -> None:
    """Write a call for each matrix of a batch; ``{}`` in it is the number of the matrix."""
    count = math.prod(shape[:-2])
    if count == 1:
        emitter.line(calls.format(0))
        return
    name = emitter.name("m")
    emitter.open(f"for (int {name} = 0; {name} < {count}; {name}++)")
    emitter.line(calls.format(name))
    emitter.close()


@statement("cholesky", addressed=True)
def write_cholesky(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write the factor L of L L'."""
    (a,), n = node.operands, node.shape[-1]
    emitter.helpers.add("cholesky_factor")
    a_name, size = emitter.storage_of(a).name, n * n
    _each_matrix(
        emitter,
        node.shape,
        f"cholesky_factor({n}, {a_name} + {{0}} * {size}, {storage.name} + {{0}} * {size});",
    )


@statement("triangular_solve", addressed=True)
def write_triangular_solve(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write the solution x of A x = b, A a triangle."""
    a, b = node.operands
    params, (n, m) = node.params, b.shape[-2:]
    if not params["left_side"]:
        raise UntraceableError(f"{node.source or 'it'}: write x A = b as A' x' = b'")
    emitter.helpers.add("solve_triangular")
    flags = [params["lower"], params["transpose_a"], params["unit_diagonal"]]
    words = ", ".join("true" if flag else "false" for flag in flags)
    b_at, a_at = (
        f"{emitter.storage_of(b).name} + {{0}} * {n * m}",
        f"{emitter.storage_of(a).name} + {{0}} * {n * n}",
    )
    calls = f"solve_triangular({n}, {m}, {a_at}, {b_at}, {storage.name} + {{0}} * {n * m}, {words});"
    _each_matrix(emitter, b.shape, calls)


def write_lu(emitter: Emitter, node: Node, results: Sequence[Storage]) -> None:
    """Write the factors of a square matrix, with the rows in the order of their pivots."""
    (a,) = node.operands
    n = a.shape[-1]
    if a.shape[-2] != n or math.prod(a.shape[:-2]) != 1 or n == 1:
        raise UntraceableError(
            f"{node.source or 'it'}: factors are known in C of one square matrix at a time"
        )
    emitter.helpers.add("lu_factor")
    names = ", ".join(each.name for each in (emitter.storage_of(a), *results))
    emitter.line(f"lu_factor({n}, {names});")


def write_sort(emitter: Emitter, node: Node, results: Sequence[Storage]) -> None:
    """Write arrays sorted along an axis by the first of them: insertion, which keeps the order of equals."""
    axis, first = node.params["dimension"], node.operands[0]
    if node.params["num_keys"] != 1:
        raise UntraceableError(f"{node.source or 'it'}: sorting by several keys is not known in C")
    for operand, where in zip(node.operands, results, strict=True):
        emitter.copy(operand, where)
    shape, step = first.shape, math.prod(first.shape[axis + 1 :])
    names = {k: emitter.name("i") for k, n in enumerate(shape) if k != axis and n != 1}
    for k, name in names.items():
        emitter.open(f"for (int {name} = 0; {name} < {shape[k]}; {name}++)")
    base = emitter.place(
        Storage("x"), shape, [variable(names[k]) if k in names else Index() for k in range(len(shape))]
    )
    start = base[2:-1]
    k, j = emitter.name("j"), emitter.name("j")
    emitter.open(f"for (int {k} = 1; {k} < {shape[axis]}; {k}++)")
    key = results[0].name

    def at(place: str) -> str:
        return f"[{start} + {step} * {place}]"

    before = f"({j} - 1)"
    later = f"{key}{at(before)} > {key}{at(j)}"
    if first.dtype.kind == "f":  # what is not a number comes last
        later = f"({later} || ({key}{at(before)} != {key}{at(before)} && {key}{at(j)} == {key}{at(j)}))"
    emitter.open(f"for (int {j} = {k}; {j} > 0 && {later}; {j}--)")
    for operand, where in zip(node.operands, results, strict=True):
        held = emitter.name("h")
        emitter.line(f"const {emitter.type_of(operand.dtype)} {held} = {where.name}{at(j)};")
        emitter.line(f"{where.name}{at(j)} = {where.name}{at(before)};")
        emitter.line(f"{where.name}{at(before)} = {held};")
    for _ in range(2 + len(names)):
        emitter.close()


WHOLE |= {"lu": write_lu, "sort": write_sort}
