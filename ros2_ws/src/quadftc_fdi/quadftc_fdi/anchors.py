"""Anchors of the supervision: two earlier states of the filter that have run on the gyro alone since.

A fault so slow that the filter follows it shows in the residuals of an anchor, and when it is found the
filter goes back to one, so that what it has taken from the fault is undone. Each time the younger reaches
half the greatest age it becomes the older, and a new one is set: memory and work of a step are constant.

An anchor is kept as the correction (..., 16) that the filter has received since. That follows the transition
of the error state, so the residual of the anchor is that of the filter plus H times it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.error_transition import SIZE, Transition
from quadftc_fdi.inertial_filter import MEASURED, FilterState, bias_variance, shifted
from quadftc_model.arrays import Array, any_of, changed_where, namespace, product

OLD, YOUNG = 3, 4  # columns of the residuals; those before are of the filter itself
ANCHORED = np.array([0.0, 0.0, 0.0, 1.0, 1.0])
# x @ ROLLED: the young anchor becomes the old one, and starts at zero
ROLLED = np.array(
    [[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0], [0, 0, 1.0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0]]
)


class Anchors(NamedTuple):
    """Two earlier states of the filter, relative to it."""

    ahead: Array  # (..., 16, 5) corrections since; the first three columns are zero
    P: Array  # (..., 2, 16, 16) covariance now, the older first
    age: Array  # (..., 1) of the younger [s]


def anchored(P: Array) -> Anchors:
    """Both at a state with a covariance (..., 16, 16)."""
    xp = namespace(P)
    batch = P.shape[:-2]
    return Anchors(xp.zeros((*batch, SIZE, 5)), xp.stack([P, P], axis=-3), xp.zeros((*batch, 1)))


def carried(anchors: Anchors, F: Transition, noise: Array) -> Anchors:
    """Take a step with the transition of the filter's, and its noise (..., 16, 16)."""
    xp = namespace(noise)
    P = xp.stack([F.around(anchors.P[..., age, :, :]) + noise for age in (0, 1)], axis=-3)
    return anchors._replace(ahead=F.of(anchors.ahead), P=P)


def own_variances(P: Array, anchors: Anchors, H: Array) -> Array:
    """Variance (..., 3, 3) of each predicted angle by filter, old and young anchor [rad²]."""
    covariances = namespace(P).concatenate([P[..., None, :, :], anchors.P], axis=-3)
    each = H[..., None, :, :]
    return (product(each, covariances, MEASURED) * each).sum(axis=-1).swapaxes(-1, -2)


def returned(
    estimate: FilterState,
    anchors: Anchors,
    residuals: Array,
    own: Array,
    back: Array,
    far: Array,
    known: float,
) -> tuple[FilterState, Array, Array]:
    """Go back to an anchor, unless it is of the time when the gyro bias was still unknown, and now it is not.

    Parameters
    ----------
    estimate : FilterState
    anchors : Anchors
    residuals : array (..., 3, 5)
        [rad].
    own : array (..., 3, 3)
        Of `own_variances`.
    back, far : array (..., 3) bool
        Axes that ask to go back, and to the old anchor; else to the young one: less is lost.
    known : float
        Standard deviation up to which a gyro bias is known [rad/s].

    Returns
    -------
    FilterState, its residual (..., 3), and the variance (..., 3) of its angles.
    """
    xp = namespace(back)

    def gone() -> tuple[FilterState, Array, Array]:
        most = xp.maximum(known**2, 2.0 * bias_variance(estimate.P))
        old_knows, young_knows = (bias_variance(anchors.P[..., k, :, :]) <= most for k in (0, 1))
        returns, to_old = any_of(back) & young_knows, any_of(far) & old_knows

        def chosen(now: Array, young: Array, old: Array) -> Array:
            extra = (None,) * (now.ndim - returns.ndim)
            return xp.where(returns[(..., *extra)], xp.where(to_old[(..., *extra)], old, young), now)

        ahead = anchors.ahead
        dx = chosen(xp.zeros_like(ahead[..., 0]), ahead[..., YOUNG], ahead[..., OLD])
        P = chosen(estimate.P, anchors.P[..., 1, :, :], anchors.P[..., 0, :, :])
        residual = chosen(residuals[..., 0], residuals[..., YOUNG], residuals[..., OLD])
        return shifted(estimate._replace(P=P), -dx), residual, chosen(own[..., 0], own[..., 2], own[..., 1])

    return changed_where(back, gone, (estimate, residuals[..., 0], own[..., 0]))


def renewed(
    anchors: Anchors, P: Array, dx: Array, anew: Array, held: Array, dt: float, oldest: float
) -> tuple[Anchors, Array]:
    """Take a correction of the filter, begin anew where told to, and roll on when of age.

    Parameters
    ----------
    anchors : Anchors
    P : array (..., 16, 16)
        Covariance of the filter now.
    dx : array (..., 16)
        Its correction.
    anew, held : array (..., 1) bool
        Both begin at the present state; neither is given up, as it may be needed soon.
    dt, oldest : float
        Step, and greatest age [s].

    Returns
    -------
    Anchors, and whether (..., 1) the young one became the old one.
    """
    xp = namespace(dx)
    age = (anchors.age + dt) * ~anew
    rolled = (age > 0.5 * oldest) & ~held
    kept = Anchors(anchors.ahead + dx[..., None] * ANCHORED, anchors.P, age * ~rolled)

    def changed() -> Anchors:
        now = P[..., None, :, :]
        covariance = xp.where(anew[..., None, None], now, kept.P)
        next_ones = xp.concatenate([covariance[..., 1:, :, :], now], axis=-3)
        ahead = kept.ahead * ~anew[..., None]
        return kept._replace(
            ahead=xp.where(rolled[..., None], ahead @ ROLLED, ahead),
            P=xp.where(rolled[..., None, None], next_ones, covariance),
        )

    return changed_where(anew | rolled, changed, kept), rolled
