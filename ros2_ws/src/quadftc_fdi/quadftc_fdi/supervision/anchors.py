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

from quadftc_fdi.supervision import inertial_filter
from quadftc_fdi.supervision.inertial_filter import MEASURED, SIZE, Covariance, FilterState, MeasurementMatrix
from quadftc_model import arrays
from quadftc_model.arrays import Array, Column, Float, Mask, Vector, any_of, changed_where, namespace, product

Residuals = Float[arrays.AnyArray, "*batch 3 5"]
Predicted = Float[arrays.AnyArray, "*batch 3 3"]
One = arrays.Bool[arrays.AnyArray, "*batch 1"]

OLD, YOUNG = 3, 4  # columns of the residuals; the three before are of the filter itself
IS_ANCHOR = np.array([0.0, 0.0, 0.0, 1.0, 1.0])
# x @ PROMOTION: the column of the young anchor moves to the old one, and starts at zero
PROMOTION = np.array(
    [[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0], [0, 0, 1.0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0]]
)


class Anchors(NamedTuple):
    """Two earlier states of the filter, relative to it."""

    corrections: Float[arrays.AnyArray, "*batch 16 5"]  # of the filter since; columns 0 to 2 are zero
    P: Float[arrays.AnyArray, "*batch 2 16 16"]  # covariance now, the older anchor first
    age: Column  # of the younger [s]


def set_anchors(P: Covariance) -> Anchors:
    """Set both at the present state of a filter with covariance P."""
    xp = namespace(P)
    batch = P.shape[:-2]
    return Anchors(xp.zeros((*batch, SIZE, 5)), xp.stack([P, P], axis=-3), xp.zeros((*batch, 1)))


def predict_anchors(anchors: Anchors, F: inertial_filter.Transition, Q: Covariance) -> Anchors:
    """Take a step with the transition and the noise of the filter."""
    xp = namespace(Q)
    P = xp.stack([F.around(anchors.P[..., each, :, :]) + Q for each in (0, 1)], axis=-3)
    return anchors._replace(corrections=F.of(anchors.corrections), P=P)


def all_residuals(residual: Vector, anchors: Anchors, H: MeasurementMatrix) -> Residuals:
    """Residuals [rad] of the filter (three times), the old and the young anchor."""
    return residual[..., None] + product(H, anchors.corrections, MEASURED)


def predicted_variances(P: Covariance, anchors: Anchors, H: MeasurementMatrix) -> Predicted:
    """Variance (..., angle, source) of the angles [rad²] that filter, old and young anchor predict."""
    covariances = namespace(P).concatenate([P[..., None, :, :], anchors.P], axis=-3)
    each = H[..., None, :, :]
    return (product(each, covariances, MEASURED) * each).sum(axis=-1).swapaxes(-1, -2)


def go_back_to_anchor(
    estimate: FilterState,
    anchors: Anchors,
    residuals: Residuals,
    variances: Predicted,
    back: Mask,
    far: Mask,
    known: float,
) -> tuple[FilterState, Vector, Vector]:
    """Go back to an anchor where an axis asks for it.

    ``back`` are these axes; those of ``far`` need the old anchor. But the filter does not go back to before
    the gyro bias was known to ``known`` [rad/s], 1 sigma, if it is now: forgetting the bias costs more than
    the fault has done. ``residuals`` [rad] are of `all_residuals`, ``variances`` [rad²] of
    `predicted_variances`. Also return residual (..., 3) [rad] and variance (..., 3) [rad²] of the filter's
    predicted angles.
    """
    xp = namespace(back)

    def go_back() -> tuple[FilterState, Array, Array]:
        # which anchor: a bias may be known half as well, in variance, as now
        limit = xp.maximum(known**2, 2.0 * inertial_filter.bias_variance(estimate.P))
        old_knows, young_knows = (
            inertial_filter.bias_variance(anchors.P[..., k, :, :]) <= limit for k in (0, 1)
        )
        returns, to_old = any_of(back) & young_knows, any_of(far) & old_knows

        def choose(now: Array, young: Array, old: Array) -> Array:
            extra = (None,) * (now.ndim - returns.ndim)
            return xp.where(returns[(..., *extra)], xp.where(to_old[(..., *extra)], old, young), now)

        # take back the corrections since then; covariance, residual and variance are those of the anchor
        c = anchors.corrections
        dx = choose(xp.zeros_like(c[..., 0]), c[..., YOUNG], c[..., OLD])
        P = choose(estimate.P, anchors.P[..., 1, :, :], anchors.P[..., 0, :, :])
        residual = choose(residuals[..., 0], residuals[..., YOUNG], residuals[..., OLD])
        variance = choose(variances[..., 0], variances[..., 2], variances[..., 1])
        return inertial_filter.apply_correction(estimate._replace(P=P), -dx), residual, variance

    return changed_where(back, go_back, (estimate, residuals[..., 0], variances[..., 0]))


def update_anchors(
    anchors: Anchors,
    P: Covariance,
    dx: inertial_filter.Errors,
    restart: One,
    hold: One,
    dt: float,
    greatest_age: float,
) -> tuple[Anchors, One]:
    """Note a correction dx of the filter; promote the young anchor at half of ``greatest_age`` [s].

    Where ``restart``, both anchors move to the present state, with the filter's covariance P. Where ``hold``,
    none is given up, as it may be needed soon. Also return where the young one has become the old one.
    """
    xp = namespace(dx)
    age = (anchors.age + dt) * ~restart
    promoted = (age > 0.5 * greatest_age) & ~hold
    kept = Anchors(anchors.corrections + dx[..., None] * IS_ANCHOR, anchors.P, age * ~promoted)

    def replace() -> Anchors:
        now = P[..., None, :, :]
        covariance = xp.where(restart[..., None, None], now, kept.P)
        next_ones = xp.concatenate([covariance[..., 1:, :, :], now], axis=-3)
        corrections = kept.corrections * ~restart[..., None]
        return kept._replace(
            corrections=xp.where(promoted[..., None], corrections @ PROMOTION, corrections),
            P=xp.where(promoted[..., None, None], next_ones, covariance),
        )

    return changed_where(restart | promoted, replace, kept), promoted
