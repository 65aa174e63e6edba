"""Long flights: a process that grows is found out, and the flights are whole."""

import subprocess
import sys
import time

import pytest

from quadftc_flight.scenario import ScenarioError
from quadftc_tools.soak import endurance
from quadftc_tools.soak.endurance import Flown, Growth, Looks, soak

GROWING = """
import time
kept, files = [], []
while True:
    kept.append(bytearray(200_000))
    files.append(open("/dev/null"))
    time.sleep(0.01)
"""
RESTING = "import time; time.sleep(60)"


@pytest.mark.parametrize(("program", "grows"), [(GROWING, True), (RESTING, False)])
def test_process_that_grows_is_found_out(program, grows):
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        try:
            looks = Looks(process.pid)
            for _ in range(8):
                time.sleep(0.05)
                looks.look()
        finally:
            process.kill()
    (found,) = looks.growth()
    assert found.process == "graph"
    assert (found.growth_mb_h > 1000.0) == grows == bool(found.wrong)
    assert (found.files_growth_h > 1000.0) == grows


def test_flights_follow_each_other_and_are_judged(monkeypatch):
    monkeypatch.setattr(endurance, "LOOK", 0.1)
    found = list(soak("lockstep", "composed", 100.0, 10.0, 0.01))
    flown, grown = ([each for each in found if isinstance(each, kind)] for kind in (Flown, Growth))
    assert flown
    assert all((each.samples, each.missing, each.wrong) == (999, 0, "") for each in flown)
    assert all(0.0 < each.largest_deg < 5.0 for each in flown)
    assert {each.process for each in grown} >= {"graph"}


def test_flights_that_cannot_be_are_refused():
    with pytest.raises(ScenarioError, match="rate"):
        next(soak("lockstep", "composed", 1e9, 10.0, 0.1))
