"""`quadftc report`: what it writes, what it says, and how it refuses."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from command_bench import Done, call_quadftc, complaints, run_installed


@pytest.fixture(scope="module")
def runs(fly_graph, busy_scenario, tmp_path_factory) -> Path:
    """A directory of two runs of one scenario, and something that is no run."""
    folder = tmp_path_factory.mktemp("flown")
    for scheme in busy_scenario.schemes:
        directory, _ = fly_graph(busy_scenario, scheme)
        shutil.copytree(directory, folder / directory.name)
    (folder / "notes").mkdir()
    return folder


@pytest.fixture(scope="module")
def replayed(runs: Path, replay_run) -> Path:
    fault = "bias axis=roll value=3deg start=0.5s stop=1.5s"
    return replay_run(runs / "busy-proposed", fault, topic="plant/imu")


def report(*arguments: str | Path) -> Done:
    return call_quadftc("report", *arguments)


def test_directory_of_runs_gives_a_page(runs: Path, tmp_path: Path):
    out = tmp_path / "new" / "report.html"
    done = run_installed("report", runs, "--out", out)
    assert done.returncode == 0, done.stderr
    assert complaints(done) == []
    assert f"report on 2 runs: {out}" in done.stdout
    page = out.read_text(encoding="utf-8")
    assert 'data-run="busy-proposed"' in page
    assert 'data-run="busy-conventional"' in page
    assert "report_figures" not in page
    assert [path.name for path in out.parent.iterdir()] == ["report.html"]


def test_figure_is_drawn_alone_and_an_unknown_one_is_refused(runs: Path, tmp_path: Path):
    done = report(runs, "--figure", "busy-torque", "--out", tmp_path / "some.html")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.rglob("*.*")) == ["busy-torque.pdf", "busy-torque.png"]
    done = report(runs, "--figure", "6", "--out", tmp_path / "some.html")
    assert done.returncode == 2
    assert complaints(done)[0].startswith("error: no figure '6' of these runs; there are: busy-fault-roll, ")


def test_truncated_bag_is_read_to_its_end_with_a_warning(runs: Path, tmp_path: Path):
    run = shutil.copytree(runs / "busy-proposed", tmp_path / "busy-proposed")
    (bag,) = run.glob("*.mcap")
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size * 7 // 10])
    done = report(run, "--out", tmp_path / "report.html")
    assert done.returncode == 0, done.stderr
    (warning,) = complaints(done)
    assert warning.startswith(f"warning: {run}: cut short at ")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<li>{warning.removeprefix('warning: ')}</li>" in page


def test_replay_gives_a_page_in_a_directory_and_figures_for_print(replayed: Path, tmp_path: Path):
    done, out = report(replayed, "--figures", "--out", tmp_path), tmp_path / "report.html"
    assert done.returncode == 0, done.stderr
    assert complaints(done) == []
    assert f"report on 1 replay: {out}" in done.stdout
    assert sorted(each.name for each in tmp_path.iterdir()) == ["report.html", "report_figures"]
    page = out.read_text(encoding="utf-8")
    assert f'data-run="{replayed.name}"' in page
    figures = {file.name for file in (tmp_path / "report_figures").iterdir()}
    assert {f"replay-busy-proposed-fault-roll.{kind}" for kind in ("pdf", "png")} <= figures
    assert all(f"report_figures/{name}" in page for name in figures)


def test_runs_and_replays_go_into_one_report(runs: Path, replayed: Path, tmp_path: Path):
    done = report(runs, replayed, "--out", tmp_path / "report.html")
    assert done.returncode == 0, done.stderr
    assert "report on 2 runs and 1 replay: " in done.stdout
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>2 recorded runs of 1 scenario and 1 replay of 1 recording</h1>" in page


def test_replay_is_refused_by_the_check_in_one_line(replayed: Path):
    done = call_quadftc("check", replayed)
    assert done.returncode == 2
    assert len(complaints(done)) == 1
    assert f"{replayed}: a replay of a recording; expected a flight" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("noise.mcap", b"\x00\x01 no bag at all", "noise.mcap"),
        ("empty.mcap", b"", "empty.mcap"),
        ("missing", None, "no such file or directory"),
    ],
)
def test_wrong_bag_among_good_ones_is_one_line_and_leaves_the_old_report(
    runs: Path, tmp_path: Path, name: str, content: bytes | None, words: str
):
    out = tmp_path / "report.html"
    out.write_text("the old report", encoding="utf-8")
    if content is not None:
        (tmp_path / name).write_bytes(content)
    before = sorted(tmp_path.iterdir())
    done = report(runs / "busy-proposed", tmp_path / name, "--out", out)
    assert done.returncode == 2
    (line,) = complaints(done)
    assert line.startswith("error: ")
    assert words in line
    assert out.read_text(encoding="utf-8") == "the old report"
    assert sorted(tmp_path.iterdir()) == before


def test_report_of_a_campaign_is_pointed_to(tmp_path: Path):
    (tmp_path / "campaign.json").write_text("{}", encoding="utf-8")
    done = report(tmp_path, "--out", tmp_path / "out.html")
    assert done.returncode == 2
    assert f"{tmp_path}: a campaign, whose report is {tmp_path}/report.html; " in done.stderr


def test_command_starts_without_the_libraries_that_draw():
    code = "import sys, quadftc_cli.main; print(*{'plotly', 'matplotlib', 'jinja2'} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == ""
