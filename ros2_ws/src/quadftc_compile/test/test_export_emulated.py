"""An exported law on emulated microcontrollers gives the numbers that it gives here.

A machine without arm-none-eabi-gcc and qemu-system-arm leaves these tests out.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from footprint import CORTEX_M4F, CORTEX_M7, footprint_of, footprints_of

pytest.importorskip("jax")
sys.path.insert(0, str(Path(__file__).parent))
from emulation import can_emulate, emulate
from exported_laws import COUNT, built, exported_waves, run, table_of, wave_samples, write_inputs, written

pytestmark = pytest.mark.skipif(not can_emulate(), reason="there is no compiler or emulator for Cortex-M")
LIBM = Path(__file__).parent / "shared_libm.c"
DOUBLES = re.compile(r"__aeabi_(?:d\w+|\w+2d)$|\w+df\d?$")  # arithmetic in double without hardware
CASES = [
    ("double", CORTEX_M7),
    pytest.param(("float", CORTEX_M7), marks=pytest.mark.thorough),
    ("float", CORTEX_M4F),
]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[1].name}-{case[0]}")
def case(request, tmp_path_factory):
    """Return a law with samples for a processor: its folder, and what is exported."""
    real, target = request.param
    exported = exported_waves(real)
    folder = written(exported, tmp_path_factory.mktemp("law"))
    samples = write_inputs(exported, folder / "samples.csv", *wave_samples())
    return exported, target, folder, samples


def test_a_microcontroller_gives_the_bits_of_this_machine_with_the_same_libm(case, tmp_path):
    exported, target, folder, samples = case
    libm = tmp_path / "shared_libm.c"
    single = "#define SINGLE\n" if exported.real == "float" else ""
    libm.write_text(single + LIBM.read_text(encoding="utf-8"), encoding="utf-8")
    told = run(built(exported, folder, "-fno-builtin", str(libm)), samples)  # or there is a sincos of its own
    assert told.returncode == 0, told.stderr
    assert emulate(folder, exported.name, target, samples, tmp_path, [libm]).stdout == told.stdout


def test_with_its_own_libm_a_microcontroller_differs_by_rounding(case, tmp_path):
    exported, target, folder, samples = case
    here = table_of(run(built(exported, folder), samples).stdout)
    there = table_of(emulate(folder, exported.name, target, samples, tmp_path).stdout)
    assert here.shape == (COUNT, 4)
    tolerance = 1e-13 if exported.real == "double" else 1e-5
    np.testing.assert_allclose(there, here, rtol=tolerance, atol=tolerance * np.abs(here).max())


def test_float_hides_no_double(case):
    exported, target, folder, _ = case
    footprint = footprint_of(folder, exported.name, target)
    assert not list(filter(DOUBLES.match, footprint.calls))
    taken = ("asin", "atan2", "cos", "exp", "log", "sin", "tan")
    suffix = "f" if exported.real == "float" else ""
    assert {*footprint.calls} - {"memcpy", "memset"} == {f"{each}{suffix}" for each in taken}
    assert footprint.variables == 0
    assert 0 < footprint.flash < footprint.flash_with_libm < footprint.flash + 20000


def test_double_without_hardware_is_noticed(tmp_path):
    exported = exported_waves("double")
    calls = footprint_of(written(exported, tmp_path), exported.name, CORTEX_M4F).calls
    assert list(filter(DOUBLES.match, calls))


def test_each_precision_is_measured_where_hardware_has_it(tmp_path):
    exported = exported_waves("double")
    assert [*footprints_of(written(exported, tmp_path / "d"), exported.name, "double")] == [CORTEX_M7]
    exported = exported_waves("float")
    both = footprints_of(written(exported, tmp_path / "f"), exported.name, "float")
    assert [*both] == [CORTEX_M7, CORTEX_M4F]


def test_an_example_that_fails_there_says_why(case, tmp_path):
    exported, target, folder, _ = case
    (tmp_path / "bad.csv").write_text("dt\n")
    told = emulate(folder, exported.name, target, tmp_path / "bad.csv", tmp_path)
    assert told.returncode == 1
    assert re.search(r"standard input:1: expected .* columns, found 1", told.stderr)
