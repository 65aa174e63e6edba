"""What the tests of the whole graph share: short flights."""

from __future__ import annotations

from pathlib import Path

import pytest

SCENARIOS = Path(__file__).parent / "scenarios"


@pytest.fixture(scope="session")
def busy_scenario():
    """Two seconds in which everything happens at once: noise, a late sensor, every fault, dropouts."""
    from quadftc_flight.scenario import load_scenario

    return load_scenario(SCENARIOS / "busy.yaml")


@pytest.fixture(scope="session")
def fly_graph(tmp_path_factory):
    """Fly a scenario through the real graph, once for each set of arguments; return its run directory."""
    from quadftc_flight.run_files import prepare, run_name
    from quadftc_flight.runs import RunOptions, run

    flown = {}

    def fly(scenario, scheme, **options):
        key = (scenario.name, scenario.duration, scheme, tuple(sorted(options.items())))
        if key not in flown:
            out = tmp_path_factory.mktemp("runs")
            name = run_name(scenario, scenario.scheme(scheme))
            prepare(out, [name], force=False)
            summary = run(scenario, scenario.scheme(scheme), out, RunOptions(**options), lambda _: True)
            flown[key] = out / name, summary
        return flown[key]

    return fly


@pytest.fixture(scope="session")
def replay_run(tmp_path_factory):
    """Replay a run, with a fault overlaid; return the directory of the replay."""
    from quadftc_replay.plan import ReplayOptions
    from quadftc_replay.replay_bag import replay

    def replayed(run, fault, **options):
        out = tmp_path_factory.mktemp("replayed")
        return out / replay(run, ReplayOptions(faults=(fault,), **options), out)["bag"]

    return replayed
