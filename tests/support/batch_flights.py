"""Flights of the batch engine beside those of the closed loop."""

import dataclasses

import jax
import numpy as np
import pytest

from quadftc_campaign.batch.compiled import take
from quadftc_campaign.batch.engine import Engine
from quadftc_campaign.batch.inputs import InputSource
from quadftc_campaign.batch.loop_step import ClosedLoop, may_start_late
from quadftc_campaign.batch.records import fault_records, flight_record
from quadftc_campaign.batch.tally import Outcome, schedule_of, update_tally
from quadftc_campaign.flights import parts_of
from quadftc_flight.flight import NO_STATE, VECTORS, onset_ns, unknown_flight
from quadftc_flight.metrics import flight_metrics, look_up
from quadftc_model.stepper import seconds
from quadftc_sim.assembly import EPOCH_NS

AGREE = 1e-9  # in SI
ROUNDED = {"fault_std_dev": 1e-8}  # the square root of a variance that may be zero to rounding


def flight_of(trace, period_ns):
    """The flight of one lane, as `quadftc_flight.closed_loop.fly` gives it."""
    there = np.asarray(trace.delivered, np.bool_)
    stamp_ns = EPOCH_NS + period_ns * np.arange(len(there))
    estimate, output, column = trace.estimate, trace.output, there[:, None]
    onsets = onset_ns(stamp_ns[:, None], np.asarray(estimate.onset_age, np.float64))
    motion = {name: getattr(trace, name) for name in ("angles", "body_rate", "disturbance")}
    known = {name: getattr(trace, name) for name in ("reference", "fault", "disturbance_estimate")}
    known |= {name: getattr(output, name) for name in ("torque", "error", "sliding_variable")}
    known |= {"fault_estimate": estimate.fault, "fault_std_dev": estimate.std_dev}
    if trace.position is not None:
        motion["position"] = trace.position
        known |= {name: getattr(trace, name) for name in ("position_reference", "position_estimate")}
    return dataclasses.replace(
        unknown_flight(stamp_ns),
        delivered=there,
        fault_state=np.where(column, estimate.state, NO_STATE).astype(np.uint8),
        fault_onset_ns=np.where(column, onsets, 0),
        saturated=column & output.saturated,
        **{name: np.asarray(values, np.float64) for name, values in motion.items()},
        **{name: np.where(column, values, np.nan) for name, values in known.items()},
    )


def traced(parts, scenarios, engine=None):
    """Outcome and flight of each, with every sample."""
    events = [(*each.fault_events, *each.rotor_events) for each in scenarios]
    outcomes = (engine or Engine()).fly(parts, events, traced=True)
    pairs = zip(outcomes, parts, strict=True)
    return [(outcome, flight_of(outcome.trace, one.loop.period_ns)) for outcome, one in pairs]


def stepped(scenario, scheme=None):
    """Outcome and flight of the batch's step in NumPy, which takes no compiling."""
    one = parts_of(scenario, scheme)
    loop, rotors = one.loop, one.loop.plant.command_size if one.loop.plant.flies else 0
    schedule = schedule_of([(*scenario.fault_events, *scenario.rotor_events)], rotors)
    source = InputSource([one], np.dtype(float))
    inputs, times = source.next(loop.count)
    first, inputs, schedule = take((source.first, inputs, schedule), 0, axis=-1)
    given = [take((inputs, times), row) for row in range(loop.count)]
    closed, begun = ClosedLoop(loop, may_start_late(loop)), loop.sensor.delay + 1
    state, row = closed.begin(first, given[:begun])
    rows, tally = [row], update_tally(None, row, schedule)
    for each in given[begun:]:
        state, row = closed.step(state, *each)
        rows.append(row)
        tally = update_tally(tally, row, schedule)
    period = seconds(loop.period_ns)
    marks = {**tally.ever, **tally.largest, **tally.smallest, **tally.last}
    trace = jax.tree.map(lambda *leaves: np.stack(leaves), *rows)
    span = (loop.count - begun) * period
    return Outcome(tally.sums, marks, span, period, None, trace), flight_of(trace, loop.period_ns)


def assert_same_flight(flight, expected, rtol=0.0):
    for name in VECTORS:
        if name.startswith(("attitude_", "gyro_", "accelerometer_")):  # the engine makes no reports
            continue
        bound = ROUNDED.get(name, AGREE)
        np.testing.assert_allclose(
            getattr(flight, name), getattr(expected, name), rtol=rtol, atol=bound, err_msg=name
        )
    for name in ("stamp_ns", "delivered", "fault_state", "saturated"):
        np.testing.assert_array_equal(getattr(flight, name), getattr(expected, name), err_msg=name)
    assert np.max(np.abs(flight.fault_onset_ns - expected.fault_onset_ns)) <= 1000  # ns


def assert_same_metrics(outcome, flight, scenario, tolerance=1e-9):
    events = scenario.fault_events, scenario.rotor_events
    expected = flight_metrics(flight, scenario.fault_windows, *events)
    diagnosis = expected["diagnosis"]
    for name, value in flight_record(outcome).items():
        metric, _, axis = name.partition(".")
        if metric in ("sensors", "rotors"):
            wanted = look_up(expected, name)
            wanted = sum(wanted.values()) if isinstance(wanted, dict) else wanted
            assert value == pytest.approx(wanted, rel=1e-6, abs=tolerance), name
            continue
        there = expected if metric in expected else diagnosis
        if metric in ("finite", "healthy_estimate_max_deg"):
            continue
        wanted = there[metric][axis] if axis else there[metric]
        assert value == pytest.approx(wanted, rel=1e-6, abs=tolerance), name
    records = fault_records(outcome, [*events[0], *events[1]])
    of_attitude, of_sensors = iter(diagnosis["events"]), [*expected["sensors"]["events"]]
    of_sensors += expected["rotors"]["events"] if "rotors" in expected else []
    assert len(records) == len(of_sensors)
    for record, named in zip(records, of_sensors, strict=True):
        wanted = named | (next(of_attitude) if record["component"] == "attitude" else {})
        for name, value in record.items():
            if isinstance(value, str) or value is None:
                assert value == wanted.get(name)
            elif name in wanted:
                assert value == pytest.approx(wanted[name], rel=1e-6, abs=tolerance), (name, record)
