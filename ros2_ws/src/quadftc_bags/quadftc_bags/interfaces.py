"""Message types by name: the class, the full text of the definition, and the type hash."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from typing import NamedTuple

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

_SEPARATOR = "=" * 80
_FIELD_TYPE = re.compile(r"\s*([a-zA-Z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s")
_INTEGERS = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
_PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "string", "wstring"} | _INTEGERS


class Interface(NamedTuple):
    """A message type as a bag describes it."""

    name: str  # ``package/msg/Name``
    text: str  # the definition followed by those of all types it uses (encoding ``ros2msg``)
    type_hash: str  # ``RIHS01_`` and 64 hexadecimal digits (REP-2016)


def load_interface(type_name: str) -> Interface:
    """Read a message type's definition and hash from the installed packages.

    Raises ValueError if the name is not ``package/msg/Name`` or no such type is installed.
    """
    package, name = split_type(type_name)
    text = "".join(_definitions(f"{package}/{name}", seen=set()))
    description = json.loads(_share(package, type_name).joinpath("msg", f"{name}.json").read_text("utf-8"))
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return Interface(type_name, text, hashes[type_name])


def load_message_class(type_name: str) -> type:
    """Import the Python class of a message type.

    Raises ValueError if the name is not ``package/msg/Name`` or no such type is installed.
    """
    package, name = split_type(type_name)
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"message type '{type_name}': not installed ({error})") from error


def split_type(type_name: str) -> tuple[str, str]:
    """Split ``package/msg/Name`` into package and name.

    Raises ValueError if the name has another form.
    """
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg" or not all(parts):
        raise ValueError(f"message type '{type_name}': expected package/msg/Name")
    return parts[0], parts[2]


def _definitions(short_name: str, seen: set[str]) -> list[str]:
    """Return a type's own text and, depth first and sorted, those it uses, each once behind its separator."""
    package, name = short_name.split("/")
    type_name = f"{package}/msg/{name}"
    path = _share(package, type_name).joinpath("msg", f"{name}.msg")
    try:
        text = path.read_text("utf-8")
    except FileNotFoundError as error:
        raise ValueError(f"message type '{type_name}': no file {path}") from error
    pieces = [text]
    for dependency in sorted(_dependencies(text, package)):
        if dependency not in seen:
            seen.add(dependency)
            pieces.append(f"\n{_SEPARATOR}\nMSG: {dependency}\n")
            pieces.extend(_definitions(dependency, seen))
    return pieces


def _dependencies(text: str, package: str) -> set[str]:
    """Return the types of the fields of a definition that are messages themselves, as ``package/Name``."""
    found: set[str] = set()
    for line in text.splitlines():
        match = _FIELD_TYPE.match(line)
        if match and match[1] not in _PRIMITIVES:
            parts = match[1].split("/")
            found.add(f"{package if len(parts) == 1 else parts[0]}/{parts[-1]}")
    return found


def _share(package: str, type_name: str) -> Path:
    try:
        return Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError) as error:
        raise ValueError(f"message type '{type_name}': package '{package}' is not installed") from error
