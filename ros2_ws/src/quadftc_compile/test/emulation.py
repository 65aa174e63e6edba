"""The example of an exported law on an emulated microcontroller: QEMU runs it with samples."""

import shutil
import subprocess
from pathlib import Path

from footprint import CORTEX_M4F, CORTEX_M7, has_compiler, told

from quadftc_compile.export import FLAGS

PARTS = Path(__file__).parent / "emulated"
BOARDS = {CORTEX_M7: "mps2-an500", CORTEX_M4F: "mps2-an386"}
EMULATOR = "qemu-system-arm"
QUIET = ("-nographic", "-monitor", "none", "-serial", "none")
FILES = ("-semihosting-config", "enable=on,target=native")  # standard input and output are the emulator's


def can_emulate():
    """Whether compiler and emulator are there."""
    return has_compiler() and shutil.which(EMULATOR) is not None


def emulate(folder, name, target, samples, scratch, sources=()):
    """Run the example on samples; ``sources`` are more files in C."""
    program = scratch / f"{name}.elf"
    start = told(name, [*target.command, "-print-file-name=rdimon-crt0.o"], folder).strip()
    files = [PARTS / "startup.c", *sorted(folder.glob("*.c")), *sources]
    command = [
        *(*target.command, "-std=gnu99", *FLAGS, "--specs=rdimon.specs", "-nostartfiles"),
        *("-T", str(PARTS / "mps2.ld"), "-Wl,--gc-sections", *(str(each.resolve()) for each in files), start),
        *("-lm", "-o", str(program)),
    ]
    told(name, command, folder)
    run = [EMULATOR, "-M", BOARDS[target], *QUIET, *FILES, "-kernel", str(program)]
    with samples.open("rb") as given:
        return subprocess.run(run, stdin=given, capture_output=True, text=True, check=False)
