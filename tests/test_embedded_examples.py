"""The embedded examples fit what is exported, and the published signatures of what they run on.

Firmware and rclcpp are not here: headers of `examples/embedded/test/stand_ins` stand in for theirs.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from footprint import CORTEX_M4F, CORTEX_M7, footprint_of, has_compiler

from quadftc_cli.exporting import exported_law, guarded_law
from quadftc_compile.export import write_law
from quadftc_model.rotations import to_earth

EMBEDDED = Path(__file__).resolve().parents[1] / "examples" / "embedded"
STAND_INS = EMBEDDED / "test" / "stand_ins"
INCLUDE = Path(sys.prefix) / "include"
WARNINGS = ("-Wall", "-Wextra", "-Wno-unused-parameter", "-Wdouble-promotion", "-Werror")
# example: sources, what they run, the vehicle, in which precision, language and warnings
EXAMPLES = {
    "crazyflie": ("crazyflie/src/diagnosis.c", "supervised", "crazyflie_2x", "float", "gnu11"),
    "px4": ("px4/quadftc_diagnosis/quadftc_diagnosis.cpp", "isolating", "x500", "float", "gnu++14"),
    "rclcpp": ("rclcpp/src/observer_component.cpp", "isolating", "qball_x4", "double", "c++17"),
}
# where an example says how much stack it gets, in which unit [bytes], and on which processor
STACKS = {
    "crazyflie": ("crazyflie/app-config", r"STACKSIZE=(\d+)", 4, CORTEX_M4F),
    "px4": ("px4/quadftc_diagnosis/quadftc_diagnosis.cpp", r"STACK = (\d+)", 1, CORTEX_M7),
}
FRAMES = """
#include <cstdio>
#include "frames.hpp"

int main()
{
    float q[4], v[3], turned[4], flipped[3];
    while (scanf("%f %f %f %f %f %f %f", q, q + 1, q + 2, q + 3, v, v + 1, v + 2) == 7) {
        quadftc::enu_from_ned(q, turned);
        quadftc::flu_from_frd(v, flipped);
        for (float each : turned) printf("%.9g ", each);
        for (float each : flipped) printf("%.9g ", each);
        printf("\\n");
    }
    return 0;
}
"""


def compiler_for(standard: str, name: str) -> list[str]:
    """Return the command of a compiler; of a Cortex-M4F for the Crazyflie if it is there."""
    if name == "crazyflie" and has_compiler():
        return CORTEX_M4F.command
    return ["c++" if "++" in standard else "cc"]


@pytest.mark.thorough
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_compiles_against_published_signatures(name, tmp_path):
    pytest.importorskip("jax")
    source, law, vehicle, real, standard = EXAMPLES[name]
    if name == "rclcpp" and not (INCLUDE / "sensor_msgs").exists():
        pytest.skip("there are no headers of messages")
    exported = exported_law(law, guarded_law(law, vehicle), real)
    write_law(exported, tmp_path / law)
    messages = INCLUDE.glob("*") if name == "rclcpp" else ()
    includes = [f"-I{tmp_path}", f"-I{STAND_INS / name}", *(f"-isystem{each}" for each in messages)]
    command = [*compiler_for(standard, name), f"-std={standard}", *WARNINGS, *includes]
    done = subprocess.run(
        [*command, "-fsyntax-only", str(EMBEDDED / source)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    if name in STACKS and has_compiler():
        file, pattern, unit, target = STACKS[name]
        found = re.search(pattern, (EMBEDDED / file).read_text(encoding="utf-8"))
        given, needed = unit * int(found[1]), footprint_of(tmp_path / law, law, target).stack
        assert needed + 1024 < given < needed + 8192  # libm and the task itself


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no compiler for C++")
def test_frames_of_px4_become_those_of_quadftc(tmp_path):
    (tmp_path / "frames.cpp").write_text(FRAMES)
    include = f"-I{EMBEDDED / 'px4' / 'quadftc_diagnosis'}"
    subprocess.run(["c++", include, "frames.cpp", "-o", "frames"], cwd=tmp_path, check=True)
    random = np.random.default_rng(1)
    attitudes, vectors = random.normal(size=(20, 4)), random.normal(size=(20, 3))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    given = np.concatenate([attitudes, vectors], axis=1)
    text = "\n".join(" ".join(map(repr, row)) for row in given.tolist())
    said = subprocess.run(
        [tmp_path / "frames"], input=text, capture_output=True, text=True, check=True
    ).stdout
    found = np.array([line.split() for line in said.splitlines()], float)
    ned = to_earth(np.roll(attitudes, -1, axis=1), vectors)  # w, x, y, z becomes x, y, z, w
    enu = to_earth(found[:, :4], found[:, 4:])
    assert len(found) == 20
    np.testing.assert_allclose(enu, ned[:, [1, 0, 2]] * [1, 1, -1], atol=1e-6)
