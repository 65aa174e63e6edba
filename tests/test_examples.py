"""The examples run: an observer in a package of its own flies, and a batch of flights says how well."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

FLY = """
import numpy as np
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import find_scenario, load_scenario, with_components, with_duration

scenario = with_duration(load_scenario(find_scenario("paper_faults")), 24.0)
flight = fly(with_components(scenario, observer="washout"), "proposed")
print(np.degrees(np.abs(flight.angles - flight.reference)).max(), np.degrees(np.abs(flight.fault)).max())
"""


def run(*arguments, **options):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_own_observer_flies_when_only_its_entry_point_names_it(tmp_path):
    package = EXAMPLES / "own_observer"
    run("setup.py", "-q", "egg_info", "--egg-base", tmp_path, cwd=package)  # as colcon build does
    path = os.pathsep.join([str(tmp_path), str(package), os.environ.get("PYTHONPATH", "")])
    error, fault = map(float, run("-c", FLY, env={**os.environ, "PYTHONPATH": path}).split())
    assert fault > 0.9
    assert error < 0.1 * fault


@pytest.mark.slow
def test_batch_in_ten_lines_flies_each_flight():
    spec = importlib.util.spec_from_file_location("batch_in_ten_lines", EXAMPLES / "batch_in_ten_lines.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    sizes, errors = example.fly(3, "conventional")
    assert len(set(sizes)) == 3
    # without diagnosis the vehicle is off by the fault for a quarter of the flight, and by -2 deg for another
    assert errors == pytest.approx(np.sqrt((sizes**2 + 2.0**2) / 4.0), rel=0.25)


def test_imu_example_names_its_options():
    assert "--bias" in run(EXAMPLES / "own_imu" / "publish_and_listen.py", "--help")
