"""Diagnosis of a stream: when it starts, and what it does with samples that cannot be used."""

import numpy as np
import pytest
from accusing_observer import AccusingObserver

from quadftc_fdi.diagnosis import Diagnosis, describe_axes, describe_component, is_due, report_faults
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import (
    FAULT_KINDS,
    FAULTY,
    HEALTHY,
    RECOVERING,
    STARTING,
    SUSPECT,
    ComponentFault,
    DiagnosisReport,
    FaultEstimate,
    ImuSample,
    SensorDiagnosis,
    SensorEstimate,
)
from quadftc_model.vehicle import load_vehicle

START, PERIOD = 1_000_000_000, 4_000_000  # ns
ANGLES = np.array([0.3, -0.2, 0.4])
TRUE, FALSE = np.bool_(True), np.bool_(False)
NO_TORQUE = np.zeros(3)


@pytest.fixture
def diagnosis():
    return Diagnosis(fault_observers.get("sliding_mode")(vehicle=load_vehicle("qball_x4")))


def sample(**changes):
    """A vehicle that hangs still at an angle."""
    force = np.array([0.0, 0.0, 9.8])
    return ImuSample(quaternion_from_euler(ANGLES), np.zeros(3), force, TRUE, TRUE, TRUE)._replace(**changes)


@pytest.mark.parametrize(
    "changes", [{"attitude_valid": FALSE}, {"rate_valid": FALSE}, {"q_xyzw": np.full(4, np.nan)}]
)
def test_start_waits_for_attitude_and_rate(diagnosis, changes):
    assert diagnosis.diagnose(START, sample(**changes), NO_TORQUE).state.tolist() == [STARTING] * 3
    assert diagnosis.diagnose(START + PERIOD, sample(), NO_TORQUE).state.tolist() == [HEALTHY] * 3


def test_start_without_attitude_leaves_no_fault_behind(diagnosis):
    diagnosis.diagnose(START, sample(attitude_valid=FALSE), NO_TORQUE)
    estimate = diagnosis.diagnose(START + PERIOD, sample(), NO_TORQUE)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=1e-12)


@pytest.mark.parametrize("gap", [2_000_000_000, -2_000_000_000])
def test_start_after_a_gap_waits_for_attitude_too(diagnosis, gap):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    blind = diagnosis.diagnose(START + gap, sample(attitude_valid=FALSE), NO_TORQUE)
    assert blind.state.tolist() == [STARTING] * 3
    estimate = diagnosis.diagnose(START + gap + PERIOD, sample(), NO_TORQUE)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=1e-12)


def test_sample_with_a_stamp_that_is_not_new_gives_none(diagnosis):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    assert diagnosis.diagnose(START, sample(), NO_TORQUE) is None
    assert diagnosis.diagnose(START - PERIOD, sample(), NO_TORQUE) is None


@pytest.mark.parametrize("channel", ["q_xyzw", "body_rate", "specific_force"])
def test_not_a_number_does_not_reach_the_corrected_sample(diagnosis, channel):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    broken = sample(**{channel: np.full_like(getattr(sample(), channel), np.nan)})
    estimate = diagnosis.diagnose(START + PERIOD, broken, NO_TORQUE)
    np.testing.assert_allclose(euler_from_quaternion(estimate.corrected.q_xyzw), ANGLES, atol=1e-9)
    for array in (estimate.fault, *estimate.corrected):
        assert np.all(np.isfinite(array))


def test_reset_starts_anew_at_the_next_sample(diagnosis):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    diagnosis.restart()
    turned = sample(q_xyzw=quaternion_from_euler(ANGLES + 0.5))
    np.testing.assert_allclose(diagnosis.diagnose(START + PERIOD, turned, NO_TORQUE).fault, 0.0, atol=1e-12)


def test_new_law_goes_on_with_the_state_of_the_old(diagnosis):
    for index in range(100):
        diagnosis.diagnose(START + index * PERIOD, sample(), NO_TORQUE)
    diagnosis.switch(fault_observers.get("sliding_mode")(vehicle=load_vehicle("qball_x4"), epsilon_s=0.7))
    turned = sample(q_xyzw=quaternion_from_euler(ANGLES + 0.01))
    for index in range(100, 150):
        estimate = diagnosis.diagnose(START + index * PERIOD, turned, NO_TORQUE)
    np.testing.assert_allclose(estimate.fault, 0.01, atol=1e-4)


def test_axes_are_described_without_what_is_not_known():
    estimate = FaultEstimate(
        fault=np.array([np.radians(1.5), -1e-9, 0.0]),
        std_dev=np.array([np.radians(0.1), -1.0, -1.0]),
        state=np.array([FAULTY, HEALTHY, STARTING], np.uint8),
        onset_age=np.array([2.5, -1.0, -1.0]),
        corrected=sample(),
    )
    assert list(describe_axes(estimate)) == [
        ("roll", FAULTY, {"size_deg": "1.500", "sigma_deg": "0.100", "age_s": "2.50"}),
        ("pitch", HEALTHY, {"size_deg": "0.000"}),
        ("yaw", STARTING, {"size_deg": "0.000"}),
    ]


def gyro(state=(FAULTY, HEALTHY, SUSPECT), **changes):
    """What is said of a gyro with an offset of 0.3 rad/s about x."""
    values = {
        "size": [0.3, 0.0, 0.1],
        "std_dev": [0.01, -1.0, -1.0],
        "onset_age": [0.25, -1.0, -1.0],
        "probability": [0.9, 0.0, 0.2],
        "kind": [FAULT_KINDS.index("offset"), 0, 0],
        "ambiguous": [True, False, True],
        **changes,
    }
    return SensorEstimate(np.array(state, np.uint8), *map(np.array, values.values()))


OFFSET = ComponentFault(
    component="gyro",
    element="x",
    kind="offset",
    state=FAULTY,
    size=0.3,
    std_dev=0.01,
    unit="rad/s",
    probability=0.9,
    ambiguous_with=("attitude/roll",),
    onset_ns=START - 250_000_000,
)


def test_report_names_the_confirmed_faults_alone():
    assert report_faults(START, {"gyro": gyro()}) == DiagnosisReport(START, ("gyro",), (OFFSET,))


def test_fault_of_the_accelerometer_is_confused_with_none():
    (fault,) = report_faults(START, {"accelerometer": gyro()}).faults
    assert (fault.element, fault.unit, fault.ambiguous_with) == ("x", "m/s^2", ())


@pytest.mark.parametrize(
    "changed",
    [
        DiagnosisReport(START + PERIOD, ("gyro",), ()),
        DiagnosisReport(START + PERIOD, ("gyro", "attitude"), (OFFSET,)),
        *(
            DiagnosisReport(START + PERIOD, ("gyro",), (OFFSET._replace(**change),))
            for change in (
                {"element": "y"},
                {"kind": "stuck"},
                {"state": RECOVERING},
                {"ambiguous_with": ()},
                {"component": "attitude"},
            )
        ),
    ],
)
def test_report_is_due_at_once_when_it_changes(changed):
    said = DiagnosisReport(START, ("gyro",), (OFFSET,))
    assert is_due(changed, said)
    assert not is_due(said._replace(stamp_ns=START + PERIOD), said)


def test_numbers_alone_do_not_make_a_report_due():
    said = DiagnosisReport(START, ("gyro",), (OFFSET,))
    other = OFFSET._replace(size=0.4, std_dev=0.02, probability=0.5, onset_ns=1)
    assert not is_due(DiagnosisReport(START + PERIOD, ("gyro",), (other,)), said)


@pytest.mark.parametrize("rate", [50, 250, 300, 1000])
def test_report_comes_ten_times_a_second_without_a_change(rate):
    stamps = [START + round(k * 1e9 / rate) for k in range(5 * rate)]
    last, count = None, 0
    for stamp_ns in stamps:
        report = DiagnosisReport(stamp_ns, (), ())
        if is_due(report, last):
            last, count = report, count + 1
    assert count == 50


def test_report_is_due_when_stamps_go_back():
    said = DiagnosisReport(START + 50_000_000, (), ())
    assert is_due(DiagnosisReport(START + 40_000_000, (), ()), said)


def test_observer_of_the_attitude_alone_reports_its_faults():
    diagnosis = Diagnosis(fault_observers.get("threshold")(vehicle=load_vehicle("qball_x4")))
    estimate = FaultEstimate(
        np.array([0.1, 0.0, 0.0]),
        np.full(3, -1.0),
        np.array([RECOVERING, HEALTHY, HEALTHY], np.uint8),
        np.array([0.5, -1.0, -1.0]),
        sample(),
    )
    report = diagnosis.report(START, estimate)
    assert report.watched == ("attitude",)
    (fault,) = report.faults
    assert fault == ComponentFault(
        "attitude", "roll", "unknown", RECOVERING, 0.1, -1.0, "rad", -1.0, (), START - 500_000_000
    )
    assert diagnosis.report(START + PERIOD, estimate) is None


@pytest.mark.parametrize("name", ["none", "sliding_mode"])
def test_observer_that_never_decides_watches_nothing(name):
    diagnosis = Diagnosis(fault_observers.get(name)(vehicle=load_vehicle("qball_x4")))
    assert diagnosis.report(START, diagnosis.diagnose(START, sample(), NO_TORQUE)) == (START, (), ())


class Undecided(AccusingObserver):
    """Gives an infinite size to what it says of the gyro."""

    def step(self, state, inputs, dt):
        state, estimate = super().step(state, inputs, dt)
        endless = estimate.sensors.gyro._replace(size=np.full(3, np.inf))
        return state, estimate._replace(sensors=estimate.sensors._replace(gyro=endless))


def test_what_is_no_number_of_a_sensor_is_not_reported():
    diagnosis = Diagnosis(Undecided(vehicle=load_vehicle("qball_x4")))
    turning = sample(body_rate=np.array([1.0, 0.0, 0.0]))
    estimate = diagnosis.diagnose(START, turning, NO_TORQUE)
    assert diagnosis.replaced == 1
    assert diagnosis.report(START, estimate) == (START, (), ())


def test_component_is_watched_once_the_observer_has_converged_on_it():
    sensors = {"attitude": gyro([HEALTHY] * 3), "gyro": gyro([STARTING, HEALTHY, HEALTHY])}
    assert report_faults(START, sensors) == (START, ("attitude",), ())


def test_component_is_described_by_its_worst_element_in_units_for_people():
    assert describe_component("gyro", gyro()) == (
        FAULTY,
        {
            "x": "faulty, offset",
            "x_size_deg_s": "17.189",
            "x_sigma_deg_s": "0.573",
            "x_age_s": "0.25",
            "x_probability": "0.90",
            "x_or": "attitude/roll",
        },
    )
    assert describe_component("accelerometer", gyro([STARTING, HEALTHY, SUSPECT])) == (SUSPECT, {})


def test_axis_of_the_attitude_says_what_else_may_be_faulty():
    sensors = SensorDiagnosis(
        gyro([HEALTHY, FAULTY, HEALTHY], ambiguous=[False, True, False]), gyro(), gyro()
    )
    estimate = FaultEstimate(
        np.zeros(3), np.full(3, -1.0), sensors.attitude.state, np.zeros(3), sample(), sensors
    )
    values = {axis: values for axis, _, values in describe_axes(estimate)}
    assert values["pitch"] == {"size_deg": "0.000", "age_s": "0.00", "probability": "0.00", "or": "gyro/y"}
    assert values["roll"] == {"size_deg": "0.000", "age_s": "0.00"}
