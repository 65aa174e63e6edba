"""What commands print: what a stranger named neither steers the terminal nor ends the command."""

from __future__ import annotations

import pytest
from rich.text import Text

from quadftc_cli.screen import Bars, Screen, plain_table, say

NAME = "imu[/b]\x1b]0;owned\x07\udcff"
SHOWN = r"imu[/b]\x1b]0;owned\x07\udcff"


def test_table_shows_a_name_as_it_is_written(capsys):
    table = plain_table(("topic",), ("count",))
    table.add_row(NAME, "[red]3[/]")
    Screen(force_terminal=True, width=100).print(table)
    said = capsys.readouterr().out
    assert SHOWN in said
    assert "[red]" not in said
    assert "\x07" not in said


def test_bar_shows_a_name_as_it_is_written(capsys):
    with Bars(Screen(force_terminal=True, width=200), still=True) as bars:
        bars.add(NAME)(1.0, NAME)
    said = capsys.readouterr().out
    assert SHOWN in Text.from_ansi(said).plain
    assert "\x07" not in said


@pytest.mark.parametrize("stderr", [False, True])
def test_line_shows_a_name_as_it_is_written(capsys, stderr):
    say(NAME, stderr=stderr)
    assert f"{SHOWN}\n" in capsys.readouterr()
