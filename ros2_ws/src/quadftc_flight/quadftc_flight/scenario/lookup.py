"""Files found by name, or given by path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadftc_flight.scenario.yaml_document import ScenarioError
from quadftc_model.hints import nearest


def find_file(name_or_path: str, folders: Sequence[Path], what: str, advice: str = "give a path") -> Path:
    """Find a YAML file: by its path, or by its name in one of some folders.

    Parameters
    ----------
    name_or_path : str
    folders : sequence of Path
        In the order in which they are looked through.
    what : str
        What is in it, for messages.
    advice : str
        For when there is none at all.

    Raises
    ------
    ScenarioError
        If there is none.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml") or path.name != name_or_path:
        if path.is_file():
            return path
        raise ScenarioError(f"{path}: no such file")
    for folder in folders:
        candidate = folder / f"{name_or_path}.yaml"
        if candidate.is_file():
            return _short(candidate)
    names = names_in(folders)
    there = ", ".join(names) or f"none; {advice}"
    raise ScenarioError(f"no {what} '{name_or_path}'{nearest(name_or_path, names)}; there are: {there}")


def names_in(folders: Sequence[Path]) -> tuple[str, ...]:
    """Return the names of all files that can be found without a path, sorted."""
    return tuple(sorted({file.stem for folder in folders for file in folder.glob("*.yaml")}))


def folders_named(name: str) -> tuple[Path, ...]:
    """Return a folder in the working directory, and the repository's, if there is one."""
    above = (parent / name for parent in Path(__file__).resolve().parents)
    own = next((folder for folder in above if any(folder.glob("*.yaml"))), None)
    return (Path(name), *(() if own is None else (own,)))


def _short(path: Path) -> Path:
    """The path as one would type it, if it is below the working directory."""
    try:
        return path.resolve().relative_to(Path.cwd())
    except ValueError:
        return path
