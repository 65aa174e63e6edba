"""What a vehicle looks like, from its file alone: boxes and cylinders in the body frame, and a URDF of them.

In the URDF, propellers of radius 1 (``meshes/``) take the place of the discs that the rotors sweep.

The frame is FLU, as that of the vehicle file. Sizes that the file does not have follow from the places of its
rotors: a picture needs them, a law does not.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from quadftc_model.vehicle import Vehicle

ROTOR_RADIUS = 0.4  # 1; over the distance of two rotors that are neighbours; 0.5, and they touch
ROTOR_HEIGHT = 0.09  # 1; of the rotors above the arms, over the distance of the farthest rotor
DARK, LIGHT, NOSE = "#30343a", "#8a929c", "#e69f00"  # frame; rotors; what points forward
DISC_ALPHA = 0.35  # 1; of the discs that the rotors sweep
MESHES = "package://quadftc_model/meshes"

Triple = tuple[float, float, float]


class Part(NamedTuple):
    """A box, or a cylinder along z; angles are turns about body z."""

    name: str
    kind: Literal["box", "cylinder"]
    size: Triple  # [m] along its axes; of a cylinder twice the diameter, and the height
    position: Triple  # [m] of its centre
    yaw: float  # [rad]
    colour: str
    alpha: float = 1.0
    mesh: str = ""  # file of a mesh of radius 1 that the URDF shows instead


def rotor_radius(vehicle: Vehicle) -> float:
    """Return a radius [m] with which the rotors do not touch."""
    places = vehicle.rotors.positions
    gaps = np.linalg.norm(places[:, None] - places, axis=-1) + np.diag(np.full(len(places), np.inf))
    return ROTOR_RADIUS * float(np.min(gaps))


def parts_of(vehicle: Vehicle) -> tuple[Part, ...]:
    """Return the parts of a vehicle: body, nose, and of each rotor arm, motor, leg and disc."""
    places = vehicle.rotors.positions.tolist()
    span, radius = max(math.hypot(x, y) for x, y in places), rotor_radius(vehicle)
    parts = [
        Part("body", "box", (0.5 * span, 0.32 * span, 0.13 * span), (0.0, 0.0, 0.0), 0.0, DARK),
        Part("nose", "box", (0.1 * span, 0.2 * span, 0.07 * span), (0.29 * span, 0.0, 0.0), 0.0, NOSE),
    ]
    for number, ((x, y), spin) in enumerate(zip(places, vehicle.rotors.spin_sign, strict=True), 1):
        yaw, colour = math.atan2(y, x), NOSE if x > 0.1 * span else DARK
        arm = (math.hypot(x, y), 0.07 * span, 0.05 * span)
        disc = (2.0 * radius, 2.0 * radius, 0.012 * span)
        top = ROTOR_HEIGHT * span
        parts += [
            Part(f"arm_{number}", "box", arm, (0.5 * x, 0.5 * y, 0.0), yaw, DARK),
            Part(
                f"motor_{number}",
                "cylinder",
                (0.13 * span, 0.13 * span, 0.12 * span),
                (x, y, 0.03 * span),
                0.0,
                colour,
            ),
            Part(
                f"leg_{number}",
                "cylinder",
                (0.035 * span, 0.035 * span, 0.26 * span),
                (0.55 * x, 0.55 * y, -0.13 * span),
                0.0,
                LIGHT,
            ),
            Part(
                f"rotor_{number}",
                "cylinder",
                disc,
                (x, y, top),
                yaw + 0.5 * math.pi,  # blades across the arm
                LIGHT,
                DISC_ALPHA,
                "propeller_ccw.stl" if spin > 0.0 else "propeller_cw.stl",
            ),
        ]
    return tuple(parts)


def urdf_of(vehicle: Vehicle) -> str:
    """Return a URDF: ``base_link`` with mass, inertia and shape, and ``imu_link`` at the place of the IMU."""
    robot = ET.Element("robot", name=vehicle.name)
    base = ET.SubElement(robot, "link", name="base_link")
    inertial = ET.SubElement(base, "inertial")
    ET.SubElement(inertial, "mass", value=f"{vehicle.mass:g}")
    moments = dict(zip(("ixx", "iyy", "izz"), (f"{value:g}" for value in vehicle.inertia), strict=True))
    ET.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})
    for part in parts_of(vehicle):
        _add_visual(base, part)
    ET.SubElement(robot, "link", name="imu_link")
    joint = ET.SubElement(robot, "joint", name="imu_joint", type="fixed")
    ET.SubElement(joint, "parent", link="base_link")
    ET.SubElement(joint, "child", link="imu_link")
    ET.SubElement(joint, "origin", xyz=_words(vehicle.aerodynamics.imu_position), rpy="0 0 0")
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def rgba(colour: str, alpha: float = 1.0) -> tuple[float, float, float, float]:
    """Return red, green, blue and alpha, 0 to 1, of a colour such as ``#30343a``."""
    red, green, blue = (int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5))
    return red, green, blue, alpha


def _add_visual(link: ET.Element, part: Part) -> None:
    visual = ET.SubElement(link, "visual", name=part.name)
    ET.SubElement(visual, "origin", xyz=_words(part.position), rpy=_words((0.0, 0.0, part.yaw)))
    geometry = ET.SubElement(visual, "geometry")
    alpha = part.alpha
    if part.mesh:
        scale, alpha = (0.5 * part.size[0],) * 3, 1.0
        ET.SubElement(geometry, "mesh", filename=f"{MESHES}/{part.mesh}", scale=_words(scale))
    elif part.kind == "box":
        ET.SubElement(geometry, "box", size=_words(part.size))
    else:
        ET.SubElement(geometry, "cylinder", radius=f"{0.5 * part.size[0]:g}", length=f"{part.size[2]:g}")
    material = ET.SubElement(visual, "material", name=f"{part.colour[1:]}_{100.0 * alpha:.0f}")
    ET.SubElement(material, "color", rgba=_words(rgba(part.colour, alpha)))


def _words(numbers: object) -> str:
    return " ".join(f"{float(number):.6g}" for number in np.asarray(numbers))
