"""Many flights without a control loop at once: faults, sensors and observers step arrays of flights.

A step of an observer costs NumPy about as much for a dozen flights as for one; for long flights it is
compiled (`quadftc_campaign.batch.scan`). Flights go together that share their stamps and the numbers of the
observer. Those that cannot (a fault withholds samples or has a memory, an estimate cannot be used) are
diagnosed one by one, as `quadftc_replay.diagnose` does it.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.parts import numbers_of, structure_of
from quadftc_fdi.diagnosis import report_flight
from quadftc_fdi.fault_observer import FaultObserver, await_start
from quadftc_model.arrays import rows_of
from quadftc_model.compiled import UNTRACEABLE
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import UNUSABLE, FaultEstimate, FaultObserverInputs, ImuSample, sanitised
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND
from quadftc_replay.diagnose import Diagnosed, diagnose
from quadftc_replay.imu_recording import Recording
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import TRUTH, Injection, fault_generators
from quadftc_sim.injector import FaultDraws, FaultInjector, Faulty

WORTH_COMPILING = 5000  # samples; NumPy takes 0.05 to 0.5 ms for each, the compiler some seconds


class OpenFlight(NamedTuple):
    """What an observer shall diagnose: samples, the faults to put on them, and the seed of these."""

    recording: Recording
    injections: tuple[Injection, ...]
    seed: int


def diagnose_all(flights: Sequence[OpenFlight], laws: Sequence[FaultObserver]) -> list[Diagnosed]:
    """Put the faults on the samples of each flight, and diagnose it with its law."""
    groups: dict[Any, list[int]] = {}
    for place, (flight, law) in enumerate(zip(flights, laws, strict=True)):
        numbers = tuple((path, value.tobytes()) for path, value in numbers_of(law).items())
        key = (flight.recording.stamp_ns.tobytes(), structure_of(law), numbers)
        groups.setdefault(key, []).append(place)
    found: dict[int, Diagnosed] = {}
    for places in groups.values():
        law, together = laws[places[0]], [place for place in places if _is_simple(flights[place])]
        faulty = [inject_at_once(flights[place]) for place in together]
        tried = dict(zip(together, _diagnose_together(law, flights, together, faulty), strict=True))
        for place in places:
            diagnosed = tried.get(place)
            if diagnosed is not None and not diagnosed.unusable:
                found[place] = diagnosed
            else:
                recording, injections, seed = flights[place]
                found[place] = diagnose(recording, law, FaultInjector(seed, injections))
    return [found[place] for place in range(len(flights))]


def inject_at_once(flight: OpenFlight) -> Faulty:
    """Put faults without a memory on all samples of a flight, as `quadftc_sim.injector.inject` on each.

    Every column of the result has the leading axis n.
    """
    imu, stamp_ns = flight.recording.imu, flight.recording.stamp_ns
    time = (stamp_ns - stamp_ns[0]) / NANOSECONDS_PER_SECOND
    step: Any = np.diff(stamp_ns, prepend=stamp_ns[:1])[:, None] / NANOSECONDS_PER_SECOND
    angles = euler_from_quaternion(imu.q_xyzw)
    values = {"attitude": angles, "gyro": imu.body_rate, "accelerometer": imu.specific_force}
    there = dict(zip(values, (imu.attitude_valid, imu.rate_valid, imu.force_valid), strict=True))
    turned = np.zeros(len(time), np.bool_)
    for number, injection in enumerate(flight.injections, start=1):
        channel, elapsed = injection.channel, (time - injection.start)[:, None]
        acts = (injection.start <= time) & (time < injection.stop)
        inputs = FaultInputs(values[channel], elapsed, *_draws(flight.seed, number, acts))
        output = injection.law.step(injection.law.init(values[channel]), inputs, step)[1]
        values[channel] = np.where(acts[:, None] & injection.mask, output.value, values[channel])
        there[channel] = there[channel] & (output.valid | ~acts)
        turned |= acts & (channel == "attitude")
    q_xyzw = np.where(turned[:, None], quaternion_from_euler(values["attitude"]), imu.q_xyzw)
    fault = np.where(turned[:, None], wrap(values["attitude"] - angles), 0.0)
    gyro, force = values["gyro"], values["accelerometer"]
    sample = ImuSample(q_xyzw, gyro, force, *there.values())
    return Faulty(sample, np.ones_like(turned), fault, gyro - imu.body_rate, force - imu.specific_force)


def _draws(seed: int, number: int, acts: NDArray[np.bool_]) -> FaultDraws:
    """Draw the random numbers (n, 3) of a fault for the samples on which it acts; elsewhere they are 0."""
    numbers, count = np.zeros((2, len(acts), 3)), int(np.sum(acts))
    normal, uniform = fault_generators(seed, number)
    numbers[:, acts] = normal.standard_normal((count, 3)), uniform.random((count, 3))
    return FaultDraws(*numbers)


def _is_simple(flight: OpenFlight) -> bool:
    return all(not each.law.has_memory and each.channel != "imu" for each in flight.injections)


def _diagnose_together(
    law: FaultObserver, flights: Sequence[OpenFlight], places: Sequence[int], faulty: Sequence[Faulty]
) -> list[Diagnosed | None]:
    """Diagnose flights with the same stamps; None where one has no valid samples when others have."""
    if not places:
        return []
    recording = flights[places[0]].recording
    seen = sanitised(
        ImuSample(*(np.stack(each, axis=1) for each in zip(*(f.sample for f in faulty), strict=True)))
    )
    complete = seen.attitude_valid & seen.rate_valid  # (n, flights)
    if np.any(complete.any(axis=1) != complete.all(axis=1)):
        return [None] * len(places)
    torque = np.stack([flights[place].recording.torque for place in places], axis=1)
    driven = np.array([flights[place].recording.driven for place in places])
    said = _step_through(law, recording.stamp_ns, seen, torque, driven, complete[:, 0])
    usable = [
        np.all(np.abs(each) < UNUSABLE, axis=(0, 2))  # false for NaN
        for each in (said.fault, said.corrected.q_xyzw, said.corrected.body_rate, *_sizes(said))
    ]
    lanes = [rows_of(said, (slice(None), lane)) for lane in range(len(faulty))]
    return [
        Diagnosed(
            delivered=np.ones(len(recording), np.bool_),
            seen=one.sample,
            overlaid={channel: getattr(one, channel) for channel in TRUTH},
            estimate=own,
            reports=report_flight(law, recording.stamp_ns, own),
            unusable=0 if all(each[lane] for each in usable) else 1,
        )
        for lane, (one, own) in enumerate(zip(faulty, lanes, strict=True))
    ]


def _sizes(said: FaultEstimate) -> list[Any]:
    """Return what is said of sensors in numbers."""
    return [column for sensor in said.sensors or () for column in sensor[1:5]]


def _step_through(
    law: FaultObserver,
    stamp_ns: NDArray[np.int64],
    seen: ImuSample,
    torque: NDArray[np.float64],
    driven: NDArray[np.bool_],
    complete: NDArray[np.bool_],
) -> FaultEstimate:
    """Diagnose samples (n, flights, ...), as `quadftc_fdi.diagnosis.Diagnosis` does those of one flight."""
    dt = np.diff(stamp_ns, prepend=stamp_ns[:1]) / NANOSECONDS_PER_SECOND
    inputs = FaultObserverInputs(seen, torque, driven=np.broadcast_to(driven, torque.shape[:2]))
    edges = [0, *np.flatnonzero(dt > MAX_GAP).tolist(), len(dt)]
    parts: list[FaultEstimate | None] = []  # None: before the observer has started
    waiting: list[ImuSample] = []  # its samples then
    for first, stop in itertools.pairwise(edges):
        start = first + int(np.argmax(np.append(complete[first:stop], True)))
        if first < start:
            parts.append(None)
            waiting.append(rows_of(seen, slice(first, start)))
        if start < stop:
            step = np.append(0.0, dt[start + 1 : stop])
            parts.append(_diagnose_samples(law, rows_of(inputs, slice(start, stop)), step))
    says_more = any(each is not None and each.sensors is not None for each in parts)
    awaiting = (await_start(each, says_more) for each in waiting)
    return _join(np.concatenate, [next(awaiting) if each is None else each for each in parts])


def _diagnose_samples(
    law: FaultObserver, inputs: FaultObserverInputs, dt: NDArray[np.float64]
) -> FaultEstimate:
    """Start an observer on the first of samples (n, flights, ...), and step over all; ``dt[0]`` [s] is 0."""
    if len(dt) >= WORTH_COMPILING:
        from quadftc_campaign.batch.scan import scan

        with contextlib.suppress(*UNTRACEABLE):
            return scan(law, inputs, dt)
    state, said = law.init(rows_of(inputs, 0)), list[FaultEstimate]()
    for row, step in enumerate(dt.tolist()):
        state, estimate = law.step(state, rows_of(inputs, row), step)
        said.append(estimate)
    return _join(np.stack, said)


def _join(how: Callable[..., Any], parts: Sequence[Any]) -> Any:
    """Join nested tuples of arrays, array by array."""
    first: Any = parts[0]
    if isinstance(first, tuple):
        return parts[0].__class__(*(_join(how, each) for each in zip(*parts, strict=True)))
    return None if first is None else how(parts)
