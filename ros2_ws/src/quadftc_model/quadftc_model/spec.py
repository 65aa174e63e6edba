"""Component specifications in one line of text: ``bias channel=attitude axes=roll value=1deg stop=40s``.

The first word names the component, the others set its parameters; a comma makes a list, which may have
brackets as in YAML: ``rotors=1,2`` is ``rotors=[1, 2]``. ROS parameters, services and the command line carry
components in this form.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

_WORD = re.compile(r"(?:\[[^]]*\]|\S)+")  # blanks within brackets do not end it


class Spec(NamedTuple):
    """A component's name and its raw parameters (texts, numbers, or lists of them)."""

    kind: str
    values: dict[str, Any]


def parse_spec(text: str) -> Spec:
    """Parse one specification."""
    words = _WORD.findall(text)
    if not words or "=" in words[0]:
        raise ValueError(f"{text!r}: expected a name first, then key=value words")
    values: dict[str, Any] = {}
    for word in words[1:]:
        key, equals, value = word.partition("=")
        if not equals or not key or not value:
            raise ValueError(f"{text!r}: '{word}' is no key=value")
        if key in values:
            raise ValueError(f"{text!r}: '{key}' is given twice")
        values[key] = _value(value)
    return Spec(words[0], values)


def _value(text: str) -> str | list[str]:
    """Return a text, or the texts of a list."""
    inner = text.removeprefix("[").removesuffix("]") if text[0] + text[-1] == "[]" else text
    if "[" in inner or "]" in inner:
        raise ValueError(f"'{text}' is no list: expected such as [1, 2], or 1,2 without brackets")
    if inner is text:
        return text.split(",") if "," in text else text
    return [each.strip() for each in inner.split(",")] if inner.strip() else []


def format_spec(kind: str, values: Mapping[str, object]) -> str:
    """Write a specification that :func:`parse_spec` reads back; floating-point numbers survive exactly."""
    return " ".join([kind, *(f"{key}={_format(value)}" for key, value in values.items())])


def _format(value: object) -> str:
    if isinstance(value, (list, tuple)):
        parts: list[object] = [*value]
        return ",".join(_format(part) for part in parts)
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(float(value)) if isinstance(value, float) else str(value)  # np.float64 is a float, too
    return text.replace(" ", "")
