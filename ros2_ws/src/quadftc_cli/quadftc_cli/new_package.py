"""Packages that ``quadftc new`` writes: one component each, in a ROS 2 package of the user's own.

They are copies of the examples under other names: of the package ``own_observer``, and of the law of a kind.
"""

from __future__ import annotations

import importlib.util
import keyword
import re
from pathlib import Path
from typing import Any, NamedTuple

from quadftc_control.controller import controllers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.registry import Registry
from quadftc_sim.fault import faults

PACKAGE = "own_observer"  # the example whose files every package has
README = """# {name}

{what} for quadftc: put your law in place of that in `{name}/{name}.py`. Build it in a workspace on top of
quadftc, whose environment is sourced:

```
colcon build --packages-select {name} && . install/setup.bash
{flies}
```

In a clone of quadftc, its contract tests run on it, too: `scripts/test ros2_ws/src/{tests} -k {name}`.
"""


class Kind(NamedTuple):
    """What a kind of component needs."""

    group: str  # of entry points
    depends: str  # the package with its base class
    registry: Registry[Any]
    tests: str  # contract tests, in a clone
    law: str  # the file of the law, among the examples
    named: str  # as the law is there
    what: str  # of it, to begin a sentence
    trial: str  # what flies it; {} is its name


KINDS = {
    "observer": Kind(
        "quadftc.fault_observers",
        "quadftc_fdi",
        fault_observers,
        "quadftc_fdi/test/test_fault_observer_contract.py",
        "own_observer/own_observer/washout.py",
        "washout",
        "A fault observer",
        "quadftc run paper_faults --observer {}",
    ),
    "controller": Kind(
        "quadftc.controllers",
        "quadftc_control",
        controllers,
        "quadftc_control/test/test_controller_contract.py",
        "own_controller.py",
        "pd",
        "A controller",
        "quadftc run paper_faults --controller {}",
    ),
    "fault": Kind(
        "quadftc.faults",
        "quadftc_sim",
        faults,
        "quadftc_sim/test/test_faults.py",
        "own_fault.py",
        "flicker",
        "A fault",
        "quadftc inject {} axis=roll size=3deg duration=10s    # into a graph that runs",
    ),
}


def write_package(kind: str, name: str, directory: Path) -> list[Path]:
    """Write a package for a component of a kind into ``directory/NAME``; return its files.

    A ValueError says if the name cannot be used, the directory exists, or the examples are not there.
    """
    if kind not in KINDS:
        raise ValueError(f"{kind}: expected one of {', '.join(KINDS)}")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name) or name.startswith("quadftc"):
        raise ValueError(f"{name}: expected small letters, digits, _, as my_{kind}; quadftc begins its own")
    if name in KINDS[kind].registry.names():
        raise ValueError(f"{name}: exists already, see quadftc list {kind}s")
    folder = directory / name
    if folder.exists():
        raise ValueError(f"{folder}: exists")
    if importlib.util.find_spec(name) is not None:
        raise ValueError(f"{name}: Python has a package of that name already; expected another")
    # the package of examples/ is that of an observer; its words become those of the kind
    row, example = KINDS[kind], KINDS["observer"]
    words = {
        rf"\b({row.named}|{example.named}|{PACKAGE})\b": name,
        f"{row.named.capitalize()}|{example.named.capitalize()}": "".join(
            map(str.capitalize, name.split("_"))
        ),
        example.group: row.group,
        example.depends: row.depends,
        example.what: row.what,
    }
    originals = {each: f"{PACKAGE}/{each}" for each in ("package.xml", "setup.py", "setup.cfg")}
    originals |= {f"{name}/__init__.py": f"{PACKAGE}/{PACKAGE}/__init__.py", f"{name}/{name}.py": row.law}
    texts = {"README.md": README.format(name=name, flies=row.trial.format(name), **row._asdict())}
    for path, original in originals.items():
        text = (_examples() / original).read_text(encoding="utf-8")
        for word, new in words.items():
            text = re.sub(word, new, text)
        texts[path] = text
    written: list[Path] = []
    for path, text in {**texts, f"resource/{name}": ""}.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        written.append(file)
    return written


def _examples() -> Path:
    """Return the folder of the examples, the repository's or the wheel's; a ValueError: there is neither."""
    for folder in Path(__file__).resolve().parents:
        if (folder / "examples" / PACKAGE).is_dir():
            return folder / "examples"
    raise ValueError("the examples, which it copies, are not there: build with colcon's --symlink-install")
