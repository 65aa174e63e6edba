"""Which files a rosbag2 bag consists of."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from ruamel.yaml import YAML, YAMLError


class BagError(ValueError):
    """A bag that cannot be read, or does not hold what was asked for; the text is one line."""


def storage_files(path: Path) -> list[Path]:
    """Return the MCAP files of a bag (directory or file) in their order.

    Raises
    ------
    BagError
        If there are none, one is missing or empty, or the bag is of another kind.
    """
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        if path.stat().st_size == 0:
            raise BagError(f"{path}: empty file")
        return [path]
    information = bag_information(path / "metadata.yaml")
    mode = str(information.get("compression_mode") or "").lower()
    if mode not in ("", "none", "storage"):
        raise BagError(f"{path}: compressed by {mode}; unpack it with 'ros2 bag convert'")
    names = cast("list[Any]", information.get("relative_file_paths") or [])
    files = [path / Path(str(name)).name for name in names] or sorted(path.glob("*.mcap"))
    if not files:
        raise BagError(f"{path}: no bag in this directory (neither metadata.yaml nor an .mcap file)")
    for file in files:
        if not file.is_file():
            raise BagError(
                f"{path}: metadata.yaml names {file.name}, which is missing; run quadftc repair {path}"
            )
        if file.suffix != ".mcap":
            raise BagError(f"{path}: {file.name} is not MCAP; convert the bag with 'ros2 bag convert'")
        if file.stat().st_size == 0:
            raise BagError(f"{file}: empty file")
    return files


def bag_information(path: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says; nothing if it is missing."""
    if not path.exists():
        return {}
    try:
        content: Any = YAML(typ="safe").load(path.read_text("utf-8"))  # pyright: ignore
        return dict(content["rosbag2_bagfile_information"])
    except (OSError, YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, RecursionError) as error:
        what = f"not the metadata of a bag ({type(error).__name__})"
        raise BagError(f"{path}: {what}; run quadftc repair {path.parent}") from error
