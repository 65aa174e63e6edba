"""Make the meshes of the URDF: propellers of radius 1 that lift along z, as binary STL.

    python -m quadftc_tools.meshes ros2_ws/src/quadftc_model/meshes

``propeller_ccw.stl`` turns counterclockwise seen from above; ``propeller_cw.stl`` is its mirror image.
Each has its file, because not every viewer draws negative scales right.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

Floats = NDArray[np.float64]

# lengths are over the radius of the propeller
STATIONS = 1.0 - 0.95 * np.linspace(1.0, 0.0, 20) ** 1.6  # along a blade, denser at the tip
RADIUS, CHORD = (0.05, 0.2, 0.4, 0.6, 0.8, 0.93, 1.0), (0.1, 0.16, 0.215, 0.2, 0.155, 0.11, 0.03)
PITCH = 0.9  # advance in a turn; a 10x4.5 propeller
ROOT = 0.2  # within this the twist levels off, at 35 deg
THICKNESS = (0.2, 0.09)  # over the chord, at the root and at the tip
CAMBER = 0.045  # over the chord
CORNERS = 12  # of a blade section
HUB = ((0.08, -0.062), (0.08, 0.04), (0.07, 0.05))  # radius and height, upward; lower than the blades
SEGMENTS = 24  # of the hub


def section(chord: float, thickness: float) -> Floats:
    """Return corners (x forward, y up) of a blade section, from the trailing edge along the bottom.

    The mean line is a parabola; the thickness is that of NACA four-digit sections with a closed trailing edge
    (Abbott and von Doenhoff, 1959, (6.2)). The origin lies at 0.35 of the chord.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    x = 0.5 * (1.0 + np.cos(turn))  # from the leading edge
    half = 5.0 * thickness * np.polyval([-0.1036, 0.2843, -0.3516, -0.126, 0.0], x)
    half += 5.0 * thickness * 0.2969 * np.sqrt(x)
    y = 4.0 * CAMBER * x * (1.0 - x) + np.where(turn < np.pi, -half, half)
    return chord * np.stack([0.35 - x, y], axis=-1)


def skin(rings: Floats) -> Floats:
    """Return triangles (n, 3, 3) between rings (m, k, 3), which turn right-handed, and over both ends."""
    ends = [np.broadcast_to(ring.mean(axis=0), (1, *ring.shape)) for ring in (rings[0], rings[-1])]
    rings = np.concatenate([ends[0], rings, ends[1]])
    after = np.roll(rings, -1, axis=1)
    quads = (rings[:-1], after[:-1], after[1:], rings[1:])
    halves = [np.stack([quads[0], quads[k], quads[k + 1]], axis=2).reshape(-1, 3, 3) for k in (1, 2)]
    triangles = np.concatenate(halves)
    return triangles[np.linalg.norm(twice_area(triangles), axis=-1) > 0.0]


def twice_area(triangles: Floats) -> Floats:
    """Return the outward normal of each triangle, as long as twice its area."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def blade() -> Floats:
    """Return triangles of a blade along x whose leading edge points to y."""
    chords = PchipInterpolator(RADIUS, CHORD)(STATIONS)
    pitch = np.arctan2(PITCH, 2.0 * np.pi * np.hypot(STATIONS, ROOT))
    thicknesses = np.interp(STATIONS, (STATIONS[0], 1.0), THICKNESS)
    rings: list[Floats] = []
    for r, chord, angle, thickness in zip(STATIONS, chords, pitch, thicknesses, strict=True):
        forward, up = section(chord, thickness).T
        y, z = forward * np.cos(angle) - up * np.sin(angle), forward * np.sin(angle) + up * np.cos(angle)
        rings.append(np.stack([np.full_like(y, r), y, z], axis=-1))
    return skin(np.array(rings))


def propeller() -> Floats:
    """Return triangles (n, 3, 3) of two blades and a hub that stands on z = 0; they turn counterclockwise."""
    turn = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    hub = np.array([np.insert(radius * circle, 2, height, axis=1) for radius, height in HUB])
    one = blade()
    triangles = np.concatenate([one, one * [-1.0, -1.0, 1.0], skin(hub)])
    triangles -= [0.0, 0.0, HUB[0][1]]
    return triangles / np.max(np.hypot(triangles[..., 0], triangles[..., 1]))


def write_stl(path: Path, triangles: Floats) -> None:
    """Write triangles (n, 3, 3) as binary STL."""
    normals = twice_area(triangles)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    records = np.zeros(len(triangles), dtype=[("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    records["vectors"] = np.concatenate([normals[:, None], triangles], axis=1)
    path.write_bytes(b"quadftc".ljust(80) + np.array(len(triangles), "<u4").tobytes() + records.tobytes())


def main() -> None:
    """Write both propellers into the folder that is given."""
    folder, triangles = Path(sys.argv[1]), propeller()
    write_stl(folder / "propeller_ccw.stl", triangles)
    write_stl(folder / "propeller_cw.stl", triangles[:, ::-1] * [1.0, -1.0, 1.0])


if __name__ == "__main__":
    main()
