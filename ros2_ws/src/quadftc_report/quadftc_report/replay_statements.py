"""What was replayed and what the observers made of it, in plain words written from the numbers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_flight.flight import Floats
from quadftc_model.stepper import MAX_GAP
from quadftc_replay.replay_directory import RecordedReplay
from quadftc_report.comparison import ReplayComparison, has_observer
from quadftc_report.detection import SHOWN, detection_sentences
from quadftc_report.injected import faults_text
from quadftc_report.measures import axis_metric
from quadftc_report.statements import Paragraph, paragraph, recording_sentences
from quadftc_report.wording import (
    counted,
    duration,
    each_axis,
    listing,
    period,
    plain,
    sentence,
    spread,
    worst_text,
)

NO_TORQUE = "zero"  # how the torque is told where none was recorded
RECORDED = "recorded"  # how the truth begins where the recording has faults of its own


def replay_statements(comparison: ReplayComparison) -> list[Paragraph]:
    """Tell what happened: a paragraph on each subject of which there is something to say.

    Returns
    -------
    list of Paragraph
        With the keys replayed, samples, injected, detection, estimate and recording.
    """
    paragraphs = (
        paragraph("replayed", "What was replayed", _replayed(comparison)),
        paragraph("samples", "Samples that are missing", _missing(comparison.longest)),
        paragraph("injected", "Faults", _faults(comparison.longest)),
        paragraph("detection", "Detection of faults", detection_sentences(comparison)),
        paragraph("estimate", "Fault estimate", _estimates(comparison)),
        paragraph("recording", "Bags", recording_sentences(comparison)),
    )
    return [each for each in paragraphs if each.sentences]


def _replayed(comparison: ReplayComparison) -> Iterator[str]:
    longest = comparison.longest
    origin = longest.origin
    yield (
        f"{origin.samples} samples of {origin.topic} of the recording '{origin.recording}',"
        f" {duration(origin.duration)} at {plain(longest.summary['rate'])} Hz."
    )
    names = [comparison.full_title(run) for run in comparison.runs]
    yield f"They went through the fault observer{'s' if len(names) > 1 else ''} {listing(names)}."
    if origin.torque.startswith(NO_TORQUE):
        yield "No torque was recorded; it counts as zero."
    else:
        yield f"The torque is that of {origin.torque}."


def _missing(run: RecordedReplay) -> Iterator[str]:
    """What of the recording did not reach the observers."""
    left_out = run.origin.left_out
    if any(left_out.values()):
        reasons = listing([f"{count} ({reason})" for reason, count in left_out.items() if count])
        yield f"Of the recorded samples, these were left out: {reasons}."
    delivered, time = run.flight.delivered, run.flight.time
    withheld = int((~delivered).sum())
    if withheld:
        yield f"An overlaid fault withheld {withheld} of the samples."
    for words, values in (("attitude", run.measured.angles), ("body rate", run.measured.body_rate)):
        absent = delivered & ~np.isfinite(values).all(axis=1)
        if absent.any():
            count, longest = counted(int(absent.sum()), "sample"), duration(_longest(time, absent))
            yield f"{count} came without a usable {words}, for at most {longest} at a stretch."
    gaps = int(np.sum(np.diff(time) > MAX_GAP))
    if gaps:
        yield f"Gaps of more than {MAX_GAP:g} s: {gaps}; the diagnosis starts anew behind each."


def _longest(time: Floats, mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> float:
    """How long a mask holds without a break, at most [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    starts, stops = edges[::2], np.minimum(edges[1::2], len(time) - 1)
    return float(np.max(time[stops] - time[starts]))


def _faults(run: RecordedReplay) -> Iterator[str]:
    origin = run.origin
    overlaid = faults_text(origin.faults, origin.duration, run.duration)
    yield sentence("these faults were overlaid.", overlaid) if overlaid else "No fault was overlaid."
    events = [event for event in run.fault_events if event.start < run.duration]
    if origin.truth.startswith(RECORDED) and events:
        names = [f"{event.kind} on {event.axis} {period(event.start, event.stop)}" for event in events]
        some = names if len(names) <= SHOWN else [*names[:SHOWN], f"{len(names) - SHOWN} more"]
        yield f"The recording has faults of its own; with them, the attitude is faulty by: {listing(some)}."
    sizes = axis_metric(run, "fault_max_deg")
    if any(sizes.values()):
        yield sentence("the true fault of the attitude is", each_axis(sizes, "deg"), "at its largest")
    yield sentence(
        "but for these faults" if run.fault_events or origin.faults else "",
        "the recorded attitude counts as the truth: its own errors count as errors of the estimate",
    )


def _estimates(comparison: ReplayComparison) -> Iterator[str]:
    """How well each replay estimates the fault of the attitude, in the fault windows and outside of them."""
    for run in comparison.runs:
        name = comparison.full_title(run)
        if not has_observer(run):
            yield f"{name} estimates no fault, so that its error is the fault."
            continue
        parts = (
            _errors(run, "inside", "in the fault windows"),
            _errors(run, "outside", "outside fault windows"),
        )
        told = "; ".join(part for part in parts if part)
        yield sentence(f"with {name}", told) if told else f"Of {name} no error is known."


def _errors(run: RecordedReplay, part: str, words: str) -> str:
    """The errors inside or outside the fault windows; empty if there are none."""
    rmse, largest = (axis_metric(run, f"fault_estimate_{kind}_{part}_deg") for kind in ("rmse", "max"))
    if not any(value is not None for value in largest.values()):
        return ""
    return f"the RMSE {words} is {spread(rmse, 'deg')}, the largest error {worst_text(largest, 'deg')}"
