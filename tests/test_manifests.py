"""Manifests name what is imported: package.xml for ROS, pyproject.toml for the wheel, and nothing else."""

import ast
import re
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(path.parent for path in ROOT.glob("ros2_ws/src/*/setup.py"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"].values()
NEEDED = [*PROJECT["project"]["dependencies"], *(each for extra in EXTRAS for each in extra)]
WHEEL = {re.split(r"[><=;]", each)[0].strip() for each in NEEDED}  # what the wheel installs, with all extras
ROSDEP = {"numpy": "python3-numpy", "scipy": "python3-scipy", "yaml": "python3-yaml"}
# what has no key in rosdep, or an older version there, comes with the wheel; PyPI calls it otherwise
DISTRIBUTIONS = {
    "pydantic_core": "pydantic",
    "ruamel": "ruamel.yaml",
    "typing_extensions": "pydantic",  # it needs it
    "yaml": "pyyaml",
}

# what rosdep can install: rosdep/python.yaml and jazzy/distribution.yaml of ros/rosdistro, on 2026-08-22
KNOWN_TO_ROSDEP = {
    *(
        "ament_cmake",
        "ament_index_python",
        "builtin_interfaces",
        "diagnostic_aggregator",
        "diagnostic_msgs",
        "geometry_msgs",
        "launch",
        "lifecycle_msgs",
    ),
    *("launch_ros", "nav_msgs", "rcl_interfaces", "rclpy", "ros2service", "rosgraph_msgs", "sensor_msgs"),
    *(
        "rosidl_default_generators",
        "rosidl_default_runtime",
        "std_msgs",
        "std_srvs",
        "tf2_msgs",
        "visualization_msgs",
    ),
    *(f"python3-{name}" for name in ("hypothesis", "numpy", "pytest", "ruamel.yaml", "scipy", "yaml")),
}


class RunTime(ast.NodeTransformer):
    """Drops what only a type checker reads."""

    def visit_If(self, node):
        is_for_types = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return node.orelse if is_for_types else self.generic_visit(node)


def imported_by(package, folder=""):
    """Top-level names that the modules of a package, or of another folder of it, import when they run."""
    names = set()
    for file in (package / (folder or package.name)).rglob("*.py"):
        for node in ast.walk(RunTime().visit(ast.parse(file.read_text(encoding="utf-8")))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(str(node.module).partition(".")[0])
    return names - sys.stdlib_module_names - {package.name, "tomllib"}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_manifest_names_what_the_package_imports(package):
    manifest = (package / "package.xml").read_text(encoding="utf-8")
    keys = set(re.findall(r"<exec_depend>(.*)</exec_depend>", manifest))
    imports = imported_by(package)
    ours_and_ros = {name for name in imports if name.startswith("quadftc_") or name in keys}
    wanted = ours_and_ros | {ROSDEP[name] for name in imports if name in ROSDEP}
    assert wanted - keys == set()
    assert {DISTRIBUTIONS.get(name, name) for name in imports - ours_and_ros} <= WHEEL
    # messages may be named in a table, nodes in a launch file
    unused = {key for key in keys if not key.endswith(("_msgs", "_srvs", "_interfaces"))} - wanted
    launched = "".join(file.read_text(encoding="utf-8") for file in package.glob("launch/*.py"))
    assert {key for key in unused - {"ros2service"} if key not in launched} == set()


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_manifest_names_the_parts_of_ros_that_tests_import(package):
    manifest = (package / "package.xml").read_text(encoding="utf-8")
    keys = set(re.findall(r"<(?:exec|test)_depend>(.*)</(?:exec|test)_depend>", manifest))
    imports = {name for name in imported_by(package, "test") if name in KNOWN_TO_ROSDEP}
    assert imports - keys - {"launch", "launch_ros"} == set(), "of these the tests are skipped"


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_setup_says_of_the_package_what_its_manifest_says(package):
    """Name, version, description, licence and maintainer."""
    call = ast.parse((package / "setup.py").read_text(encoding="utf-8")).body[-1].value
    given = {each.arg: each.value for each in call.keywords}
    manifest = ET.parse(package / "package.xml").getroot()
    for field in ("version", "description", "license", "maintainer"):
        assert ast.literal_eval(given[field]) == manifest.findtext(field)
    assert ast.literal_eval(given["maintainer_email"]) == manifest.find("maintainer").get("email")
    scripts = f"$base/lib/{package.name}"
    lines = (package / "setup.cfg").read_text(encoding="utf-8").split()
    assert lines == ["[develop]", f"script_dir={scripts}", "[install]", f"install_scripts={scripts}"]


@pytest.mark.parametrize(
    "manifest", sorted(PACKAGES[0].parent.glob("*/package.xml")), ids=lambda file: file.parent.name
)
def test_manifest_names_only_keys_that_rosdep_knows(manifest):
    """Another key: look it up there, then add it above; what has none is named in the comment of PyPI."""
    keys = {str(each.text) for each in ET.parse(manifest).getroot() if each.tag.endswith("depend")}
    assert {key for key in keys if not key.startswith("quadftc_")} <= KNOWN_TO_ROSDEP


def test_wheel_holds_every_package_that_does_without_ros_and_needs_what_they_import():
    targets = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    here = [f"ros2_ws/src/{package.name}/{package.name}" for package in PACKAGES]
    assert targets["packages"] == [each for each in here if "bringup" not in each]
    assert all((ROOT / source).exists() for source in targets["force-include"])
    imports = set().union(*map(imported_by, PACKAGES)) | {"tomli"}
    assert {DISTRIBUTIONS.get(name, name) for name in imports} >= WHEEL
