"""quadftc new: packages that build, register their law and fly."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from quadftc_cli import new_package
from quadftc_cli.new_package import KINDS, PACKAGE, write_package
from quadftc_control.controller import controllers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.samples import AttitudeReference, ControllerInputs, FaultObserverInputs, level_sample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.fault import FaultInputs, faults
from quadftc_sim.injection import make_injection


@pytest.fixture
def made(tmp_path, monkeypatch):
    """The modules of new packages, of each kind, imported."""

    def make(kind):
        name = f"brand_new_{kind}"
        write_package(kind, name, tmp_path)
        monkeypatch.syspath_prepend(tmp_path / name)
        importlib.import_module(f"{name}.{name}")
        return name

    yield make
    for registry in (controllers, fault_observers, faults):
        for name in [each for each in registry._components if each.startswith("brand_new_")]:
            del registry._components[name]


@pytest.mark.parametrize("kind", KINDS)
def test_no_name_of_the_example_is_left(kind, tmp_path):
    written = write_package(kind, f"brand_new_{kind}", tmp_path)
    names = re.compile(rf"{PACKAGE}|\b({KINDS['observer'].named}|{KINDS[kind].named})", re.IGNORECASE)
    assert [file for file in written if names.search(file.read_text())] == []
    about = ET.parse(tmp_path / f"brand_new_{kind}" / "package.xml").findtext("description")
    assert about == f"{KINDS[kind].what} for quadftc in a package of its own."


def test_observer_names_a_step_of_the_attitude(made):
    law = fault_observers.get(made("observer"))(vehicle=load_vehicle("qball_x4"))
    healthy = FaultObserverInputs(level_sample(), np.zeros(3))
    state, estimate = law.step(law.init(healthy), healthy, 0.0)
    turned = level_sample()._replace(q_xyzw=np.array([np.sin(0.05), 0.0, 0.0, np.cos(0.05)]))
    state, estimate = law.step(state, healthy._replace(imu=turned), 0.004)
    assert estimate.fault[0] == pytest.approx(0.1, rel=1e-3)
    assert estimate.state.tolist() == [3, 1, 1]


def test_controller_turns_back(made):
    law = controllers.get(made("controller"))(vehicle=load_vehicle("qball_x4"))
    turned = level_sample()._replace(q_xyzw=np.array([np.sin(0.05), 0.0, 0.0, np.cos(0.05)]))
    inputs = ControllerInputs(turned, AttitudeReference(*np.zeros((3, 3))), np.zeros(3))
    output = law.step(law.init(inputs), inputs, 0.0)[1]
    assert output.error[0] == pytest.approx(0.1)
    assert output.torque[0] < 0.0


def test_fault_comes_and_goes(made):
    injection = make_injection(made("fault"), {"axes": "x", "size": "2 deg", "period": "1 s"})
    zeros = np.zeros(3)
    sizes = [
        injection.law.step((), FaultInputs(zeros, np.array(time), zeros, zeros), 0.004)[1].value[0]
        for time in (0.1, 0.6, 1.1)
    ]
    assert sizes == pytest.approx([np.radians(2.0), 0.0, np.radians(2.0)])


@pytest.mark.parametrize("kind", KINDS)
def test_package_registers_its_law_by_an_entry_point(tmp_path, kind):
    write_package(kind, "my_part", tmp_path)
    package = ET.parse(tmp_path / "my_part" / "package.xml").getroot()
    assert package.findall("exec_depend")[0].text == KINDS[kind].depends
    command = [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", str(tmp_path)]
    subprocess.run(command, cwd=tmp_path / "my_part", check=True, capture_output=True)
    entry = (tmp_path / "my_part.egg-info" / "entry_points.txt").read_text(encoding="utf-8")
    assert entry == f"[{KINDS[kind].group}]\nmy_part = my_part.my_part:MyPart\n"


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("observer", "isolating", "exists already, see quadftc list observers"),
        ("observer", "numpy", "numpy: Python has a package of that name already"),
        ("observer", "My", "small letters"),
        ("observer", "class", "small letters"),
        ("plant", "mine", "expected one of observer, controller, fault"),
    ],
)
def test_name_that_cannot_be_used_is_refused(tmp_path, kind, name, words):
    with pytest.raises(ValueError, match=words):
        write_package(kind, name, tmp_path)


def test_directory_that_exists_is_left_alone(tmp_path):
    (tmp_path / "mine").mkdir()
    with pytest.raises(ValueError, match="exists"):
        write_package("fault", "mine", tmp_path)


def test_installation_without_the_examples_is_told_how_to_have_them(tmp_path, monkeypatch):
    monkeypatch.setattr(new_package, "__file__", str(tmp_path / "new_package.py"))
    with pytest.raises(ValueError, match="--symlink-install"):
        write_package("fault", "mine", tmp_path)
    assert not (tmp_path / "mine").exists()
