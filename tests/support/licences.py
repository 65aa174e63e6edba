"""What each locked package may be used under: a licence in ACCEPTED or, with a reason, in EXCEPTIONS.

A package says its licence in its metadata, in the `package.xml` of a ROS wheel, or in its licence file.
"""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

# Licences that let an Apache-2.0 work import theirs. MPL-2.0 asks something of changes to its own files only.
ACCEPTED = re.compile(
    r"(MIT|Apache|BSD|0BSD|ISC|PSF|Python Software Foundation|MPL|Mozilla Public License 2.0|zlib|CC0"
    r"|Public Domain|any-OSI)\b",
    re.IGNORECASE,
)
EXCEPTIONS = {
    "codespell": "GPL-2.0: scripts/test runs it as a program; nothing imports it",
    "docutils": "public domain and BSD; its one GPL file is for Emacs and not in the wheel",
    "pymavlink": "LGPL-3.0: a separate library, used as published (NOTICE)",
}
LICENCE_TEXTS = {
    "MIT": "Permission is hereby granted, free of charge",
    "Apache-2.0": "Apache License",
}


def locked_names(lock: str) -> dict[str, bool]:
    """Return the packages that a lock file names, and whether each is for every platform and Python."""
    lines = re.findall(r"^([A-Za-z0-9._-]+)==\S+ *(;?)", lock, re.MULTILINE)
    return {name: not marker for name, marker in lines}


def stated_licences(package: Distribution) -> list[str] | None:
    """Return all licences that hold at once, each as "A OR B" where there is a choice.

    None: a package that only names others, as it installs no file.
    """
    metadata = package.metadata
    for expression in metadata.get_all("License-Expression") or []:
        return [part.strip(" ()") for part in re.split(r"\bAND\b", expression)]
    classifiers = [text for text in metadata.get_all("Classifier") or [] if text.startswith("License ::")]
    if named := [last for text in classifiers if (last := text.split(" :: ")[-1]) != "OSI Approved"]:
        return named
    if fields := " ".join(metadata.get_all("License") or []).strip():
        return [fields.splitlines()[0]]
    return _licences_of_files(package)


def judge_licences(lock: str) -> list[str]:
    """Return a line for each locked package that may not be used, and for each exception without need."""
    found: list[str] = []
    needed: set[str] = set()
    for name, everywhere in locked_names(lock).items():
        try:
            licences = stated_licences(distribution(name))
        except PackageNotFoundError:
            if everywhere:
                found.append(f"{name}: locked, but not installed; call scripts/setup")
            continue
        if licences is None or (licences and all(_is_accepted(licence) for licence in licences)):
            continue
        needed.add(name)
        if name not in EXCEPTIONS:
            found.append(f"{name}: {' and '.join(licences) or 'no licence said'}; expected one of ACCEPTED")
    return found + [f"{name}: needs no exception any more" for name in sorted(EXCEPTIONS.keys() - needed)]


def _is_accepted(licence: str) -> bool:
    return any(ACCEPTED.match(choice.strip()) for choice in re.split(r"\bOR\b", licence))


def _licences_of_files(package: Distribution) -> list[str] | None:
    """Licences by the manifests of a ROS wheel, else by the licence file."""
    files = package.files or []
    if all(".dist-info" in str(file) for file in files):
        return None
    manifests = [Path(str(file.locate())) for file in files if file.name == "package.xml"]
    for path in manifests:
        named = re.findall(r"<license[^>]*>(.*?)</license>", path.read_text(encoding="utf-8"))
        if named:
            return named
    texts = [Path(str(file.locate())) for file in files if re.match(r"(LICEN[CS]E|COPYING)", file.name)]
    for path in texts:
        text = path.read_text(encoding="utf-8", errors="replace")
        if known := [name for name, words in LICENCE_TEXTS.items() if words in text]:
            return known
    return []
