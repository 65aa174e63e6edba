"""The table of docs/export.md that says what exported observers cost on microcontrollers.

    python -m quadftc_tools.study.embedded_costs [--docs docs]

A closed loop flies a scenario with one fault, and the samples that its observer gets are noted. The exported
observer takes them here and under QEMU, which counts instructions and stack; the compiler tells flash. All of
it needs arm-none-eabi-gcc and qemu-system-arm. Without ``--docs`` the table is printed.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.exporting import exported_law
from quadftc_cli.screen import say
from quadftc_compile.build import BuildError
from quadftc_compile.emulation import Emulated, can_emulate, emulate
from quadftc_compile.engine import CEngine
from quadftc_compile.export import FLAGS, Exported, write_example, write_law
from quadftc_compile.footprint import Footprint, Target, footprints_of
from quadftc_compile.layout import flatten, layout_of, unflatten
from quadftc_compile.memory import Rows
from quadftc_compile.samples import write_samples
from quadftc_flight.closed_loop import loop_of
from quadftc_flight.loop import ClosedLoop
from quadftc_flight.loop_draws import LoopDraws
from quadftc_flight.scenario import Scenario, build_scenario, changed_document
from quadftc_flight.scenario.document import Keys
from quadftc_flight.scenario.files import find_scenario
from quadftc_model.composition import RunnerCalls
from quadftc_sim.assembly import sample_count
from quadftc_tools.study.numbers import write_number
from quadftc_tools.study.page import markdown, publish_tables

PAGE = "export.md"
LAWS = (  # observer, scenario, where
    ("isolating", "free_circle", "free flight"),
    ("isolating", "mems_faults", "test stand"),
    ("supervised", "mems_faults", "test stand"),
    ("sliding_mode", "mems_faults", "test stand"),
)
DURATION = 10.0  # s, of each flight
FAULT = {
    "kind": "bias",
    "channel": "attitude",
    "axes": "roll",
    "value": "3 deg",
    "start": "5 s",
    "stop": "8 s",
}
MEGAHERTZ = {"Cortex-M7": 480, "Cortex-M4F": 168}  # of an STM32H743, an STM32F405
HEADS = (
    *("observer", "where", "processor", "precision", "instructions a step: mean / most", "clock"),
    *("a step, mean / most", "flash: law / of libm / numbers", "RAM", "stack of a step"),
    "fault estimate apart from that here, at most",
)


class Samples(NamedTuple):
    """What an observer got in a flight."""

    law: Any  # guarded
    dt: NDArray[np.float64]  # (n,) [s]
    inputs: Any  # arrays (n, ...)


class Case(NamedTuple):
    """A law with its samples."""

    where: str  # it flies
    exported: Exported
    samples: Samples
    folder: Path  # for its C


class Cost(NamedTuple):
    """What a law costs on a processor."""

    case: Case
    target: Target
    footprint: Footprint
    emulated: Emulated
    apart: float  # largest difference of the fault estimates there and here [rad]


class _Noting(RunnerCalls):
    """Notes what the observer gets."""

    def __init__(self, loop: ClosedLoop) -> None:
        super().__init__(loop.laws, CEngine())
        self.dt = list[float]()
        self.inputs = list[list[Any]]()  # arrays
        self.layout: Any = None

    def step(self, name: str, state: Any, inputs: Any, dt: Any) -> tuple[Any, Any]:
        """Step a law."""
        if name == "observer":
            self.layout = layout_of(inputs)
            self.dt.append(float(dt))
            self.inputs.append([np.array(each) for each in flatten(self.layout, inputs)])
        return super().step(name, state, inputs, dt)


def fly(observer: str, name: str) -> Samples:
    """Fly the begin of a scenario with one fault; return what its observer got."""
    document = changed_document(find_scenario(name), ())
    scheme: dict[str, Any] = dict(next(iter(document.data["schemes"].values())))
    changes: dict[Keys, Any] = {
        ("faults",): [FAULT],
        ("schemes",): {"embedded": {**scheme, "observer": observer, "checks": []}},
    }
    return _noted(build_scenario(document.replaced(changes, "study of costs")))


def _noted(scenario: Scenario) -> Samples:
    loop, count = loop_of(scenario, scenario.scheme()), sample_count(DURATION, scenario.rate)
    given, calls = Rows(layout_of(LoopDraws.example(loop)), count), _Noting(loop)
    given.write(LoopDraws(loop, scenario.seed, count).next(count))
    state = loop.init(calls)
    for row in range(count):
        state, _ = loop.step(calls, state, given.row(row))
    columns = (np.stack(each) for each in zip(*calls.inputs, strict=True))
    return Samples(loop.observer, np.array(calls.dt), unflatten(calls.layout, columns))


def costs_of(case: Case) -> list[Cost]:
    """Run a law here and on each processor whose hardware has its precision."""
    exported, folder, samples = case.exported, case.folder, case.samples
    write_law(exported, folder)
    write_example(exported, folder)
    file = folder / "samples.csv"
    write_samples(file, exported.layouts["inputs"], samples.dt, samples.inputs)
    here = _faults(_run_here(folder, file))
    costs: list[Cost] = []
    for target, footprint in footprints_of(folder, exported.name, exported.real).items():
        emulated = emulate(folder, exported.name, target, file)
        apart = float(np.max(np.abs(_faults(emulated.said) - here)))
        costs.append(Cost(case, target, footprint, emulated, apart))
    return costs


def _run_here(folder: Path, samples: Path) -> str:
    sources = sorted(str(each) for each in folder.glob("*.c"))
    program = str(folder / "example")
    subprocess.run(["cc", "-std=c99", *FLAGS, *sources, "-lm", "-o", program], check=True)
    return subprocess.run([program, samples], check=True, capture_output=True, text=True).stdout


def _faults(said: str) -> NDArray[np.float64]:
    """Return the fault estimates (n, 3) of what an example says [rad]."""
    head, *lines = said.splitlines()
    names = head.split(",")
    columns = [names.index(f"said.fault[{axis}]") for axis in range(3)]
    return np.array([[float(line.split(",")[k]) for k in columns] for line in lines])


def make() -> dict[str, str]:
    """Return the table."""
    with tempfile.TemporaryDirectory(prefix="quadftc_") as scratch, ThreadPoolExecutor() as pool:
        cases: list[Case] = []
        for observer, name, where in LAWS:
            samples = fly(observer, name)
            for real in ("double", "float"):
                exported = exported_law(observer, samples.law, real)
                cases.append(Case(where, exported, samples, Path(scratch) / str(len(cases))))
        costs = [cost for costs in pool.map(costs_of, cases) for cost in costs]
    return {"embedded-costs": markdown(HEADS, map(_row, costs))}


def _row(cost: Cost) -> list[str]:
    case, target, footprint, emulated, apart = cost
    exported = case.exported
    clock = MEGAHERTZ[target.name]
    counts = (emulated.instructions, emulated.most_instructions)
    ram = 2 * exported.bytes_of("state") + exported.bytes_of("inputs") + exported.bytes_of("output")
    flash = (footprint.flash, footprint.flash_with_libm - footprint.flash, exported.bytes_of("numbers"))
    return [
        *(exported.name, case.where, target.name, exported.real, _thousands(counts), f"{clock} MHz"),
        f"{' / '.join(write_number(each / clock) for each in counts)} us",
        f"{' / '.join(_kib(each) for each in flash)} KiB",
        *(f"{_kib(each)} KiB" for each in (ram, emulated.stack)),
        f"{write_number(float(np.degrees(apart)))} deg",
    ]


def _thousands(counts: Iterable[float]) -> str:
    return " / ".join(f"{write_number(each / 1e3)} k" for each in counts)


def _kib(count: int) -> str:
    return f"{count / 1024:.1f}"


def main() -> int:
    """Write the table into the page, or print it."""
    parser = argparse.ArgumentParser(
        prog="embedded_costs", description=f"Table of costs on microcontrollers in docs/{PAGE}."
    )
    parser.add_argument("--docs", type=Path, help=f"directory of {PAGE}")
    options = parser.parse_args()
    if not can_emulate():
        say("error: arm-none-eabi-gcc and qemu-system-arm are not installed", stderr=True)
        return BAD_INPUT
    try:
        publish_tables(make(), options.docs and options.docs / PAGE)
    except (BuildError, ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT
    return GOOD


if __name__ == "__main__":
    raise SystemExit(main())
