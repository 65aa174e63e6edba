"""The wheel in an environment of its own, without ROS 2: built, installed, every command that needs none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST = 8_000_000  # bytes of the wheel

pytestmark = pytest.mark.thorough  # pip installs 1 GB


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
    venv.create(folder / "env", with_pip=True)
    home = {"PATH": os.defpath, "HOME": str(folder), **{k: v for k, v in os.environ.items() if "PIP" in k}}
    subprocess.run([folder / "env/bin/pip", "install", "--quiet", wheel], check=True, env=home)

    def call(*arguments, path=os.defpath):
        command = [folder / "env/bin/quadftc", *map(str, arguments)]
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
    assert call("export", "sliding_mode", "--vehicle", "x500", "--out", "law").returncode == 0


def test_diagnoses_a_flight_with_and_without_a_compiler_alike(call, tmp_path):
    assert call("run", "rotor_loss", "--out", tmp_path / "runs").returncode in (0, 1)
    (bag,) = (tmp_path / "runs").iterdir()
    said = [
        call("diagnose", bag, "--out", tmp_path / name, path=path)
        for name, path in (("c", os.defpath), ("numpy", str(tmp_path)))
    ]
    verdicts = [json.loads((tmp_path / name / "verdict.json").read_text()) for name in ("c", "numpy")]
    assert [each.returncode for each in said] == [1, 1], said
    assert verdicts[0]["findings"] == verdicts[1]["findings"] != []


def test_flies_the_same_without_a_compiler_and_says_so(call, tmp_path):
    done = [
        call("run", "paper_faults", "--set", "references=[]", "--out", tmp_path / name, path=path)
        for name, path in (("c", os.defpath), ("numpy", str(tmp_path)))
    ]
    assert done[1].stderr.count("flies in NumPy, which is slower: there is no C compiler") == 1
    summaries = [
        json.loads(next((tmp_path / name).glob("*/summary.json")).read_text()) for name in ("c", "numpy")
    ]
    rmse = [each["metrics"]["tracking_rmse_deg"] for each in summaries]
    assert rmse[0] == pytest.approx(rmse[1])
    assert summaries[0]["passed"] == summaries[1]["passed"]


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (("live",), "ROS 2"),
        (("replay", "x.mcap"), "ROS 2"),
        (("serve",), "quadftc[serve]"),
        (("campaign", ROOT / "campaigns/mems_faults.yaml"), "quadftc[batch]"),
    ],
)
def test_says_what_a_command_needs_besides(call, arguments, remedy):
    done = call(*arguments)
    assert done.returncode == 2
    assert remedy in done.stderr
