# pyright: basic
"""The vehicle in 3D: truth solid, what is measured and corrected as ghosts, thrust as arrows."""

from __future__ import annotations

import math

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from quadftc_cli.live_page.picture import Picture
from quadftc_model.rotations import to_earth
from quadftc_model.shape import LIGHT, ROTOR_HEIGHT, Part, parts_of
from quadftc_ros.conversions import Floats

TRUTH, MEASURED, CORRECTED = "#30343a", "#d55e00", "#0072b2"  # those of the charts
GHOSTS = {"measured": MEASURED, "corrected": CORRECTED}
GHOST_ALPHA, RING = 0.85, 0.07  # 1; of the rings around the rotors; their width over the radius of a rotor
THRUST = "#009e73"
THRUST_LENGTH = 0.9  # 1; of the arrow of a rotor that carries its share of the weight, over the span
GROUND, GRID = "#f7f8fa", "#c3c9d2"  # colours
GRID_HALF, GRID_STEP = 10, 0.5  # lines either side of the origin; m
TARGET = "#cc79a7"
STEP = 1e-3  # m; the camera follows no less
SMOOTH = 32  # segments of a circle
UPRIGHT = 0.5 * math.pi  # turns y, the axis of a cylinder, to z


class _Camera(ui.element, component="follow.js"):
    """Has the camera of a scene follow the vehicle."""

    def __init__(self, scene: int, start: tuple[float, ...], slack: float) -> None:
        super().__init__()
        self._props["scene"], self._props["start"], self._props["slack"] = scene, start, slack
        self._place = np.array(start)

    def follow(self, place: list[float]) -> None:
        """Look at the vehicle at a place [m]."""
        if np.max(np.abs(np.subtract(place, self._place))) > STEP:
            self._place = np.array(place)
            self.run_method("follow", place)


class VehicleScene:
    """The vehicle of a picture in a 3D element of the page that is being built."""

    def __init__(self, picture: Picture) -> None:
        self._picture = picture
        self._vehicle = picture.latest.vehicle
        places = self._vehicle.rotors.positions
        self._span = float(np.max(np.linalg.norm(places, axis=-1)))
        camera = ui.scene.perspective_camera(fov=38, near=0.02, far=100)
        element = ui.scene(800, 500, grid=False, camera=camera, background_color=GROUND, fps=30)
        self.element = element.classes("scene")
        # a test stand holds the vehicle above the grid
        self._lift = np.array([0.0, 0.0, 0.0 if picture.latest.flies else 2.0 * self._span])
        x, y, z = (picture.latest.position() + self._lift).tolist()
        with self.element:
            self._lay_grid()
            self._groups = {role: self._ghost(k, GHOSTS[role]) for k, role in enumerate(GHOSTS)}
            self._groups["truth"] = self._truth()
            if picture.latest.flies:
                self._target = self.element.sphere(0.06 * self._span).material(TARGET, 0.9)
            else:
                thick = 0.06 * self._span
                post = Part("post", "cylinder", (thick, thick, z), (x, y, 0.5 * z), 0.0, LIGHT)
                self._add(post, post.colour, post.alpha)
        far = 4.3 * self._span
        self.element.move_camera(
            *(x - 0.62 * far, y - 0.68 * far, z + 0.42 * far, x, y, z + 0.12 * self._span), duration=0
        )
        self._camera = _Camera(self.element.id, (x, y, z), 0.9 * self._span)

    def show(self, reference: Floats | None) -> None:
        """Put everything where it is now; ``reference`` is the position to be at, None: there is none."""
        latest = self._picture.latest
        attitudes, place = latest.attitudes(), latest.position() + self._lift
        if "truth" not in attitudes and "corrected" in attitudes:  # on a vehicle that exists
            attitudes["truth"] = attitudes["corrected"]
        for role, group in self._groups.items():
            group.visible(role in attitudes)
            if role in attitudes:
                columns = [to_earth(attitudes[role], axis) for axis in np.eye(3)]
                group.move(*place.tolist()).rotate_R(np.round(np.transpose(columns), 5).tolist())
        share = self._vehicle.weight / len(self._arrows)
        for (shaft, head), thrust in zip(self._arrows, latest.thrusts().tolist(), strict=True):
            length = max(0.02, THRUST_LENGTH * round(thrust / share, 3)) * self._span
            shaft.scale(1.0, length, 1.0).move(z=0.5 * length)
            head.move(z=length)
        if latest.flies:
            self._target.visible(reference is not None)
        if latest.flies and reference is not None:
            self._target.move(*reference.tolist())
        self._camera.follow(place.tolist())

    def _lay_grid(self) -> None:
        """Lay the lines of the ground, as boxes: some renderers lose lines that pass behind the camera."""
        long, thin = 2.0 * GRID_HALF * GRID_STEP, 0.007 * self._span
        for k in range(-GRID_HALF, GRID_HALF + 1):
            self.element.box(long, thin, thin).material(GRID).move(0.0, k * GRID_STEP, 0.0)
            self.element.box(thin, long, thin).material(GRID).move(k * GRID_STEP, 0.0, 0.0)

    def _truth(self) -> Object3D:
        """Make the solid vehicle with its thrust."""
        with self.element.group() as group:
            for part in parts_of(self._vehicle):
                self._add(part, part.colour, part.alpha)
            self._mast(TRUTH, 1.0)
            self._arrows = [self._arrow(x, y) for x, y in self._vehicle.rotors.positions.tolist()]
        return group

    def _ghost(self, rank: int, colour: str) -> Object3D:
        """Make a ghost: thin arms, a ring around each rotor, and a line along body z.

        Arms hide in those of the truth, and rings are around one another, while all agree.
        """
        with self.element.group() as group:
            for part in parts_of(self._vehicle):
                if part.name.startswith("arm"):
                    long, wide, high = part.size
                    self._add(part._replace(size=(long, 0.5 * wide, 0.5 * high)), colour, 1.0)
                elif part.name.startswith("rotor"):
                    inner = 0.5 * part.size[0] * (1.0 + RING * rank)
                    ring = self.element.ring(inner, inner * (1.0 + 0.8 * RING), SMOOTH)
                    ring.material(colour, GHOST_ALPHA, "both").move(*part.position)
            self._mast(colour, 1.25 + 0.12 * rank)
        return group

    def _add(self, part: Part, colour: str, alpha: float) -> None:
        long, wide, high = part.size
        if part.kind == "box":
            shape = self.element.box(long, wide, high).rotate(0.0, 0.0, part.yaw)
        else:
            shape = self.element.cylinder(0.5 * long, 0.5 * long, high, SMOOTH).rotate(UPRIGHT, 0.0, 0.0)
        shape.material(colour, alpha).move(*part.position)

    def _mast(self, colour: str, length: float) -> None:
        length, radius = length * self._span, 0.011 * self._span / length
        mast = self.element.cylinder(radius, radius, length, SMOOTH).rotate(UPRIGHT, 0.0, 0.0)
        mast.material(colour).move(z=0.5 * length)

    def _arrow(self, x: float, y: float) -> tuple[Object3D, Object3D]:
        """Make the arrow of a rotor, one metre long; return its shaft and its head."""
        radius = 0.022 * self._span
        with self.element.group().move(x, y, (ROTOR_HEIGHT + 0.01) * self._span):
            shaft = self.element.cylinder(radius, radius, 1.0, SMOOTH).rotate(UPRIGHT, 0.0, 0.0)
            head = self.element.cylinder(0.0, 2.6 * radius, 6.0 * radius, SMOOTH).rotate(UPRIGHT, 0.0, 0.0)
        return shaft.material(THRUST), head.material(THRUST)
