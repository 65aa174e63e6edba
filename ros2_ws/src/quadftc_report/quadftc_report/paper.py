"""What the paper claims of its simulations, held against recorded runs.

Source: B. Wang, P. Huang, W. Zhang, A Robust Fault-Tolerant Control for Quadrotor Helicopters against Sensor
Faults and External Disturbances, Complexity, 2021, section 4; the claims are in `report.claims`.

A claim is judged on runs that are as the paper has them: the scenario of its figures, the vehicle, ideal
sensors, faults on all three axes from 20 to 40 s and from 50 to 70 s, the paper's observers and controller,
and the conventional control that it compares with. On other runs there is no verdict. The paper states hardly
a number; where a claim needs a bound, it is ours, and the claim's criterion says so.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence

from quadftc_report.claims import CLAIMS
from quadftc_report.comparison import Comparison
from quadftc_report.evidence import Claim, Evidence, Number, evidence_of


class Verdict(str, enum.Enum):
    """What the numbers say of a claim."""

    AGREES = "agrees"
    DISAGREES = "disagrees"
    CANNOT_SAY = "cannot say"


@dataclasses.dataclass(frozen=True, eq=False)
class Judgement:
    """A claim, what became of it, why, and the numbers it rests on."""

    claim: Claim
    verdict: Verdict
    reason: str
    numbers: tuple[Number, ...] = ()


def judge(comparison: Comparison, among: Sequence[Comparison] = ()) -> list[Judgement]:
    """Hold the paper's claims on one scenario against its runs.

    Parameters
    ----------
    comparison : Comparison
        Of any scenario; on one that is not in the paper there are no claims.
    among : sequence of Comparison
        All comparisons at hand: some claims compare scenarios.
    """
    claims = [claim for claim in CLAIMS if comparison.scenario.name in claim.scenarios]
    if not claims:
        return []
    evidence = evidence_of(comparison)
    if isinstance(evidence, str):
        return [Judgement(claim, Verdict.CANNOT_SAY, evidence) for claim in claims]
    others = [evidence_of(other) for other in among if other is not comparison]
    named = {found.comparison.scenario.name: found for found in others if isinstance(found, Evidence)}
    complete = dataclasses.replace(evidence, others=named)
    return [_judgement(claim, complete) for claim in claims]


def _judgement(claim: Claim, evidence: Evidence) -> Judgement:
    finding = claim.judge(evidence)
    verdicts = {True: Verdict.AGREES, False: Verdict.DISAGREES, None: Verdict.CANNOT_SAY}
    return Judgement(claim, verdicts[finding.holds], finding.reason, finding.numbers)
