"""What an exported law needs on a microcontroller: flash and stack, as compilers tell them."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from quadftc_compile.build import BuildError
from quadftc_compile.export import FLAGS

ARM = "arm-none-eabi-"


@dataclasses.dataclass(frozen=True)
class Target:
    """A processor."""

    name: str
    flags: tuple[str, ...]
    reals: tuple[str, ...]  # what its hardware computes in

    @property
    def command(self) -> list[str]:
        """The compiler with its flags."""
        return [f"{ARM}gcc", "-mthumb", "-mfloat-abi=hard", *self.flags]


CORTEX_M7 = Target("Cortex-M7", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16"), ("double", "float"))
CORTEX_M4F = Target("Cortex-M4F", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"), ("float",))
TARGETS = (CORTEX_M7, CORTEX_M4F)


@dataclasses.dataclass(frozen=True)
class Footprint:
    """What a law needs on a processor [bytes]."""

    flash: int  # code and constants of the law, without its numbers
    flash_with_libm: int  # with what it takes of the C library
    variables: int  # that are no constants
    stack: int  # of a step, without that of libm
    calls: tuple[str, ...]  # functions that it takes from libraries


def has_compiler() -> bool:
    """Whether there is a compiler for these processors."""
    return shutil.which(f"{ARM}gcc") is not None


def targets_for(real: str) -> list[Target]:
    """Return the processors whose hardware computes in "double" or "float"."""
    return [each for each in TARGETS if real in each.reals]


def footprint_of(folder: Path, name: str, target: Target) -> Footprint:
    """Compile an exported law for a processor, and measure it; BuildError says why it cannot be."""
    with tempfile.TemporaryDirectory(prefix="quadftc_") as scratch:
        place = Path(scratch)
        source = str((folder / f"{name}.c").resolve())
        told(name, [*target.command, "-std=c99", *FLAGS, "-fstack-usage", "-c", source, "-o", "law.o"], place)
        entries = [f"-Wl,-e,{name}_step", f"-Wl,-u,{name}_init", "-Wl,--gc-sections", "-nostartfiles"]
        specs = ["--specs=nano.specs", "--specs=nosys.specs"]
        told(name, [*target.command, *entries, *specs, "law.o", "-lm", "-o", "law.elf"], place)
        code, data, zeros = _sizes(name, place, "law.o")
        symbols = told(name, [f"{ARM}nm", "-u", "law.o"], place).split()
        frames = dict(_frames((place / "law.su").read_text(encoding="utf-8")))
        whole = sum(_sizes(name, place, "law.elf")[:2])
    calls = tuple(sorted(set(symbols) - {"U"}))
    return Footprint(code, whole, data + zeros, frames[f"{name}_step"], calls)


def footprints_of(folder: Path, name: str, real: str) -> dict[Target, Footprint]:
    """Return what an exported law needs on each processor that it fits, if there is a compiler."""
    targets = targets_for(real) if has_compiler() else []
    with ThreadPoolExecutor() as pool:
        found = [pool.submit(footprint_of, folder, name, target) for target in targets]
        return {target: each.result() for target, each in zip(targets, found, strict=True)}


def told(name: str, command: Sequence[str], place: Path) -> str:
    """Run a command; return what it says; BuildError says what is wrong."""
    try:
        run = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"{name}: {error}") from None
    if run.returncode:
        words = (run.stderr.strip().splitlines() or ["no words"])[0]
        raise BuildError(f"{name}: {command[0]} fails with code {run.returncode}: {words}")
    return run.stdout


def _sizes(name: str, place: Path, file: str) -> list[int]:
    """Return bytes of code and constants, of variables with a value, and of those without one."""
    return [int(each) for each in told(name, [f"{ARM}size", file], place).splitlines()[1].split()[:3]]


def _frames(usage: str) -> list[tuple[str, int]]:
    """Return functions with the bytes of their frames, from what gcc says."""
    rows = [line.split("\t") for line in usage.splitlines()]
    return [(where.rpartition(":")[2], int(size)) for where, size, *_ in rows]
