"""What the position says of the attitude: faults that it shows, and such that it does not."""

import numpy as np
import pytest

from quadftc_fdi.bank import hypotheses, inference, modes, translation
from quadftc_fdi.bank.motion import LOUD
from quadftc_fdi.isolation import free_flight
from quadftc_fdi.isolation.accelerometer_monitor import start_accelerometer
from quadftc_fdi.isolation.reading_test import start_test
from quadftc_model.position_estimator import PositionEstimatorInputs
from quadftc_model.samples import STANDARD_GRAVITY, PositionSample, level_sample

SLOPE, AGE = 0.01, 10.0  # rad/s, s; of the fault of roll
DUE = SLOPE * (AGE - 1.0)  # rad; one second late, as the filter of b is here
OF_ROLL = [3 * modes.ATTITUDE, 3 * modes.CREEP]  # modes that creep
OTHERS = np.delete(np.arange(modes.MODES), OF_ROLL)
SHAPE = (modes.MODES, len(hypotheses.RING))


def said_of(tilt, learned=10.0, believed=0.0):
    """Return what a tilt [rad] by the position adds to the log weights, and where it is asked.

    ``believed`` is the tilt that it shows of a fault that is believed [rad].
    """
    imu, law = level_sample(), free_flight.motion_law(0.0, 0.002, False, 0.1)
    here = PositionSample(np.zeros(3), np.zeros(3), np.bool_(True))
    flight = free_flight.start_flight(law, PositionEstimatorInputs(imu, here), np.float64(0.0))
    covariance = np.array([0.0, 0.0, 0.0, 0.0, 0.0, free_flight.WALK**2])
    bias = np.array([0.0, -STANDARD_GRAVITY * tilt, 0.0])
    motion = flight.motion._replace(covariance=covariance, bias=bias, started=np.bool_(True))
    due = np.array([believed, 0.0, 0.0])
    flight = flight._replace(motion=motion, learned=np.float64(learned), due=due)
    force = imu.specific_force
    state = translation.Translation(
        start_test(force, 0.1), start_accelerometer(force), flight, None, np.zeros(3)
    )
    return asked(state)


def asked(state):
    bank = hypotheses.start_bank(np.zeros(3))
    bank = bank._replace(age=bank.age * 0.0 + AGE)
    b = np.zeros((2, *SHAPE))
    b[1, OF_ROLL] = SLOPE
    posterior = inference.Posterior(np.zeros(SHAPE), b, np.zeros((3, *SHAPE)), np.zeros(3), np.ones(3))
    after, where = translation.ask_position(state, bank, posterior)
    return after.log_weight, where


def test_a_drift_of_roll_that_the_position_shows_is_likelier_and_nothing_else_is():
    said, where = said_of(DUE)
    assert np.all((said[OF_ROLL] > -translation.RIVAL) & (said[OF_ROLL] < 0.4 * LOUD))
    assert np.all(abs(said[OTHERS]) < 0.01)
    assert where.tolist() == [True, True, False]


def test_a_drift_of_roll_that_the_position_does_not_show_is_less_likely():
    said, _ = said_of(0.0)
    assert said[OF_ROLL] == pytest.approx(-0.5 * LOUD, rel=1e-3)


def test_a_tilt_that_no_fault_of_the_attitude_explains_is_the_accelerometers():
    said, _ = said_of(-DUE)
    assert np.all(said[OF_ROLL] < -10.0)
    assert np.all(abs(said[OTHERS]) < 0.01)


def test_a_tilt_by_a_fault_that_is_believed_speaks_for_no_other():
    said, _ = said_of(DUE, believed=DUE)
    assert np.all(said[OF_ROLL] <= 0.0)
    said, _ = said_of(1.1 * DUE, believed=DUE)
    assert np.all(said[OF_ROLL] < 1.0), "of a large one nobody knows exactly what is shown"


def test_without_a_position_or_before_it_is_known_nobody_is_asked():
    said, where = said_of(DUE, learned=0.0)
    assert not said.any()
    assert not where.any()
    force = level_sample().specific_force
    stand = translation.Translation(
        start_test(force, 0.1), start_accelerometer(force), None, None, np.zeros(3)
    )
    said, where = asked(stand)
    assert not said.any()
    assert not where.any()
