r"""Does a rotor follow its command? Measured against commanded thrust, where speeds are measured.

Both are averaged over 15 and 60 ms. A rotor is faulty once they differ by more than `FAR` of the hover
thrust, and by more than a wrong lag explains: `UNSURE` of what the command has just changed. It is healthy
again when they have agreed for `RECOVERED`, to a factor of two even where little is commanded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Scalar, clip, exp, larger, namespace

TIMES = np.array([0.015, 0.06])  # s
FAR = np.array([0.35, 0.12])  # 1; of hover thrust, for each time
UNSURE = 0.6  # 1; share of fast changes of the command that a healthy rotor may not show
HOLD, RECOVERED, SHOWN = (
    0.011,
    0.5,
    0.1,
)  # s; before it is faulty; before it is healthy; before it is recovering
LEAST = 0.01  # 1; of hover thrust: a command that shows whether a rotor follows
STEADY = 0.03  # 1; of hover thrust: a speed that is still


class Following(NamedTuple):
    """How each rotor follows."""

    mean: Array  # measured and commanded thrust, averaged, (..., 2, 2 n)
    apart: Array  # for how long they have differed (..., n) [s]
    calm: Array  # for how long they have agreed (..., n) [s]
    faulty: Array  # bool (..., n)
    share: Array  # of its thrust that a faulty rotor does not give (..., n) [1]
    still: Array  # bool; its speed does not change


def start_following(thrusts: Array) -> Following:
    """Start at thrusts (..., n), as commanded."""
    xp = namespace(thrusts)
    zeros = xp.zeros_like(thrusts)
    mean = xp.concatenate([thrusts, thrusts], axis=-1)[..., None, :] * np.ones((2, 1))
    return Following(mean, zeros, zeros, zeros > 1.0, zeros, zeros > 1.0)


def step_following(state: Following, thrusts: Array, wanted: Array, hover: Scalar, dt: Scalar) -> Following:
    """Advance by ``dt`` [s]: measured and commanded thrust (..., n)."""
    xp, n = namespace(thrusts), thrusts.shape[-1]
    news = xp.concatenate([thrusts, wanted], axis=-1)
    mean = state.mean + (1.0 - exp(-dt / TIMES))[:, None] * (news[..., None, :] - state.mean)
    given, asked = mean[..., :n], mean[..., n:]
    quick = UNSURE * abs(wanted - asked[..., 1, :])
    apart = (abs(asked - given) > FAR[:, None] * hover + quick[..., None, :]).any(axis=-2)
    time = (state.apart + dt) * apart
    faulty = state.faulty | (time > HOLD)
    # a rotor that nobody asks for anything shows nothing
    shows = (asked > LEAST * hover) & (given > 0.5 * asked) & (given < 2.0 * asked)
    calm = (state.calm + dt) * (faulty & shows.all(axis=-2) & ~apart)
    faulty = faulty & (calm < RECOVERED)
    share = 1.0 - given[..., 0, :] / larger(asked[..., 0, :], 1e-3 * hover)
    share = clip(share, 0.0, 1.0) * faulty
    still = faulty & (abs(thrusts - given[..., 1, :]) < STEADY * hover)
    return Following(mean, time, calm * faulty, faulty, share, still)
