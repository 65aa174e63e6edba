"""The quadftc command starts fast: help and completion import no subcommand."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest
from typer.testing import CliRunner

from quadftc_cli.main import OWN_ENTRIES, SUBCOMMANDS, app, purpose

HEAVY = ("numpy", "pydantic", "rclpy", "rich", "scipy")


def test_help_and_completion_import_nothing_heavy():
    code = (
        "import sys; from quadftc_cli.main import guarded; guarded(['--help']); "
        f"sys.exit(', '.join(name for name in {HEAVY} if name in sys.modules) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Fly scenarios through the node graph" in done.stdout


@pytest.mark.parametrize("entry", OWN_ENTRIES, ids=lambda entry: entry.name)
def test_every_command_says_what_it_does(entry):
    assert len(purpose(entry)) > 20
    assert purpose(entry)[-1] in ".:" or "\n" in purpose(entry)


def test_command_that_cannot_be_imported_does_not_spoil_the_list():
    assert purpose(EntryPoint("lost", "no_such_package.commands:lost", SUBCOMMANDS)) == "(cannot be imported)"


@pytest.mark.parametrize("words", [["-h"], ["check", "-h"], ["new", "observer", "-h"]])
def test_help_has_a_short_name(words):
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0
    assert done.output.startswith("Usage: ")


def test_version_is_told():
    done = CliRunner().invoke(app, ["--version"])
    assert done.exit_code == 0
    assert done.output.startswith("quadftc 0.")


def test_commands_are_completed(monkeypatch):
    monkeypatch.setenv("COMP_WORDS", "quadftc rep")
    monkeypatch.setenv("COMP_CWORD", "1")
    done = CliRunner().invoke(app, env={"_QUADFTC_COMPLETE": "complete_bash"}, prog_name="quadftc")
    assert done.output.split() == ["repair", "replay", "report"]


@pytest.mark.parametrize(
    ("words", "count", "found"),
    [
        ("quadftc run paper_f", 2, ["paper_faults"]),
        ("quadftc run paper_faults --observer iso", 4, ["isolating"]),
    ],
)
def test_names_of_scenarios_and_observers_are_completed(monkeypatch, words, count, found):
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(count))
    done = CliRunner().invoke(app, env={"_QUADFTC_COMPLETE": "complete_bash"}, prog_name="quadftc")
    assert done.output.split() == found
