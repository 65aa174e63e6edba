"""Tests of the gyros: steps in flight, and standing offsets at rest.

A step in flight that the rate itself does not explain (`steps`) is the gyro's, unless the vehicle was hit.
Then another gyro, or an attitude that is not made of this gyro, shows it as well. A smaller step counts where
attitude and gyro begin or cease to turn at different rates by as much.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.agreement import SCALE, Agreement, parts_by
from quadftc_replay.inspection.attitude import Creep
from quadftc_replay.inspection.flight import Flight, near_any, rests_of
from quadftc_replay.inspection.found import BODY_AXES, Found, component_name, make_found
from quadftc_replay.inspection.steps import (
    LEVEL,
    LIMITS,
    SEEN,
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
CANDIDATE = 5.0  # standard deviations; of a step that the border of a creep confirms
NEAR = 0.35  # s; between a step and the border of a creep that it makes
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
        steps = steps_of(flight, sensor, LIMITS["gyro"], CANDIDATE)
        kept = [step for step in steps if not any(shows(other, step) for other in others)]
        kept = _without_knocks(flight, name, kept)
        own = [step for step in kept if step.score > LEVEL]
        ask = agreement if number == 0 else None
        # where nobody knows what moves the vehicle, a step needs a witness
        trusted = (flight.phases_known and (ask is None or is_own)) or bool(others)
        witness = None if is_own else ask
        sure = [step for step in own if trusted or (witness is not None and _confirms(witness, step))]
        joined = join_ends([step for step in sure if not step.is_pulse])
        if ask is not None:
            bordered = [(creep, _from_borders(creep, kept)) for creep in left]
            offsets = [step for _, step in bordered if step is not None]
            joined = [step for step in joined if not any(_same(step, each) for each in offsets)] + offsets
            left = [
                creep
                for creep, step in bordered
                if step is None and not any(_explains(each, creep) for each in joined)
            ]
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


def _from_borders(creep: Creep, steps: Sequence[Step]) -> Step | None:
    """The offset that a creep is, if the gyro steps where it begins or ends; None: it does not."""
    borders: list[Step | None] = []
    for moment, size in ((creep.span.start, creep.size), (creep.span.end, -creep.size)):
        near = [
            step
            for step in steps
            if step.axis == creep.axis
            and not step.is_pulse
            and abs(moment - step.onset) < NEAR
            and abs(size - step.size) < SEEN * abs(size)
        ]
        borders.append(max(near, key=lambda step: step.score, default=None))
    begin, end = borders
    best = max(filter(None, borders), key=lambda step: step.score, default=None)
    if best is None:
        return None
    # the rates' difference is as uncertain as the scale that was taken out of it
    weights = np.array([best.sigma, SCALE * creep.size]) ** -2.0
    sizes = np.array([best.size if best is begin else -best.size, creep.size])
    return Step(
        axis=creep.axis,
        onset=begin.onset if begin else creep.span.start,
        end=end.onset if end else creep.end,
        size=float(weights @ sizes / weights.sum()),
        sigma=best.sigma,
        score=LEVEL * max(creep.score, best.score / LEVEL),
    )


def _same(step: Step, other: Step) -> bool:
    """Whether a step begins or ends an offset that is known already."""
    ends = [each for each in (step.onset, step.end) if each is not None]
    borders = [each for each in (other.onset, other.end) if each is not None]
    return step.axis == other.axis and any(abs(a - b) < NEAR for a in ends for b in borders)


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
