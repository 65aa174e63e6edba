"""Vehicles are data: one TOML file each, here or anywhere else, every number with its unit and source.

A wrong file is a ValueError that says which file, line and key, for all that is wrong.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadftc_model.numbers import LABEL, prepared
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.small_files import read_small, read_toml
from quadftc_model.vehicle_checks import impossible
from quadftc_model.vehicle_table import ALONE, KEYS, Problem, line_of, read_section, shortened, wrong_numbers
from quadftc_model.wrench_set import WrenchSet, extremes, limits, wrench_set

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

_DIRECTORY = Path(__file__).parent / "vehicles"
_GROUP = "quadftc.vehicles"  # entry points: name -> path of a TOML file


def _zeros() -> NDArray[np.float64]:
    zeros = np.zeros(3)
    zeros.setflags(write=False)
    return zeros


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

    @prepared
    def speed_min(self) -> float:
        """Speed at the smallest command [rad/s]."""
        return self._speed_at(self.command_min)

    @prepared
    def speed_max(self) -> float:
        """Speed at the largest command [rad/s]."""
        return self._speed_at(self.command_max)

    @property
    def thrust_range(self) -> tuple[float, float]:
        """Least and largest thrust of a rotor [N]."""
        return self.thrust_coefficient * self.speed_min**2, self.thrust_coefficient * self.speed_max**2

    @prepared
    def torque_to_thrust(self) -> float:
        """Reaction torque over thrust [m]."""
        return self.yaw_gain / self.thrust_gain

    def _speed_at(self, command: float) -> float:
        """Speed [rad/s] from thrust_coefficient speed² = thrust_gain (command - idle); 0 below the idle."""
        thrust = self.thrust_gain * max(command - self.command_idle, 0.0)
        return math.sqrt(thrust / self.thrust_coefficient)


@dataclasses.dataclass(frozen=True, eq=False)
class Aerodynamics:
    """How the air drags a vehicle in free flight, and where its IMU is.

    Zeros, the default, mean a vehicle without drag whose IMU is at its centre of mass.
    """

    rotor_drag: float = 0.0  # [N s²/(m rad)] in-plane force of a rotor over its speed and the air's velocity
    drag_area: NDArray[np.float64] = dataclasses.field(default_factory=_zeros)  # (3,) [m²] C_d A, body axes
    imu_position: NDArray[np.float64] = dataclasses.field(default_factory=_zeros)  # (3,) [m] from its centre


@dataclasses.dataclass(frozen=True, eq=False)
class Vehicle:
    """A multirotor: its rigid body and its rotors. One that cannot be is refused by :mod:`vehicle_checks`."""

    name: str = dataclasses.field(metadata=LABEL)
    description: str = dataclasses.field(metadata=LABEL)
    source: str = dataclasses.field(metadata=LABEL)
    mass: float  # [kg]
    inertia: NDArray[np.float64]  # (3,) principal moments [kg m²], body frame
    rotational_drag: NDArray[np.float64]  # (3,) k_d1..k_d3 of (2) [N m s/rad]
    rotors: Rotors
    aerodynamics: Aerodynamics = dataclasses.field(default_factory=Aerodynamics)

    def __post_init__(self) -> None:
        """Check the numbers; a ValueError has a line for each that is wrong."""
        values = {"": vars(self), "rotors": vars(self.rotors), "aerodynamics": vars(self.aerodynamics)}
        problems = [*wrong_numbers(values)]
        if all(problem.key == ALONE for problem in problems):
            problems = [*impossible(self), *problems]
        if problems:
            raise ValueError("\n".join(problem.line for problem in problems))

    @prepared
    def mixer(self) -> NDArray[np.float64]:
        """The matrix of (2), (3, n): body torque [N m] per unit of rotor command."""
        rotors = self.rotors
        x, y = rotors.positions[:, 0], rotors.positions[:, 1]
        return np.stack([rotors.thrust_gain * y, -rotors.thrust_gain * x, rotors.yaw_gain * rotors.yaw_sign])

    @prepared
    def allocation(self) -> NDArray[np.float64]:
        """Pseudo-inverse of the mixer, (n, 3): rotor commands around the trim per unit of torque."""
        return np.asarray(np.linalg.pinv(self.mixer), dtype=np.float64)

    @prepared
    def authority(self) -> NDArray[np.float64]:
        """Largest torque of each axis alone, both ways, (3,) [N m]."""
        return self.command_room / np.max(np.abs(self.allocation), axis=0)

    @prepared
    def command_room(self) -> float:
        """How far a rotor command can move from the trim, both ways [1]."""
        rotors = self.rotors
        return min(rotors.command_trim - rotors.command_min, rotors.command_max - rotors.command_trim)

    @prepared
    def effectiveness(self) -> NDArray[np.float64]:
        """Thrust [N] and body torque [N m] per unit of each rotor's thrust [N], (4, n).

        Rows: collective thrust, then torque about x, y, z: the mixer of (2) over the thrust gain.
        """
        thrust = np.ones((1, len(self.rotors.positions)))
        return np.concatenate([thrust, self.mixer / self.rotors.thrust_gain])

    @prepared
    def force_allocation(self) -> NDArray[np.float64]:
        """Pseudo-inverse of the effectiveness, (n, 4): each rotor's thrust per unit of thrust and torque."""
        return np.asarray(np.linalg.pinv(self.effectiveness), dtype=np.float64)

    @prepared
    def thrust_max(self) -> float:
        """Largest thrust of all rotors together [N]."""
        return self._thrust_at(self.rotors.speed_max)

    @prepared
    def thrust_min(self) -> float:
        """Smallest thrust of all rotors together [N]."""
        return self._thrust_at(self.rotors.speed_min)

    @property
    def weight(self) -> float:
        """Weight [N]."""
        return self.mass * STANDARD_GRAVITY

    @property
    def thrust_to_weight(self) -> float:
        """Largest thrust over the weight [1]."""
        return self.thrust_max / self.weight

    @prepared
    def hover_speed(self) -> float:
        """Speed at which the rotors, all alike, carry the weight [rad/s]."""
        rotors = self.rotors
        return math.sqrt(self.weight / (len(rotors.positions) * rotors.thrust_coefficient))

    @prepared
    def wrench_set(self) -> WrenchSet:
        """The thrusts and torques that the rotors can give together."""
        return wrench_set(self.effectiveness)

    @prepared
    def hover_yaw(self) -> float:
        """Yaw torque that healthy rotors have in hover, the weaker way [N m]."""
        least, most = extremes(self.wrench_set.yaw, limits(self), np.array([self.weight, 0.0, 0.0]))
        return float(np.minimum(most, -least))

    @prepared
    def reach(self) -> float:
        """Distance of the outermost rotor from body z [m]."""
        return float(np.max(np.hypot(*self.rotors.positions.T)))

    def _thrust_at(self, speed: float) -> float:
        """Thrust [N] of all rotors, each at a speed [rad/s]."""
        return len(self.rotors.positions) * self.rotors.thrust_coefficient * speed**2


def vehicle_names() -> tuple[str, ...]:
    """Return the names of the vehicles that come with quadftc or are added by entry point."""
    own = {path.stem for path in _DIRECTORY.glob("*.toml")}
    return tuple(sorted(own | _added().names))


def _added() -> EntryPoints:
    from importlib.metadata import entry_points  # takes 50 ms

    return entry_points(group=_GROUP)


def load_vehicle(name: str) -> Vehicle:
    """Load a vehicle by name, or from the path of a TOML file.

    A ValueError has a line for each thing that is wrong: file, line, key, value, and what was expected.
    """
    path = _path_of(name)
    try:
        return _load(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise ValueError(f"vehicle {path}: {error.strerror}") from None
    except ValueError as error:  # no TOML, no UTF-8, wrong values
        found = sorted((_line_of(path, problem), problem) for problem in str(error).splitlines())
        told = (f"vehicle {path}{f':{line}' if line else ''}: {problem}" for line, problem in found)
        raise ValueError("\n".join(told)) from None


def _line_of(path: Path, problem: str) -> int:
    """Return the line of the key of a problem; 0: unknown."""
    try:
        return line_of(read_small(path), problem.partition(" ")[0].rstrip(":")) or 0
    except ValueError:  # too large, or no UTF-8
        return 0


def _path_of(name: str) -> Path:
    if name.endswith(".toml"):
        return Path(name)
    path = _DIRECTORY / f"{name}.toml"
    if path.is_file():
        return path
    for entry in _added().select(name=name):
        return Path(str(entry.load()))
    raise ValueError(
        f"no vehicle '{name}'; there are: {', '.join(vehicle_names())}; or give the path of a .toml file"
    )


@functools.lru_cache(maxsize=64)
def _load(path: Path, changed_ns: int) -> Vehicle:
    """Read a file; again only when it has changed, as a campaign builds thousands of flights."""
    table = read_toml(path)
    read: dict[str, dict[str, Any]] = {}
    problems: list[Problem] = []
    for section in KEYS:
        part = table if section == "" else table.get(section, {} if section == "aerodynamics" else None)
        if not isinstance(part, dict):
            given = "missing" if part is None else f"= {shortened(repr(part))}"
            problems.append(Problem(section, f"{given}: expected a table [{section}] with its keys"))
            continue
        read[section], wrong = read_section(part, section)  # pyright: ignore[reportUnknownArgumentType]
        problems += wrong
    if problems:
        problems += wrong_numbers(read)
        raise ValueError("\n".join(problem.line for problem in problems))
    rotors, air = Rotors(**read["rotors"]), Aerodynamics(**read["aerodynamics"])
    return Vehicle(**read[""], rotors=rotors, aerodynamics=air)
