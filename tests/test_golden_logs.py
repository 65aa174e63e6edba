"""Verdicts on recorded logs are those that are stored, as long as nobody changed them on purpose."""

from __future__ import annotations

import json

import pytest
from sampling import sampled

from quadftc_tools.study.golden_logs import GOLDEN, judge_log
from recorded_logs import DATA, needs_data

STORED = json.loads(GOLDEN.read_text(encoding="utf-8"))
ONSET, PROBABILITY = 0.02, 0.02  # s, 1


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("name", sampled(STORED, every=11))
def test_verdict_on_a_recorded_log_is_the_stored_one(name: str):
    stored, path = STORED[name], DATA / name
    if not path.exists():
        pytest.skip("this log is not there")
    said = judge_log(path)
    assert said["exit"] == stored["exit"], said
    assert [each[:3] for each in said["findings"]] == [each[:3] for each in stored["findings"]]
    for now, then in zip(said["findings"], stored["findings"], strict=True):
        assert now[3] == pytest.approx(then[3], abs=ONSET)
        assert now[4] == pytest.approx(then[4], abs=PROBABILITY)
