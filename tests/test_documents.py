"""What the documents say is true: links lead somewhere, and the controller of CONTRIBUTING flies."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]

FLY = """
import numpy as np
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import find_scenario, load_scenario, with_components, with_duration

scenario = with_duration(load_scenario(find_scenario("paper_faults")), 8.0)
flight = fly(with_components(scenario, controller="pd"), "proposed")
print(np.degrees(np.abs(flight.angles - flight.reference)).max(), np.degrees(np.abs(flight.reference)).max())
"""


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_of_a_document_lead_somewhere(document: Path):
    links = re.findall(r"\]\((?!https?://)([^)#]+)", document.read_text(encoding="utf-8"))
    missing = [link for link in links if not (document.parent / link).exists()]
    assert not missing


def test_every_package_is_in_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    packages = [path.parent.name for path in (ROOT / "ros2_ws" / "src").glob("*/package.xml")]
    assert len(packages) == 16
    table = readme.partition("| package | what is in it |")[2].partition("\n\n")[0]
    assert [name for name in packages if f"`{name}`" not in table] == []


def test_modules_that_the_readme_of_a_package_names_exist():
    there = {path.name for folder in ("ros2_ws/src", "scripts") for path in (ROOT / folder).rglob("*.py")}
    named = {
        (path.parent.name, module)
        for path in (ROOT / "ros2_ws" / "src").glob("*/README.md")
        for module in re.findall(r"`(?:[\w-]+/)*([\w-]+\.py)`", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 100
    assert [each for each in sorted(named) if each[1] not in there] == []


def test_scripts_that_documents_name_exist():
    text = "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
    named = set(re.findall(r"\bscripts/[\w./]*\w", text))
    assert {"scripts/demo", "scripts/test", "scripts/setup"} <= named
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_documents_with_the_command_ros2_say_what_to_type_without_it():
    nodes: set[str] = set()
    for document in (ROOT / "docs").glob("*.md"):
        text = document.read_text(encoding="utf-8")
        if re.search(r"^ros2 (run|launch) ", text, re.MULTILINE):
            assert "Without the `ros2` command" in text, document.name
            nodes.update(re.findall(r"ros2_ws/install/[\w/]+", text))
    assert len(nodes) >= 3
    assert [name for name in nodes if not os.access(ROOT / name, os.X_OK)] == []


def test_controller_of_contributing_flies_when_pasted_into_a_file(tmp_path: Path):
    blocks = re.findall(
        r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.DOTALL
    )
    (code,) = [block for block in blocks if '@register("pd")' in block]
    (tmp_path / "pd.py").write_text(code, encoding="utf-8")
    (tmp_path / "fly.py").write_text("import pd\n" + FLY, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(tmp_path / "fly.py")], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    error, reference = map(float, done.stdout.split())
    assert reference > 1.0  # it had somewhere to go
    assert error < 0.2 * reference
