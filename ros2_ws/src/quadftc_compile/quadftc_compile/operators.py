# pyright: basic
"""Operations that are done number by number, as expressions of C.

`max` and `min` are NaN where an operand is, as NumPy's and JAX's are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from quadftc_compile.graph import Node
from quadftc_compile.layout import C_TYPES
from quadftc_compile.text import Expression, binary, call, choice, literal, unary

SIGNS = {"add": "+", "sub": "-", "mul": "*"}
SIGNS |= {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
FUNCTIONS = {"sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "floor", "ceil", "erf", "erfc"}
FUNCTIONS |= {"sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"}
TWO_ARGUMENTS = {"atan2": "atan2", "pow": "pow", "rem": "fmod", "nextafter": "nextafter"}
BITS = {"and": "&", "or": "|", "xor": "^"}
LOGICAL = {"and": "&&", "or": "||", "xor": "!="}


def operate(node: Node, x: Sequence[Expression], real: str) -> Expression:
    """Return one number of an operation on numbers."""
    op, floating = node.op, node.operands[0].dtype.kind == "f"
    if op in SIGNS:
        return binary(SIGNS[op], *x)
    if op in ("max", "min"):
        return combine(op, node.dtype, *x)
    if op in ("and", "or", "xor", "not"):
        return _logical(op, node.dtype, x)
    if op in FUNCTIONS or (op in TWO_ARGUMENTS and floating):
        return call(f"{TWO_ARGUMENTS.get(op, op)}{_suffix(real)}", *x)
    return _OTHERS[op](node, x, floating, real)


def _suffix(real: str) -> str:
    """Return the end of the names of functions of libm."""
    return "f" if real == "float" else ""


def _divide(_: Node, x: Sequence[Expression], floating: bool, __: str) -> Expression:
    quotient = binary("/", *x)
    return quotient if floating else choice(binary("==", x[1], ZERO), Expression("-1"), quotient)


def _logistic(_: Node, x: Sequence[Expression], __: bool, real: str) -> Expression:
    one = literal(1.0, real)
    return binary("/", one, binary("+", one, call(f"exp{_suffix(real)}", unary("-", x[0]))))


def _round(node: Node, x: Sequence[Expression], _: bool, real: str) -> Expression:
    return call(f"{'rint' if int(node.params['rounding_method']) == 1 else 'round'}{_suffix(real)}", x[0])


def _is_finite(_: Node, x: Sequence[Expression], floating: bool, __: str) -> Expression:
    return binary("!=", call("isfinite", x[0]), ZERO) if floating else Expression("true")


ZERO = Expression("0")
_OTHERS: dict[str, Callable[[Node, Sequence[Expression], bool, str], Expression]] = {
    "div": _divide,
    "neg": lambda node, x, floating, real: unary("-", x[0]),
    "abs": lambda node, x, floating, real: _size("abs", x[0], floating, real),
    "sign": lambda node, x, floating, real: _size("sign", x[0], floating, real),
    "rem": lambda node, x, floating, real: choice(binary("==", x[1], ZERO), x[0], binary("%", *x)),
    "rsqrt": lambda node, x, floating, real: binary(
        "/", literal(1.0, real), call(f"sqrt{_suffix(real)}", x[0])
    ),
    "logistic": _logistic,
    "round": _round,
    "is_finite": _is_finite,
    "select_n": lambda node, x, floating, real: _select(node, x),
    "convert_element_type": lambda node, x, floating, real: _convert(node, x[0], real),
}
ELEMENTWISE = {*SIGNS, *FUNCTIONS, *TWO_ARGUMENTS, *_OTHERS, "max", "min", "and", "or", "xor", "not"}


def combine(op: str, dtype: np.dtype, x: Expression, y: Expression) -> Expression:
    """Return what a reduction makes of two numbers."""
    if op in ("add", "mul"):
        return binary(SIGNS[op], x, y)
    if op in ("max", "min"):
        if dtype.kind == "f":
            return call("larger" if op == "max" else "smaller", x, y)
        return choice(binary(">" if op == "max" else "<", x, y), x, y)
    return _logical(op, dtype, (x, y))


def _size(op: str, x: Expression, floating: bool, real: str) -> Expression:
    """Return size or sign of a number."""
    f, zero = "f" if real == "float" else "", literal(0.0 if floating else 0, real)
    negative = binary("<", x, zero)
    if op == "abs":
        return call(f"fabs{f}", x) if floating else choice(negative, unary("-", x), x)
    one = literal(1.0 if floating else 1, real)
    return choice(binary(">", x, zero), one, choice(negative, unary("-", one), x))


def _logical(op: str, dtype: np.dtype, x: Sequence[Expression]) -> Expression:
    if op == "not":
        return unary("!" if dtype.kind == "b" else "~", x[0])
    if dtype.kind == "b":
        return binary(LOGICAL[op], *x)
    return Expression(f"({x[0].within(0)} {BITS[op]} {x[1].within(0)})")


PLAIN = re.compile(r"-?(?:->|[\w\0\[\].])*")  # a number, a variable, an element of an array


def _select(node: Node, x: Sequence[Expression]) -> Expression:
    """Return the case that a flag or a number selects."""
    which, *cases = x
    if node.operands[0].dtype.kind == "b":
        # what is only read is read at once, so that a loop of it becomes vector instructions
        if node.dtype.kind == "f" and all(PLAIN.fullmatch(each.text) for each in cases):
            return call("either", which, cases[1], cases[0])
        return choice(which, cases[1], cases[0])
    chosen = cases[0]
    for number, case in enumerate(cases[1:], start=1):
        chosen = choice(binary("==", which, Expression(str(number))), case, chosen)
    return chosen


def _convert(node: Node, x: Expression, real: str) -> Expression:
    before, after = node.operands[0].dtype, node.dtype
    if after.kind == "b":
        return binary("!=", x, Expression("0"))
    if after.kind == "f":
        return x if before.kind == "f" else unary(f"({real})", x)
    kind = C_TYPES[after.str[1:]]
    return unary(f"({kind})", call("whole", x) if before.kind == "f" else x)
