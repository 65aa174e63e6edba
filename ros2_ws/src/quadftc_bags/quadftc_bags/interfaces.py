"""Message types by name: the class, the full text of the definition, and the type hash.

Without ROS 2, text and hash come from rosbags and from the definitions in the wheel (folder ``msg``).
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

_SEPARATOR = "=" * 80


class Interface(NamedTuple):
    """A message type as a bag describes it."""

    text: str  # the definition followed by those of all types it uses (encoding ``ros2msg``)
    type_hash: str  # ``RIHS01_`` and 64 hexadecimal digits (REP-2016)


def load_interface(type_name: str) -> Interface:
    """Read a message type (``package/msg/Name``) from the installed packages; ValueError if there is none."""
    if importlib.util.find_spec("ament_index_python") is None:
        return _interface_without_ros(type_name)
    package, name = _split_type(type_name)
    text = "".join(_definitions(package, name, seen=set()))
    description = json.loads(_file(package, f"{name}.json").read_text("utf-8"))
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return Interface(text, hashes[type_name])


def load_message_class(type_name: str) -> type:
    """Import the Python class of a message type; ValueError if no such type is installed."""
    package, name = _split_type(type_name)
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"message type '{type_name}': not installed ({error})") from error


def installed_fields(type_name: str) -> list[tuple[str, str, int | None]]:
    """Return each field: name, type of its elements, and their number (None: one, -1: a sequence)."""
    fields: list[tuple[str, str, int | None]] = []
    message_class: Any = load_message_class(type_name)
    # texts such as sequence<a/B, 3> and double[9]
    for name, text in message_class.get_fields_and_field_types().items():
        ((sequence, base, size),) = re.findall(r"^(sequence<)?([\w/]+)[^\[]*(?:\[(\d+)\])?$", text)
        length = int(size) if size else None
        fields.append((name, base.replace("/", "/msg/"), -1 if sequence else length))
    return fields


def _split_type(type_name: str) -> tuple[str, str]:
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg" or not all(parts):
        raise ValueError(f"message type '{type_name}': expected package/msg/Name")
    return parts[0], parts[2]


def _definitions(package: str, name: str, seen: set[str]) -> list[str]:
    """Return a type's own text and, depth first and sorted, those it uses, each once behind its separator."""
    pieces = [_file(package, f"{name}.msg").read_text("utf-8")]
    for dependency in sorted(
        {base for _, base, _ in installed_fields(f"{package}/msg/{name}") if "/" in base}
    ):
        if dependency not in seen:
            seen.add(dependency)
            inner, inner_name = _split_type(dependency)
            pieces.append(f"\n{_SEPARATOR}\nMSG: {inner}/{inner_name}\n")
            pieces.extend(_definitions(inner, inner_name, seen))
    return pieces


def _file(package: str, name: str) -> Path:
    """Return the file of that name among an installed package's messages."""
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    type_name = f"{package}/msg/{Path(name).stem}"
    try:
        path = Path(get_package_share_directory(package), "msg", name)
    except (PackageNotFoundError, ValueError) as error:
        raise ValueError(f"message type '{type_name}': package '{package}' is not installed") from error
    if not path.is_file():
        raise ValueError(f"message type '{type_name}': no file {path}")
    return path


def _interface_without_ros(type_name: str) -> Interface:
    from rosbags.typesys import TypesysError

    store = _types_without_ros()
    try:
        text, _ = store.generate_msgdef(type_name, ros_version=2)
    except TypesysError:
        raise ValueError(f"message type '{type_name}': not known without ROS 2") from None
    return Interface(text, store.hash_rihs01(type_name))


@cache
def _types_without_ros() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (Path(__file__).parent / "msg").glob("*.msg"):
        store.register(get_types_from_msg(file.read_text("utf-8"), f"quadftc_msgs/msg/{file.stem}"))
    return store
