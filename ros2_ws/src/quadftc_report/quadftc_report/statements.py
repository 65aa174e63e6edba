"""What happened in the runs of a scenario, in plain words written from the numbers.

What the paper does not say, how its observer fares on sensors that are not ideal: `report.real_sensors`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import Comparison, SideBySide
from quadftc_report.detection import detection_sentences
from quadftc_report.injected import disturbances_text, faults_text, largest_disturbance, stray_fault
from quadftc_report.measures import axis_metric
from quadftc_report.paper import Judgement, Verdict, judge
from quadftc_report.performance import effort_sentences, estimate_sentences, tracking_sentences
from quadftc_report.wording import duration, each_axis, listing, quantity, sentence


class Paragraph(NamedTuple):
    """A few sentences on one subject; ``key`` names the subject, ``title`` heads it."""

    key: str
    title: str
    sentences: tuple[str, ...]

    @property
    def text(self) -> str:
        """All sentences."""
        return " ".join(self.sentences)


def statements(comparison: Comparison, among: Sequence[Comparison] = ()) -> list[Paragraph]:
    """Tell what happened in a comparison: a paragraph on each subject of which there is something to say.

    Parameters
    ----------
    comparison : Comparison
    among : sequence of Comparison
        All comparisons at hand; the paper compares some with each other.

    Returns
    -------
    list of Paragraph
        With the keys injected, detection, estimate, tracking, effort, checks, paper and recording.
    """
    paragraphs = (
        paragraph("injected", "What was injected", _injected(comparison)),
        paragraph("detection", "Detection of faults", detection_sentences(comparison)),
        paragraph("estimate", "Fault estimate", estimate_sentences(comparison)),
        paragraph("tracking", "Tracking", tracking_sentences(comparison)),
        paragraph("effort", "Torque", effort_sentences(comparison)),
        paragraph("checks", "Checks", _checks(comparison)),
        paragraph("paper", "The paper's claims", _paper(judge(comparison, among))),
        paragraph("recording", "Recording", recording_sentences(comparison)),
    )
    return [each for each in paragraphs if each.sentences]


def paragraph(key: str, title: str, sentences: Iterator[str]) -> Paragraph:
    """Make a paragraph of the sentences that are not empty."""
    return Paragraph(key, title, tuple(text for text in sentences if text))


def _injected(comparison: Comparison) -> Iterator[str]:
    scenario = comparison.scenario
    longest = max(comparison.runs, key=lambda run: run.duration)
    faults = faults_text(scenario.faults, scenario.duration, longest.duration)
    yield sentence(faults or "no sensor fault is scheduled")
    sizes = axis_metric(longest, "fault_max_deg")
    if faults and any(sizes.values()):
        yield sentence("the recorded fault of the attitude is", each_axis(sizes, "deg"), "at its largest")
    stray = stray_fault(longest.flight, scenario)
    if stray is not None:
        size = quantity(float(np.degrees(stray)), "deg")
        yield f"Outside the schedule, too, the attitude was faulty, by up to {size}."
    disturbances = disturbances_text(scenario, longest.duration)
    if not disturbances:
        yield "No disturbance acts."
        return
    yield sentence("a disturbance acts", disturbances)
    largest = largest_disturbance(longest)
    if largest:
        yield sentence("the recorded disturbance is", each_axis(largest, "N m"), "at its largest")


def _checks(comparison: Comparison) -> Iterator[str]:
    for run in comparison.runs:
        name, checks = comparison.title(run), run.summary["checks"]
        failed = [check for check in checks if not check["passed"]]
        if not run.is_whole:
            yield (
                f"The scenario's checks are made for the whole flight; none counts for {name}, of which"
                f" {duration(run.duration)} of {duration(run.scenario.duration)} were recorded."
            )
        elif not checks:
            yield f"The scenario checks nothing of {name}."
        elif failed:
            details = "; ".join(map(_failed, failed))
            yield f"{name} FAILS {len(failed)} of {len(checks)} checks: {details}."
        else:
            yield f"{name} passes {'its check' if len(checks) == 1 else f'all its {len(checks)} checks'}."


def _failed(check: dict[str, Any]) -> str:
    axis = f" ({check['axis']})" if check["axis"] else ""
    return f"{check['metric']}{axis} is {quantity(check['value'], '')}, required {check['bound']}"


def _paper(judgements: Sequence[Judgement]) -> Iterator[str]:
    if not judgements:
        return
    groups = {verdict: [j for j in judgements if j.verdict is verdict] for verdict in Verdict}
    unjudged = groups[Verdict.CANNOT_SAY]
    claims = f"{len(judgements)} claims of the paper about this scenario"
    if len(unjudged) == len(judgements) and len({judgement.reason for judgement in unjudged}) == 1:
        yield f"None of the {claims} can be judged: {unjudged[0].reason}."
        return
    if len(groups[Verdict.AGREES]) == len(judgements):
        yield f"All {claims} agree with these runs."
        return
    counts = [f"{len(found)} {_verb(verdict, len(found))}" for verdict, found in groups.items() if found]
    yield f"Of the {claims} {listing(counts)}."
    for judgement in (*groups[Verdict.DISAGREES], *unjudged):
        claim = judgement.claim
        yield sentence(
            f'"{claim.text}" ({claim.place}): these runs',
            "DISAGREE:" if judgement.verdict is Verdict.DISAGREES else "cannot say:",
            judgement.reason,
        )


def _verb(verdict: Verdict, count: int) -> str:
    if verdict is Verdict.CANNOT_SAY:
        return "cannot be judged"
    verb = "agree" if verdict is Verdict.AGREES else "disagree"
    return f"{verb}s" if count == 1 else verb


def recording_sentences(comparison: SideBySide[Recorded]) -> Iterator[str]:
    """What was not as it should be with the bags."""
    for run in comparison.runs:
        yield from (sentence(warning) for warning in run.warnings)
    if len({run.duration for run in comparison.runs}) > 1:
        lengths = [f"{duration(run.duration)} of {comparison.title(run)}" for run in comparison.runs]
        yield f"Numbers over the whole time do not compare, as the recordings differ: {listing(lengths)}."
