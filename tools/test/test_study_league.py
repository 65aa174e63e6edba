"""The league: what counts as naming a fault, and which parts of logs take part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadftc_replay.flight_log import Event, FlightLog, Signal, Watched
from quadftc_tools.study.league_logs import LABELLED, cut, read_labels


def test_cut_leaves_nothing_of_what_came_later():
    time = np.arange(10.0)
    signal = Signal(time, time[:, None])
    log = FlightLog(
        path=Path("log"),
        format="none",
        gyros={"": signal},
        gps_positions={"": signal},
        battery=signal,
        watched=(Watched("load", signal, 1.0),),
        events=(Event(3.0, "MSG", "before"), Event(6.0, "MSG", "Attack Started")),
    )
    part = cut(log, 2.0, 6.0)
    assert part.battery is not None
    for each in (part.gyros[""], part.gps_positions[""], part.battery, part.watched[0].signal):
        np.testing.assert_array_equal(each.time, [2.0, 3.0, 4.0, 5.0])
    assert [each.text for each in part.events] == ["before"]


def test_wrong_label_is_refused_with_file_and_field(tmp_path: Path):
    file = tmp_path / LABELLED / "truth.json"
    file.parent.mkdir(parents=True)
    file.write_text('{"a.BIN": {"component": "gyro", "element": "x", "onset_s": "early"}}', encoding="utf-8")
    with pytest.raises(ValueError, match=r"truth\.json: a\.BIN\.onset_s: .*number"):
        read_labels(tmp_path)
