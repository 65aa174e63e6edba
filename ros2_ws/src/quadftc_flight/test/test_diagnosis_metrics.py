"""Metrics of diagnosis on flights that one can work out by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from quadftc_flight.checks import refuse_wrong_checks
from quadftc_flight.diagnosis_metrics import GRACE_TIME, diagnosis_metrics, pool
from quadftc_flight.diagnosis_metrics.columns import consistency_band, independent_samples
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, attitude_events, events_of_windows
from quadftc_flight.flight import NO_STATE, VECTORS, Flight, unknown_flight
from quadftc_flight.metrics import flight_metrics, known_metrics
from quadftc_flight.scenario import ScenarioError, parse_scenario
from quadftc_model.samples import AXES, FAULTY, HEALTHY, RECOVERING, STARTING, SUSPECT

DEG = math.pi / 180.0
PERIOD = 0.01  # s
DURATION = 40.0  # s
ROLL = FaultEvent("roll", "step", 10.0, 20.0)
NO_FAULT: tuple[FaultEvent, ...] = ()

States = Mapping[str, list[tuple[float, float, int]]]  # axis -> (from, to, state); HEALTHY elsewhere


def flight_of(
    events=(ROLL,), states: States | None = None, size_deg=2.0, duration=DURATION, **columns
) -> Flight:
    """A flight with faults of one size, estimated as they are in the state FAULTY, else as zero."""
    stamp_ns = 5_000_000_000 + np.arange(round(duration / PERIOD)) * round(1e9 * PERIOD)
    time = unknown_flight(stamp_ns).time
    fault, state = np.zeros((len(time), 3)), np.full((len(time), 3), HEALTHY, np.uint8)
    for event in events:
        fault[(time >= event.start) & (time < event.stop), AXES.index(event.axis)] = size_deg * DEG
    for axis, parts in (states or {}).items():
        for start, stop, value in parts:
            state[(time >= start) & (time < stop), AXES.index(axis)] = value
    estimate = np.where(state == FAULTY, fault, 0.0)
    known = {"fault": fault, "fault_estimate": estimate, "fault_std_dev": np.full(fault.shape, -1.0)}
    zeros = {name: np.zeros(fault.shape) for name in VECTORS}
    flight = dataclasses.replace(unknown_flight(stamp_ns), fault_state=state, **{**zeros, **known, **columns})
    flight.delivered[:] = True
    return flight


def judged(events=(ROLL,), states: States | None = None, **columns) -> dict[str, Any]:
    return diagnosis_metrics(flight_of(events, states, **columns), events)


def test_fault_is_detected_from_its_onset_and_trusted_again_from_its_end():
    states = [(9.98, 10.03, SUSPECT), (10.03, 20.0, FAULTY), (20.0, 20.5, RECOVERING), (20.5, 21.0, SUSPECT)]
    found = judged(states={"roll": states})
    (event,) = found["events"]
    assert (event["detected"], event["already_declared"], event["recovered"]) == (True, False, True)
    assert event["detection_delay_s"] == pytest.approx(3 * PERIOD)
    assert event["recovery_delay_s"] == pytest.approx(0.5)
    assert event["declared_share"] == pytest.approx(0.997)
    assert (found["fault_count"], found["missed"], found["not_recovered"]) == (1, 0, 0)
    assert found["delay_max_s"] == {"all": event["detection_delay_s"], "step": event["detection_delay_s"]}


def test_recovering_counts_as_declared_and_starting_as_neither():
    later = {"roll": [(10.0, 12.0, STARTING), (12.0, 20.0, RECOVERING), (20.0, 21.0, STARTING)]}
    (event,) = judged(states=later)["events"]
    assert event["detection_delay_s"] == pytest.approx(2.0)
    assert event["recovery_delay_s"] == pytest.approx(1.0)
    assert judged(states={"yaw": [(0.0, 10.0, STARTING)]})["starting_share"]["yaw"] == pytest.approx(0.25)


def test_estimate_is_judged_over_the_whole_fault_and_from_its_detection_on():
    flight = flight_of(states={"roll": [(11.0, 20.0, FAULTY)]})
    estimate = flight.fault_estimate + np.where(flight.fault_state == FAULTY, 0.5 * DEG, 0.0)
    (event,) = diagnosis_metrics(dataclasses.replace(flight, fault_estimate=estimate), [ROLL])["events"]
    assert event["fault_max_deg"] == pytest.approx(2.0)
    assert event["estimate_rmse_deg"] == pytest.approx(math.sqrt(0.1 * 2.0**2 + 0.9 * 0.5**2))
    assert event["estimate_bias_deg"] == pytest.approx(0.1 * -2.0 + 0.9 * 0.5)
    assert event["estimate_max_deg"] == pytest.approx(2.0)
    assert event["estimate_rmse_detected_deg"] == pytest.approx(0.5)
    assert event["estimate_max_detected_deg"] == pytest.approx(0.5)


def test_tracking_is_judged_on_the_faulty_axis_during_the_fault():
    flight = flight_of()
    angles = np.zeros((len(flight), 3))
    angles[:, 1] = 5.0 * DEG
    angles[(flight.time >= 10.0) & (flight.time < 15.0), 0] = 1.0 * DEG
    (event,) = diagnosis_metrics(dataclasses.replace(flight, angles=angles), [ROLL])["events"]
    assert event["tracking_rmse_deg"] == pytest.approx(math.sqrt(0.5))


def test_onset_is_compared_as_it_is_reported_at_the_detection():
    flight = flight_of(states={"roll": [(10.1, 20.0, FAULTY)]})
    onset_ns = np.where(flight.fault_state == FAULTY, flight.stamp_ns[0] + 10_040_000_000, 0)
    onset_ns[1100:] = 0  # what is said later does not matter
    (event,) = diagnosis_metrics(dataclasses.replace(flight, fault_onset_ns=onset_ns), [ROLL])["events"]
    assert event["onset_error_s"] == pytest.approx(0.04)
    assert judged(states={"roll": [(10.1, 20.0, FAULTY)]})["events"][0]["onset_error_s"] is None


def test_missed_fault_is_counted_by_kind_and_has_no_delay():
    events = (ROLL, FaultEvent("yaw", "ramp", 10.0, 20.0))
    found = judged(events, {"roll": [(10.02, 20.0, FAULTY)], "yaw": [(20.0, 25.0, FAULTY)]})
    assert (found["fault_count"], found["missed"]) == (2, 1)
    assert found["missed_by_kind"] == {"step": 0, "ramp": 1}
    assert found["delay_max_s"] == {"all": pytest.approx(0.02), "step": pytest.approx(0.02), "ramp": None}
    assert [event["recovered"] for event in found["events"]] == [True, None]


def test_axis_declared_before_the_onset_is_no_detection_of_that_fault():
    found = judged(states={"roll": [(8.0, 20.0, FAULTY)]})
    (event,) = found["events"]
    assert (event["detected"], event["already_declared"], event["detection_delay_s"]) == (True, True, None)
    assert (found["missed"], found["already_declared"], found["delay_max_s"]["all"]) == (0, 1, None)
    assert found["false_alarms"]["roll"] == 1
    assert found["false_alarm_time_s"]["roll"] == pytest.approx(2.0)


def test_declaration_that_comes_and_goes_is_counted():
    chatter = [(10.0 + k, 10.5 + k, FAULTY) for k in range(7)]
    (event,) = judged(states={"roll": chatter})["events"]
    assert event["declarations"] == 7
    assert event["declared_share"] == pytest.approx(0.35)


def test_sensor_that_is_never_trusted_again_is_told():
    found = judged(states={"roll": [(10.0, DURATION, FAULTY)]})
    assert (found["not_recovered"], found["events"][0]["recovered"]) == (1, False)
    again = (ROLL, ROLL._replace(start=21.0, stop=30.0))
    found = judged(
        again, {"roll": [(10.0, 30.0, FAULTY)]}
    )  # what is trusted after the second one is too late
    assert [event["recovered"] for event in found["events"]] == [False, True]
    assert [event["already_declared"] for event in found["events"]] == [False, True]
    end = FaultEvent("roll", "step", 10.0, DURATION)
    found = judged((end,), {"roll": [(10.0, DURATION, FAULTY)]})
    assert (found["not_recovered"], found["events"][0]["recovered"]) == (None, None)  # it could not be


def test_false_alarm_of_known_length_is_counted_timed_and_related_to_healthy_time():
    found = judged(states={"pitch": [(5.0, 5.5, FAULTY)], "yaw": [(7.0, 7.2, SUSPECT)]})
    assert found["healthy_time_s"] == pytest.approx(
        {"roll": DURATION - 10.0 - GRACE_TIME, "pitch": DURATION, "yaw": DURATION}
    )
    assert found["false_alarms"] == {"roll": 0, "pitch": 1, "yaw": 0}
    assert found["false_alarm_time_s"] == pytest.approx({"roll": 0.0, "pitch": 0.5, "yaw": 0.0})
    assert found["false_alarm_share"]["pitch"] == pytest.approx(0.5 / DURATION)
    assert found["false_alarms_per_hour"]["pitch"] == pytest.approx(3600.0 / DURATION)
    healthy = 3.0 * DURATION - 10.0 - GRACE_TIME
    assert found["total_false_alarms"] == 1
    assert found["total_false_alarm_share"] == pytest.approx(0.5 / healthy)
    assert found["total_false_alarms_per_hour"] == pytest.approx(3600.0 / healthy)


def test_grace_after_a_fault_is_no_false_alarm_and_what_lasts_longer_is_left_over():
    stop = 20.0 + GRACE_TIME + 0.7
    found = judged(states={"roll": [(10.0, stop, FAULTY)]})
    assert found["false_alarms"]["roll"] == 0
    assert found["false_alarm_time_s"]["roll"] == pytest.approx(0.7)
    assert found["late_recovery_time_s"]["roll"] == pytest.approx(0.7)
    within = judged(states={"roll": [(10.0, 20.0, FAULTY), (20.5, 21.0, FAULTY)]})
    assert (within["false_alarms"]["roll"], within["false_alarm_time_s"]["roll"]) == (0, 0.0)


def test_longest_false_alarm_is_that_of_the_flight_and_of_the_pool():
    two = {"pitch": [(5.0, 5.5, FAULTY), (6.0, 6.8, RECOVERING)], "roll": [(12.0, 26.0, FAULTY)]}
    found, calm = judged(states=two), judged()
    longest = {"roll": 20.0 + GRACE_TIME, "pitch": 0.8, "yaw": 0.0}
    longest["roll"] = 26.0 - longest["roll"]  # the rest is fault and grace
    assert found["longest_false_alarm_s"] == pytest.approx(longest)
    assert pool([calm, found])["longest_false_alarm_s"] == pytest.approx(longest)
    older = {name: value for name, value in calm.items() if name != "longest_false_alarm_s"}
    assert pool([older])["longest_false_alarm_s"] == {}


def test_declaration_after_the_end_of_a_fault_is_timed_whether_or_not_it_was_found():
    missed = {"roll": [(20.1, 20.4, FAULTY), (21.0, 21.5, SUSPECT)]}
    (event,) = judged(states=missed)["events"]
    assert event["detected"] is False
    assert event["declared_after_s"] == pytest.approx(0.4)
    assert judged()["events"][0]["declared_after_s"] == 0.0
    always = judged(states={"roll": [(0.0, DURATION, FAULTY)]})["events"][0]
    assert always["declared_after_s"] == pytest.approx(GRACE_TIME)


def test_samples_withheld_do_not_break_an_alarm_and_do_not_count_as_time():
    flight = flight_of(NO_FAULT, {"roll": [(5.0, 6.0, FAULTY)]})
    flight.fault_state[530:560] = NO_STATE
    found = diagnosis_metrics(flight, NO_FAULT)
    assert found["false_alarms"]["roll"] == 1
    assert found["false_alarm_time_s"]["roll"] == pytest.approx(0.7)
    assert found["healthy_time_s"]["roll"] == pytest.approx(DURATION - 0.3)


def consistent_flight(rng, given_over_true=1.0) -> Flight:
    flight = flight_of(states={"roll": [(10.0, 20.0, FAULTY)]})
    error = 0.1 * DEG * rng.standard_normal((len(flight), 3))
    std_dev = np.full((len(flight), 3), 0.1 * DEG * given_over_true)
    return dataclasses.replace(flight, fault_estimate=flight.fault_estimate + error, fault_std_dev=std_dev)


def test_nees_of_errors_as_large_as_they_are_said_to_be_is_within_its_band():
    (event,) = diagnosis_metrics(consistent_flight(np.random.default_rng(1)), [ROLL])["events"]
    assert event["nees_samples"] == pytest.approx(1000, rel=0.05)  # white: every sample counts
    assert event["nees_low"] == pytest.approx(1.0 - 1.96 * math.sqrt(2.0 / 1000), abs=0.01)
    assert event["nees_low"] < event["nees"] < event["nees_high"]
    assert event["coverage_2_sigma"] == pytest.approx(0.954, abs=0.02)


def test_nees_of_errors_twice_as_large_as_they_are_said_to_be_is_above_its_band():
    (event,) = diagnosis_metrics(consistent_flight(np.random.default_rng(2), 0.5), [ROLL])["events"]
    assert event["nees"] == pytest.approx(4.0, rel=0.15)
    assert event["nees"] > event["nees_high"]
    assert event["coverage_2_sigma"] < 0.75


def test_nees_counts_only_while_the_axis_is_declared_and_a_deviation_is_given():
    flight = consistent_flight(np.random.default_rng(3))
    late = flight.fault_state.copy()
    late[1000:1500, 0] = SUSPECT  # a second half of errors of the size of the fault
    wrong = np.where(late == SUSPECT, 9.0, flight.fault_estimate)
    late_flight = dataclasses.replace(flight, fault_state=late, fault_estimate=wrong)
    (event,) = diagnosis_metrics(late_flight, [ROLL])["events"]
    assert event["nees"] == pytest.approx(1.0, rel=0.2)
    (event,) = judged(states={"roll": [(10.0, 20.0, FAULTY)]})["events"]
    assert [event[name] for name in ("nees", "nees_samples", "nees_low", "coverage_2_sigma")] == [None] * 4


def test_independent_samples_of_a_correlated_error_are_fewer():
    rng = np.random.default_rng(4)
    phi, error = 0.9, np.zeros(20_000)
    for k, noise in enumerate(rng.standard_normal(len(error) - 1)):
        error[k + 1] = phi * error[k] + noise
    assert independent_samples(error) == pytest.approx(len(error) * (1 - phi**2) / (1 + phi**2), rel=0.15)
    assert independent_samples(np.full(500, 0.3)) == pytest.approx(1.0)
    assert independent_samples(np.zeros(500)) == 500.0


def test_band_of_a_mean_square_is_that_of_the_chi_square_distribution():
    assert consistency_band(1.0) == pytest.approx((0.000982, 5.024), rel=1e-3)  # tables of chi-square
    assert consistency_band(10.0) == pytest.approx((0.3247, 2.0483), rel=1e-3)


def test_fault_that_leaves_the_reading_as_it_is_need_not_be_found():
    dropout = FaultEvent("roll", "dropout", 10.0, 20.0)
    blamed = flight_of((dropout,), {"pitch": [(10.0, 20.0, FAULTY)]})
    for no_size in (0.0, np.nan):  # absent, or no number
        fault = np.where(blamed.fault != 0.0, no_size, 0.0)
        found = diagnosis_metrics(dataclasses.replace(blamed, fault=fault), [dropout])
        assert found["events"][0]["detected"] is None
        assert (found["fault_count"], found["missed"]) == (0, None)
        assert found["healthy_time_s"]["roll"] == pytest.approx(DURATION - 10.0 - GRACE_TIME)


def test_fault_whose_size_was_not_recorded_is_there_by_schedule():
    flight = dataclasses.replace(flight_of(), fault=np.full((4000, 3), np.nan))
    assert diagnosis_metrics(flight, [ROLL])["missed"] == 1


def test_fault_behind_the_end_of_the_recording_does_not_count():
    found = diagnosis_metrics(flight_of((ROLL,), duration=5.0), [ROLL])
    assert (found["fault_count"], found["missed"]) == (0, None)
    assert found["events"][0]["detected"] is None
    assert found["fault_count_by_kind"] == {"step": 0}


def test_flight_without_diagnosis_has_no_value_and_is_json():
    flight = flight_of()
    flight.fault_state[:] = NO_STATE
    unknown = dataclasses.replace(flight, **{name: np.full((len(flight), 3), np.nan) for name in VECTORS})
    found = diagnosis_metrics(unknown, [ROLL])
    json.dumps(found, allow_nan=False)
    assert found["missed"] is None
    assert found["false_alarm_share"] == found["starting_share"] == dict.fromkeys(AXES)
    assert found["events"][0]["estimate_rmse_deg"] is None
    json.dumps(diagnosis_metrics(unknown.first(1), [ROLL]), allow_nan=False)


def test_wholly_known_flight_has_the_same_names_and_is_json():
    known = known_metrics(1, [ROLL])
    full = flight_metrics(flight_of(states={"roll": [(10.1, 21.0, FAULTY)]}), [], [ROLL])
    json.dumps(full, allow_nan=False)
    assert set(paths(full["diagnosis"])) == set(paths(known["diagnosis"]))


def paths(metrics: Any, prefix: str = "") -> list[str]:
    if not isinstance(metrics, (dict, list)):
        return [prefix]
    items = metrics.items() if isinstance(metrics, dict) else enumerate(metrics)
    return [path for name, value in items for path in paths(value, f"{prefix}.{name}")]


def test_windows_stand_for_faults_of_which_nothing_else_is_known():
    window = FaultWindow(10.0, 20.0, ("roll", "yaw"))
    assert [event.axis for event in events_of_windows([window])] == ["roll", "yaw"]
    found = flight_metrics(flight_of(states={"roll": [(10.0, 20.0, FAULTY)]}), [window])["diagnosis"]
    assert found["fault_count_by_kind"] == {"fault": 1}  # on yaw there was none
    assert found["missed"] == 0


SCENARIO = """
name: kinds
duration: 30 s
rate: 50 Hz
vehicle: qball_x4
faults:
  - {kind: bias, axes: [yaw, roll], value: 2 deg, start: 4, stop: 9}
  - {kind: sine, axes: roll, amplitude: 1 deg, start: 6, stop: 12}
  - {kind: drift, axes: pitch, rate: 1 deg/s, start: 5}
  - {kind: stuck, axes: roll, start: 12, stop: 14}
  - {kind: noise, axes: yaw, sigma: 1 deg, start: 5, stop: 6}
  - {kind: bias, channel: gyro, value: 0.1, start: 1}
schemes: {only: {controller: smc, checks: [{metric: METRIC, below: 1}]}}
"""


def test_scheduled_faults_are_events_in_the_words_of_the_field():
    events = parse_scenario(SCENARIO.replace("METRIC", "diagnosis.missed")).fault_events
    assert [event[:4] for event in attitude_events(events)] == [
        ("roll", "step+sine", 4.0, 12.0),  # they overlap
        ("yaw", "step+noise", 4.0, 9.0),
        ("pitch", "ramp", 5.0, 30.0),  # until the end of the flight
        ("roll", "stuck", 12.0, 14.0),  # follows without a break
    ]
    assert [event for event in events if event.component == "gyro"] == [
        (axis, "step", 1.0, 30.0, "gyro") for axis in AXES
    ]


@pytest.mark.parametrize(
    "metric",
    ["diagnosis.delay_max_s.ramp", "diagnosis.false_alarm_share", "diagnosis.events.3.recovery_delay_s"],
)
def test_check_can_name_metrics_of_diagnosis(metric):
    refuse_wrong_checks(parse_scenario(SCENARIO.replace("METRIC", metric)))


def test_check_on_a_kind_of_fault_that_is_not_scheduled_is_refused():
    with pytest.raises(
        ScenarioError, match="no 'spikes'; there is: all, step\\+sine, step\\+noise, ramp, stuck"
    ):
        refuse_wrong_checks(parse_scenario(SCENARIO.replace("METRIC", "diagnosis.delay_max_s.spikes")))


def two_flights() -> list[dict[str, Any]]:
    first = judged(states={"roll": [(10.1, 20.2, FAULTY)], "yaw": [(0.0, 1.0, FAULTY)]})
    events = (ROLL, ROLL._replace(axis="pitch"), FaultEvent("roll", "ramp", 30.0, 35.0))
    second = judged(events, {"roll": [(10.3, 20.0, FAULTY), (34.0, 35.0, FAULTY)]})
    return [first, second]


def test_pool_counts_every_fault_once_and_every_healthy_second():
    pooled = pool(two_flights())
    json.dumps(pooled, allow_nan=False)
    assert (pooled["flights"], pooled["fault_count"], pooled["missed"]) == (2, 4, 1)
    assert pooled["missed_by_kind"] == {"step": 1, "ramp": 0}
    assert pooled["delay_median_s"] == pytest.approx({"all": 0.3, "step": 0.2, "ramp": 4.0})
    assert pooled["delay_max_s"]["step"] == pytest.approx(0.3)
    healthy = {"roll": 2 * DURATION - 3 * GRACE_TIME - 25.0, "pitch": 2 * DURATION - GRACE_TIME - 10.0}
    assert pooled["healthy_time_s"] == pytest.approx({**healthy, "yaw": 2 * DURATION})
    assert pooled["total_false_alarms"] == 1
    assert pooled["false_alarm_share"]["yaw"] == pytest.approx(1.0 / (2 * DURATION))
    rmse = [2.0 * math.sqrt(share) for share in (0.01, 0.03, 1.0, 0.8)]
    assert pooled["estimate_rmse_median_deg"]["all"] == pytest.approx(np.median(rmse))
    assert pooled["estimate_rmse_p95_deg"]["all"] == pytest.approx(np.percentile(rmse, 95))


def test_errors_of_onsets_do_not_cancel_in_the_pool():
    flight = flight_of(states={"roll": [(10.1, 20.0, FAULTY)]})
    errors_ns = [-20_000_000, 30_000_000, -40_000_000, 50_000_000]
    onsets = [np.full((4000, 3), flight.stamp_ns[0] + 10_000_000_000 + error) for error in errors_ns]
    flights = [dataclasses.replace(flight, fault_onset_ns=onset) for onset in onsets]
    pooled = pool(diagnosis_metrics(each, [ROLL]) for each in flights)
    assert pooled["onset_error_median_s"]["step"] == pytest.approx(0.035)


def test_pool_of_one_flight_says_what_the_flight_says():
    (flight, _) = two_flights()
    pooled = pool([flight])
    assert {name: pooled[name] for name in pooled if name != "flights"} == {
        name: flight[name] for name in flight if name not in ("events", "starting_share")
    }


def test_pool_of_nothing_has_no_value():
    pooled = pool([])
    assert (pooled["fault_count"], pooled["missed"], pooled["total_false_alarm_share"]) == (0, None, None)


def test_more_consistent_faults_narrow_the_band_of_their_mean_nees():
    rng = np.random.default_rng(5)
    flights = [diagnosis_metrics(consistent_flight(rng), [ROLL]) for _ in range(40)]
    one, many = pool(flights[:1]), pool(flights)
    assert one["nees_high"]["all"] == pytest.approx(5.024, rel=1e-3)
    assert (many["nees_low"]["all"], many["nees_high"]["all"]) == pytest.approx(consistency_band(40))
    assert many["nees"]["step"] == pytest.approx(1.0, abs=0.05)
