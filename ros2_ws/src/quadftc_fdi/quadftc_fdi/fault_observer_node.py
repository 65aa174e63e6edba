# pyright: basic
"""The fault observer node: estimates the attitude fault and publishes the corrected IMU.

Inputs: imu/data; torque/command (observer (16) of the paper needs the torque that acted), in free flight
rotors/command, rotors/speed and position/data. In real time fault/kept and gyro/kept: restarted in flight,
the node resumes where the one before has died.
Outputs: imu/corrected, fault/estimate, fault/status; diagnosis, in real time with gyro/bias, at 10 Hz and at
once on a change; in free flight rotors/status.
Services: ~/reset (std_srvs/Trigger). A sample whose stamp repeats or goes back is refused and counted.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
from std_msgs.msg import Header

from quadftc_compile.engine import engine_from
from quadftc_fdi.diagnosis import COMPONENTS, Diagnosis, describe_axes, describe_component, watched_sensors
from quadftc_fdi.fault_observer import LastDiagnosis, fault_observer_from, fault_observers
from quadftc_model import samples
from quadftc_model.parameters import parameter
from quadftc_model.samples import ALARMS, FaultEstimate, ImuSample, PositionSample, RotorReading
from quadftc_model.stepper import seconds
from quadftc_ros.conversions import Floats, array_of, stamp_of
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.join import CommandGate, PlaceGate, PlaceParameters, SpeedGate
from quadftc_ros.limits import limits_of
from quadftc_ros.motion_wire import PositionSampleReader, RotorsReader
from quadftc_ros.node import GraphNode
from quadftc_ros.parameters import STAYS, VehicleParameters
from quadftc_ros.rotor_wire import RotorStatusWire
from quadftc_ros.topics import EARTH_FRAME
from quadftc_ros.wire import FaultStatusWire, ImuWire, VectorWire, imu_of, vector_of

RAW_AFTER = 50  # samples in a row without attitude, after which the driver gives none
RAW_IMU = (
    "imu/data has no attitude: start the node quadftc_fdi attitude_estimator on the topic of the driver, "
    "with -r imu/data_raw:=TOPIC; it publishes imu/data"
)
NO_STATES = "declares no faults, it only estimates; bank and isolating declare them"


@dataclasses.dataclass(frozen=True)
class ObserverParameters:
    """Parameters of the node besides those of the observer, which stand behind its name."""

    observer: str = parameter("bank", doc="name of the fault observer; may be changed in flight")


class FaultObserverNode(GraphNode):
    """A fault observer on the stream of IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("fault_observer", **kwargs)
        self.settings.declare(VehicleParameters, read_only=True)
        self.settings.declare_law(ObserverParameters, fault_observers, self._must_keep)
        values, flies = self.settings.values(), self.plant_kind == "free_flight"
        engine = engine_from(values, self.get_logger().info)
        self._diagnosis = Diagnosis(fault_observer_from(values), engine, flies)
        self.settings.on_change(fault_observer_from, self._diagnosis.switch)
        self.limits = limits_of(self._diagnosis.observer.vehicle)
        self._publish_corrected, self._imu = self.publishes("imu/corrected"), ImuWire(self.imu_frame)
        self._publish_estimate, self._earth = self.publishes("fault/estimate"), VectorWire(EARTH_FRAME)
        self._publish_status, self._status = self.publishes("fault/status"), FaultStatusWire(self.imu_frame)
        self._publish_report, self._report = self.publishes("diagnosis"), DiagnosisWire(self.imu_frame)
        if flies:
            self._read_flight()
        else:
            gate = CommandGate(self.mode, self._diagnose, self.diagnostics.count, first=None)
            self.driven_by("imu/data", gate.put_sample, restart=self._diagnosis.restart, decode=imu_of)
            self.reads("torque/command", gate.put_command, decode=vector_of)
        self._kept: dict[str, Any] = {}
        if not self.lockstep:
            self._publish_bias, self._gyro = self.publishes("gyro/bias"), VectorWire(self.imu_frame)
            self.reads("gyro/kept", partial(self._on_kept, "gyro"), decode=vector_of)
            self.reads("fault/kept", partial(self._on_kept, "fault"))
        self._estimate: FaultEstimate | None = None  # the last
        self._alarms: list[bool] = [False] * 3  # elements that are faulty
        self._raw = 0  # samples in a row without attitude
        self._replaced = 0  # estimates that could not be used, up to the last report
        self._introduce()
        self.ready()

    def _introduce(self) -> None:
        """Note which observer it is; what one before it has said no longer holds."""
        self._observer = fault_observers.name_of(type(self._diagnosis.observer))
        self.diagnostics.forget(*(f"attitude fault {axis}" for axis in samples.AXES))
        self.diagnostics.forget(*(f"{component} fault" for component in (*COMPONENTS, "rotor")))
        self.diagnostics.changed = True
        if not self._diagnosis.observer.has_detector and not self.lockstep:
            self.get_logger().warning(f"observer {self._observer} {NO_STATES}")

    def _must_keep(self) -> str:
        """Return why another observer must not take over now; empty: it may."""
        if self.lockstep:
            return STAYS
        return "a fault is confirmed, which another observer would not know" if any(self._alarms) else ""

    def _read_flight(self) -> None:
        """Read what there is in free flight: a sample waits for its position, then for the rotor speeds."""
        vehicle, topic = self._diagnosis.observer.vehicle, "rotors/command"
        rotors = len(vehicle.rotors.positions)
        first = np.full(rotors, vehicle.hover_speed)
        self.settings.declare(PlaceParameters, "position.", read_only=True)
        values = self.settings.values()
        gate = CommandGate(self.mode, self._on_flight, self.diagnostics.count, topic, first)

        def put(stamp_ns: int, sample: ImuSample, place: PositionSample | None) -> None:
            gate.put_sample(stamp_ns, (sample, place))

        self._speeds = SpeedGate(self.mode, self._on_rotors)
        self._publish_rotors = self.publishes("rotors/status")
        self._rotors = RotorStatusWire(rotors, self.base_frame)
        self.reads("rotors/speed", self._speeds.put_speeds, decode=RotorsReader(rotors))
        places = PlaceGate(self.mode, values["position.period"], values["position.delay"], put)
        self.driven_by("imu/data", places.put_sample, restart=self._diagnosis.restart, decode=imu_of)
        self.reads("position/data", places.put_place, decode=PositionSampleReader())
        self.reads(topic, gate.put_command, decode=RotorsReader(rotors))

    def _on_flight(
        self, stamp_ns: int, message: tuple[ImuSample, PositionSample | None], command: Floats
    ) -> None:
        """Take a sample of a free flight, with the speeds [rad/s] commanded before it."""
        self._speeds.put_sample(stamp_ns, (*message, command))

    def _on_rotors(
        self, stamp_ns: int, message: tuple[ImuSample, PositionSample | None, Floats], speeds: Floats | None
    ) -> None:
        """Diagnose a sample of a free flight, with the speeds [rad/s] measured with it."""
        sample, place, command = message
        rotors = RotorReading(command, np.zeros_like(command), np.False_)
        if speeds is not None:
            rotors = RotorReading(command, speeds, np.True_)
        self._diagnose(stamp_ns, sample, rotors=rotors, place=place)

    def _on_kept(self, what: str, stamp_ns: int, value: Any) -> None:
        self._kept[what] = value
        if len(self._kept) < 2:
            return
        status = self._kept["fault"]
        onsets_ns = [stamp_of(Header(stamp=time)) for time in status.onset]
        last = LastDiagnosis(
            fault=array_of(status.estimate),
            std_dev=array_of(status.std_dev),
            faulty=np.isin(status.state, ALARMS),
            gyro_correction=self._kept["gyro"],
            since=np.array([seconds(max(0, stamp_ns - onset)) if onset else 0.0 for onset in onsets_ns]),
        )
        self._diagnosis.offer(stamp_ns, last)

    def _diagnose(
        self,
        stamp_ns: int,
        sample: ImuSample,
        torque: Floats | None = None,
        rotors: RotorReading | None = None,
        place: PositionSample | None = None,
    ) -> None:
        replaced, resumed = self._diagnosis.replaced, self._diagnosis.resumed
        observer = self._diagnosis.observer
        estimate = self._diagnosis.diagnose(stamp_ns, sample, torque, rotors, place)
        if estimate is None:
            self.diagnostics.count("imu/data: stamp repeated or went back")
            return
        # others wait for the corrected sample: publish it first
        self._publish_corrected(self._imu(stamp_ns, estimate.corrected))
        if rotors is not None:
            self._publish_rotors(self._rotors(stamp_ns, estimate.rotors))
        self._publish_estimate(self._earth(stamp_ns, estimate.fault))
        self._publish_status(self._status(stamp_ns, estimate))
        report = self._diagnosis.report(stamp_ns, estimate)
        if report is not None:
            self._publish_report(self._report(report))
            bias = None if self.lockstep else self._diagnosis.gyro_bias(sample, estimate)
            if bias is not None:
                self._publish_bias(self._gyro(stamp_ns, bias))
        if self._diagnosis.resumed > resumed:
            self.get_logger().info("resumes where a fault observer has died")
        if type(self._diagnosis.observer) is not type(observer):
            self._introduce()
        if self._diagnosis.replaced > replaced:
            self.diagnostics.count("the estimate was unusable: the observer restarts")
        self._watch_input(sample)
        self._estimate = estimate
        self._watch_alarms(estimate)
        self.sampled(stamp_ns)

    def _watch_input(self, sample: ImuSample) -> None:
        """Count what is absent or unusable, and report a driver that gives no attitude."""
        if not samples.has_rate(sample):
            self.diagnostics.count("imu/data: body rate absent or unusable")
        if not samples.has_attitude(sample):
            self.diagnostics.count("imu/data: attitude absent or unusable")
            self._raw += 1
            if self._raw == RAW_AFTER:
                self.diagnostics.report("imu", WARN, RAW_IMU)
                self.get_logger().warning(RAW_IMU)
        elif self._raw:
            self._raw = 0
            self.diagnostics.forget("imu")

    def _watch_alarms(self, estimate: FaultEstimate) -> None:
        """Report at once when an alarm begins or ends; suspicions come and go."""
        states = [estimate.state, *(sensor.state for sensor in estimate.sensors or ())]
        states += [] if estimate.rotors is None else [estimate.rotors.state]
        alarms = [state in ALARMS for column in states for state in column.tolist()]
        if alarms != self._alarms:
            self._alarms = alarms
            self.diagnostics.changed = True

    def report(self) -> None:
        """Report the observer, and the fault of each axis of the attitude and of each other component."""
        law, state = self._diagnosis.observer, self._diagnosis.state
        self._report_observer()
        if self._estimate is None or self._observer == "none":
            return
        more = {} if state is None else law.describe(state)
        for axis, state, values in describe_axes(self._estimate, more):
            if law.has_detector:
                self._report_fault(f"attitude fault {axis}", state, values)
            else:
                self.diagnostics.report(f"attitude fault {axis}", OK, "not judged", **values)
        for component, sensor in watched_sensors(law, self._estimate).items():
            if component != "attitude":
                self._report_fault(f"{component} fault", *describe_component(component, sensor))

    def _report_observer(self) -> None:
        """Report which observer it is, and whether it had to restart since the last report."""
        restarts = self._diagnosis.replaced
        if restarts > self._replaced:
            self.diagnostics.report(
                "observer", ERROR, f"{self._observer} restarts: its estimate was unusable"
            )
        elif self._diagnosis.observer.has_detector:
            self.diagnostics.report("observer", OK, self._observer)
        else:
            self.diagnostics.report("observer", WARN, f"{self._observer} {NO_STATES}")
        self._replaced = restarts

    def _report_fault(self, part: str, state: int, values: dict[str, str]) -> None:
        level = OK if state in (samples.STARTING, samples.HEALTHY) else WARN
        self.diagnostics.report(part, level, samples.FAULT_STATE_NAMES[state], **values)


main = partial(run_node, FaultObserverNode)
