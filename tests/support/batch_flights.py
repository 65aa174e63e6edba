"""Flights of the batch engine beside those of the closed loop."""

import pytest

from quadftc_campaign.batch.records import fault_records, flight_record
from quadftc_flight.metrics import flight_metrics, look_up

AGREE = 1e-9  # in SI


def events_of(scenario):
    return (*scenario.fault_events, *scenario.rotor_events)


def assert_same_metrics(outcome, flight, scenario, rel=1e-9):
    """What the batch says of a flight is what the metrics of `flight` say."""
    expected = flight_metrics(flight, scenario.fault_windows, scenario.fault_events, scenario.rotor_events)
    diagnosis = expected["diagnosis"]
    for name, value in flight_record(outcome).items():
        metric, _, axis = name.partition(".")
        if metric in ("sensors", "rotors"):
            wanted = look_up(expected, name)
            wanted = sum(wanted.values()) if isinstance(wanted, dict) else wanted
            assert value == pytest.approx(wanted, rel=rel, abs=AGREE), name
            continue
        there = expected if metric in expected else diagnosis
        if metric == "finite":
            continue
        wanted = there[metric][axis] if axis else there[metric]
        assert value == pytest.approx(wanted, rel=rel, abs=AGREE), name
    records = fault_records(outcome, events_of(scenario))
    of_attitude, of_sensors = iter(diagnosis["events"]), [*expected["sensors"]["events"]]
    of_sensors += expected["rotors"]["events"] if "rotors" in expected else []
    assert len(records) == len(of_sensors)
    for record, named in zip(records, of_sensors, strict=True):
        wanted = named | (next(of_attitude) if record["component"] == "attitude" else {})
        for name, value in record.items():
            if isinstance(value, str) or value is None:
                assert value == wanted.get(name)
            elif name in wanted:
                assert value == pytest.approx(wanted[name], rel=rel, abs=AGREE), (name, record)


def assert_same_outcome(one, other, rel=1e-9, absolute=AGREE):
    """Two forms of the engine say the same of a flight."""
    for part in ("sums", "marks"):
        pair = getattr(one, part), getattr(other, part)
        assert pair[0].keys() == pair[1].keys()
        for name, value in pair[0].items():
            assert value == pytest.approx(pair[1][name], rel=rel, abs=absolute), name
    assert (one.span, one.period) == (other.span, other.period)
