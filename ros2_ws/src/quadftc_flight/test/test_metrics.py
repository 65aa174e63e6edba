"""Metrics of flights that one can work out by hand."""

import dataclasses
import json
import math

import numpy as np
import pytest

from quadftc_flight.checks import check_results
from quadftc_flight.fault_schedule import FaultWindow
from quadftc_flight.flight import VECTORS, Flight, unknown_flight
from quadftc_flight.metrics import flight_metrics, known_metrics, look_up
from quadftc_flight.scenario import Check
from quadftc_model.samples import AXES, HEALTHY

DEG = math.pi / 180.0
WINDOW = FaultWindow(1.0, 3.0, ("roll",))


def still(count=41, period=0.1) -> Flight:
    """A flight in which everything is zero: 4 s at 10 Hz."""
    flight = unknown_flight(1_000_000_000 + np.arange(count) * round(1e9 * period))
    flight.delivered[:], flight.fault_state[:] = True, HEALTHY
    return dataclasses.replace(flight, **{name: np.zeros((count, 3)) for name in VECTORS})


def column(flight: Flight, axis: int, value) -> np.ndarray:
    """Zeros but for one axis, a function of time."""
    columns = np.zeros((len(flight), 3))
    columns[:, axis] = [value(t) for t in flight.time]
    return columns


def test_tracking_error_is_true_angle_minus_reference():
    flight = still()
    flight = dataclasses.replace(
        flight,
        angles=column(flight, 0, lambda t: 1.0 * DEG if t < 2.0 else 3.0 * DEG),
        reference=column(flight, 0, lambda t: 2.0 * DEG),
        error=column(flight, 0, lambda t: 77.0),  # what the controller believes does not count
    )
    metrics = flight_metrics(flight, [FaultWindow(1.0, 1.9999, AXES)])
    assert metrics["tracking_rmse_deg"]["roll"] == pytest.approx(1.0)
    assert metrics["tracking_max_deg"] == pytest.approx({"roll": 1.0, "pitch": 0.0, "yaw": 0.0})
    assert metrics["fault_windows"][0]["tracking_mean_deg"]["roll"] == pytest.approx(-1.0)
    assert metrics["max_tilt_deg"] == pytest.approx(3.0)


def test_errors_are_wrapped_at_half_a_turn():
    flight = still()
    flight = dataclasses.replace(
        flight,
        angles=column(flight, 2, lambda t: 179.0 * DEG),
        reference=column(flight, 2, lambda t: -179.0 * DEG),
    )
    assert flight_metrics(flight, [])["tracking_max_deg"]["yaw"] == pytest.approx(2.0)


def test_fault_estimate_is_judged_inside_and_outside_windows():
    flight = still()
    fault = column(flight, 1, lambda t: 2.0 * DEG if 1.0 <= t < 3.0 else 0.0)
    estimate = column(flight, 1, lambda t: 1.5 * DEG if 1.0 <= t < 3.0 else 0.1 * DEG)
    metrics = flight_metrics(dataclasses.replace(flight, fault=fault, fault_estimate=estimate), [WINDOW])
    assert metrics["fault_max_deg"]["pitch"] == pytest.approx(2.0)
    assert metrics["fault_estimate_rmse_inside_deg"]["pitch"] == pytest.approx(0.5)
    assert metrics["fault_estimate_max_outside_deg"]["pitch"] == pytest.approx(0.1)
    rows_inside = 20  # 1.0, 1.1, ... 2.9 s
    expected = math.sqrt((rows_inside * 0.5**2 + (41 - rows_inside) * 0.1**2) / 41)
    assert metrics["fault_estimate_rmse_deg"]["pitch"] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("moment", "counts"),
    [
        (0.9, True),
        (1.0, False),
        (1.1, False),
        (1.2, True),
        (2.9, True),
        (3.0, False),
        (3.1, False),
        (3.2, True),
    ],
)
def test_settled_error_leaves_out_a_fifth_of_a_second_after_onset_and_end(moment, counts):
    flight = still()
    estimate = column(flight, 0, lambda t: 1.0 * DEG if abs(t - moment) < 0.01 else 0.0)
    metrics = flight_metrics(dataclasses.replace(flight, fault_estimate=estimate), [WINDOW])
    assert metrics["fault_estimate_max_deg"]["roll"] == pytest.approx(1.0)
    assert metrics["fault_estimate_max_settled_deg"]["roll"] == pytest.approx(1.0 if counts else 0.0)


@pytest.mark.parametrize(
    ("error_deg", "settling"),
    [
        (lambda t: 0.0, 0.0),
        (lambda t: 1.0 if t < 1.45 else 0.04, 0.5),
        (lambda t: 1.0 if t < 1.45 or 1.95 < t < 2.05 else 0.0, 1.1),  # it left again
        (lambda t: 0.06, None),
        (lambda t: 0.0 if t < 2.85 else 1.0, None),  # not settled at the window's end
    ],
)
def test_settling_is_when_the_error_stays_small(error_deg, settling):
    flight = still()
    estimate = column(flight, 0, lambda t: error_deg(t) * DEG)
    metrics = flight_metrics(dataclasses.replace(flight, fault_estimate=estimate), [WINDOW])
    assert metrics["fault_windows"][0]["fault_estimate_settling_s"]["roll"] == (
        None if settling is None else pytest.approx(settling)
    )


def test_effort_counts_torque_its_changes_and_its_limits():
    flight = still()
    saturated = np.zeros((41, 3), np.bool_)
    saturated[:10, 2] = True
    torque = column(flight, 2, lambda t: 0.3 if round(10 * t) % 2 else -0.3)
    metrics = flight_metrics(dataclasses.replace(flight, torque=torque, saturated=saturated), [])
    assert metrics["torque_rms"]["yaw"] == pytest.approx(0.3)
    assert metrics["torque_total_variation"]["yaw"] == pytest.approx(40 * 0.6 / 4.0)  # N m/s
    assert metrics["saturation_share"] == pytest.approx({"roll": 0.0, "pitch": 0.0, "yaw": 10 / 41})


def test_samples_withheld_do_not_count():
    flight = still()
    torque = column(flight, 0, lambda t: 0.0 if t < 2.0 else 1.0)
    estimate = column(flight, 0, lambda t: 1.0 * DEG)
    for columns in (torque, estimate):
        columns[15:25] = np.nan
    metrics = flight_metrics(dataclasses.replace(flight, torque=torque, fault_estimate=estimate), [WINDOW])
    assert metrics["torque_total_variation"]["roll"] == pytest.approx(1.0 / 4.0)
    assert metrics["fault_estimate_rmse_deg"]["roll"] == pytest.approx(1.0)


def test_what_is_never_known_is_none_and_the_rest_is_json():
    metrics = known_metrics(1)
    json.dumps(metrics, allow_nan=False)
    assert metrics["tracking_rmse_deg"] == dict.fromkeys(AXES)
    assert metrics["torque_total_variation"] == dict.fromkeys(AXES)
    assert metrics["fault_windows"][0]["fault_estimate_settling_s"] == dict.fromkeys(AXES)
    assert metrics["max_tilt_deg"] is None
    full = flight_metrics(still(), [WINDOW])
    json.dumps(full, allow_nan=False)
    assert full.keys() == metrics.keys()


def test_metrics_are_found_by_dotted_path():
    metrics = {"fault_windows": [{"tracking_mean_deg": {"roll": -1.0}}], "max_tilt_deg": 3.0}
    assert look_up(metrics, "max_tilt_deg") == 3.0
    assert look_up(metrics, "fault_windows.0.tracking_mean_deg.roll") == -1.0
    with pytest.raises(KeyError, match=r"no 'max_tild_deg' \(did you mean 'max_tilt_deg'\?\)"):
        look_up(metrics, "max_tild_deg")
    with pytest.raises(KeyError, match="no '1'; there is: 0"):
        look_up(metrics, "fault_windows.1.tracking_mean_deg")


def test_a_check_holds_on_every_axis_unless_one_is_named():
    metrics = {"tracking_rmse_deg": {"roll": 0.05, "pitch": 0.2, "yaw": None}, "max_tilt_deg": 5.0}
    results = check_results(metrics, [Check(metric="tracking_rmse_deg", below=0.1)])
    assert [(result.axis, result.value, result.passed) for result in results] == [
        ("roll", 0.05, True),
        ("pitch", 0.2, False),
        ("yaw", None, False),  # what has no value fails
    ]
    assert results[1].bound == "below 0.1"
    (single,) = check_results(
        metrics, [Check(metric="tracking_rmse_deg", axis="roll", above=0.01, below=0.1)]
    )
    assert single.passed
    assert single.bound == "between 0.01 and 0.1"
    (scalar,) = check_results(metrics, [Check(metric="max_tilt_deg", above=5.0)])
    assert not scalar.passed  # bounds are exclusive
