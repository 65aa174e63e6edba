# pyright: basic
"""Bad input made of good input: values in YAML replaced, texts broken, bytes overwritten.

Each function draws from a `random.Random`, that of a seed or that of a property test.
"""

from __future__ import annotations

import copy
import re
from itertools import pairwise
from random import Random
from typing import Any

import yaml

from quadftc_tools.soak.bad_values import TEXTS, TOKENS, WRITTEN, bad_value

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutated_yaml(data: bytes, random: Random) -> bytes:
    """Change a YAML file: mostly values and keys, now and then its text or its bytes."""
    if random.random() < 0.25:
        return mutated_text(data, random)
    try:
        tree: Any = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, RecursionError):
        return mutated_text(data, random)
    try:
        for _ in range(random.choice((1, 1, 1, 2, 4))):
            tree = _changed(tree, random)
        return plain_dump(tree, random.random() < 0.5)
    except RecursionError:  # too deep to be written
        return bombs(random)


def plain_dump(tree: Any, unicode: bool = False) -> bytes:
    """Write plain data as YAML; with ``unicode``, characters as they are."""
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=unicode, width=1000)
    return text.encode("utf-8", "surrogatepass")


def _changed(tree: Any, random: Random) -> Any:
    """Change one place of plain data."""
    tree = copy.deepcopy(tree)
    places = list(_places(tree))
    if not places:
        return bad_value(random)
    holder, key = random.choice(places)
    value, kind = holder[key], random.randrange(9)
    if kind < 4:
        holder[key] = bad_value(random)
    elif kind == 4:
        del holder[key]
    elif kind == 5:  # another place's value, shared
        other, at = random.choice(places)
        holder[key] = copy.deepcopy(other[at])
    elif kind == 6:
        holder[key] = random.choice(
            ([value], {"a": value}, [value] * 3, [value] * 300, str(value), _deep(value, random))
        )
    elif isinstance(holder, dict):
        name = random.choice((*TEXTS, f"{key}s", str(key)[:-1], str(key).upper(), 1, None, True, 1.5))
        if kind == 7:
            del holder[key]
        holder[name] = value
    else:
        holder.insert(key, copy.deepcopy(value))
    return tree


def _deep(value: Any, random: Random) -> Any:
    for _ in range(random.choice((15, 30, 150))):
        value = [value] if random.random() < 0.5 else {"a": value}
    return value


def _places(tree: Any) -> Any:
    """Yield every (mapping or list, key) of plain data."""
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in list(keys):
        yield tree, key
        yield from _places(tree[key])


def mutated_text(data: bytes, random: Random) -> bytes:
    """Change a text: lines, numbers, characters that mean something, bytes."""
    for _ in range(random.choice((1, 1, 2, 3, 6))):
        kind = random.randrange(8)
        if kind < 3 and (found := list(_NUMBER.finditer(data))):
            number = random.choice(found)
            data = data[: number.start()] + random.choice(WRITTEN) + data[number.end() :]
        elif kind < 5:
            at = random.randrange(len(data) + 1)
            data = data[:at] + random.choice(TOKENS).encode("utf-8", "surrogatepass") + data[at:]
        elif kind < 7:
            data = _with_other_lines(data, random)
        else:
            data = mutated_bytes(data, random)
    return bombs(random) if random.random() < 0.01 else data


def _with_other_lines(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    row, other = random.randrange(len(lines)), random.randrange(len(lines))
    kind = random.randrange(5)
    if kind == 0:
        del lines[row]
    elif kind == 1:
        lines.insert(other, lines[row])
    elif kind == 2:
        lines[row], lines[other] = lines[other], lines[row]
    elif kind == 3:
        lines[row] = b"  " + lines[row]
    else:
        lines[row] = lines[row].lstrip()
    return b"".join(lines)


def bombs(random: Random) -> bytes:
    """Draw a YAML text that grows when it is read, or is deep."""
    names = "abcdefghij"
    laughs = "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise(names))
    return random.choice(
        (
            (f"a: &a [x, x, x]\n{laughs}").encode(),
            b"[" * 20_000,
            b"{a: " * 5_000 + b"1" + b"}" * 5_000,
            b"a: &a [*a]\n",
            b"a: &a {b: *a}\n",
            b"- " * 3_000,
            b"".join(b"k%d: 1\n" % k for k in range(30_000)),
            b"a: '" + b"x" * 2_000_000 + b"'",
            b"? " * 2_000,
            b"",
            b"\xff\xfe",
            b"# nothing",
        )
    )


def mutated_bytes(data: bytes, random: Random) -> bytes:
    """Overwrite, insert, delete or repeat bytes, or cut the end off."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 5, 20))):
        at = random.randrange(len(changed) + 1)
        size = random.choice((1, 1, 2, 4, 8, 64))
        kind = random.randrange(8)
        if kind < 3:
            changed[at : at + size] = bytes(
                random.randrange(256) for _ in range(min(size, len(changed) - at))
            )
        elif kind == 3:
            changed[at : at + size] = random.choice((b"\0", b"\xff", b"\x7f", b"\x80")) * min(
                size, len(changed) - at
            )
        elif kind == 4:
            changed[at:at] = bytes(random.randrange(256) for _ in range(size))
        elif kind == 5:
            del changed[at : at + size]
        elif kind == 6:
            changed[at:at] = changed[at : at + 16 * size]
        elif random.random() < 0.3:
            del changed[at:]
    return bytes(changed)
