"""Licences of all locked packages; and of some made up, in the places where packages say theirs."""

import importlib.metadata
import subprocess
from pathlib import Path

import licences
import pytest
from licences import judge_licences

ROOT = Path(__file__).parents[1]


def test_every_locked_package_may_be_used():
    command = ["bash", "-c", ". scripts/lib/common.sh; lock_file"]
    lock = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    assert judge_licences((ROOT / lock).read_text(encoding="utf-8")) == []


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a package with the given lines of metadata where it is looked for; no exception is known."""
    monkeypatch.setattr(
        licences, "distribution", lambda name: importlib.metadata.PathDistribution(folder(tmp_path, name))
    )
    monkeypatch.setattr(licences, "EXCEPTIONS", {})

    def write(name, *lines, files=None):
        folder(tmp_path, name).mkdir()
        metadata = "\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1.0", *lines, "", ""])
        (folder(tmp_path, name) / "METADATA").write_text(metadata)
        for path, text in (files or {}).items():
            (tmp_path / path).parent.mkdir(exist_ok=True)
            (tmp_path / path).write_text(text)
        (folder(tmp_path, name) / "RECORD").write_text("".join(f"{path},,\n" for path in files or {}))

    return write


def folder(site, name):
    return site / f"{name}-1.0.dist-info"


@pytest.mark.parametrize(
    ("line", "accepted"),
    [
        ("License-Expression: MIT", True),
        ("License-Expression: MPL-2.0 AND (GPL-3.0-only OR MIT)", True),
        ("License-Expression: GPL-2.0 AND BSD-3-Clause", False),
        ("License: BSD-3-Clause", True),
        ("License: GPLv2", False),
        ("Classifier: License :: OSI Approved :: MIT License", True),
        ("Classifier: License :: OSI Approved :: GNU Lesser General Public License v3 (LGPLv3)", False),
    ],
)
def test_a_licence_is_found_where_a_package_states_it(install, line, accepted):
    install("thing", line)
    assert (judge_licences("thing==1.0 \\\n") == []) is accepted


def test_a_ros_wheel_states_its_licence_in_its_manifest(install):
    install("thing", files={"thing/package.xml": "<license>Apache License 2.0</license>"})
    install("other", files={"other/package.xml": "<license>GPL-3.0</license>"})
    assert judge_licences("thing==1.0\nother==1.0\n") == ["other: GPL-3.0; expected one of ACCEPTED"]


def test_a_package_that_says_nothing_is_named(install):
    install("thing", files={"thing.py": ""})
    assert judge_licences("thing==1.0\n") == ["thing: no licence said; expected one of ACCEPTED"]


def test_an_exception_without_need_is_named(install, monkeypatch):
    install("thing", "License: MIT")
    monkeypatch.setattr(licences, "EXCEPTIONS", {"thing": "once needed"})
    assert judge_licences("thing==1.0\n") == ["thing: needs no exception any more"]


def test_a_locked_package_must_be_there_unless_it_is_for_another_python(monkeypatch):
    monkeypatch.setattr(licences, "EXCEPTIONS", {})
    lock = "nowhere-a==1.0 \\\nnowhere-b==1.0 ; python_full_version < '3.11' \\\n"
    assert judge_licences(lock) == ["nowhere-a: locked, but not installed; call scripts/setup"]
