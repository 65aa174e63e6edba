# pyright: basic
"""The scene node: a vehicle that flies, for RViz and Foxglove, 30 times a second.

Inputs: plant/attitude, in free flight plant/odometry (the truth, where there is one); imu/data,
imu/corrected; position/data, where there is no truth; torque/command or rotors/speed, rotors/fault. The last
message of each counts.
Outputs: scene/truth, scene/measured, scene/corrected (geometry_msgs/PoseStamped); scene/markers
(visualization_msgs/MarkerArray); robot_description (std_msgs/String, latched: a URDF); /tf, where tf2_msgs is
installed: base_link and imu_link, and base_link_measured, base_link_corrected, all in map.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose, PoseStamped, TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from quadftc_bags.interfaces import load_message_class
from quadftc_model.parameters import parameter
from quadftc_model.rotations import quaternion_from_euler, quaternion_product, to_earth
from quadftc_model.shape import Part, parts_of, rgba, urdf_of
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.conversions import Floats, time_message
from quadftc_ros.executor import run_node
from quadftc_ros.latest import ROLES, Latest
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import EARTH_FRAME, TOPICS

TRANSFORMS = "tf2_msgs/msg/TFMessage"
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # of what it reads
SHOWN = QoSProfile(depth=1)  # reliable, as RViz asks for unless told otherwise; takes best effort, too
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
GHOSTS = {"measured": "#d55e00", "corrected": "#0072b2"}  # vermilion, blue (Okabe and Ito, 2008)
GHOST_ALPHA = 0.35  # 1
THRUST, THRUST_WIDTH = "#009e73", 0.05  # colour; width over the span of the vehicle
THRUST_LENGTH = 1.0  # 1; of the arrow of a rotor that carries its share of the weight, over the span
LIFETIME = 1  # s; markers vanish when nothing comes
Q_LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
Q_UP = quaternion_from_euler(np.array([0.0, -0.5 * np.pi, 0.0]))  # turns x, the axis of arrows, to z


@dataclasses.dataclass(frozen=True)
class SceneParameters:
    """Parameters of the scene."""

    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")
    frame_rate: float = parameter(30.0, unit="Hz", low=1.0, high=60.0, doc="pictures a second")


class SceneNode(GraphNode):
    """Poses, markers and transforms of a vehicle."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("scene", **kwargs)
        self.settings.declare(SceneParameters, read_only=True)
        values = self.settings.values()
        self._vehicle = load_vehicle(values["vehicle"])
        self._latest = Latest(self._vehicle, self.plant_kind)
        for topic in Latest.topics(self.plant_kind):
            kind = load_message_class(TOPICS[topic].type_name)
            self.guard.subscribe(topic, kind, partial(self._latest.put, topic), LATEST)
        self._poses = {role: self.create_publisher(PoseStamped, f"scene/{role}", SHOWN) for role in ROLES}
        self._markers = self.create_publisher(MarkerArray, "scene/markers", SHOWN)
        self._shapes = {role: self._make_shape(role) for role in ROLES}
        self._arrows = self._make_arrows()
        self._description = self.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=urdf_of(self._vehicle)))
        try:
            self._transforms: Any = load_message_class(TRANSFORMS)
            self._broadcast = self.create_publisher(self._transforms, "/tf", QoSProfile(depth=100)).publish
        except ValueError:  # not installed
            self._transforms = None
        self._drawn_ns = 0
        self._timer = self.create_timer(1.0 / values["frame_rate"], self._draw, clock=self.steady_clock)
        self.ready()

    def _draw(self) -> None:
        """Publish a picture, if anything has come since the last."""
        stamp_ns = self._latest.stamp_ns()
        if not self.active or stamp_ns == self._drawn_ns:
            return
        self._drawn_ns = stamp_ns
        position, attitudes = self._latest.position(), self._latest.attitudes()
        poses = {role: _pose(position, q_xyzw) for role, q_xyzw in attitudes.items()}
        for role, pose in poses.items():
            message = PoseStamped(pose=pose)
            message.header.stamp, message.header.frame_id = time_message(stamp_ns), EARTH_FRAME
            self._poses[role].publish(message)
        if self._markers.get_subscription_count():
            self._publish_markers(stamp_ns, position, attitudes)
        if self._transforms is not None:
            self._broadcast(self._transforms(transforms=self._frames(stamp_ns, poses)))

    def _frames(self, stamp_ns: int, poses: dict[str, Pose]) -> list[TransformStamped]:
        """Return where the frames are; ``base_link`` is the truth, without one what is corrected."""
        true = poses.get("truth") or poses.get("corrected")
        frames = [(EARTH_FRAME, f"{self.base_frame}_{role}", poses[role]) for role in GHOSTS if role in poses]
        if true is not None:
            imu = _pose(self._vehicle.aerodynamics.imu_position, Q_LEVEL)
            frames += [(EARTH_FRAME, self.base_frame, true), (self.base_frame, self.imu_frame, imu)]
        return [_transform(stamp_ns, *frame) for frame in frames]

    def _publish_markers(self, stamp_ns: int, position: Floats, attitudes: dict[str, Floats]) -> None:
        stamp, shown = time_message(stamp_ns), list[Marker]()
        for role, q_xyzw in attitudes.items():
            for part, marker in self._shapes[role]:
                turned = quaternion_from_euler(np.array([0.0, 0.0, part.yaw]))
                place = position + to_earth(q_xyzw, np.array(part.position))
                marker.pose = _pose(place, quaternion_product(q_xyzw, turned))
                shown.append(marker)
        body = attitudes.get("truth", attitudes.get("corrected"))
        if body is not None:
            shown += self._place_arrows(position, body)
        for marker in shown:
            marker.header.stamp = stamp
        self._markers.publish(MarkerArray(markers=shown))

    def _place_arrows(self, position: Floats, q_xyzw: Floats) -> list[Marker]:
        """Put an arrow above each rotor, as long as its thrust is large."""
        share = self._vehicle.weight / len(self._arrows)
        for (part, arrow), thrust in zip(self._arrows, self._latest.thrusts().tolist(), strict=True):
            place = position + to_earth(q_xyzw, np.array(part.position))
            arrow.pose = _pose(place, quaternion_product(q_xyzw, Q_UP))
            arrow.scale.x = max(1e-3, THRUST_LENGTH * self._span * thrust / share)
        return [arrow for _, arrow in self._arrows]

    @property
    def _span(self) -> float:
        """Distance of the farthest rotor [m]."""
        return float(np.max(np.linalg.norm(self._vehicle.rotors.positions, axis=-1)))

    def _make_shape(self, role: str) -> list[tuple[Part, Marker]]:
        """Make the markers of a vehicle: of a ghost only arms and rotors, in one colour."""
        kinds = {"box": Marker.CUBE, "cylinder": Marker.CYLINDER}
        parts = [
            part for part in parts_of(self._vehicle) if role == "truth" or part.name[:3] in ("arm", "rot")
        ]
        shape: list[tuple[Part, Marker]] = []
        for number, part in enumerate(parts):
            colour, alpha = (GHOSTS[role], GHOST_ALPHA) if role in GHOSTS else (part.colour, part.alpha)
            marker = _marker(role, number, kinds[part.kind], colour, alpha)
            marker.scale.x, marker.scale.y, marker.scale.z = part.size
            shape.append((part, marker))
        return shape

    def _make_arrows(self) -> list[tuple[Part, Marker]]:
        rotors = [part for part in parts_of(self._vehicle) if part.name.startswith("rotor_")]
        arrows = [(part, _marker("thrust", k, Marker.ARROW, THRUST, 1.0)) for k, part in enumerate(rotors)]
        for _, arrow in arrows:
            arrow.scale.y = arrow.scale.z = THRUST_WIDTH * self._span
        return arrows


def _marker(role: str, number: int, kind: int, colour: str, alpha: float) -> Marker:
    marker = Marker(ns=role, id=number, type=kind, action=Marker.ADD)
    marker.header.frame_id = EARTH_FRAME
    marker.lifetime.sec = LIFETIME
    red, green, blue, opaque = rgba(colour, alpha)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=opaque)
    return marker


def _pose(position: Floats, q_xyzw: Floats) -> Pose:
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = position.tolist()
    turn = pose.orientation
    turn.x, turn.y, turn.z, turn.w = q_xyzw.tolist()
    return pose


def _transform(stamp_ns: int, parent: str, child: str, pose: Pose) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.stamp, message.header.frame_id = time_message(stamp_ns), parent
    place, moved = pose.position, message.transform.translation
    moved.x, moved.y, moved.z = place.x, place.y, place.z
    message.transform.rotation = pose.orientation
    return message


main = partial(run_node, SceneNode)
