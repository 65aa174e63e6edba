"""What a recording says of how alike the axes of a gyro get noisy."""

from __future__ import annotations

import numpy as np
import pytest

from quadftc_replay.flight_log import Signal
from quadftc_tools.study.scatter import SETTLES, alone_of


@pytest.mark.parametrize(
    ("shares", "least", "most"), [((1.0, 0.0, 0.0), 2.0, 9.0), ((1.0, 1.0, 1.0), -1.0, 1.0)]
)
def test_an_axis_that_gets_noisy_by_itself_is_alone(shares, least, most):
    time = np.arange(0.0, 6.0, 0.004)
    loud = 0.002 + 0.05 * np.array(shares) * (time > 4.0)[:, None]
    gyro = Signal(time, loud * np.random.default_rng(1).standard_normal((len(time), 3)))
    alone = alone_of(gyro)
    assert len(alone) == np.sum(time > SETTLES)
    assert least <= alone[:, 0].max() <= most
    assert alone[:, 1:].max() < 1.0
