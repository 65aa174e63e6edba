"""What the wheel carries besides sources: the laws of all scenarios, compiled.

On Linux x86-64 they are compiled for any x86-64. With the variable `CC` that compiler makes them, anywhere on
Linux, and its target is that of the wheel. `scripts/wheels` makes the wheels of a release.

Called by hatchling, and by itself as a script in a process of its own: ``hatch_build.py FOLDER``.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).parent
NEEDED = ("jax", "numpy", "pydantic", "pyyaml", "ruamel-yaml")  # to load and trace the scenarios
CC = os.environ.get("CC", "")
HAS_COMPILER = platform.machine() == "x86_64" and any(map(shutil.which, ("cc", "gcc", "clang")))
CARRIES = sys.platform == "linux" and (CC != "" or HAS_COMPILER)
NO_C = 3  # the exit code where the compiler does not work; a law that cannot be compiled stops the build


class CarryHook(BuildHookInterface):
    """Compiles laws into the wheel, which is then for this platform; without a compiler it is for any."""

    def dependencies(self) -> list[str]:
        """Return what the build needs besides hatchling; JAX is of the extra `batch`."""
        core = self.metadata.core
        given = core.dependencies_complex | core.optional_dependencies_complex["batch"]
        return [text for text, each in given.items() if each.name in NEEDED] if CARRIES else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the laws."""
        if not CARRIES or version == "editable":
            return
        if missing := [name for name in NEEDED if not _is_installed(name)]:  # without build isolation
            self.app.display_warning(f"the wheel carries no compiled laws: no {', '.join(missing)}")
            return
        self._place = tempfile.TemporaryDirectory(prefix="quadftc_")  # until the wheel is written
        folder = self._place.name
        here = os.environ.get("PYTHONPATH", "").split(os.pathsep)  # pip has put the libraries there
        paths = [*map(str, ROOT.glob("ros2_ws/src/quadftc_*")), *filter(None, here)]
        env = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "1"}
        told = subprocess.run(
            [sys.executable, __file__, folder], env=env, capture_output=True, text=True, check=False
        )
        if told.returncode not in (0, NO_C):
            raise RuntimeError(f"laws cannot be compiled:\n{told.stderr}")
        if told.returncode == NO_C:
            self.app.display_warning(f"the wheel carries no compiled laws: {told.stderr}")
            return
        build_data["force_include"][folder] = "quadftc_compile/carried"
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-linux_{told.stdout}"


def _is_installed(name: str) -> bool:
    try:
        importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def main(folder: Path) -> None:
    """Compile the laws of the scenarios, with each of their schemes, into a folder; print the machine."""
    from quadftc_compile.build import BuildError
    from quadftc_compile.carry import carry, portable_compiler
    from quadftc_compile.wiring import compile_conductor
    from quadftc_flight.closed_loop import loop_of
    from quadftc_flight.scenario import load_scenario

    try:
        compile_conductor(cc := portable_compiler(CC))
    except BuildError as error:  # a compiler without headers, say
        sys.stderr.write(f"{error}\n")
        sys.exit(1 if CC else NO_C)
    scenarios = [load_scenario(path) for path in sorted(ROOT.glob("scenarios/*.yaml"))]
    loops = [loop_of(each, each.scheme(name)) for each in scenarios for name in each.schemes]
    sys.stdout.write(carry((law for loop in loops for law in loop.laws.values()), folder, cc))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
