"""The keys of a vehicle's file: kind, unit and meaning of each; and reading them, with all that is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.hints import nearest

LARGEST = 1e9  # in SI; no number of a vehicle is larger
SMALLEST = 1e-12  # in SI; no number of a vehicle that is positive is smaller
LAG = (5e-4, 0.5)  # s; of the rotors: 5 mm of a toy to 1 m of a carrier of persons
ALONE = "rotors.time_constant"  # what nothing else follows from
POSITIVE = (
    *(("", name) for name in ("mass", "inertia")),
    *(("rotors", name) for name in ("thrust_gain", "yaw_gain", "time_constant", "thrust_coefficient")),
)
NOT_NEGATIVE = (
    *(("", "rotational_drag"), ("rotors", "rotor_inertia")),
    *(("aerodynamics", "rotor_drag"), ("aerodynamics", "drag_area")),
)


class Key(NamedTuple):
    """One key of a table."""

    kind: type[str] | type[float] | tuple[int, ...]  # the last: shape of an array, -1 being any length
    unit: str  # SI; empty: a text
    doc: str


# what a file holds, by table; the keys of [aerodynamics] may be missing
KEYS: dict[str, dict[str, Key]] = {
    "": {
        "name": Key(str, "", "what `quadftc list vehicles` and reports call it"),
        "description": Key(str, "", "one line"),
        "source": Key(str, "", "where the numbers are from"),
        "mass": Key(float, "kg", "mass"),
        "inertia": Key((3,), "kg m^2", "principal moments about x, y, z"),
        "rotational_drag": Key((3,), "N m s/rad", "torque against each body rate; 0: none"),
    },
    "rotors": {
        "positions": Key((-1, 2), "m", "of each rotor from the centre of mass: x forward, y left"),
        "spin_sign": Key((-1,), "1", "1: counter-clockwise from above, -1: clockwise"),
        "yaw_sign": Key((-1,), "1", "sign of its reaction torque about z: the opposite of `spin_sign`"),
        "thrust_gain": Key(float, "N", "thrust per unit of command"),
        "yaw_gain": Key(float, "N m", "reaction torque per unit of command"),
        "command_min": Key(float, "1", "least command of a rotor"),
        "command_max": Key(float, "1", "largest command of a rotor"),
        "command_idle": Key(float, "1", "command at which the thrust is zero"),
        "command_trim": Key(float, "1", "command around which the attitude is controlled, near hover"),
        "time_constant": Key(float, "s", "first-order lag of the thrust"),
        "rotor_inertia": Key(float, "kg m^2", "of one rotor about its axis; 0: no gyroscopic torque"),
        "thrust_coefficient": Key(float, "N s^2/rad^2", "thrust over squared speed"),
    },
    "aerodynamics": {
        "rotor_drag": Key(
            float, "N s^2/(m rad)", "in-plane force of a rotor over its speed and that of the air"
        ),
        "drag_area": Key((3,), "m^2", "C_d A of the body, from ahead, the side, above"),
        "imu_position": Key((3,), "m", "of the IMU from the centre of mass"),
    },
}
_EXAMPLES: dict[object, str] = {(3,): "[x, y, z]", (-1, 2): "[[x, y], [x, y], ...]", (-1,): "[1, -1, ...]"}


class Problem(NamedTuple):
    """What is wrong with a key."""

    key: str  # dotted
    text: str  # beginning with ``=`` and the value, if that is wrong

    @property
    def line(self) -> str:
        """The line that reports it."""
        return f"{self.key}{' ' if self.text.startswith('=') else ': '}{self.text}"


def read_section(table: Mapping[str, object], section: str) -> tuple[dict[str, Any], list[Problem]]:
    """Return the values of a table by key, and what is wrong with it."""
    keys, prefix = KEYS[section], f"{section}." if section else ""
    values: dict[str, Any] = {}
    problems: list[Problem] = []
    for name, key in keys.items():
        if name in table:
            found = _read(table[name], key.kind)
            if found is None:
                text = f"= {shortened(repr(table[name]))}: expected {_expected(table[name], key)}"
                problems.append(Problem(f"{prefix}{name}", text))
            values[name] = found
        elif section != "aerodynamics":
            problems.append(
                Problem(f"{prefix}{name}", f"missing; expected {_expected(None, key)}: {key.doc}")
            )
    unknown = [name for name in table if name not in keys and not (section == "" and name in KEYS)]
    problems += [Problem(f"{prefix}{name}", f"unknown key{_hint(name, section)}") for name in unknown]
    return values, problems


def wrong_numbers(values: Mapping[str, Mapping[str, Any]]) -> Iterator[Problem]:
    """Yield which numbers have a wrong count, sign or size by themselves; of those that are not there, none.

    ``values`` holds the tables by name, the first under the empty one.
    """
    rotors = values.get("rotors", {})
    places = rotors.get("positions")
    for name in ("yaw_sign", "spin_sign"):
        signs = rotors.get(name)
        if signs is not None and places is not None and len(signs) != len(places):
            told = f"expected {len(places)} numbers, one for each of rotors.positions, not {len(signs)}"
            yield Problem(f"rotors.{name}", told)
    for section, name in (*POSITIVE, *NOT_NEGATIVE):
        value, is_positive = values.get(section, {}).get(name), (section, name) in POSITIVE
        if value is None or np.all(value >= (SMALLEST if is_positive else 0.0)):
            continue
        shown = value if isinstance(value, float) else value.tolist()
        expected = f"positive, at least {SMALLEST:g}" if is_positive else "not negative"
        yield Problem(f"{section}.{name}".lstrip("."), f"= {shown}: must be {expected}")
    lag = rotors.get("time_constant")
    if lag is not None and lag >= SMALLEST and not LAG[0] <= lag <= LAG[1]:
        yield Problem(ALONE, f"= {lag:g}: expected within [{LAG[0]:g}, {LAG[1]:g}] s")
    low, high, trim = (rotors.get(f"command_{name}") for name in ("min", "max", "trim"))
    if low is not None and high is not None and trim is not None and not low < trim < high:
        told = f"= {trim}: must be in ({low:g}, {high:g}), the limits of the command"
        yield Problem("rotors.command_trim", told)


def _hint(name: str, section: str) -> str:
    """Say where a key belongs, or what may be meant."""
    for other, keys in KEYS.items():
        if name in keys:
            return f" here; it belongs {f'into [{other}]' if other else 'above the first table'}"
    known = [*KEYS[section], *(KEYS if section == "" else ())]
    return nearest(name, known) or f"; known are {', '.join(filter(None, known))}"


def _expected(value: object, key: Key) -> str:
    """Say what a key takes."""
    if key.kind is str:
        return "a text"
    unit = "" if key.unit == "1" else f", in {key.unit}"
    if isinstance(value, str) and re.match(r"\s*[-+]?[\d.]", value):
        return f"the number alone{unit}, without quotes"
    if key.kind is float:
        return f"a finite number{unit}, not beyond {LARGEST:g}"
    return f"finite numbers {_EXAMPLES[key.kind]}{unit}, none beyond {LARGEST:g}"


def _read(value: object, kind: type | tuple[int, ...]) -> str | float | NDArray[np.float64] | None:
    """Return a text, a number or an array as the vehicle holds it; None if it is none."""
    if isinstance(kind, tuple):
        return _array_of(value, kind)
    if kind is str:
        return value if isinstance(value, str) else None
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value) if abs(value) <= LARGEST else None
    return None


def shortened(text: str) -> str:
    """Cut a value for a message."""
    return text if len(text) <= 100 else f"{text[:97]}..."


def _array_of(value: object, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    array.setflags(write=False)
    return array if fits and np.all(np.abs(array) <= LARGEST) else None


def line_of(text: str, key: str) -> int | None:
    """Return the line (from 1) of a dotted key in the text of a file; of its table if the key is missing."""
    section, _, name = key.rpartition(".")
    present, table = "", None
    for number, line in enumerate(text.splitlines(), start=1):
        if heading := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            present = heading[1]
            table = number if present == section else table
        elif present == section and re.match(rf"\s*{re.escape(name)}\s*=", line):
            return number
    return table
