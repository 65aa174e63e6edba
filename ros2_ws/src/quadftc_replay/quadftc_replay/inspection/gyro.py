"""Tests of the gyros: steps in flight, and standing offsets at rest.

A step in flight that the rate itself does not explain (`steps`) is the gyro's, unless the vehicle was hit.
Then another gyro, or an attitude that is not made of this gyro, shows it as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.agreement import Agreement, parts_by
from quadftc_replay.inspection.attitude import Creep
from quadftc_replay.inspection.flight import Flight, near_any, rests_of
from quadftc_replay.inspection.found import BODY_AXES, Found, component_name, make_found
from quadftc_replay.inspection.steps import (
    LIMITS,
    Step,
    begins_within,
    join_ends,
    shows,
    step_found,
    steps_of,
)

REST = 0.02  # rad/s; largest scatter of a gyro at rest
OFFSET = 0.1  # rad/s; a standing offset that is a fault: what calibrated gyros do not have
MANY = 8  # steps of one axis that are noise, not offsets
TOGETHER = 0.012  # s; steps of several axes within it have one cause


def gyro_findings(
    flight: Flight,
    gyros: Mapping[str, Signal],
    agreement: Agreement | None,
    creeps: list[Creep],
    is_own: bool,
) -> tuple[list[Found], list[Creep]]:
    """Test all gyros (name: samples), the main one first; of that one the attitude tells, too.

    ``is_own``: the attitude is computed from the gyro. Returns findings, and the creeps that none explains.
    """
    found: list[Found] = []
    left = creeps
    for number, (name, sensor) in enumerate(gyros.items()):
        others = [gyros[other] for other in gyros if other != name]
        steps = steps_of(flight, sensor, LIMITS["gyro"])
        own = [step for step in steps if not any(shows(other, step) for other in others)]
        own = _without_knocks(flight, name, own)
        ask = agreement if number == 0 else None
        # where nobody knows what moves the vehicle, a step needs a witness
        trusted = (flight.phases_known and (ask is None or is_own)) or bool(others)
        witness = None if is_own else ask
        sure = [step for step in own if trusted or (witness is not None and _confirms(witness, step))]
        joined = join_ends([step for step in sure if not step.is_pulse])
        if ask is not None:
            left = [creep for creep in left if not any(_explains(each, creep) for each in joined)]
        found += _step_findings(flight, name, sensor, joined, has_witness=bool(others) or ask is not None)
        if trusted:
            found += _pulse_findings(name, [step for step in own if step.is_pulse])
        found += _rest_findings(flight, name, sensor)
    return found, left


def _without_knocks(flight: Flight, name: str, steps: Sequence[Step]) -> list[Step]:
    """Leave out steps at which the accelerometer beside the gyro jumps, too: a touch-down makes both."""
    force = flight.log.accelerometers.get(name)
    if not steps or force is None:
        return list(steps)
    knocks = np.array([each.onset for each in steps_of(flight, force, LIMITS["accelerometer"])])
    moments = np.array([step.onset for step in steps])
    return [step for step, near in zip(steps, near_any(moments, knocks, TOGETHER), strict=True) if not near]


def _confirms(witness: Agreement, step: Step) -> bool:
    """Whether an independent attitude does not turn as the gyro says from a step on."""
    return parts_by(witness, step.axis, step.onset, step.size)


def _explains(step: Step, creep: Creep) -> bool:
    """Whether a step explains that attitude and gyro turn at different rates."""
    end = np.inf if step.end is None else step.end
    overlap = step.onset - 1.0 <= creep.span.end and creep.span.start <= end + 1.0
    return step.axis == creep.axis and overlap and abs(creep.size - step.size) < abs(step.size)


def _is_alone(step: Step, steps: Sequence[Step]) -> bool:
    """Whether no other axis steps at the same time."""
    at_once = (each for each in steps if abs(each.onset - step.onset) < TOGETHER)
    return all(each.axis == step.axis for each in at_once)


def _pulse_findings(name: str, pulses: Sequence[Step]) -> Iterator[Found]:
    """Say where readings are wrong one by one."""
    for axis, element in enumerate(BODY_AXES):
        own = [step for step in pulses if step.axis == axis and _is_alone(step, pulses)]
        if len(own) > MANY:
            largest = max(abs(step.size) for step in own)
            said = f"{len(own)} single readings are off by up to {largest:.3g} rad/s, on this axis alone"
            yield make_found(
                *(component_name("gyro", name), element, "noise", own[0].onset),
                end_s=own[-1].onset,
                size=largest,
                unit="rad/s",
                evidence=(said,),
            )


def _step_findings(
    flight: Flight, name: str, sensor: Signal, steps: Sequence[Step], has_witness: bool
) -> Iterator[Found]:
    component = component_name("gyro", name)
    for axis, element in enumerate(BODY_AXES):
        own = [step for step in steps if step.axis == axis]
        if len(own) > MANY:
            said = f"{len(own)} steps of up to {max(abs(step.size) for step in own):.3g} rad/s in flight"
            begin, end = own[0].onset, own[-1].onset
            yield make_found(component, element, "noise", begin, end_s=end, evidence=(said,))
            continue
        for step in own:
            is_sure = has_witness or _is_alone(step, steps)
            yield step_found(flight, component, sensor, LIMITS["gyro"], step, is_sure)


def _rest_findings(flight: Flight, name: str, sensor: Signal) -> Iterator[Found]:
    """Say where a gyro reads a rate while the vehicle stands."""
    rests = rests_of(flight, sensor, REST) if flight.phases_known else []
    if not rests:
        return
    means = np.array([each.mean for each in rests])
    for axis, element in enumerate(BODY_AXES):
        off = np.abs(means[:, axis]) > OFFSET
        if not (off[-1] or off.mean() > 0.5):
            continue
        first = int(np.argmax(off))
        size, onset = float(np.median(means[off, axis])), rests[first].start
        said = [f"it reads {size:+.3g} rad/s while the vehicle stands still"]
        if first > 0:  # it was right before
            between = rests[first - 1].end, rests[first].start
            onset = begins_within(flight, sensor, LIMITS["gyro"], axis, size, between)
            said.append(f"until {between[0]:.2f} s it was right, from {between[1]:.2f} s on it is not")
        yield make_found(
            *(component_name("gyro", name), element, "offset", onset),
            size=size,
            sigma=float(means[off, axis].std()),
            unit="rad/s",
            evidence=tuple(said),
            is_direct=True,
        )
