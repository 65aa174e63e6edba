"""The conditions of a whole scheme, in sections, and the verdict.

The bounds that they are held against come from a scenario as it is written, or from a recorded run.
"""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
from pydantic_core import to_json

from quadftc_control.reference import combined
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_model.rotations import body_rates, quaternion_from_euler
from quadftc_model.samples import AttitudeReference, ImuSample
from quadftc_model.stepper import seconds
from quadftc_sim.assembly import period_ns, sample_count
from quadftc_sim.injector import FaultInjector
from quadftc_theory.conditions import Bound, Circumstances, Condition, Floats, Series, Trace, judge
from quadftc_theory.controller_conditions import estimation_error
from quadftc_theory.linear_model import attitude_model, structure_conditions
from quadftc_theory.rotor_conditions import rotor_conditions

FAULT_RATE = 50.0  # Hz; at which the scheduled faults are looked at
GROWN = 0.99  # 1; share of its peak at which a fault counts as grown
REFERENCE = "given: as on the reference"


@dataclasses.dataclass(frozen=True)
class Section:
    """Conditions that belong together."""

    title: str
    conditions: tuple[Condition, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class CheckReport:
    """What was found."""

    scenario: str
    scheme: str
    bag: str | None  # of the recorded run
    sections: tuple[Section, ...]
    given: Circumstances  # the bounds that were used

    @property
    def failed(self) -> list[str]:
        """Names of the conditions that fail and that the scheme needs."""
        return [item.name for section in self.sections for item in section.conditions if item.failed]

    @property
    def passed(self) -> bool:
        """Whether nothing fails that the scheme needs."""
        return not self.failed

    def to_dict(self) -> dict[str, object]:
        """Ready for JSON; None for what is not finite."""
        found = {name: getattr(self, name) for name in ("scenario", "scheme", "bag", "passed", "sections")}
        found["bounds"] = self.given.bounds
        return json.loads(to_json(found, inf_nan_mode="null", fallback=lambda scalar: scalar.item()))


def check_scenario(scenario: Scenario, scheme: Scheme) -> CheckReport:
    """Judge a scheme in a scenario, without flying it."""
    return _check(scenario, scheme, circumstances(scenario, scheme))


def check_run(run: RecordedRun) -> CheckReport:
    """Judge the scheme of a recorded run: with the bounds of the recording, and along it."""
    trace = trace_of_run(run)
    given = circumstances_of_run(run, trace)
    report = _check(run.scenario, run.scheme, given)
    laws = (run.scheme.observer.law, run.scheme.controller.law)
    found = tuple(item for law in laws for item in judge(law, given, along=trace))
    along = (Section("along the recorded run", found),) if found else ()
    return dataclasses.replace(report, bag=str(run.path), sections=report.sections + along)


def _check(scenario: Scenario, scheme: Scheme, given: Circumstances) -> CheckReport:
    roles = ("fault observer", "disturbance observer", "controller")
    parts = (scheme.observer, scheme.disturbance_observer, scheme.controller)
    sections = [
        Section(f"{role}: {part.kind}", tuple(judge(part.law, given)))
        for role, part in zip(roles, parts, strict=True)
    ]
    if scheme.observer.kind != "none":
        title = "the paper's own set-up, y = (roll, pitch, yaw), q = 3; not used here"
        sections.append(Section(title, tuple(structure_conditions(attitude_model("angles"), needed=False))))
    if scenario.plant.flies:
        found = tuple(rotor_conditions(given.vehicle, _rotors_off(scenario)))
        sections.append(Section("rotors: what the vehicle flies on without", found))
    return CheckReport(scenario.name, scheme.name, None, tuple(sections), given)


def _rotors_off(scenario: Scenario) -> list[int]:
    """Rotors (0, 1, ...) that a fault of the scenario turns off."""
    injections = [fault.injection for fault in scenario.faults]
    off = [each.mask for each in injections if each.channel == "rotor" and each.kind == "off"]
    return [int(rotor) for rotor in np.flatnonzero(np.any(off, axis=0))] if off else []


def circumstances(scenario: Scenario, scheme: Scheme) -> Circumstances:
    """Bounds from the scenario: its faults, disturbances and sensors; motion as on its reference."""
    sensor, dt = scenario.sensor, seconds(period_ns(scenario.rate))
    time, motion = _motion(scenario, scenario.rate)
    rates: Floats = body_rates(motion.angles, motion.rates)
    disturbance = _disturbance(scenario, time, rates)
    generator = np.random.default_rng(scenario.seed)
    noise: Floats = sensor.gyro_noise / math.sqrt(dt) * generator.standard_normal(rates.shape)
    error = estimation_error(scheme.disturbance_observer.law, disturbance, noise, dt)
    (fault, growth, length), given = _attitude_faults(scenario), "given: scheduled faults"
    accelerations = tuple(np.max(np.abs(motion.accelerations), axis=0).tolist())
    return Circumstances(
        vehicle=scenario.plant.vehicle,
        dt=dt,
        duration=scenario.duration,
        faulty_channels=tuple(sorted({each.injection.channel for each in scenario.faults})),
        tilt=Bound(float(np.max(np.abs(motion.angles[:, :2]))), "rad", REFERENCE),
        body_rate=Bound(_largest_norm(rates), "rad/s", REFERENCE),
        acceleration=Bound(accelerations, "rad/s^2", REFERENCE),
        fault=Bound(fault, "rad", given),
        fault_growth=Bound(growth, "rad/s", given),
        fault_length=Bound(length, "s", given),
        gyro_bias=Bound(sensor.gyro_bias, "rad/s", "given: sensor"),
        gyro_noise=Bound(sensor.gyro_noise, "rad/sqrt(s)", "given: sensor"),
        attitude_noise=Bound(sensor.attitude_noise, "rad", "given: sensor"),
        disturbance=Series(disturbance, "rad/s^2", "given: disturbances, and drag on the reference"),
        disturbance_error=Series(error, "rad/s^2", "computed: observer run on that disturbance"),
    )


def trace_of_run(run: RecordedRun) -> Trace:
    """Return the delivered samples of a run."""
    imu, flight = run.bag.series("imu/data"), run.flight
    _, rows, there = np.intersect1d(imu.stamp_ns, flight.stamp_ns, return_indices=True)
    attitude, gyro = imu["orientation_xyzw"][rows].copy(), imu["angular_velocity"][rows].copy()
    attitude[imu["orientation_covariance"][rows][:, 0] == -1.0] = np.nan  # absent, by REP-145
    gyro[imu["angular_velocity_covariance"][rows][:, 0] == -1.0] = np.nan
    names = ("stamp_ns", "torque", "angles", "body_rate", "sliding_variable", "saturated")
    return Trace(q_xyzw=attitude, gyro=gyro, **{name: getattr(flight, name)[there] for name in names})


def circumstances_of_run(run: RecordedRun, trace: Trace) -> Circumstances:
    """Bounds from a recorded run, where the bag has the truth; from its scenario where it has not."""
    planned, flight = circumstances(run.scenario, run.scheme), run.flight
    drag = planned.vehicle.rotational_drag / run.scenario.plant.inertia * flight.body_rate
    disturbance = flight.disturbance - drag
    changes: dict[str, Bound | Series] = {}  # what the truth tells
    if np.any(np.isfinite(flight.angles)):
        changes["tilt"] = Bound(float(np.nanmax(np.abs(flight.angles[:, :2]))), "rad", "trace")
    if np.any(np.isfinite(flight.body_rate)):
        changes["body_rate"] = Bound(_largest_norm(flight.body_rate), "rad/s", "trace")
        changes["gyro_bias"] = _gyro_bias(trace) or planned.gyro_bias
    if np.any(np.isfinite(flight.fault)):
        changes["fault"] = Bound(_largest_norm(flight.fault), "rad", "trace")
    if len(known := _finite(disturbance)):
        changes["disturbance"] = Series(known, "rad/s^2", "trace, drag included")
    if len(known := _finite(disturbance - flight.disturbance_estimate)):
        changes["disturbance_error"] = Series(known, "rad/s^2", "trace")
    return dataclasses.replace(planned, **changes)


def _motion(scenario: Scenario, rate: float) -> tuple[Floats, AttitudeReference]:
    """Times (n,) [s] at a rate [Hz], and the reference there, (n, 3) each."""
    count = sample_count(scenario.duration, rate)
    time = seconds(period_ns(rate)) * np.arange(count, dtype=np.float64)
    found = combined([part.law for part in scenario.references], time[:, None])
    return time, AttitudeReference(*(np.broadcast_to(each, (count, 3)) for each in found))


def _disturbance(scenario: Scenario, time: Floats, rates: Floats) -> Floats:
    """Lumped disturbance d of (36) (n, 3) [rad/s²]: torques of the scenario, and the drag f leaves out.

    What a wrong model of the inertia adds depends on the torque, and is not in it.
    """
    torque = np.zeros((len(time), 3))
    for part in scenario.disturbances:
        torque += np.array([part.law.at(np.float64(moment)) for moment in time])
    return (torque - scenario.plant.vehicle.rotational_drag * rates) / scenario.plant.inertia


def _attitude_faults(scenario: Scenario) -> tuple[float, float, float]:
    """Largest norm of the attitude fault [rad], slowest growth to a peak [rad/s], longest fault [s]."""
    injector = FaultInjector(scenario.seed, (fault.injection for fault in scenario.faults))
    time, motion = _motion(scenario, FAULT_RATE)
    zeros, there = np.zeros(3), np.asarray(True)
    found = [
        injector.apply(k * period_ns(FAULT_RATE), ImuSample(q, zeros, zeros, there, there, there)).attitude
        for k, q in enumerate(quaternion_from_euler(motion.angles))
    ]
    size = np.abs(np.nan_to_num(np.array(found, np.float64).reshape(-1, 3)))
    growth, length = math.inf, 0.0
    for window in scenario.fault_windows:
        rows = (window.start <= time) & (time < window.stop)
        length = max(length, window.stop - window.start)
        for column in size[rows].T:
            if (peak := column.max(initial=0.0)) > 0.0:
                grown = int(np.argmax(column >= GROWN * peak))
                elapsed = max(float(time[rows][grown]) - window.start, 1.0 / scenario.rate)
                growth = min(growth, float(column[grown]) / elapsed)
    return _largest_norm(size), growth, length


def _gyro_bias(trace: Trace) -> Bound | None:
    """Mean of gyro minus true rate [rad/s], the largest axis; None without a gyro."""
    error = _finite(trace.gyro - trace.body_rate)
    if len(error) == 0:
        return None
    # a mean of noise is not a bias: count it only where it stands out of its own scatter
    mean, scatter = np.mean(error, axis=0), 5.0 * np.std(error, axis=0) / math.sqrt(len(error))
    return Bound(float(np.max(np.where(np.abs(mean) > scatter, np.abs(mean), 0.0))), "rad/s", "trace")


def _finite(vectors: Floats) -> Floats:
    """The rows without NaN or Inf."""
    return vectors[np.all(np.isfinite(vectors), axis=1)]


def _largest_norm(vectors: Floats) -> float:
    return float(np.max(np.linalg.norm(_finite(vectors), axis=1), initial=0.0))
