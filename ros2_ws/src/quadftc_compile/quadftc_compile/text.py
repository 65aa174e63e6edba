"""Expressions of C as texts: parentheses where they are needed, literals, indices."""

from __future__ import annotations

import collections
import dataclasses
import math
from collections.abc import Sequence
from typing import cast

import numpy as np

# how tightly an expression holds together; operands that hold less tightly get parentheses
ATOM, UNARY, TIMES, PLUS, COMPARE, EQUAL, AND, OR, CHOICE = range(9)
BINARY = {
    **dict.fromkeys(("*", "/", "%"), TIMES),
    **dict.fromkeys(("+", "-"), PLUS),
    **dict.fromkeys(("<", "<=", ">", ">="), COMPARE),
    **dict.fromkeys(("==", "!="), EQUAL),
    "&&": AND,
    "||": OR,
}


@dataclasses.dataclass(frozen=True)
class Expression:
    """A text, and how tightly it holds together."""

    text: str
    level: int = ATOM

    def within(self, level: int) -> str:
        """Return it as an operand of what holds together at a level."""
        return self.text if self.level <= level else f"({self.text})"


def call(name: str, *arguments: Expression) -> Expression:
    """Return the call of a function."""
    return Expression(f"{name}({', '.join(each.text for each in arguments)})")


def binary(sign: str, x: Expression, y: Expression) -> Expression:
    """Return x sign y, computed as it stands: (x + y) + z and x + (y + z) differ."""
    level = BINARY[sign]
    if level in (TIMES, PLUS):
        return Expression(f"{x.within(level)} {sign} {y.within(level - 1)}", level)
    operands = PLUS if level <= EQUAL else COMPARE  # compilers warn of && within || without parentheses
    same = level if level >= AND else operands
    left = x.text if x.level == same else x.within(operands)
    return Expression(f"{left} {sign} {y.within(operands)}", level)


def unary(sign: str, x: Expression) -> Expression:
    """Return - x, ! x or a cast of x."""
    text = x.within(UNARY)
    return Expression(f"{sign}{f'({text})' if text.startswith(sign) else text}", UNARY)


def choice(flag: Expression, x: Expression, y: Expression) -> Expression:
    """Return flag ? x : y."""
    return Expression(f"{flag.within(OR)} ? {x.within(OR)} : {y.within(CHOICE)}", CHOICE)


def literal(value: float | np.number | np.bool_, real: str) -> Expression:
    """Return a number; floats are of the type ``real``, "double" or "float"."""
    if isinstance(value, (bool, np.bool_)):
        return Expression("true" if value else "false")
    if isinstance(value, (int, np.integer)):
        whole = int(cast("int", value))
        text = str(whole) if abs(whole) < 2**31 else f"INT64_C({whole})"
        return Expression(text, UNARY if whole < 0 else ATOM)
    with np.errstate(over="ignore"):
        number = np.float32(value) if real == "float" else np.float64(value)
    if math.isnan(number):
        return Expression("NAN")
    if math.isinf(number):
        return Expression("INFINITY") if number > 0 else Expression("-INFINITY", UNARY)
    text = str(number)
    if not any(letter in text for letter in ".e"):
        text += ".0"
    return Expression(text + ("f" if real == "float" else ""), UNARY if text.startswith("-") else ATOM)


@dataclasses.dataclass(frozen=True)
class Index:
    """A whole number that is linear in loop variables: ``constant + sum(factor * variable)``."""

    constant: int = 0
    terms: tuple[tuple[str, int], ...] = ()  # by variable

    def __add__(self, other: Index | int) -> Index:
        if isinstance(other, int):
            return Index(self.constant + other, self.terms)
        total = collections.Counter(dict(self.terms))
        for name, factor in other.terms:
            total[name] += factor
        terms = tuple((name, factor) for name, factor in total.items() if factor)
        return Index(self.constant + other.constant, terms)

    def __mul__(self, factor: int) -> Index:
        if factor == 0:
            return Index()
        return Index(self.constant * factor, tuple((name, factor * each) for name, each in self.terms))

    def factor_of(self, variable: str) -> int:
        """How far it moves by a step of a variable."""
        return dict(self.terms).get(variable, 0)

    def without(self, variable: str) -> Index:
        """Return it without a variable."""
        return Index(self.constant, tuple(each for each in self.terms if each[0] != variable))

    def __str__(self) -> str:
        parts = [name if factor == 1 else f"{factor} * {name}" for name, factor in self.terms]
        if self.constant or not parts:
            parts.append(str(self.constant))
        return " + ".join(parts).replace("+ -", "- ")


Indices = Sequence[Index]


def variable(name: str) -> Index:
    """Return the index that is a loop variable."""
    return Index(0, ((name, 1),))


def placed(at: Indices, axis: int, place: Index) -> list[Index]:
    """Return indices with another one along an axis."""
    return [place if k == axis else index for k, index in enumerate(at)]


def flat(shape: Sequence[int], at: Indices) -> Index:
    """Return where an element lies among all of an array."""
    place, step = Index(), 1
    for n, index in zip(reversed(shape), reversed(at), strict=True):
        place = place + (index * step if n != 1 else Index())
        step *= n
    return place
