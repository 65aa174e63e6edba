"""Replays in the report: grouped, drawn and told from their numbers, beside flights and without."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import recorded_run

from quadftc_bags.bag import Bag
from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, fault_events
from quadftc_flight.flight import NO_STATE, ImuReadings, unknown_flight
from quadftc_flight.scenario import parse_scenario
from quadftc_model.samples import AXES, FAULTY, HEALTHY, STARTING
from quadftc_replay.overlay import faults_from
from quadftc_replay.replay_directory import RecordedReplay, ReplayOrigin, replay_metrics
from quadftc_report.comparison import compare, list_injections, tell_run
from quadftc_report.description import Figure, Panel
from quadftc_report.figures import replay_figures
from quadftc_report.overview import HEADINGS, overview_row
from quadftc_report.page import flight_sections, pool_replays, render, replay_sections

PERIOD = 0.01  # s
COUNT = 1000
SPECS = (
    "bias axis=roll value=3deg start=4s stop=6s",
    "noise channel=gyro axis=yaw sigma=1deg/s start=2s stop=3s",
)
SCENARIO = """
name: small
duration: 1 s
rate: 100 Hz
vehicle: qball_x4
schemes: {conventional: {controller: smc}}
"""


def columns(*rows: tuple[int, slice, float]) -> np.ndarray:
    """Zeros (n, 3) but for a value on an axis in some rows."""
    found = np.zeros((COUNT, 3))
    for axis, part, value in rows:
        found[part, axis] = value
    return found


def made_replay(
    observer: str = "watchful", name: str = "", specs=SPECS, recording: str = "garden walk", **changes
) -> RecordedReplay:
    """A replay as if read from a bag: the bias is found 0.5 s after its onset, to half a degree."""
    faults = faults_from((), specs)
    events = fault_events(faults, COUNT * PERIOD)
    windows = tuple(FaultWindow(event.start, event.stop, (event.axis,)) for event in events)
    stamp_ns = 10**9 + 10**7 * np.arange(COUNT)
    found = 0 if observer == "none" else 1
    state = np.full((COUNT, 3), HEALTHY, np.uint8)
    state[:50], state[450:600, 0] = STARTING, FAULTY if found else HEALTHY
    flight = dataclasses.replace(
        unknown_flight(stamp_ns),
        **{
            "time": PERIOD * np.arange(COUNT),
            "delivered": np.ones(COUNT, np.bool_),
            "fault": columns((0, slice(400, 600), np.radians(3.0))) if events else columns(),
            "fault_estimate": found * columns((0, slice(450, 600), np.radians(2.5))),
            "fault_std_dev": np.full((COUNT, 3), np.radians(0.3) if found else -1.0),
            "fault_state": state,
            **changes,
        },
    )
    measured = ImuReadings(flight.fault + 0.2, columns() + 0.1)
    measured.angles[700:720] = np.nan
    parameters = {"vehicle": "qball_x4", "observer": observer}
    origin = ReplayOrigin(
        recording=recording,
        topic="/imu/data",
        observer=observer,
        faults=[fault.spec for fault in faults],
        seed=0,
        truth="overlaid faults" if faults else "no fault: the recording counts as healthy",
        torque="unknown: none recorded",
        duration=COUNT * PERIOD,
        samples=COUNT,
        samples_left_out={"stamp repeated": 7},
        fault_windows=windows,
        fault_events=events,
    )
    return RecordedReplay(
        name=name or f"{recording}-{observer}",
        path=Path(name or observer),
        bag=Bag(Path(observer)),
        parameters={"fault_observer": parameters},
        flight=flight,
        summary={
            "rate": 1.0 / PERIOD,
            "parameters": parameters,
            "samples": COUNT,
            "samples_withheld": int((~flight.delivered).sum()),
            "metrics": replay_metrics(flight, windows, events),
        },
        versions={"quadftc": "1.2.3"},
        origin=origin,
        faults=faults,
        measured=measured,
        corrected=ImuReadings(measured.angles - flight.fault_estimate, measured.body_rate - 0.01 * found),
    )


def described(*replays: RecordedReplay) -> dict[str, Figure]:
    (comparison,) = compare(replays)
    return {figure.key.removeprefix(f"{comparison.key}-"): figure for figure in replay_figures(comparison)}


def lines(panel: Panel) -> dict[str, np.ndarray]:
    return {trace.name: trace.y for trace in panel.traces}


def told(*replays: RecordedReplay) -> list[str]:
    (comparison,) = compare(replays)
    return [tell_run(comparison, run) for run in comparison.runs]


PAIR = ("watchful", "none")


def test_replays_are_compared_where_only_their_observers_differ():
    healthy = made_replay(specs=())
    elsewhere = made_replay(recording="garden/walk")
    none, watchful = made_replay("none"), made_replay()
    first, second, third = compare([none, healthy, elsewhere, watchful], taken=["replay-garden_walk"])
    assert first.runs == (watchful, none)  # the one that estimates comes first
    assert (second.runs, third.runs) == ((healthy,), (elsewhere,))
    assert [each.key for each in (first, second, third)] == [
        f"replay-garden_walk-{number}" for number in (2, 3, 4)
    ]
    again = made_replay(name="tuned")
    (both,) = compare([watchful, again])
    assert [both.label(run) for run in both.runs] == ["watchful", "tuned"]


def test_recordings_of_one_name_are_told_apart_by_their_stamps():
    later = made_replay(stamp_ns=10**12 + 10**7 * np.arange(COUNT))
    assert len(compare([made_replay(), later])) == 2


def test_every_figure_of_two_replays_is_there_in_order():
    assert list(described(*map(made_replay, PAIR))) == [
        *(f"attitude-{axis}" for axis in AXES),
        *("fault-roll", "state", "gyro", "gyro_correction"),
    ]


def test_attitude_figure_shows_measured_faultless_and_corrected_angle():
    replay = made_replay()
    upper, lower = described(replay, made_replay("none"))["attitude-roll"].panels
    shown = lines(upper)
    assert list(shown) == ["without the fault", "measured", "watchful", "none"]
    assert np.array_equal(shown["measured"], np.degrees(replay.measured.angles[:, 0]), equal_nan=True)
    there = ~np.isnan(shown["measured"])
    assert np.flatnonzero(~there).tolist() == list(range(700, 720))
    assert shown["without the fault"][there] == pytest.approx(np.degrees(0.2))
    errors = lines(lower)
    assert errors["measured"][450] == errors["none"][450] == pytest.approx(3.0)
    assert errors["watchful"][450] == pytest.approx(0.5)
    assert [(shade.label, shade.start, shade.stop) for shade in upper.shades] == [("fault window", 4.0, 6.0)]


def test_attitude_without_fault_is_drawn_once():
    figure = described(made_replay())["attitude-yaw"]
    assert list(lines(figure.panels[0])) == ["measured", "watchful"]
    assert [(shade.label, shade.start) for shade in figure.panels[0].shades] == [("gyro noise", 2.0)]


def test_state_figure_shows_states_by_their_names_and_gaps_without_one():
    state = np.full((COUNT, 3), HEALTHY, np.uint8)
    state[450:600, 0], state[800:] = FAULTY, NO_STATE
    figure = described(made_replay(fault_state=state))["state"]
    roll, pitch, _ = figure.panels
    assert dict(roll.ticks)[float(lines(roll)["watchful"][500])] == "faulty"
    assert dict(pitch.ticks)[float(lines(pitch)["watchful"][500])] == "healthy"
    assert np.isnan(lines(roll)["watchful"][800:]).all()


def test_observer_that_never_doubts_has_no_state_figure():
    assert "state" not in described(made_replay("none"))


def test_correction_of_the_gyro_is_that_of_the_observers_that_correct():
    found = described(*map(made_replay, PAIR))
    (line,) = found["gyro_correction"].panels[0].traces
    assert line.name == "watchful"
    assert line.y == pytest.approx(np.degrees(-0.01))
    assert "gyro_correction" not in described(made_replay("none"))


def test_what_was_not_recorded_has_no_figure():
    nothing = ImuReadings(np.full((COUNT, 3), np.nan), np.full((COUNT, 3), np.nan))
    replay = dataclasses.replace(made_replay(), measured=nothing, corrected=nothing)
    assert list(described(replay)) == ["fault-roll", "state"]


def test_replay_that_was_cut_is_drawn_to_its_end_and_named():
    whole = made_replay()
    cut = dataclasses.replace(
        made_replay("none"),
        flight=whole.flight.first(500),
        measured=ImuReadings(*(values[:500] for values in whole.measured)),
        corrected=ImuReadings(*(values[:500] for values in whole.corrected)),
    )
    figure = described(whole, cut)["attitude-roll"]
    assert (figure.span, len(lines(figure.panels[0])["none"])) == ((0.0, 10.0), 500)
    assert figure.caption.endswith("none ends at 4.99 s.")


def test_sentence_tells_what_the_observer_made_of_it():
    watchful, none = told(*map(made_replay, PAIR))
    assert watchful == "'watchful' detects 1 of 1 fault with 0 false alarms."
    assert none == "'none' has no fault observer."


def test_injections_are_the_overlaid_faults_and_those_of_the_recording():
    assert list_injections(made_replay()) == [
        ("2 to 3 s", "gyro: yaw", "noise: sigma 1 deg/s"),
        ("4 to 6 s", "attitude: roll", "bias: value 3 deg"),
    ]
    replay = made_replay(specs=())
    event = FaultEvent("pitch", "sine", 1.0, 2.0)
    origin = replay.origin.model_copy(update={"truth": "recorded faults", "fault_events": (event,)})
    recorded = list_injections(dataclasses.replace(replay, origin=origin))
    assert recorded == [("1 to 2 s", "attitude: pitch", "sine, in the recording")]


class Page(HTMLParser):
    """What a page links to and names, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.cells: list[dict[str, str | None]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found["href"][1:]] if found.get("href", "").startswith("#") else []
        self.cells += [found] if "data-metric" in found else []

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def page_of(*replays: RecordedReplay, runs=()) -> Page:
    parts = flight_sections(compare(runs))
    taken = [part.key for part in parts]
    return Page(render(parts, [], replay_sections(compare(replays, taken)), None))


@pytest.fixture(scope="module")
def pair_page() -> Page:
    return page_of(*map(made_replay, PAIR))


def test_page_of_replays_alone_has_no_word_of_flights(pair_page):
    assert "2 replays of 1 recording" in pair_page.text
    assert len(pair_page.ids) == len(set(pair_page.ids))
    assert set(pair_page.links) <= set(pair_page.ids)
    assert "summary" not in pair_page.ids
    for word in ("Wang", "checks", "Scenario as flown"):
        assert word not in pair_page.text


def test_page_of_flights_and_replays_has_both():
    page = page_of(
        *map(made_replay, PAIR),
        made_replay(specs=()),
        runs=[recorded_run(parse_scenario(SCENARIO), "conventional")],
    )
    assert "1 recorded run of 1 scenario and 3 replays of 2 recordings" in page.text
    assert len(page.ids) == len(set(page.ids))
    assert set(page.links) <= set(page.ids)
    assert {"summary", "small", "replays", "replay-garden_walk", "replay-garden_walk-2"} <= set(page.ids)


def test_observer_on_several_recordings_has_a_line_for_all_faults():
    again = made_replay(name="again")
    replays = [made_replay(), again, made_replay(recording="street"), made_replay("none")]
    (pooled,) = pool_replays(compare(replays))
    assert [run.origin.recording for run in pooled] == ["garden walk", "street"]
    other = made_replay(recording="street")
    other.summary["parameters"]["threshold"] = 1.0
    assert pool_replays(compare([made_replay(), other])) == []


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ({}, ("4", "1", "300 ms", "4 s", "–", "0.512 / 1.88 deg", "3, 21.6 an hour, 1.25 % of healthy time")),
        ({"already_declared": 2}, (..., "1 (2 declared before the onset)")),
        (
            {"total_false_alarms": 0},
            (..., ..., ..., ..., ..., ..., "none; 1.25 % of healthy time left over from faults"),
        ),
        ({"total_false_alarms": 0, "total_false_alarm_share": 0.0}, (..., ..., ..., ..., ..., ..., "none")),
    ],
)
def test_overview_shows_counts_delays_errors_and_alarms(found, expected):
    pooled = {
        "fault_count": 4,
        "missed": 1,
        "already_declared": 0,
        "delay_max_s": {"all": 4.0, "step": 0.3},
        "delay_median_s": {"all": 0.3, "ramp": 4.0, "sine": None},
        "estimate_rmse_median_deg": {"all": 0.5123},
        "estimate_rmse_p95_deg": {"all": 1.876},
        "total_false_alarms": 3,
        "total_false_alarm_share": 0.0125,
        "total_false_alarms_per_hour": 21.63,
    }
    row = overview_row(pooled | found)
    assert len(row) == len(HEADINGS)
    assert all(text in (..., cell) for text, cell in zip(expected, row, strict=False))


def test_overview_of_nothing_is_dashes():
    assert overview_row(pool([])) == ("0", *["–"] * 6)
