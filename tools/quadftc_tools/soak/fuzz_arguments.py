# pyright: basic
"""Command lines, drawn from what the commands themselves say of their arguments and options."""

from __future__ import annotations

from random import Random
from typing import Any

import typer

from quadftc_tools.soak.bad_values import TEXTS

COMMANDS = (
    "run",
    "check",
    "replay",
    "repair",
    "report",
    "list",
    "campaign",
    "tune",
    "play",
    "bench",
    "doctor",
)
# of commands that fly long or start many processes: what is bad enough to be refused before
BAD_ONLY = {
    "campaign": ["nowhere.yaml"],
    "tune": ["s.yaml"],
    "bench": ["latency", "--rate", "fast"],
    "doctor": ["x"],
}
PLACES = (
    "s.yaml",
    "bag",
    "log.ulg",
    "g.yaml",
    "c.yaml",
    "nowhere",
    "link",
    "bag/metadata.yaml",
    "",
    ".",
    "-",
    "--",
    "\udcff",
)
VALUES = (
    *(
        "s.yaml",
        "bag",
        "out",
        "g.yaml",
        "proposed",
        "all",
        "pid",
        "none",
        "supervised",
        "500",
        "250 Hz",
        "3",
        "lockstep",
    ),
    *(
        "faults.0.value=2 deg",
        "observer.delta=0.1",
        "imu/data",
        "bias axis=roll value=3deg",
        "composed",
        "sleep",
        "poll",
        "-7",
    ),
)
SPARED = {
    *("--help", "--realtime-priority", "--loop", "--scheduler", "--workers", "--install-completion"),
    *("--graph", "--delay", "--show-completion"),
}  # change the machine, or take long
NEVER_SLOW = {"--rate": ("0", "-1", "nan", "inf", "abc", "1e300", "10", "1000")}


def draw_arguments(app: typer.Typer, random: Random) -> list[str]:
    """Draw a command line of ``quadftc``."""
    name = random.choice((*COMMANDS[:6], *COMMANDS[:6], *COMMANDS, "fly", "", "\udcff"))
    if name in BAD_ONLY:
        return [name, *BAD_ONLY[name]]
    commands: Any = typer.main.get_command(app)
    command: Any = commands.commands.get(name)
    if command is None:
        return [name, *_words(random, 2)]
    arguments = [name]
    for parameter in command.params:
        if parameter.param_type_name == "argument":
            arguments += _place(name, random)
    options = [
        each for each in command.params if each.param_type_name == "option" and not SPARED & set(each.opts)
    ]
    for option in random.sample(options, min(len(options), random.choice((0, 1, 1, 2, 3, 5)))):
        arguments.append(random.choice(option.opts))
        if not getattr(option, "is_flag", False) or random.random() < 0.05:
            arguments.append(_value(arguments[-1], random))
    if random.random() < 0.1:
        arguments += _words(random, 1)
    if name == "run" and random.random() < 0.9:
        arguments += ["--out", "out"]
    return [word.replace("\0", "") for word in arguments]


def _place(name: str, random: Random) -> list[str]:
    """What a command is about: mostly what it expects."""
    good = {"run": "s.yaml", "check": "s.yaml", "list": "faults"}.get(name, "bag")
    return [good] if random.random() < 0.7 else [random.choice((*PLACES, *PLACES, _text(random)))]


def _value(option: str, random: Random) -> str:
    if option in NEVER_SLOW:
        return random.choice(NEVER_SLOW[option])
    if option == "--out":
        return random.choice(
            ("out", "out/a/b", "s.yaml", "bag", "", "bag/metadata.yaml", "x" * 300, "out\n", "\udcff")
        )
    if option == "--set":  # not of the duration: flights are short
        return random.choice(
            (*VALUES, "seed=-1", "x=1", "=", "a", "rate=nan", "name=../../x", "vehicle=../../x.toml")
        )
    return random.choice(VALUES) if random.random() < 0.5 else _text(random)


def _words(random: Random, most: int) -> list[str]:
    return [random.choice((*PLACES, *VALUES, _text(random))) for _ in range(random.randrange(most + 1))]


def _text(random: Random) -> str:
    """A text that an argument can be: what is no text comes as surrogates, as of bytes that are not UTF-8."""
    return random.choice(TEXTS).replace("\0", "").replace("\ud800", "\udcff")
