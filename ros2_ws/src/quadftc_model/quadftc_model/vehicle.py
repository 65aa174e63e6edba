"""Vehicles are data: one TOML file each, here or anywhere else, every number with its unit and source.

A wrong file is a ValueError that says which file and which key.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_DIRECTORY = Path(__file__).parent / "vehicles"
_GROUP = "quadftc.vehicles"  # entry points: name -> path of a TOML file
_LARGEST, _SMALLEST = 1e9, 1e-12  # in SI; no number of a vehicle is larger, none that is positive smaller
_ROTOR_NUMBERS = (
    *("thrust_gain", "yaw_gain", "command_min", "command_max", "command_idle", "command_trim"),
    *("time_constant", "rotor_inertia", "thrust_coefficient"),
)


@dataclasses.dataclass(frozen=True, eq=False)
class Rotors:
    """The rotors of a vehicle; arrays have one element a rotor."""

    positions: NDArray[np.float64]  # (n, 2) [m] x forward, y left
    yaw_sign: NDArray[np.float64]  # (n,) sign of the reaction torque about body z
    spin_sign: NDArray[np.float64]  # (n,) sign of the rotor's angular velocity about body z
    thrust_gain: float  # [N] per unit of command
    yaw_gain: float  # [N m] per unit of command
    command_min: float  # [1]
    command_max: float  # [1]
    command_idle: float  # [1] command of zero thrust
    command_trim: float  # [1] collective command around which the attitude is controlled
    time_constant: float  # [s] first-order lag of the thrust
    rotor_inertia: float  # [kg m²] about the spin axis
    thrust_coefficient: float  # [N s²/rad²] thrust over squared speed


@dataclasses.dataclass(frozen=True, eq=False)
class Vehicle:
    """A multirotor: its rigid body and its rotors."""

    name: str
    description: str
    source: str
    mass: float  # [kg]
    inertia: NDArray[np.float64]  # (3,) principal moments [kg m²], body frame
    rotational_drag: NDArray[np.float64]  # (3,) k_d1..k_d3 of (2) [N m s/rad]
    rotors: Rotors

    def __post_init__(self) -> None:
        """Check the numbers."""
        rotors = self.rotors
        count = len(rotors.positions)
        for name in ("yaw_sign", "spin_sign"):
            if getattr(rotors, name).shape != (count,):
                raise ValueError(f"rotors.{name}: expected {count} numbers, one for each of rotors.positions")
        positive = f"positive, at least {_SMALLEST:g}"
        _require("mass", self.mass, self.mass >= _SMALLEST, positive)
        _require("inertia", self.inertia, bool(np.all(self.inertia >= _SMALLEST)), positive)
        _require(
            "rotational_drag", self.rotational_drag, bool(np.all(self.rotational_drag >= 0.0)), "not negative"
        )
        _require("rotors.rotor_inertia", rotors.rotor_inertia, rotors.rotor_inertia >= 0.0, "not negative")
        low, high = rotors.command_min, rotors.command_max
        _require(
            "rotors.command_trim",
            rotors.command_trim,
            low < rotors.command_trim < high,
            f"in ({low}, {high})",
        )
        for name in ("thrust_gain", "yaw_gain", "time_constant", "thrust_coefficient"):
            _require(f"rotors.{name}", getattr(rotors, name), getattr(rotors, name) >= _SMALLEST, positive)
        if np.linalg.matrix_rank(self.mixer) < 3:
            raise ValueError("rotors.positions: this layout cannot give a torque about each axis")

    @functools.cached_property
    def mixer(self) -> NDArray[np.float64]:
        """The matrix of (2), (3, n): body torque [N m] per unit of rotor command."""
        rotors = self.rotors
        x, y = rotors.positions[:, 0], rotors.positions[:, 1]
        return np.stack([rotors.thrust_gain * y, -rotors.thrust_gain * x, rotors.yaw_gain * rotors.yaw_sign])

    @functools.cached_property
    def allocation(self) -> NDArray[np.float64]:
        """Pseudo-inverse of the mixer, (n, 3): rotor commands around the trim per unit of torque."""
        return np.asarray(np.linalg.pinv(self.mixer), dtype=np.float64)

    @functools.cached_property
    def authority(self) -> NDArray[np.float64]:
        """Largest torque of each axis alone, both ways, (3,) [N m]."""
        return self.command_room / np.max(np.abs(self.allocation), axis=0)

    @functools.cached_property
    def command_room(self) -> float:
        """How far a rotor command can move from the trim, both ways [1]."""
        rotors = self.rotors
        return min(rotors.command_trim - rotors.command_min, rotors.command_max - rotors.command_trim)


def vehicle_names() -> tuple[str, ...]:
    """Return the names of the vehicles that come with quadftc or are added by entry point."""
    own = {path.stem for path in _DIRECTORY.glob("*.toml")}
    return tuple(sorted(own | {entry.name for entry in importlib.metadata.entry_points(group=_GROUP)}))


def load_vehicle(name: str) -> Vehicle:
    """Load a vehicle by name, or from the path of a TOML file."""
    path = _path_of(name)
    try:
        return _loaded(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise ValueError(f"vehicle {path}: {error}") from None


@functools.lru_cache(maxsize=64)
def _loaded(path: Path, changed_ns: int) -> Vehicle:
    """Read a file; again only when it has changed, as a campaign builds thousands of flights."""
    try:
        with path.open("rb") as file:
            table = tomllib.load(file)
    except (OSError, ValueError) as error:  # unreadable, no TOML, no UTF-8
        raise ValueError(f"vehicle {path}: {error}") from None
    try:
        return _vehicle_from(table)
    except ValueError as error:
        raise ValueError(f"vehicle {path}: {error}") from None


def _path_of(name: str) -> Path:
    if name.endswith(".toml"):
        return Path(name)
    path = _DIRECTORY / f"{name}.toml"
    if path.is_file():
        return path
    for entry in importlib.metadata.entry_points(group=_GROUP, name=name):
        return Path(str(entry.load()))
    raise ValueError(
        f"no vehicle '{name}'; there are: {', '.join(vehicle_names())}; or give the path of a .toml file"
    )


def _vehicle_from(table: dict[str, Any]) -> Vehicle:
    table = dict(table)
    rotors_table = _section(table, "rotors")
    rotors = Rotors(
        positions=_array(rotors_table, "rotors.positions", (-1, 2)),
        yaw_sign=_array(rotors_table, "rotors.yaw_sign", (-1,)),
        spin_sign=_array(rotors_table, "rotors.spin_sign", (-1,)),
        **{name: _number(rotors_table, f"rotors.{name}") for name in _ROTOR_NUMBERS},
    )
    vehicle = Vehicle(
        name=_text(table, "name"),
        description=_text(table, "description"),
        source=_text(table, "source"),
        mass=_number(table, "mass"),
        inertia=_array(table, "inertia", (3,)),
        rotational_drag=_array(table, "rotational_drag", (3,)),
        rotors=rotors,
    )
    for section, rest in (("", table), ("rotors.", rotors_table)):
        for key in rest:
            raise ValueError(f"{section}{key}: unknown key")
    return vehicle


def _section(table: dict[str, Any], key: str) -> dict[str, Any]:
    section = table.pop(key, None)
    if not isinstance(section, dict):
        raise ValueError(f"[{key}]: expected this table")
    return dict(section)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]


def _number(table: dict[str, Any], key: str) -> float:
    value = table.pop(key.rpartition(".")[2], None)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= _LARGEST:
        raise ValueError(f"{key} = {_shown(value)}: expected a finite number, not beyond {_LARGEST:g}")
    return float(value)


def _text(table: dict[str, Any], key: str) -> str:
    value = table.pop(key, None)
    if not isinstance(value, str):
        raise ValueError(f"{key} = {value!r}: expected a text")
    return value


def _array(table: dict[str, Any], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    value = table.pop(key.rpartition(".")[2], None)
    wanted = (
        f"{key} = {_shown(value)}: expected finite numbers of shape {shape}, -1 being any length,"
        f" none beyond {_LARGEST:g}"
    )
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(wanted) from None
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or not np.all(np.abs(array) <= _LARGEST):
        raise ValueError(wanted)
    array.setflags(write=False)
    return array


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:97]}..."


def _require(name: str, value: Any, holds: bool, expected: str) -> None:
    if not holds:
        raise ValueError(f"{name} = {value}: must be {expected}")
