# pyright: basic
"""Operations that are done number by number, as expressions of C.

`max` and `min` are NaN where an operand is, as NumPy's and JAX's are; sums and products are done as they stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from quadftc_compile.graph import Node
from quadftc_compile.layout import C_TYPES
from quadftc_compile.text import Expression, binary, call, choice, literal, unary

SIGNS = {"add": "+", "sub": "-", "mul": "*", "eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
FUNCTIONS = ("sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan")
FUNCTIONS += ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "floor", "ceil", "erf", "erfc")
TWO_ARGUMENTS = {"atan2": "atan2", "pow": "pow", "rem": "fmod", "nextafter": "nextafter"}
OTHERS = ("div", "max", "min", "neg", "abs", "sign", "and", "or", "xor", "not", "select_n", "convert_element_type")
OTHERS += ("is_finite", "round", "rsqrt", "logistic")
ELEMENTWISE = {*SIGNS, *FUNCTIONS, *TWO_ARGUMENTS, *OTHERS}
LOGICAL = {"and": "&&", "or": "||", "xor": "!="}
BITS = {"and": "&", "or": "|", "xor": "^"}


def operate(node: Node, x: Sequence[Expression], real: str) -> Expression:
    """Return one number of an operation on numbers."""
    op, floating = node.op, node.operands[0].dtype.kind == "f"
    f = "f" if real == "float" else ""
    if op in SIGNS:
        return binary(SIGNS[op], *x)
    if op == "div":
        quotient = binary("/", *x)
        return quotient if floating else choice(binary("==", x[1], Expression("0")), Expression("-1"), quotient)
    if op in ("max", "min"):
        return combine(op, node.dtype, *x)
    if op == "neg":
        return unary("-", x[0])
    if op in ("abs", "sign"):
        return _size(op, x[0], floating, real)
    if op in FUNCTIONS:
        return call(f"{op}{f}", x[0])
    if op in TWO_ARGUMENTS and floating:
        return call(f"{TWO_ARGUMENTS[op]}{f}", *x)
    if op == "rem":
        return choice(binary("==", x[1], Expression("0")), x[0], binary("%", *x))
    if op == "rsqrt":
        return binary("/", literal(1.0, real), call(f"sqrt{f}", x[0]))
    if op == "logistic":
        one = literal(1.0, real)
        return binary("/", one, binary("+", one, call(f"exp{f}", unary("-", x[0]))))
    if op == "round":
        return call(f"{'rint' if int(node.params['rounding_method']) == 1 else 'round'}{f}", x[0])
    if op == "is_finite":
        return binary("!=", call("isfinite", x[0]), Expression("0")) if floating else Expression("true")
    if op in ("and", "or", "xor", "not"):
        return _logical(op, node.dtype, x)
    return _select(node, x) if op == "select_n" else _convert(node, x[0], real)


def combine(op: str, dtype: Any, x: Expression, y: Expression) -> Expression:
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


def _logical(op: str, dtype: Any, x: Sequence[Expression]) -> Expression:
    if op == "not":
        return unary("!" if dtype.kind == "b" else "~", x[0])
    if dtype.kind == "b":
        return binary(LOGICAL[op], *x)
    return Expression(f"({x[0].within(0)} {BITS[op]} {x[1].within(0)})")


def _select(node: Node, x: Sequence[Expression]) -> Expression:
    """Return the case that a flag or a number selects."""
    which, *cases = x
    if node.operands[0].dtype.kind == "b":
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
