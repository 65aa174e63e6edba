"""Which sensor is named, on flights that one can work out by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest

from quadftc_flight.diagnosis_metrics import GRACE_TIME, sensor_metrics
from quadftc_flight.fault_schedule import SENSORS, FaultEvent
from quadftc_flight.flight import NO_STATE, VECTORS, Flight, unknown_flight
from quadftc_flight.metrics import flight_metrics, known_metrics, look_up
from quadftc_flight.summary import ATTITUDE_ERRORS, relate_to_undiagnosed
from quadftc_model.samples import AXES, FAULTY, HEALTHY, RECOVERING

DEG = math.pi / 180.0
PERIOD = 0.01  # s
DURATION = 40.0  # s
GYRO = FaultEvent("roll", "step", 10.0, 20.0, "gyro")
ATTITUDE = GYRO._replace(component="attitude")
STATES = {"attitude": "fault_state", "gyro": "gyro_state", "accelerometer": "accelerometer_state"}
TRUTH = {"attitude": "fault", "gyro": "gyro_fault", "accelerometer": "accelerometer_fault"}


def flight_of(events=(GYRO,), said=(), ambiguous=(), **columns) -> Flight:
    """A flight; ``said`` gives (sensor, axis, from, to, state), ``ambiguous`` (sensor, axis, from, to)."""
    stamp_ns = 5_000_000_000 + np.arange(round(DURATION / PERIOD)) * round(1e9 * PERIOD)
    empty = unknown_flight(stamp_ns)
    zeros = {name: np.zeros((len(empty), 3)) for name in VECTORS}
    healthy = {name: np.full((len(empty), 3), HEALTHY, np.uint8) for name in STATES.values()}
    flight = dataclasses.replace(empty, delivered=np.ones(len(empty), np.bool_), **zeros, **healthy)

    def fill(column: Any, axis: str, start: float, stop: float, value: Any) -> None:
        rows = (flight.time >= start) & (flight.time < stop)
        column[rows, AXES.index(axis)] = value

    for event in events:
        fill(getattr(flight, TRUTH[event.component]), event.axis, event.start, event.stop, 0.1)
    for sensor, axis, start, stop, state in said:
        fill(getattr(flight, STATES[sensor]), axis, start, stop, state)
    for sensor, axis, start, stop in ambiguous:
        fill(getattr(flight, f"{sensor}_ambiguous"), axis, start, stop, True)
    return dataclasses.replace(flight, **columns)


def judged(events=(GYRO,), said=(), ambiguous=(), **columns) -> dict[str, Any]:
    return sensor_metrics(flight_of(events, said, ambiguous, **columns), events)


def cells(found, axis="roll"):
    """The entries of the confusion matrix of an axis that are not zero [s]."""
    return {
        (true, said): axes[axis]
        for true, row in found["confusion_s"].items()
        for said, axes in row.items()
        if axes[axis]
    }


def test_gyro_named_after_a_while_fills_its_row_of_the_matrix():
    said = [("gyro", "roll", 10.5, 18.0, FAULTY), ("gyro", "roll", 18.0, 20.0, RECOVERING)]
    found = judged(said=said)
    (event,) = found["events"]
    assert (event["component"], event["named"], event["already_named"]) == ("gyro", True, False)
    assert event["naming_delay_s"] == event["alarm_delay_s"] == pytest.approx(0.5)
    assert (event["named_share"], event["misnamed_share"]) == (pytest.approx(0.95), 0.0)
    healthy = DURATION - 10.0 - GRACE_TIME
    assert cells(found) == pytest.approx(
        {
            ("none", "none"): healthy,
            ("none", "time"): healthy,
            ("gyro", "gyro"): 9.5,
            ("gyro", "none"): 0.5,
            ("gyro", "time"): 10.0,
        }
    )
    assert cells(found, "yaw") == pytest.approx(
        {("none", "none"): DURATION - GRACE_TIME, ("none", "time"): DURATION - GRACE_TIME}
    )


def test_gyro_fault_blamed_on_the_attitude_is_misnamed_and_no_detection():
    found = judged(said=[("attitude", "roll", 10.1, 20.0, FAULTY)])
    (event,) = found["events"]
    assert (event["named"], event["naming_delay_s"]) == (False, None)
    assert event["alarm_delay_s"] == pytest.approx(0.1)
    assert event["misnamed_share"] == pytest.approx(0.99)
    assert cells(found)["gyro", "attitude"] == pytest.approx(9.9)
    assert found["unnamed"] == {"all": 1, "attitude": 0, "gyro": 1, "accelerometer": 0}
    assert found["misnamed"]["gyro"] == 1
    assert found["false_namings"] == {"attitude": 1, "gyro": 0, "accelerometer": 0}
    assert found["false_naming_time_s"]["attitude"] == pytest.approx(9.9)


def test_ambiguous_is_neither_a_naming_nor_a_wrong_one():
    said = [("gyro", "roll", 10.0, 20.0, FAULTY), ("attitude", "roll", 10.0, 12.0, FAULTY)]
    doubts = [("gyro", "roll", 10.0, 12.0), ("attitude", "roll", 10.0, 12.0)]
    found = judged(said=said, ambiguous=doubts)
    (event,) = found["events"]
    assert (event["alarm_delay_s"], event["naming_delay_s"]) == (0.0, pytest.approx(2.0))
    assert (event["ambiguous_share"], event["misnamed_share"]) == (pytest.approx(0.2), 0.0)
    assert cells(found)["gyro", "ambiguous"] == pytest.approx(2.0)
    assert sum(found["false_namings"].values()) == 0


def test_wrong_axis_is_a_false_naming_there_and_nothing_on_the_right_one():
    found = judged(said=[("gyro", "pitch", 10.0, 15.0, FAULTY)])
    assert found["events"][0]["named"] is False
    assert cells(found)["gyro", "none"] == pytest.approx(10.0)
    assert cells(found, "pitch")["none", "gyro"] == pytest.approx(5.0)
    assert found["false_namings"]["gyro"] == 1


def test_two_faulty_sensors_of_an_axis_are_no_row_and_none_is_misnamed():
    said = [("gyro", "roll", 10.0, 20.0, FAULTY), ("attitude", "roll", 10.0, 20.0, FAULTY)]
    found = judged((GYRO, ATTITUDE), said)
    assert {true for true, _ in cells(found)} == {"none"}
    assert [event["misnamed_share"] for event in found["events"]] == [0.0, 0.0]
    assert found["naming_delay_max_s"] == {"all": 0.0, "attitude": 0.0, "gyro": 0.0, "accelerometer": None}


def test_naming_in_the_grace_does_not_count_and_after_it_does():
    end = 20.0 + GRACE_TIME
    found = judged(said=[("gyro", "roll", 10.0, end + 1.0, FAULTY)])
    assert found["false_naming_time_s"]["gyro"] == pytest.approx(1.0)
    assert found["false_namings"]["gyro"] == 0  # it began with the fault
    assert cells(found)["none", "gyro"] == pytest.approx(1.0)


def test_fault_without_effect_is_not_judged_but_a_missing_reading_is():
    still = np.zeros((round(DURATION / PERIOD), 3))
    assert judged(gyro_fault=still)["events"][0]["named"] is None
    missing = GYRO._replace(kind="dropout")
    assert judged((missing,), gyro_fault=still)["events"][0]["named"] is False
    nan = np.where(flight_of().gyro_fault != 0.0, np.nan, 0.0)
    assert judged(gyro_fault=nan)["events"][0]["named"] is False


def test_attitude_that_is_absent_is_named_though_no_fault_is_estimated():
    absent = flight_of((), [("attitude", "roll", 10.5, 20.0, FAULTY)]).fault_state
    found = judged((ATTITUDE._replace(kind="dropout"),), attitude_state=absent)
    assert found["events"][0]["named"] is True
    assert found["naming_delay_max_s"]["attitude"] == pytest.approx(0.5)


def test_observer_that_watches_the_attitude_alone_names_no_other():
    unwatched = np.full((round(DURATION / PERIOD), 3), NO_STATE, np.uint8)
    said = [("attitude", "roll", 10.0, 20.0, FAULTY)]
    found = judged((ATTITUDE,), said, gyro_state=unwatched, accelerometer_state=unwatched)
    assert found["naming_delay_max_s"]["attitude"] == 0.0
    assert sum(found["false_namings"].values()) == 0


def test_samples_without_a_state_do_not_count():
    flight = flight_of(said=[("gyro", "roll", 10.0, 20.0, FAULTY)])
    flight.fault_state[(flight.time >= 10.0) & (flight.time < 11.0)] = NO_STATE
    found = sensor_metrics(flight, [GYRO])
    assert found["events"][0]["naming_delay_s"] == pytest.approx(1.0)
    assert cells(found)["gyro", "time"] == pytest.approx(9.0)
    flight.fault_state[:] = NO_STATE
    nowhere = sensor_metrics(flight, [GYRO])
    assert nowhere["events"][0]["named"] is None
    assert cells(nowhere) == {}


@pytest.mark.parametrize(
    ("axis", "angle", "reference", "lost"),
    [
        *((0, 61.0, 0.0, True), (0, 59.0, 0.0, False), (2, 61.0, 0.0, True), (2, 181.0, -175.0, False)),
        *((0, 80.0, 75.0, False), (1, -61.0, -2.0, True)),
    ],
)
def test_lost_is_a_tilt_that_nobody_wants_or_an_angle_far_off(axis, angle, reference, lost):
    flight = flight_of(())
    flight.angles[1000, axis], flight.reference[1000, axis] = angle * DEG, reference * DEG
    metrics = flight_metrics(flight, [], [])
    assert metrics["lost"] is lost
    off = math.remainder(angle - reference, 360.0)
    assert metrics["attitude_error_max_deg"] == pytest.approx(abs(off))
    assert metrics["attitude_error_rms_deg"] == pytest.approx(abs(off) / math.sqrt(len(flight)))


def test_attitude_error_is_over_all_axes_and_known_for_each_fault():
    flight = flight_of()
    flight.angles[1500] = np.array([2.0, 3.0, 6.0]) * DEG
    flight.angles[3000] = np.array([10.0, 0.0, 0.0]) * DEG
    metrics = flight_metrics(flight, [], [GYRO])
    assert metrics["attitude_error_max_deg"] == pytest.approx(10.0)
    assert metrics["sensors"]["events"][0]["attitude_error_max_deg"] == pytest.approx(7.0)


def test_metrics_have_names_for_checks_and_go_into_json():
    known = known_metrics(0, [GYRO])
    assert look_up(known, "sensors.naming_delay_max_s.gyro") is None
    assert look_up(known, "sensors.confusion_s.gyro.attitude.roll") == 0.0
    assert list(judged()["unnamed"]) == ["all", *SENSORS]
    json.dumps(judged(), allow_nan=False)


def test_runs_are_related_to_that_of_the_same_controller_without_a_diagnosis():
    def run(scheme, observer, controller, error):
        common = dict.fromkeys(
            ("name", "seed", "rate", "duration", "vehicle", "disturbance_observer"), "same"
        )
        errors = dict.fromkeys(ATTITUDE_ERRORS, error)
        return {**common, "scheme": scheme, "observer": observer, "controller": controller, "metrics": errors}

    runs = [run("a", "isolating", "ismc", 1.0), run("b", "none", "ismc", 4.0), run("c", "none", "smc", 2.0)]
    runs += [run("d", "supervised", "pid", 9.0), run("e", "supervised", "smc", None)]
    assert [each["scheme"] for each in relate_to_undiagnosed(runs)] == ["a", "e"]
    ratios = {"attitude_error_max_deg_ratio": 0.25, "attitude_error_rms_deg_ratio": 0.25}
    assert runs[0]["without_diagnosis"] == {"scheme": "b", **ratios}
    assert set(runs[4]["without_diagnosis"].values()) == {"c", None}
