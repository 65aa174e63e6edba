"""A dead node is started again with a growing delay, until it dies too often."""

import pytest

from quadftc_flight.graph.processes import LAST_DELAY, MEMORY, MOST_DEATHS, Respawn


def test_delay_doubles_and_ends():
    respawn, delays = Respawn(), []
    for k in range(MOST_DEATHS + 1):
        delays.append(respawn.died("controller", 1.0 * k))
        if delays[-1] is not None:
            assert respawn.started("controller") == k + 1
    assert delays == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, None])
    assert max(delays[:-1]) <= LAST_DELAY
    assert respawn.died("reference", 9.0) == pytest.approx(0.1)  # each for itself
    assert respawn.restarts == {"controller": MOST_DEATHS}


def test_old_deaths_are_forgotten():
    respawn = Respawn()
    for k in range(3 * MOST_DEATHS):
        assert respawn.died("controller", k * MEMORY / MOST_DEATHS * 1.01) is not None
        respawn.started("controller")


def test_one_death_counts_once():
    respawn = Respawn()
    assert not respawn.waits("plant")
    assert respawn.died("plant", 5.0) == pytest.approx(0.1)
    assert respawn.waits("plant")
    assert respawn.died("plant", 5.06) == pytest.approx(0.04)
    assert respawn.died("plant", 5.2) == 0.0
