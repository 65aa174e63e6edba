"""The league: what counts as naming a fault, and which parts of logs take part."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadftc_replay.flight_log import Event, FlightLog, Signal, Watched
from quadftc_tools.study.league import SIMULATED, cut, simulated_logs


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


def test_simulated_flights_are_healthy_where_their_file_says_so(tmp_path: Path):
    file = tmp_path / SIMULATED / "truth.json"
    file.parent.mkdir(parents=True)
    file.write_text('{"a.BIN": {"healthy": true}, "b.BIN": {"healthy": false}}', encoding="utf-8")
    assert simulated_logs(tmp_path, healthy=True) == {file.parent / "a.BIN"}
    assert simulated_logs(tmp_path, healthy=False) == {file.parent / "b.BIN"}
