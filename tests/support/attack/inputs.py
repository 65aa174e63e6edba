"""Bad input, drawn by Hypothesis: values, YAML documents, texts and bytes made of good ones, command lines.

Each function takes the ``draw`` of a composite strategy, so that Hypothesis can shrink what it drew.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import typer
import yaml
from hypothesis import strategies as st

T = TypeVar("T")
Draw = st.DrawFn

WORDS = (
    *("", " ", "~", "null", "true", "no", ".nan", "-inf", "1e999", "0x10", "0o17", "1_000", "٣", "="),
    *("1 deg", "3 furlongs", "1 deg deg", "-5 s", "1e-400 s", "inf s", "2026-11-22", "12:30:45", "<<"),
    *("\ud800", "\x00", "a\nb", "a\rb", "\u202etxt", "é" * 300, "x" * 70, "x" * 5000, "../../x", ".."),
    *("/tmp/x/y", ".", "a/b", "~root", "{}", "[]", "%s%n", "{channel}", "[bold]x[/]", "[/]", "${HOME}"),
    *("$(id)", "a=b", "a.b", "none", "ismc", "supervised", "roll", "x", "attitude", "gyro", "imu/data"),
    *("mems", "ideal"),
)  # texts that YAML, units, paths, terminals and our own files give a meaning
TEXTS = st.sampled_from(WORDS) | st.text(st.characters(), max_size=20)
NUMBERS = st.one_of(st.integers(), st.floats(), st.sampled_from((10**400, 5e-324, 1e-9, 1e9, 1e308, -1e308)))
SCALARS = st.one_of(NUMBERS, TEXTS, st.booleans(), st.none())
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)
TOKENS = (
    *("&a ", "*a", "!!python/object/apply:os.system [id]", "!!binary aGk=", "!!set {a}", "<<: *a", "---\n"),
    *("...\n", "%YAML 1.1\n", "\t", "{", "}", "[", "]", ":", "- ", "? ", "|\n", "#", "'", '"', "\\", ","),
    *("\0", "\ufeff", "@", "`", "!", "nan", "1e999", "=", "\r", "\u2028", "é", "[[", '"""', "null"),
)
NUMERALS = (
    *(b"nan", b"-inf", b".nan", b"1e999", b"-1", b"0", b"-0.0", b"1e-320", b"1e308", b"", b"9" * 400),
    *(b"true", b"[]", b"{}", b"''", b"[1.0, 2.0]", b"x", b"2147483648"),
)  # what stands in a text where a number was
_LAUGHS = "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise("abcdefghij"))
BOMBS = (
    *(f"a: &a [x, x, x]\n{_LAUGHS}".encode(), b"[" * 20_000, b"- " * 3_000, b"? " * 2_000),
    *(b"{a: " * 5_000 + b"1" + b"}" * 5_000, b"a: &a [*a]\n", b"a: &a {b: *a}\n"),
    *(b"".join(b"k%d: 1\n" % k for k in range(30_000)), b"a: '" + b"x" * 2_000_000 + b"'"),
    *(b"", b"\xff\xfe", b"# nothing"),
)  # YAML that grows when it is read, is deep or long, or holds nothing
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")

PLACES = (
    *("s.yaml", "bag", "log.ulg", "g.yaml", "c.yaml", "nowhere", "link", "bag/metadata.yaml", "", ".", "-"),
    *("--", "\udcff"),
)
ARGUMENTS = (
    *("s.yaml", "bag", "out", "g.yaml", "proposed", "pid", "none", "supervised", "500", "250 Hz", "3", "-7"),
    *("lockstep", "faults.0.value=2 deg", "observer.delta=0.1", "imu/data", "bias axis=roll value=3deg"),
    *("composed", "sleep", "poll"),
)
# an argument has no NUL, and no free text names a place outside the sandbox
WORD = st.sampled_from(tuple(word for word in WORDS if "\0" not in word and word != "\ud800"))
WORD |= st.text(st.characters(exclude_categories=("Cs",), exclude_characters="/\0"), max_size=20)
OF_OPTION = {
    "--rate": st.sampled_from(("0", "-1", "nan", "inf", "abc", "1e300", "10", "1000")),  # none is slow
    "--out": st.sampled_from(("out", "out/a/b", "s.yaml", "bag", "", "x" * 300, "out\n", "\udcff")),
    # not of the duration: flights are short
    "--set": st.sampled_from(
        (*ARGUMENTS, "seed=-1", "x=1", "=", "a", "rate=nan", "name=../../x", "vehicle=../../x.toml")
    ),
}
# commands that fly for long, wait for a vehicle or serve get only arguments that they refuse before
REFUSED = {
    "campaign": ["nowhere.yaml"],
    "tune": ["s.yaml"],
    "bench": ["latency", "--rate", "fast"],
    "doctor": ["x"],
    "inject": ["bias", "value"],
    "clear": ["-1"],
    "set": ["attitude", "roll"],
    "watch": ["--duration", "long"],
    "live": ["--port", "-1"],
    "serve": ["--port", "-1"],
}
SPARED = {
    *("--help", "--realtime-priority", "--loop", "--workers", "--jobs", "--delay", "--graph"),
    *("--install-completion", "--show-completion"),
}  # options that change the machine, or take long


def pick(draw: Draw, options: Sequence[T]) -> T:
    """Draw one of some options; one that stands there twice comes twice as often."""
    return draw(st.sampled_from(options))


def plain_dump(tree: Any, unicode: bool = False) -> bytes:
    """Write plain data as YAML; with ``unicode``, characters are not escaped."""
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=unicode, width=1000)
    return text.encode("utf-8", "surrogatepass")


def bad_yaml(draw: Draw, data: bytes) -> bytes:
    """Change values and keys of a YAML document; in one of four cases its text or its bytes."""
    if pick(draw, range(4)) == 3:
        return bad_text(draw, data)
    tree = yaml.safe_load(data)
    try:
        for _ in range(pick(draw, (1, 1, 1, 2, 4))):
            _change_place(draw, tree)
        return plain_dump(tree, draw(st.booleans()))
    except RecursionError:  # too deep to be written
        return pick(draw, BOMBS)


def _change_place(draw: Draw, tree: Any) -> None:
    """Replace, remove, repeat, wrap or rename one value of a YAML document, in place."""
    places = list(_places(tree))
    if not places:
        return
    holder, key = pick(draw, places)
    value, change = holder[key], pick(draw, ("replace", "replace", "remove", "repeat", "wrap", "rename"))
    if change == "replace":
        holder[key] = draw(VALUES)
    elif change == "remove":
        del holder[key]
    elif change == "repeat":
        other, at = pick(draw, places)
        holder[key] = copy.deepcopy(other[at])
    elif change == "wrap":
        depth = pick(draw, (1, 1, 30, 150))
        for _ in range(depth):
            value = [value] if draw(st.booleans()) else {"a": value}
        holder[key] = pick(draw, (value, [value] * 3, [value] * 300, str(value)))
    elif isinstance(holder, dict):
        known = st.sampled_from((f"{key}s", str(key)[:-1], str(key).upper()))
        holder[draw(known | SCALARS)] = holder.pop(key) if draw(st.booleans()) else value
    else:
        holder.insert(key, copy.deepcopy(value))


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the mapping or list, and the key, of each value."""
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in list(keys):
        yield tree, key
        yield from _places(tree[key])


def bad_text(draw: Draw, data: bytes) -> bytes:
    """Change numbers, characters that mean something, lines or bytes of a text."""
    if pick(draw, range(100)) == 99:
        return pick(draw, BOMBS)
    for _ in range(pick(draw, (1, 1, 2, 3, 6))):
        change = pick(draw, ("number", "number", "token", "line", "line", "bytes"))
        if change == "number" and (numbers := list(_NUMBER.finditer(data))):
            number = pick(draw, numbers)
            data = data[: number.start()] + pick(draw, NUMERALS) + data[number.end() :]
        elif change == "line":
            data = _change_line(draw, data)
        elif change == "bytes":
            data = bad_bytes(draw, data)
        else:
            at = draw(st.integers(0, len(data)))
            data = data[:at] + pick(draw, TOKENS).encode() + data[at:]
    return data


def _change_line(draw: Draw, data: bytes) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    row, other = pick(draw, range(len(lines))), pick(draw, range(len(lines)))
    change = pick(draw, ("remove", "repeat", "swap", "indent", "dedent"))
    if change == "remove":
        del lines[row]
    elif change == "repeat":
        lines.insert(other, lines[row])
    elif change == "swap":
        lines[row], lines[other] = lines[other], lines[row]
    else:
        lines[row] = b"  " + lines[row] if change == "indent" else lines[row].lstrip()
    return b"".join(lines)


def bad_bytes(draw: Draw, data: bytes) -> bytes:
    """Overwrite, insert, remove or repeat bytes, or cut the end off."""
    for _ in range(pick(draw, (1, 1, 2, 5, 20))):
        at, size = draw(st.integers(0, len(data))), pick(draw, (1, 1, 2, 4, 8, 64))
        before, after = data[:at], data[at + size :]
        change = pick(draw, ("overwrite", "overwrite", "fill", "insert", "remove", "repeat", "cut"))
        if change in ("overwrite", "insert"):
            new = draw(st.binary(min_size=size, max_size=size))
            data = before + new + (after if change == "overwrite" else data[at:])
        elif change == "fill":
            data = before + pick(draw, (b"\0", b"\xff", b"\x7f", b"\x80")) * size + after
        elif change == "remove":
            data = before + after
        elif change == "repeat":
            data = before + data[at : at + 16 * size] + data[at:]
        elif pick(draw, range(3)) == 2:
            data = before
    return data


def bad_argument(draw: Draw, text: str) -> str:
    """Change one word, or some characters, of an argument."""
    change = pick(draw, ("insert", "value", "part", "text"))
    if change == "insert":
        at = draw(st.integers(0, len(text)))
        text = text[:at] + draw(TEXTS) + text[at + pick(draw, range(3)) :]
    elif change == "value" and "=" in text:
        numerals = st.sampled_from([each.decode() for each in NUMERALS])
        text = f"{text.rpartition('=')[0]}={draw(TEXTS | numerals)}"
    elif change == "part":
        parts = text.split(".")
        parts[pick(draw, range(len(parts)))] = draw(TEXTS | st.sampled_from(("-1", "99", "9" * 30, "²")))
        text = ".".join(parts)
    else:
        text = bad_text(draw, text.encode()).decode("utf-8", "replace")
    return text.replace("\0", "")[:3000]  # no argument of a process has NUL


@cache
def _declared_parameters(app: typer.Typer) -> dict[str, list[Any]]:
    """Arguments and options of each command, as it declares them."""
    group: Any = typer.main.get_command(app)
    context = group.make_context("quadftc", [], resilient_parsing=True)
    return {name: group.resolve_command(context, [name])[1].params for name in group.list_commands(context)}


def bad_command_line(draw: Draw, app: typer.Typer) -> list[str]:
    """Draw a command of ``quadftc`` with options that it declares."""
    declared = _declared_parameters(app)
    names = list(declared)
    quick = [name for name in names if name not in REFUSED]
    name = pick(draw, (*quick, *quick, *names, "fly", "", "\udcff"))
    if name in REFUSED:
        return [name, *REFUSED[name]]
    parameters = declared.get(name, [])
    arguments = [name]
    if any(each.param_type_name == "argument" for each in parameters) and pick(draw, range(10)) < 9:
        good = {"run": "s.yaml", "check": "s.yaml", "list": "faults"}.get(name, "bag")
        arguments.append(good if pick(draw, range(3)) < 2 else draw(st.sampled_from(PLACES) | WORD))
    options = [
        each for each in parameters if each.param_type_name == "option" and not SPARED & set(each.opts)
    ]
    for option in draw(st.lists(st.sampled_from(options), max_size=5)) if options else ():
        arguments.append(pick(draw, option.opts))
        if not option.is_flag or pick(draw, range(20)) == 19:
            arguments.append(draw(OF_OPTION.get(arguments[-1], st.sampled_from(ARGUMENTS) | WORD)))
    if pick(draw, range(10)) == 9 or name not in declared:
        arguments += draw(st.lists(st.sampled_from((*PLACES, *ARGUMENTS)) | WORD, max_size=2))
    return [*arguments, "--out", "out"] if name == "run" and pick(draw, range(10)) < 9 else arguments
