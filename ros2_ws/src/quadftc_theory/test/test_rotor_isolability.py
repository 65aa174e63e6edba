"""Which weak rotors look alike: quadrotor and hexarotors."""

import numpy as np
import pytest
from layouts import SIXTH, circle, with_rotors
from rotor_isolability import alike, effects_in_hover, largest_cosine

from quadftc_model.vehicle import load_vehicle

X500 = load_vehicle("x500")


@pytest.mark.parametrize("accelerometer", [False, True])
def test_no_two_sets_of_two_rotors_of_a_quadrotor_look_alike(accelerometer):
    assert alike(effects_in_hover(X500, accelerometer)) == []


@pytest.mark.parametrize(
    ("layout", "pairs"),
    [
        ("PNPNPN", [((1, 4), (2, 5)), ((1, 4), (3, 6)), ((2, 5), (3, 6))]),
        ("PPNNPN", [((1, 3), (2, 6)), ((2, 4), (3, 5))]),
    ],
)
def test_single_rotors_of_a_hexarotor_are_told_apart_and_some_pairs_are_not(layout, pairs):
    effects = effects_in_hover(with_rotors(X500, circle(-SIXTH), layout))
    assert alike(effects, 1) == []
    assert alike(effects) == pairs


def test_rotors_at_one_place_that_turn_alike_look_alike():
    effects = effects_in_hover(X500)
    twice = np.concatenate([effects, effects[:, :1]], axis=1)
    assert alike(twice, 1) == [((1,), (5,))]
    assert largest_cosine(twice) == pytest.approx(1.0)


def test_quadrotor_with_accelerometer_has_orthogonal_rotors():
    assert largest_cosine(effects_in_hover(X500)) == pytest.approx(0.0, abs=1e-12)
