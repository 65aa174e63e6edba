"""The attacks of docs/security.md: who does what, and what repeats it."""

from __future__ import annotations

from typing import NamedTuple

LOG, FILE, PAGE, NODE = "a stranger's log", "a stranger's file", "a page, another user", "another node"
MACHINE, MISHAP = "another machine", "a mishap"


class Attack(NamedTuple):
    """One row: the arguments of Python behind ``-m``, and for how many examples a test is asked."""

    who: str
    what: str
    command: tuple[str, ...]
    examples: int = 0  # of which a test takes its share
    limit: float = 900.0  # s

    @property
    def is_tests(self) -> bool:
        """Whether pytest runs it."""
        return self.command[0] == "pytest"


def _tests(name: str, words: str = "") -> tuple[str, ...]:
    """Tests of ``tools/test/test_attack_NAME.py`` with some words in their names."""
    return ("pytest", f"tools/test/test_attack_{name}.py", *(["-k", words] if words else []))


def _soak(*arguments: str) -> tuple[str, ...]:
    return ("quadftc_tools.soak.command", *arguments)


READERS = "ros2_ws/src/quadftc_replay/test/test_readers_packed.py"
SOCKETS = "ros2_ws/src/quadftc_ros/test/test_reach.py"
EIGHT_HOURS = ("endurance", "--mode", "realtime", "--minutes", "480", "--length", "3600")
FIELDS = "NaN, infinity, 1e308, jumps of time in any field of 9 formats"
HEADER = "anything in the header of a blackbox"
ENDS = "the end is missing, in formats that mark it"
BOMBS = "chunks that unpack to gigabytes, types that hold themselves"
LIBRARIES = "a library that loops, fills the memory or crashes; packed bombs"
FILES = "scenarios, campaigns, gains, vehicles, parameters, bags, command lines"
STRANGERS = "no token, wrong ones, forged hosts and origins, uploads, planted links"
STOPS = "two campaigns in a folder, a read-only disk, a clock set back by an hour"
ATTACKS = (
    Attack(LOG, FIELDS, _tests("logs", "sensor"), 4000, 1800.0),
    Attack(LOG, HEADER, _tests("logs", "header"), 4000),
    Attack(LOG, ENDS, _tests("logs", "end_of or index")),
    Attack(LOG, BOMBS, _tests("logs", "chunk or type")),
    Attack(LOG, LIBRARIES, ("pytest", READERS)),
    Attack(LOG, "script in its strings, seen by Chromium", _tests("pages", "script")),
    Attack(FILE, FILES, _tests("files", "answered"), 1600, 1500.0),
    Attack(FILE, "links in the folder of results", _tests("pages", "link")),
    Attack(PAGE, STRANGERS, ("pytest", "tests/test_page_access.py")),
    Attack(PAGE, "1200 connections that ask for nothing", _tests("pages", "strangers")),
    Attack(NODE, "bad messages to every subscription", ("pytest", "tests/test_bad_messages.py")),
    Attack(NODE, "bad parameters, at the start and in flight", ("pytest", "tests/test_bad_parameters.py")),
    Attack(NODE, "a second publisher in flight", _soak("intruders")),
    Attack(MACHINE, "sockets that other machines reach", ("pytest", SOCKETS)),
    Attack(MISHAP, "Ctrl-C twice at any time of 11 commands", _tests("stops", "interrupted"), 400, 1500.0),
    Attack(MISHAP, "a worker of a campaign killed", _tests("stops", "worker"), 200),
    Attack(MISHAP, STOPS, _tests("stops", "second or disk or clock")),
    Attack(MISHAP, "recorder killed", _soak("recorder", "--trials", "12")),
    Attack(MISHAP, "disk full", _soak("disk", "--trials", "6")),
    Attack(MISHAP, "node killed, stopped or stalled in flight", _soak("nodes", "--trials", "6")),
    Attack(MISHAP, "clocks that jump in lock-step", ("pytest", "tests/test_clock_jumps.py")),
)
LONG = (Attack(MISHAP, "none, eight flights of an hour in real time", _soak(*EIGHT_HOURS), limit=32_000.0),)
