r"""Whose is a discrepancy of attitude and gyro?

    a jump of the attitude that the gyro does not show       the attitude's, for certain
    an attitude that is stuck                                the same
    a jump of the gyro at about its onset, of the right sign  the gyro's
    neither: it creeps                                       ambiguous, with a probability

Its log-odds l, gyro over attitude, begin with a belief about the rate m of the discrepancy, gyro less
attitude-based rate, root mean square over 60 ms. An attitude sensor creeps at a few hundredths of a rad/s; a
gyro may be wrong by any amount:

    p(m | attitude) = exp(-m / 0.03) / 0.03,   p(m | gyro) = 1 / (m ln 300),  0.01 < m < 3 rad/s

with 400 to 1 at most: it is a belief.

Then each reading is asked what else would have to be true. With the torque, attitude and gyro each give an
unknown acceleration, d_a and d_g. The larger is the less likely. And an attitude may scatter more than its
noise: s is the squared change of its innovation in variances.

    l' = (d_g² / sigma² - d_a² / (sigma² + var d_a) - max(s - 3, 0)) / (2 T) - l / FADES

Without a known torque, or with an attitude made of the gyro, neither belief nor accelerations tell: l stays
zero but for the position. m is less what the attitude-based rate may be off by.

From 95 % for `HOLD` the gyro is named, and from 99.9 % for the attitude, the attitude.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_model.arrays import Mask, Scalar, Vector, clip, exp, larger, log, namespace, smaller, sqrt, where

DEG = math.pi / 180.0
BENT, JUMPED = 4.2, 4.2  # 1; standard deviations of a jump of the attitude, of the gyro
SPREAD = 0.06  # s; over which the rate of a discrepancy is taken
CREEPS, SLOWEST, FASTEST = 0.03, 0.01, 3.0  # rad/s; m of an attitude, mean; of a gyro, bounds
STRONGEST = 6.0  # 1; log-odds, at most, of a belief about rates
NAMED, HOLD = 3.0, 0.15  # 1, s; log-odds from which the gyro is named, and for how long
CLEARED = -7.0  # 1; log-odds from which the attitude is named
USUAL, PERIOD, MOST = 1.5, 0.1, 25.0  # rad/s², s, 1; sigma of accelerations, T, bound of a square
SCATTERED = 3.0  # 1; of the squared changes of an attitude that is healthy, at most
FADES, FINAL = 1.0, 30.0  # s, 1; memory of evidence, and its bound
HUGE = 30.0 * DEG  # rad; no attitude sensor creeps by that much
BLEND = 0.3  # 1; share of the limit within which the rate goes over


class Hypotheses(NamedTuple):
    """What is believed of the faults of the attitude."""

    certain: Mask  # it is the attitude's
    ambiguous: Mask  # it is the attitude's or the gyro's
    spread: Vector  # mean square rate of an ambiguous discrepancy [rad²/s²]
    evidence: Vector  # log-odds by the accelerations and the scatter
    held: Vector  # how long the gyro has been likely [s]
    gyro: Vector  # probability that it is the gyro's


def start_hypotheses(faulty: Mask) -> Hypotheses:
    """Start with faults that are taken for the attitude's."""
    xp = namespace(faulty)
    zeros = xp.zeros_like(faulty, dtype=float)
    return Hypotheses(faulty, xp.zeros_like(faulty), zeros, zeros, zeros, zeros)


class Evidence(NamedTuple):
    """What speaks for and against attitude and gyro at a sample."""

    abrupt: Mask  # the test of attitude against gyro has found a jump
    stuck: Mask  # the attitude is stuck
    bend: Vector  # largest jump of the attitude of late, in standard deviations
    jump: Vector  # largest jump of the gyro of late, in standard deviations
    deviation: Vector  # gyro less attitude-based rate [rad/s]
    unsure: Vector  # variance of that rate [rad²/s²]
    of_attitude: Vector  # unknown acceleration by attitude and torque [rad/s²]
    variance: Vector  # of that [rad²/s⁴]
    of_gyro: Vector  # unknown acceleration by gyro and torque [rad/s²]
    scatter: Vector  # squared change of the attitude's innovation, in variances
    position: Vector  # log-odds by a position sensor; 0 where there is none
    telling: Mask  # the torque is known, and the attitude not made of the gyro; else only its own jumps tell


def weigh(
    state: Hypotheses, faulty: Mask, new: Mask, fault: Vector, seen: Evidence, dt: Scalar
) -> tuple[Hypotheses, Mask]:
    """Weigh the hypotheses of the axes whose attitude is ``faulty``; also return where it is the gyro's.

    ``new`` is declared at this sample, ``fault`` [rad] its size so far.
    """
    jumped = seen.telling & new & (seen.jump * fault < 0.0) & (abs(seen.jump) > JUMPED)
    certain = where(new, seen.abrupt & (abs(seen.bend) > BENT), state.certain) | seen.stuck
    change = (1.0 - exp(-dt / SPREAD)) * (seen.deviation**2 - state.spread)
    spread = (state.spread + change) * faulty
    needs_gyro = smaller(seen.of_gyro**2 / USUAL**2, MOST)
    needs_attitude = smaller(seen.of_attitude**2 / (USUAL**2 + seen.variance), MOST)
    odd = clip(seen.scatter - SCATTERED, 0.0, MOST)
    news = (0.5 * dt / PERIOD) * (needs_gyro - needs_attitude - odd)
    evidence = (state.evidence + seen.telling * news) * faulty
    # evidence of long ago fades, and none is final
    evidence = clip(evidence * exp(-dt / FADES), -FINAL, FINAL)
    rate = sqrt(larger(spread - seen.unsure, 0.0))
    odds = seen.telling * belief_in_gyro(rate) + evidence + seen.position
    certain = faulty & (certain | (odds < CLEARED))
    held = (state.held + dt) * (faulty & ~certain & (odds > NAMED))
    guilty = faulty & ~certain & (jumped | (held > HOLD) | (abs(fault) > HUGE))
    ambiguous = faulty & ~certain & ~guilty
    gyro = ambiguous / (1.0 + exp(-clip(odds, -30.0, 30.0)))
    kept = spread * ambiguous, evidence * ~guilty, held * ~guilty
    return Hypotheses(certain, ambiguous, *kept, gyro), guilty


def belief_in_gyro(rate: Vector) -> Vector:
    """Log-odds that a discrepancy of this rate [rad/s] is the gyro's and not the attitude's."""
    m = clip(rate, SLOWEST, FASTEST)
    odds = m / CREEPS + math.log(CREEPS / math.log(FASTEST / SLOWEST)) - log(m)
    return smaller(odds, STRONGEST)


def flown(fault: Vector, ambiguous: Mask, belief: Scalar) -> tuple[Vector, Vector]:
    """Decide by what to fly: up to a limit of an ambiguous fault [rad] by the gyro, beyond by the attitude.

    Return what is to be added to the dead-reckoned angles [rad], and the share of the attitude-based rate.
    Where the attitude is right, the error is ``belief`` [rad] at most; where the gyro is, it is less by that
    than without diagnosis.
    """
    shift = (fault - clip(fault, -belief, belief)) * ambiguous
    share = clip((abs(fault) / belief - 1.0) / BLEND, 0.0, 1.0) * ambiguous
    return shift, share
