"""What most places do not expect: numbers, texts, pieces of YAML, numbers as written."""

from __future__ import annotations

from random import Random
from typing import Any

NUMBERS: tuple[Any, ...] = (
    *(0, -0.0, 1, -1, 1e-320, 5e-324, 1e-9, 1e9, -1e9, 1e38, 1e300, 1.8e308, -1e308, 2**31, 2**63),
    *(-(2**63), 2**64, 10**400, float("nan"), float("inf"), float("-inf"), 1e16 + 1, 0.1 + 0.2),
)
TEXTS = (
    *("", " ", "~", "null", "true", "no", "NaN", "inf", "-inf", ".nan", "1e999", "0x10", "1_000", "٣"),
    *("1 deg", "3 furlongs", "1 deg deg", "-5 s", "1e-400 s", "inf s", "\ud800", "\x00", "a\nb"),
    *("a\rb", "\u202etxt", "é" * 300, "../../x", "/tmp/x/y", "..", ".", "a/b", "~root", "CON"),
    *("x" * 70, "x" * 5000, "none", "ismc", "supervised", "{}", "[]", "%s%n", "{0}", "{channel}"),
    *("[bold]x[/]", "[/]", "${HOME}", "`id`", "$(id)", "a=b", "a.b", "0", "-1", "roll", "yaw", "x"),
    *("attitude", "gyro", "imu", "imu/data", "mems", "ideal", "2026-11-22", "12:30:45", "0o17", "="),
    "<<",
)
TOKENS = (
    *("&a ", "*a", "!!python/object/apply:os.system [id]", "!!binary aGk=", "!!set {a}", "!x "),
    *("<<: *a", "---\n", "...\n", "%YAML 1.1\n", "%TAG ! x\n", "\t", "{", "}", "[", "]", ":", "- "),
    *("? ", "|\n", ">\n", "#", "'", '"', "\\", ",", "\0", "\ufeff", "@", "`", "&", "*", "!", "nan"),
    *("1e999", "=", "\r", "\u2028", "é", "[[", "]]", '"""', "'''", "null", "-inf", "1e400", "NaN"),
)
WRITTEN = (
    *(b"nan", b"-nan", b"inf", b"-inf", b".nan", b".inf", b"1e999", b"-1", b"0", b"0.0", b"-0.0"),
    *(b"1e-320", b"1e308", b"", b"9" * 400, b"1" + b"0" * 30, b"true", b"[]", b"{}", b"''"),
    *(b"[1.0, 2.0]", b"[[1.0]]", b"x", b"2147483648"),
)
SHAPES: tuple[Any, ...] = (
    *(None, True, False, [], {}, [[]], [1.0, 2.0], [1.0, 2.0, 3.0], ["roll", "roll"]),
    *({"kind": "bias"}, {"": 1}),
)


def bad_value(random: Random) -> Any:
    """Draw a value that most places do not expect."""
    kind = random.randrange(8)
    if kind < 3:
        return random.choice(NUMBERS)
    if kind < 6:
        return random.choice(TEXTS)
    return random.choice(SHAPES)
