"""Margins of incremental dynamic inversion, against the roots of the closed loop."""

import numpy as np
import pytest

from quadftc_control.controllers.indi import Indi
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_theory.indi_conditions import margins, transfer_function

QBALL = load_vehicle("qball_x4")
NO_DELAY = 1e-6  # s, of half a sampling period


def poles(law, factor):
    """Of the closed loop of roll, for a vehicle whose inertia is a factor times that of the model."""
    numerator, denominator = transfer_function(law, 0)
    return np.roots(np.polyadd(numerator, factor * denominator))


@pytest.mark.parametrize("vehicle", vehicle_names())
def test_loop_is_stable_between_the_inertia_margins_and_nowhere_else(vehicle):
    law = Indi(vehicle=load_vehicle(vehicle))
    found = margins(law, 0, NO_DELAY)
    for factor, stands in (
        (0.99 * found.lightest, False),
        (1.01 * found.lightest, True),
        (0.99 * found.heaviest, True),
        (1.01 * found.heaviest, False),
    ):
        assert np.all(poles(law, factor).real < 0.0) == stands


def test_filter_is_not_in_the_motion_when_the_model_is_right():
    motions = [poles(Indi(vehicle=QBALL, cutoff=cutoff), 1.0) for cutoff in (20.0, 200.0)]
    wanted = np.roots([QBALL.rotors.time_constant, 1.0, 9.0, 9.0 * 3.5])
    for motion in motions:
        assert np.max(np.min(np.abs(motion[:, None] - wanted), axis=0)) < 1e-6


def test_delay_margin_takes_the_loop_to_minus_one():
    law = Indi(vehicle=QBALL)
    delay = margins(law, 0, NO_DELAY).delay
    numerator, denominator = transfer_function(law, 0)
    s = 1j * np.geomspace(0.1, 1e3, 200000)
    loop = np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-delay * s)
    assert np.min(np.abs(1.0 + loop)) < 1e-3
    assert np.min(np.abs(1.0 + loop * np.exp(0.5 * delay * s))) > 0.1
