"""The wheel in an environment of its own, without ROS 2: built, installed, every command that needs none."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST = 8_000_000  # bytes of the wheel
CARRIES = platform.system() == "Linux" and platform.machine() == "x86_64"
LAWS = """
from quadftc_compile.engine import CEngine
from quadftc_flight.closed_loop import loop_of
from quadftc_flight.scenario import find_scenario, load_scenario, scenario_names
for name in scenario_names():
    scenario = load_scenario(find_scenario(name))
    for scheme in scenario.schemes:
        laws = loop_of(scenario, scenario.scheme(scheme)).laws
        for law, library in zip(laws, CEngine(lambda words: None).prepare(laws.values())):
            print(name, scheme, law, library and library.path.parent.name)
"""

pytestmark = pytest.mark.thorough  # pip installs 0.6 GB, and JAX for the build


@pytest.fixture(scope="module")
def call(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--wheel-dir",
        str(folder),
        str(ROOT),
    ]
    subprocess.run(pip, check=True)
    (wheel,) = folder.glob("quadftc-*.whl")
    assert wheel.stat().st_size < MOST
    assert wheel.name.endswith("-py3-none-linux_x86_64.whl" if CARRIES else "-py3-none-any.whl")
    venv.create(folder / "env", with_pip=True)
    home = {"PATH": os.defpath, "HOME": str(folder), **{k: v for k, v in os.environ.items() if "PIP" in k}}
    subprocess.run([folder / "env/bin/pip", "install", "--quiet", wheel], check=True, env=home)

    def call(*arguments, path=os.defpath, program="quadftc"):
        command = [folder / "env/bin" / program, *map(str, arguments)]
        return subprocess.run(
            command, cwd=folder, env=home | {"PATH": path}, capture_output=True, text=True, check=False
        )

    return call


def test_flies_checks_and_reports(call):
    run = call("run", "paper_faults", "--out", "runs")
    assert run.returncode in (0, 1), run.stderr
    assert call("report", "runs", "--out", "page.html").returncode == 0
    assert call("check", "paper_faults").returncode == 0
    assert call("check", "x500").returncode == 0
    assert call("-c", "import jax", program="python").returncode == 1


def test_diagnoses_a_flight_and_exports_it_as_a_log(call, tmp_path):
    assert call("run", "rotor_loss", "--out", tmp_path / "runs").returncode in (0, 1)
    (bag,) = (tmp_path / "runs").iterdir()
    assert call("diagnose", bag, "--out", tmp_path / "verdict").returncode == 1
    assert json.loads((tmp_path / "verdict" / "verdict.json").read_text())["findings"]
    assert call("export", bag, "--log", "ardupilot", "--out", tmp_path / "flight.bin").returncode == 0


def test_replays_a_flight_through_an_observer(call, tmp_path):
    assert call("run", "paper_faults", "--out", tmp_path / "runs").returncode in (0, 1)
    (bag,) = (tmp_path / "runs").iterdir()
    replayed = call("replay", bag, "--observer", "sliding_mode", "--out", tmp_path / "replays")
    assert replayed.returncode == 0, replayed.stderr
    assert call("report", tmp_path / "replays", "--out", tmp_path / "page.html").returncode == 0


def test_flies_in_numpy_what_it_does_not_carry_and_says_so_once(call, tmp_path):
    done = call("run", "paper_faults", "--set", "references=[]", "--out", tmp_path)
    assert done.returncode in (0, 1)
    assert done.stderr == (
        "quadftc: flies in NumPy, which is slower: "
        "JAX is not installed, which traces laws: pip install 'quadftc[batch]'\n"
    )


@pytest.mark.skipif(not CARRIES, reason="the wheel carries C for Linux x86-64")
def test_flies_every_scenario_in_c_that_it_carries_unless_a_source_is_another(call, tmp_path):
    told = call("-c", LAWS, program="python", path=str(tmp_path))
    assert told.returncode == 0, told.stderr
    rows = [line.split() for line in told.stdout.splitlines()]
    assert len(rows) > 300
    assert {place for *_, place in rows} == {"carried"}
    source = Path(
        call("-c", "import quadftc_control as it; print(it.__file__)", program="python").stdout.strip()
    )
    source = source.parent / "controllers" / "ismc.py"
    source.write_text(text := source.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    changed = call("-c", LAWS, program="python", path=str(tmp_path)).stdout
    source.write_text(text[:-1], encoding="utf-8")
    assert {place for *_, law, place in map(str.split, changed.splitlines()) if law == "clock"} == {"carried"}
    assert "attitude None" in changed


@pytest.mark.skipif(not CARRIES, reason="the wheel carries C for Linux x86-64")
def test_flies_in_c_that_it_carries_and_says_nothing(call, tmp_path):
    done = [
        call("run", "paper_faults", "--out", tmp_path / engine, "--engine", engine, path=str(tmp_path))
        for engine in ("c", "numpy")
    ]
    assert [each.stderr for each in done] == ["", ""]
    rmse = [
        json.loads(next((tmp_path / engine).glob("*/summary.json")).read_text())["metrics"][
            "tracking_rmse_deg"
        ]
        for engine in ("c", "numpy")
    ]
    assert rmse[0] == pytest.approx(rmse[1])


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (("live",), "ROS 2"),
        (("serve",), "quadftc[serve]"),
        (("campaign", ROOT / "campaigns/mems_faults.yaml"), "quadftc[batch]"),
        (("export", "sliding_mode", "--vehicle", "x500", "--out", "law"), "quadftc[batch]"),
    ],
)
def test_says_what_a_command_needs_besides(call, arguments, remedy):
    done = call(*arguments)
    assert done.returncode == 2
    assert remedy in done.stderr
