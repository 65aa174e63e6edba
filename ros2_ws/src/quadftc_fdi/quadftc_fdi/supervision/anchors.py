"""Anchors: two earlier states of the filter that have run on the gyro alone since.

A fault so slow that the filter follows it shows in the residuals of an anchor. When it is found, the filter
goes back to an anchor, and so forgets what the fault has taught it. Each time the younger anchor reaches half
the greatest age it replaces the older, and a new one is set: memory and work of a step are constant.

An anchor is stored as the corrections c (16) that the filter has received since. They follow the transition
of the error state, so nothing is computed twice:

    c <- F c + dx,   P_anchor <- F P_anchor F' + Q,   residual of the anchor = residual of the filter + H c
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.supervision import inertial_filter, measurement
from quadftc_fdi.supervision.measurement import MEASURED, Prediction
from quadftc_fdi.supervision.transition import SIZE, Covariance, Covariances, FilterState
from quadftc_model import arrays
from quadftc_model.arrays import (
    Column,
    Float,
    Mask,
    Scalar,
    Vector,
    any_of,
    branch,
    chosen,
    larger,
    namespace,
    product,
    where,
)

Residuals = Float[arrays.AnyArray, "*batch 3 5"]
Predicted = Float[arrays.AnyArray, "*batch 3 3"]
One = arrays.Bool[arrays.AnyArray, "*batch 1"]

OLD, YOUNG = 3, 4  # columns of the residuals; the three before are of the filter itself
# x @ PROMOTION: the column of the young anchor moves to the old one, and starts at zero
PROMOTION = np.array(
    [[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0], [0, 0, 1.0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0]]
)
TO_RESIDUALS = np.eye(5)[OLD:]
NEXT_ONE = np.array([[0.0, 0.0], [1.0, 0.0]])  # corrections @ NEXT_ONE: the same, for the two anchors


class Anchors(NamedTuple):
    """Two earlier states of the filter, relative to it; the older first."""

    corrections: Float[arrays.AnyArray, "*batch 16 2"]  # of the filter since
    P: Covariances  # now
    age: Column  # of the younger [s]


def set_anchors(P: Covariance) -> Anchors:
    """Set both at the present state of a filter with covariance P."""
    xp, batch = namespace(P), P.shape[:-2]
    return Anchors(xp.zeros((*batch, SIZE, 2)), xp.stack([P, P], axis=-3), xp.zeros((*batch, 1)))


def compare_anchors(
    anchors: Anchors, prediction: Prediction, residual: Vector
) -> tuple[Residuals, Predicted]:
    """Compare the measured angles with those of the anchors, given the filter's prediction and residual.

    Return the residuals [rad] of the filter (three times), the old and the young anchor, and the variances
    (..., angle, source) of the angles [rad²] that filter, old and young anchor predict.
    """
    shifts = product(prediction.H, anchors.corrections, MEASURED)
    xp, residuals = namespace(residual), residual[..., None] + shifts @ TO_RESIDUALS
    variances = measurement.variances_by(prediction, anchors.P)
    variances = xp.concatenate([prediction.variances[..., None, :], variances], axis=-2)
    return residuals, variances.swapaxes(-1, -2)


def go_back_to_anchor(
    estimate: FilterState,
    prediction: Prediction,
    anchors: Anchors,
    residuals: Residuals,
    back: Mask,
    far: Mask,
    known: Scalar,
) -> tuple[FilterState, Prediction, Vector]:
    """Go back to an anchor where an axis asks for it.

    ``back`` are these axes; those of ``far`` need the old anchor. But the filter does not go back to before
    the gyro bias was known to ``known`` [rad/s], 1 sigma, if it is now: forgetting the bias costs more than
    the fault has done. ``residuals`` [rad] are of `compare_anchors`. Also return the prediction and the
    residual (..., 3) [rad] of the filter.
    """
    xp, c = namespace(back), anchors.corrections
    # which anchor: a bias may be known half as well, in variance, as now
    old, young = (anchors.P[..., which, :, :] for which in (0, 1))
    limit = larger(known**2, 2.0 * inertial_filter.bias_variance(estimate.P))
    old_knows, young_knows = (inertial_filter.bias_variance(each) <= limit for each in (old, young))
    returns, to_old = (any_of(back) & young_knows)[..., 0], (any_of(far) & old_knows)[..., 0]
    # take back the corrections since then; covariance and residual are those of the anchor
    now = xp.zeros_like(c[..., 0]), estimate.P, residuals[..., 0]
    then = chosen(to_old, (c[..., 0], old, residuals[..., OLD]), (c[..., 1], young, residuals[..., YOUNG]))
    dx, P, residual = chosen(returns, then, now)
    moved = inertial_filter.apply_correction(estimate._replace(P=P), -dx)
    return moved, measurement.predict_again(prediction, P), residual


def update_anchors(
    anchors: Anchors,
    P: Covariance,
    dx: inertial_filter.Errors,
    restart: One,
    hold: One,
    dt: Scalar,
    greatest_age: Scalar,
) -> tuple[Anchors, One]:
    """Note a correction dx of the filter; promote the young anchor at half of ``greatest_age`` [s].

    Where ``restart``, both anchors move to the present state, with the filter's covariance P. Where ``hold``,
    none is given up, as it may be needed soon. Also return where the young one has become the old one.
    """
    age = anchors.age + dt
    promoted = ~hold & (age > 0.5 * greatest_age)
    changes = restart | promoted
    kept = Anchors(anchors.corrections + dx[..., None], anchors.P, age)

    def replace() -> Anchors:
        xp, now = namespace(dx), P[..., None, :, :]
        again, moved = restart[..., None], changes[..., None]
        c = where(moved, (kept.corrections * ~again) @ NEXT_ONE, kept.corrections)
        old, young = kept.P[..., :1, :, :], kept.P[..., 1:, :, :]
        old = where(again[..., None], now, where(moved[..., None], young, old))
        young = where(moved[..., None], now, young)
        return Anchors(c, xp.concatenate([old, young], axis=-3), age * ~changes)

    return branch(changes[..., 0], replace, lambda: kept), promoted
