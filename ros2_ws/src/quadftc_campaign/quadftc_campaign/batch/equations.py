# pyright: basic
"""The equations of a traced step: primitives on values of one flight, and what they cost."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.extend import core

# Relative cost of one number; what is in neither list counts as 1.
FREE = frozenset(
    [
        *("slice", "squeeze", "reshape", "broadcast_in_dim", "transpose", "expand_dims", "concatenate"),
        *("convert_element_type", "stack", "rev", "copy", "stop_gradient"),
    ]
)
DEAR = {"sin": 20.0, "cos": 20.0, "tan": 30.0, "atan2": 30.0, "asin": 30.0, "acos": 30.0, "exp": 15.0}
DEAR |= {"log": 15.0, "pow": 40.0, "div": 4.0, "sqrt": 4.0, "tanh": 20.0}
REDUCTIONS = ("reduce_sum", "reduce_max", "reduce_min", "reduce_or", "reduce_and")

Var = Any  # jax.extend.core.Var
Atom = Any  # Var or Literal


@dataclasses.dataclass(frozen=True, eq=False)
class Equation:
    """A primitive on values of one flight."""

    primitive: Any
    params: dict[str, Any]
    inputs: tuple[Atom, ...]
    outputs: tuple[Var, ...]

    @property
    def name(self) -> str:
        """Of the primitive."""
        return str(self.primitive.name)

    @property
    def free(self) -> bool:
        """Whether it moves numbers only."""
        return self.name in FREE


def cost_of(equation: Equation) -> tuple[float, float]:
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


def repeats(equation: Equation, atom: Atom) -> bool:
    """Whether each number of an input goes into several of the result."""
    if equation.name in ("concatenate", "stack"):
        return False
    if equation.name == "dot_general":
        return True
    return _size(equation.outputs[0]) > _size(atom)


def _size(atom: Atom) -> int:
    return int(np.prod(atom.aval.shape, initial=1))


def value_of(atom: Atom, known: dict[Var, Any], constants: dict[Var, Any]) -> Any:
    """Return the value of a variable or literal."""
    if isinstance(atom, core.Literal):
        return atom.val
    return known[atom] if atom in known else constants[atom]


def bound(equation: Equation, known: dict[Var, Any], constants: dict[Var, Any]) -> list[Any]:
    """Outputs of an equation that no flight is in."""
    values = [jnp.asarray(value_of(atom, known, constants), atom.aval.dtype) for atom in equation.inputs]
    found = equation.primitive.bind(*values, **equation.params)
    return list(found) if equation.primitive.multiple_results else [found]
