"""JUnit XML: what was judged, as test cases for a build server."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET


class Failure(NamedTuple):
    """Why a case failed."""

    message: str  # one line
    kind: str
    text: str = ""


class Case(NamedTuple):
    """One thing that was judged."""

    group: str  # of which it is one, such as a run
    name: str
    failures: tuple[Failure, ...] = ()
    skipped: str = ""  # why it was not judged; empty: it was


def write_junit(path: Path, suite: str, cases: Sequence[Case], duration: float | None = None) -> Path:
    """Write a test suite that took ``duration`` [s]; return its path."""
    counts = {"tests": len(cases), "failures": sum(bool(case.failures) for case in cases)}
    counts["skipped"] = sum(bool(case.skipped) for case in cases)
    root = ET.Element("testsuite", {"name": suite, **{key: str(value) for key, value in counts.items()}})
    if duration is not None:
        root.set("time", f"{duration:.3f}")
    for case in cases:
        element = ET.SubElement(root, "testcase", classname=case.group, name=case.name)
        for message, kind, text in case.failures:
            ET.SubElement(element, "failure", message=message, type=kind).text = text
        if case.skipped:
            ET.SubElement(element, "skipped", message=case.skipped)
    ET.indent(root)
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_file(path, ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n")


def check_cases(group: str, checks: Iterable[Mapping[str, object]]) -> list[Case]:
    """Return the cases of a run, one for each check of its summary; without checks, that it was flown."""
    cases: list[Case] = []
    for check in checks:
        name = f"{check['metric']} {check['axis'] or ''}".rstrip()
        value = "no value" if check["value"] is None else f"{check['value']:.6g}"
        failure = Failure(f"{name} = {value}, required {check['bound']}", "check")
        cases.append(Case(group, f"{name} {check['bound']}", () if check["passed"] else (failure,)))
    return cases or [Case(group, "flown to its end")]


def write_file(path: Path, text: str) -> Path:
    """Write a text so that nobody sees half of it; OSError, with the path, leaves nothing behind."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
        Path(name).chmod(0o644)
        return Path(name).replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        Path(name).unlink(missing_ok=True)
