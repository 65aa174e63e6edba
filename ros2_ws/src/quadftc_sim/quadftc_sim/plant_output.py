# pyright: basic
"""The publishers of the plant node."""

from __future__ import annotations

import math
from collections.abc import Callable

from quadftc_ros.motion_wire import OdometryWire, PositionSampleWire, RotorsWire
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import EARTH_FRAME
from quadftc_ros.wire import FieldWire, ImuWire, PressureWire, VectorWire, clock_message
from quadftc_sim.simulator import Emission
from quadftc_sim.vehicle_simulation import VehicleSimulation


class PlantOutput:
    """What the plant publishes of an emission: the IMU sample at once, the truth when nobody waits for it.

    ``each_sample()`` is called after each emission. ``flight`` is a vehicle in free flight.
    """

    def __init__(
        self, node: GraphNode, each_sample: Callable[[], None], flight: VehicleSimulation | None
    ) -> None:
        self._node, self._each_sample = node, each_sample
        self._publish_imu, self._imu = node.publishes("plant/imu"), ImuWire(node.imu_frame)
        body = VectorWire(node.base_frame)
        self._truth = (
            (node.publishes("plant/attitude"), VectorWire(EARTH_FRAME), "angles"),
            (node.publishes("plant/rate"), body, "body_rate"),
            (node.publishes("disturbance/applied"), body, "disturbance"),
        )
        self._flight = FlightOutput(node, flight) if flight is not None else None
        self._publish_clock = node.publishes("/clock") if node.lockstep else None
        self._stamp_ns = 0  # of the last emission
        self.pending: Emission | None = None  # whose truth is still to be published

    def emit(self, emission: Emission | None) -> None:
        """Publish clock and sample; in real time the truth waits for `show_truth`. None: the flight ended."""
        self.show_truth()
        if emission is None:
            self._node.diagnostics.changed = True
            self._node.sampled(self._stamp_ns)
            return
        if self._publish_clock is not None:
            self._publish_clock(clock_message(emission.stamp_ns))
        if self._flight is not None:
            self._flight.show_sensors(emission)
        if emission.sample is not None:  # before the truth, as others wait for it
            self._publish_imu(self._imu(emission.sample_stamp_ns, emission.sample))
        self.pending, self._stamp_ns = emission, emission.stamp_ns
        if self._publish_clock is not None:
            self.show_truth()

    def show_truth(self) -> None:
        """Publish the truth of the last emission, if that has not been done."""
        if (emission := self.pending) is None:
            return
        self.pending = None
        for publish, wire, name in self._truth:
            publish(wire(emission.stamp_ns, getattr(emission, name)))
        if self._flight is not None:
            self._flight.show_truth(emission)
        self._node.sampled(emission.stamp_ns)
        self._each_sample()


class FlightOutput:
    """What the plant publishes of an emission in free flight besides."""

    def __init__(self, node: GraphNode, law: VehicleSimulation) -> None:
        rotors, sensor = law.plant.command_size, law.position and law.position.sensor
        self._publish_odometry = node.publishes("plant/odometry")
        self._odometry = OdometryWire(node.base_frame)
        self._publish_speeds = node.publishes("rotors/speed")
        self._speeds = RotorsWire(rotors, node.base_frame)
        self._publish_wind, self._wind = node.publishes("wind/applied"), VectorWire(EARTH_FRAME)
        self._publish_place = node.publishes("position/data")
        self._place = sensor and PositionSampleWire(
            max(sensor.noise), max(sensor.velocity_noise), sensor.gives_velocity
        )
        field, pressure = law.magnetometer, law.barometer
        self._publish_field = node.publishes("imu/mag") if field else None
        self._field = field and FieldWire(node.imu_frame, math.hypot(field.noise, field.hard_iron))
        self._publish_pressure = node.publishes("imu/static_pressure") if pressure else None
        self._pressure = pressure and PressureWire(
            node.imu_frame, math.hypot(pressure.noise, pressure.wander)
        )

    def show_sensors(self, emission: Emission) -> None:
        """Publish what position sensor, magnetometer and barometer say now."""
        if self._place is not None and emission.place is not None and emission.place.there:
            self._publish_place(self._place(emission.place_stamp_ns, emission.place))
        if emission.field is not None and self._publish_field and self._field:
            self._publish_field(self._field(emission.stamp_ns, emission.field))
        if emission.pressure is not None and self._publish_pressure and self._pressure:
            self._publish_pressure(self._pressure(emission.stamp_ns, emission.pressure))

    def show_truth(self, emission: Emission) -> None:
        """Publish the true motion of vehicle, rotors and air."""
        motion, stamp_ns = emission.flight, emission.stamp_ns
        assert motion is not None
        self._publish_odometry(
            self._odometry(stamp_ns, motion.position, motion.q_xyzw, motion.body_velocity, emission.body_rate)
        )
        self._publish_speeds(self._speeds(stamp_ns, motion.speeds))
        self._publish_wind(self._wind(stamp_ns, motion.wind))
