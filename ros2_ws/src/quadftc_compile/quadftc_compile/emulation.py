"""An exported law on an emulated microcontroller: what it says, instructions and stack of each step.

QEMU runs the example with the samples, counts its instructions (``-icount``), and shows them in the SysTick
timer, which a wrapper around the step reads (`emulated/meter.c`). What is counted are instructions, not
cycles: caches, memory and the time that a division takes are not emulated.
"""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from quadftc_compile.build import BuildError
from quadftc_compile.export import FLAGS
from quadftc_compile.footprint import Target, has_compiler, told

PARTS = Path(__file__).parent / "emulated"
EMULATOR = "qemu-system-arm"
COUNTED = ("-icount", "shift=6")  # 64 ns an instruction, where SysTick ticks each 40 ns
QUIET = ("-nographic", "-monitor", "none", "-serial", "none")
FILES = ("-semihosting-config", "enable=on,target=native")  # standard input and output are the emulator's
LOOP = 3 * 300_000  # instructions of the loop that is measured first
CALLS = 1000  # of a step that does nothing


@dataclasses.dataclass(frozen=True)
class Emulated:
    """What became of the samples."""

    said: str  # CSV
    steps: int
    instructions: float  # of a step, libm included, on average
    most_instructions: float  # of the longest step
    stack: int  # bytes of the deepest step, libm included


def can_emulate() -> bool:
    """Whether compiler and emulator are there."""
    return has_compiler() and shutil.which(EMULATOR) is not None


def emulate(folder: Path, name: str, target: Target, samples: Path, sources: Sequence[Path] = ()) -> Emulated:
    """Run the example of an exported law on samples; ``sources`` are more files in C.

    BuildError says what went wrong.
    """
    with tempfile.TemporaryDirectory(prefix="quadftc_") as scratch:
        program = Path(scratch) / f"{name}.elf"
        _build(folder, name, target, program, sources)
        command = [EMULATOR, "-M", target.board, *QUIET, *FILES, *COUNTED, "-kernel", str(program)]
        with samples.open("rb") as given:
            run = subprocess.run(command, stdin=given, capture_output=True, text=True, check=False)
    found = re.search(r"^meter: (.*)$", run.stderr, re.M)
    if run.returncode or found is None:
        raise BuildError(f"{name}: {EMULATOR} ends with code {run.returncode}: {run.stderr.strip()[-200:]}")
    meter = {key: int(value) for key, value in re.findall(r"(\w+)=(\d+)", found[1])}
    instructions, steps = LOOP / meter["loop_ticks"], meter["steps"]
    call = meter["call_ticks"] / CALLS
    return Emulated(
        said=run.stdout,
        steps=steps,
        instructions=instructions * (meter["ticks"] / steps - call),
        most_instructions=instructions * (meter["most_ticks"] - call),
        stack=meter["stack"],
    )


def _build(folder: Path, name: str, target: Target, program: Path, sources: Sequence[Path]) -> None:
    """Link the example with start, meter and C library for an emulated board."""
    start = told(name, [*target.command, "-print-file-name=rdimon-crt0.o"], folder).strip()
    files = [PARTS / "startup.c", PARTS / "meter.c", *sorted(folder.glob("*.c")), *sources]
    step = f"{name}_step"
    command = [
        *(*target.command, "-std=gnu99", *FLAGS, f"-DMETERED={step}"),
        *("--specs=rdimon.specs", "-nostartfiles", "-T", str(PARTS / "mps2.ld")),
        *("-Wl,--gc-sections", f"-Wl,--wrap={step}", *(str(each.resolve()) for each in files), start),
        *("-lm", "-o", str(program)),
    ]
    told(name, command, folder)
