"""An observer that is restarted or changed in flight goes on where the one before was."""

import copy
import itertools

import numpy as np
import pytest
from accusing_observer import registered

from node_bench import imu_message, vector_message
from quadftc_compile.engine import CEngine
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.disturbance_observer import DisturbanceEstimation, disturbance_observers
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.disturbance_observers.exosystem import Exosystem
from quadftc_fdi.fault_observer import LastDiagnosis, fault_observers
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_model.guarded import OLDEST_WORDS, ResumingStepper
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import (
    FAULTY,
    HEALTHY,
    STARTING,
    DisturbanceObserverInputs,
    FaultObserverInputs,
    level_sample,
)
from quadftc_model.stepper import Stepper
from quadftc_model.vehicle import load_vehicle
from quadftc_msgs.msg import FaultStatus
from quadftc_ros.conversions import time_message

DEG = np.pi / 180.0
DT, PERIOD_NS, FIRST_NS = 0.004, 4_000_000, 10_000_000_000
FAULT = np.array([2.0, 0.0, 0.0]) * DEG
BIAS = np.array([0.8, -0.5, 0.3]) * DEG  # rad/s
WORDS = LastDiagnosis(
    fault=FAULT,
    std_dev=np.array([0.05, 0.01, 0.01]) * DEG,
    faulty=np.array([True, False, False]),
    gyro_correction=-BIAS,
    since=np.array([3.0, 0.0, 0.0]),
)
QBALL = load_vehicle("qball_x4")


def resting(seed=3):
    """Inputs of a vehicle at rest: noise of a MEMS IMU, gyro bias, fault."""
    noise = np.random.default_rng(seed)
    while True:
        attitude = quaternion_from_euler(FAULT + 0.1 * DEG * noise.standard_normal(3))
        gyro = BIAS + 0.007 * DEG / np.sqrt(DT) * noise.standard_normal(3)
        yield FaultObserverInputs(level_sample()._replace(q_xyzw=attitude, body_rate=gyro), np.zeros(3))


def test_supervised_goes_on_with_fault_and_bias():
    observer, samples = Supervised(vehicle=QBALL), resting()
    stepper, first = Stepper(observer), next(samples)
    found = [stepper.begin(FIRST_NS, first, WORDS)]
    found += [stepper.step(FIRST_NS + k * PERIOD_NS, next(samples)) for k in range(1, 1250)]  # 5 s
    states = np.array([each.state for each in found])
    assert np.all(states[:, 0] == FAULTY)
    assert np.all(states[:, 1:] == HEALTHY)
    assert found[0].onset_age[0] == pytest.approx(3.0)
    angles = np.array([euler_from_quaternion(each.corrected.q_xyzw) for each in found]) / DEG
    rates = np.array([each.corrected.body_rate for each in found]) / DEG
    assert np.max(np.abs(angles)) < 0.5
    assert np.max(np.abs(rates.mean(axis=0))) < 0.05


def test_supervised_without_last_words_takes_the_fault_for_the_attitude():
    observer, samples = Supervised(vehicle=QBALL), resting()
    estimate = Stepper(observer).step(FIRST_NS, next(samples))
    assert euler_from_quaternion(estimate.corrected.q_xyzw)[0] / DEG == pytest.approx(2.0, abs=0.5)


def test_supervised_that_has_taken_over_trusts_the_sensor_when_its_fault_ends():
    diagnosis, samples = Diagnosis(Supervised(vehicle=QBALL), CEngine()), resting()
    diagnosis.offer(FIRST_NS - PERIOD_NS, WORDS)
    for k, each in zip(range(3000), samples, strict=False):
        sample = each.imu
        if k >= 500:
            q_xyzw = quaternion_from_euler(euler_from_quaternion(sample.q_xyzw) - FAULT)
            sample = sample._replace(q_xyzw=q_xyzw)
        estimate = diagnosis.diagnose(FIRST_NS + k * PERIOD_NS, sample, np.zeros(3))
        assert k >= 500 or estimate.state[0] == FAULTY
    assert diagnosis.resumed == 1
    assert estimate.state.tolist() == [HEALTHY] * 3


@pytest.mark.parametrize("name", sorted(fault_observers.names()))
def test_every_observer_can_go_on(name):
    observer, samples = fault_observers.get(name)(vehicle=QBALL), resting()
    first = next(samples)
    stepper = Stepper(observer)
    estimates = [stepper.begin(FIRST_NS, first, WORDS)]
    estimates += [stepper.step(FIRST_NS + k * PERIOD_NS, next(samples)) for k in range(1, 5)]
    assert np.all(np.isfinite([each.corrected.q_xyzw for each in estimates]))


@pytest.mark.parametrize("model", ["constant", "ramp", "harmonic", "constant+harmonic"])
def test_disturbance_observer_goes_on_from_the_estimate(model):
    observer = Exosystem(vehicle=QBALL, model=model)
    inputs = DisturbanceObserverInputs(np.zeros(3), np.bool_(True), np.zeros(3))
    estimate = np.array([1.0, -2.0, 0.5])
    found = Stepper(observer).begin(FIRST_NS, inputs, estimate)
    np.testing.assert_allclose(found, estimate)


def test_last_words_are_used_once_by_who_began_after_them():
    handover = ResumingStepper(Exosystem(vehicle=QBALL))
    assert handover.words_for(FIRST_NS) is None
    handover.offer(FIRST_NS - 3_000_000_000, "words")
    assert handover.words_for(FIRST_NS + PERIOD_NS) == "words"
    handover.drop_words()
    assert handover.words_for(FIRST_NS + 2 * PERIOD_NS) is None
    handover.offer(FIRST_NS - 2_999_000_000, "of the same loss")
    assert handover.words_for(FIRST_NS + 3 * PERIOD_NS) is None
    handover.offer(FIRST_NS + PERIOD_NS, "its own")
    assert handover.words_for(FIRST_NS + 10 * PERIOD_NS) is None
    assert handover.words_for(FIRST_NS + 2_000_000_000) == "its own"  # after a gap it begins after them


def test_old_words_are_not_used():
    handover = ResumingStepper(Exosystem(vehicle=QBALL))
    handover.offer(FIRST_NS - round((OLDEST_WORDS + 0.1) * 1e9), "words")
    assert handover.words_for(FIRST_NS) is None


def rested(first, second, before=400, after=260):
    """A vehicle at rest without a fault whose observer is changed in flight.

    Returns corrected Euler angles [deg] and body rates [deg/s] from the change on, and what the first
    observer would have said there.
    """
    diagnosis = Diagnosis(fault_observers.get(first)(vehicle=QBALL), CEngine())
    samples = resting()

    def corrected(by, k, each):
        healthy = quaternion_from_euler(euler_from_quaternion(each.imu.q_xyzw) - FAULT)
        sample = each.imu._replace(q_xyzw=healthy)
        imu = by.diagnose(FIRST_NS + k * PERIOD_NS, sample, np.zeros(3)).corrected
        return np.array([*euler_from_quaternion(imu.q_xyzw), *imu.body_rate]) / DEG

    for k in range(before):
        corrected(diagnosis, k, next(samples))
    alone, each = copy.copy(diagnosis), next(samples)
    diagnosis.switch(fault_observers.get(second)(vehicle=QBALL))
    found = [corrected(diagnosis, before, each)]
    found += [corrected(diagnosis, before + k, next(samples)) for k in range(1, after)]
    assert isinstance(diagnosis.observer, fault_observers.get(second))
    return np.array(found), corrected(alone, before, each)


@pytest.mark.parametrize(
    ("first", "second", "step", "end"),
    [
        ("supervised", "isolating", 0.02, 0.05),
        ("isolating", "sliding_mode", 0.02, 1.0),  # which leaves the gyro its bias
        ("none", "supervised", 0.02, 0.1),
    ],
)
def test_observer_that_takes_over_in_flight_goes_on_where_the_one_before_was(first, second, step, end):
    found, alone = rested(first, second)
    np.testing.assert_allclose(found[0], alone, atol=1e-9)
    assert np.max(np.abs(np.diff(found[:, :3], axis=0))) < step  # deg; the sensor has noise of 0.1
    assert np.max(np.abs(found[-1, :3])) < end


def sender(bench, topic, found):
    """A function that sends the next sample, and waits for what a node says to it, the last of ``found``."""
    send, indices = bench.talk(topic), itertools.count()

    def fly(angles=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0)):
        index = next(indices)
        send(imu_message(FIRST_NS + index * PERIOD_NS, angles, rate))
        bench.until(lambda: len(found) > index)
        return found[-1]

    return fly


def test_observer_is_changed_by_its_parameter_unless_a_fault_is_confirmed(bench):
    with registered() as name:
        node = bench.run(FaultObserverNode, observer=name)
    fly, status = sender(bench, "imu/data", bench.listen("fault/status")), bench.watch_diagnostics()
    bench.connect()
    bench.until(lambda: fly().state[0] == HEALTHY)
    bench.until(lambda: fly(2.0 * FAULT).state[0] == FAULTY)
    refusal = bench.set_parameter("fault_observer", "observer", "supervised")
    assert "a fault is confirmed" in refusal.reason
    bench.until(lambda: fly().state[0] == HEALTHY)
    assert not bench.set_parameter("fault_observer", "observer", "nonsense").successful
    assert bench.set_parameter("fault_observer", "observer", "supervised").successful
    fly()
    bench.until(lambda: status["fault_observer: observer"].message == "supervised")
    assert bench.set_parameter("fault_observer", "supervised.gyro_bias", 0.01).successful
    assert node.settings.values()["observer"] == "supervised"


def test_diagnosis_resumes_at_the_first_complete_sample_after_the_words():
    diagnosis, samples = Diagnosis(Supervised(vehicle=QBALL)), resting()
    diagnosis.offer(FIRST_NS - 1_000_000_000, WORDS)
    blind = level_sample()._replace(attitude_valid=np.bool_(False))
    estimate = diagnosis.diagnose(FIRST_NS, blind, np.zeros(3))
    assert (diagnosis.resumed, estimate.state.tolist()) == (0, [STARTING] * 3)
    estimate = diagnosis.diagnose(FIRST_NS + PERIOD_NS, next(samples).imu, np.zeros(3))
    assert (diagnosis.resumed, estimate.state[0]) == (1, FAULTY)
    assert estimate.onset_age[0] == pytest.approx(4.0 + DT)


@pytest.mark.parametrize("name", ["isolating", "none"])
def test_gyro_bias_is_told_while_it_still_leaves_the_corrected_rate(name):
    diagnosis, samples = Diagnosis(fault_observers.get(name)(vehicle=QBALL), CEngine()), resting()
    for k in range(500):  # 2 s; the bias is known after about one, and leaves the rate in two
        sample = next(samples).imu
        estimate = diagnosis.diagnose(FIRST_NS + k * PERIOD_NS, sample, np.zeros(3))
    assert np.max(np.abs(sample.body_rate - estimate.corrected.body_rate - BIAS)) > 0.3 * DEG
    told = BIAS if name == "isolating" else np.zeros(3)
    np.testing.assert_allclose(diagnosis.gyro_bias(sample, estimate), told, atol=0.05 * DEG)


def test_words_that_are_not_finite_are_dropped():
    diagnosis, samples = Diagnosis(Supervised(vehicle=QBALL)), resting()
    diagnosis.offer(FIRST_NS - 1_000_000_000, WORDS._replace(gyro_correction=np.full(3, np.nan)))
    for k in range(3):
        estimate = diagnosis.diagnose(FIRST_NS + k * PERIOD_NS, next(samples).imu, np.zeros(3))
    assert (diagnosis.resumed, estimate.state.tolist()) == (0, [STARTING] * 3)


def test_disturbance_estimation_resumes_once_at_a_sample_with_a_body_rate():
    estimation = DisturbanceEstimation(Exosystem(vehicle=QBALL))
    estimation.offer(FIRST_NS - 1_000_000_000, np.array([0.7, 0.0, 0.0]))
    blind = level_sample()._replace(rate_valid=np.bool_(False))
    estimation.estimate(FIRST_NS, blind, np.zeros(3))
    assert estimation.resumed == 0
    estimate = estimation.estimate(FIRST_NS + PERIOD_NS, level_sample(), np.zeros(3))
    assert (estimation.resumed, estimate[0]) == (1, pytest.approx(0.7))
    estimation.estimate(FIRST_NS + 2 * PERIOD_NS, level_sample(), np.zeros(3))
    assert estimation.resumed == 1


def test_disturbance_observer_is_changed_in_flight_without_a_jump():
    estimation, found = DisturbanceEstimation(Exosystem(vehicle=QBALL, bandwidth=50.0)), []
    estimation.switch(Exosystem(vehicle=QBALL, bandwidth=20.0))  # of its own kind: only its parameters
    changes = {100: "none", 400: "exosystem"}
    for k in range(700):
        if k in changes:
            estimation.switch(disturbance_observers.get(changes[k])(vehicle=QBALL))
        spun = level_sample()._replace(body_rate=np.array([0.5 * k * DT, 0.0, 0.0]))
        found.append(estimation.estimate(FIRST_NS + k * PERIOD_NS, spun, np.zeros(3))[0])
    assert found[100] == pytest.approx(0.5, abs=1e-3)
    assert found[399] == 0.0
    assert found[-1] == pytest.approx(0.5, abs=1e-3)
    assert np.max(np.abs(np.diff(found[99:]))) < 0.025  # rad/s²; by the bandwidth


def test_an_unusable_last_estimate_is_ignored():
    estimation = DisturbanceEstimation(Exosystem(vehicle=QBALL))
    estimation.offer(FIRST_NS - 1_000_000_000, np.array([np.nan, 0.0, 0.0]))
    np.testing.assert_array_equal(estimation.estimate(FIRST_NS, level_sample(), np.zeros(3)), 0.0)
    assert estimation.resumed == 0


def kept_status():
    """The last status of an observer that has died, two seconds before the first sample."""
    kept = FaultStatus(state=WORDS.faulty * FAULTY + ~WORDS.faulty * HEALTHY)
    kept.header.stamp = time_message(FIRST_NS - 2_000_000_000)
    return kept


def test_fault_observer_node_takes_over(bench):
    bench.run(FaultObserverNode, observer="supervised")
    gyro, words, states = bench.talk("gyro/kept"), bench.talk("fault/kept"), bench.listen("fault/status")
    fly = sender(bench, "imu/data", states)
    bench.connect()
    assert fly(FAULT, BIAS).state.tolist() == [STARTING] * 3
    kept = kept_status()
    kept.onset[0] = time_message(FIRST_NS - 4_000_000_000)
    kept.estimate.x, kept.std_dev.x = FAULT[0], 1e-3
    gyro(vector_message(FIRST_NS - 2_000_000_000, -BIAS))
    words(kept)
    bench.until(lambda: fly(FAULT, BIAS).state[0] == FAULTY)
    assert states[-1].estimate.x == pytest.approx(FAULT[0], abs=1e-4)
    assert states[-1].onset[0] == kept.onset[0]


def test_observer_of_all_sensors_resumes_and_reports_at_once(bench):
    with registered() as name:
        bench.run(FaultObserverNode, observer=name)
    gyro, words, reports = bench.talk("gyro/kept"), bench.talk("fault/kept"), bench.listen("diagnosis")
    fly = sender(bench, "imu/data", bench.listen("fault/status"))
    bench.connect()
    gyro(vector_message(FIRST_NS - 2_000_000_000, (-0.4, 0.0, 0.0)))  # of a gyro that was faulty
    words(kept_status())

    def named():
        fly(FAULT, (0.4, 0.0, 0.0))
        return any(fault.component == "gyro" for report in reports for fault in report.faults)

    bench.until(named)
    assert reports[0].faults


def test_disturbance_observer_node_takes_over(bench):
    bench.run(DisturbanceObserverNode)
    kept, found = bench.talk("disturbance/kept"), bench.listen("disturbance/estimate")
    fly = sender(bench, "imu/corrected", found)
    bench.connect()
    kept(vector_message(FIRST_NS - 2_000_000_000, (0.7, 0.0, 0.0)))
    bench.until(lambda: fly().vector.x == pytest.approx(0.7))
