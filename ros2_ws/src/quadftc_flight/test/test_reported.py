"""The topic ``diagnosis`` as columns of a flight: each message holds until the next one."""

from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import QoSProfile

from quadftc_bags.bag import read_bag
from quadftc_bags.writer import BagWriter
from quadftc_flight.flight import NO_STATE, unknown_flight
from quadftc_flight.reported import note_reports, reports_from
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, ComponentFault, DiagnosisReport
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.topics import DIAGNOSIS

FIRST_NS, PERIOD_NS = 1_000_000_000, 10_000_000
WATCHED = ("attitude", "gyro")
OFFSET = ComponentFault(
    "gyro", "y", "offset", FAULTY, 0.3, 0.01, "rad/s", 0.9, ("attitude/pitch",), FIRST_NS + 5
)


def report(sample, *faults, watched=WATCHED):
    return DiagnosisReport(FIRST_NS + sample * PERIOD_NS, watched, faults)


def flight_of(*reports, count=30):
    flight = unknown_flight(FIRST_NS + PERIOD_NS * np.arange(count))
    flight.delivered[:] = True
    note_reports(flight, reports)
    return flight


def test_reports_come_back_from_a_bag_as_they_were_published(tmp_path: Path):
    reports = [
        report(0, watched=()),
        report(1, OFFSET),
        report(2, OFFSET._replace(component="attitude", element="roll", ambiguous_with=()), OFFSET),
        report(3, *[OFFSET._replace(element=axis, size=1e-300) for axis in "xyz"], watched=("gyro",)),
    ]
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/diagnosis", DIAGNOSIS, QoSProfile(depth=10))
        wire = DiagnosisWire()
        for each in reports:
            writer.write("/diagnosis", wire(each), each.stamp_ns, each.stamp_ns)
    assert reports_from(read_bag(tmp_path / "bag").series("diagnosis")) == reports


def test_report_holds_until_the_next_one():
    flight = flight_of(report(0), report(4, OFFSET), report(7, OFFSET._replace(state=RECOVERING)), report(9))
    states = [HEALTHY] * 4 + [FAULTY] * 3 + [RECOVERING] * 2 + [HEALTHY]
    assert flight.gyro_state[:10, 1].tolist() == states
    assert flight.gyro_state[:10, 0].tolist() == [HEALTHY] * 10
    np.testing.assert_array_equal(flight.gyro_estimate[:10, 1], [0.0] * 4 + [0.3] * 5 + [0.0])
    np.testing.assert_array_equal(flight.gyro_std_dev[:10, 1], [-1.0] * 4 + [0.01] * 5 + [-1.0])
    np.testing.assert_array_equal(flight.gyro_probability[:10, 1], [0.0] * 4 + [0.9] * 5 + [0.0])
    assert flight.gyro_onset_ns[:10, 1].tolist() == [0] * 4 + [FIRST_NS + 5] * 5 + [0]
    assert flight.gyro_ambiguous[:10, 1].tolist() == [False] * 4 + [True] * 5 + [False]
    assert not flight.attitude_ambiguous.any()


def test_report_holds_no_longer_than_its_tenth_of_a_second():
    flight = flight_of(report(4, OFFSET), report(20, OFFSET))  # one was lost, as in real time
    known = [*range(4, 10), *range(20, 30)]
    assert np.flatnonzero(flight.gyro_state[:, 1] == FAULTY).tolist() == known
    assert np.flatnonzero(flight.gyro_state[:, 1] == NO_STATE).tolist() == [*range(4), *range(10, 20)]
    assert np.isnan(flight.gyro_estimate[10:20]).all()


def test_component_that_is_not_watched_has_no_state():
    flight = flight_of(report(0, watched=("attitude",)))
    assert (flight.gyro_state == NO_STATE).all()
    assert np.isnan(flight.gyro_probability).all()
    np.testing.assert_array_equal(flight.attitude_probability[:10], 0.0)


def test_withheld_sample_has_no_report():
    flight = unknown_flight(FIRST_NS + PERIOD_NS * np.arange(4))
    flight.delivered[:] = [True, False, True, True]
    note_reports(flight, [report(0)])
    assert flight.gyro_state[:, 0].tolist() == [HEALTHY, NO_STATE, HEALTHY, HEALTHY]


@pytest.mark.parametrize("change", [{"component": "rotor"}, {"element": "4"}])
def test_fault_of_what_a_flight_does_not_know_is_left_out(change):
    flight = flight_of(report(0, OFFSET._replace(**change)))
    assert (flight.gyro_state[:10] == HEALTHY).all()
