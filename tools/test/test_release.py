"""What scripts/release writes is what package.xml takes; what nobody answers for is refused."""

import shutil
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

from quadftc_tools.release import main

ROOT = Path(__file__).parents[2]
WHO = {"maintainer": "Ada Byron", "email": "ada@engines.org", "url": "https://code.engines.org/ada/quadftc"}


@pytest.fixture
def clone(tmp_path):
    for file in (*ROOT.glob("ros2_ws/src/*/package.xml"), *ROOT.glob("ros2_ws/src/*/setup.py")):
        (tmp_path / file.relative_to(ROOT)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, tmp_path / file.relative_to(ROOT))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def release(clone, **changes):
    given = {**WHO, "root": str(clone), "version": "0.2.0", **changes}
    return main([word for name, value in given.items() for word in (f"--{name}", value)])


def test_every_package_says_who_and_where(clone):
    assert release(clone) == 0
    assert release(clone) == 0  # a second time changes nothing
    manifests = sorted(clone.glob("ros2_ws/src/*/package.xml"))
    assert len(manifests) > 10
    for file in manifests:
        package = parse_package(file)
        assert (package.version, package.maintainers[0].email) == ("0.2.0", WHO["email"])
        assert {each.type: each.url for each in package.urls}["repository"] == WHO["url"]
        assert len(package.urls) == 2
    assert (clone / "pyproject.toml").read_text().count(WHO["url"]) == 2


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("email", "ada@engines.example"),
        ("url", "http://x"),
        ("url", "https://example.com/a/b"),
        ("version", "1"),
    ],
)
def test_an_example_or_a_malformed_word_is_refused_and_nothing_written(clone, capsys, name, value):
    assert release(clone, **{name: value}) == 2
    assert f"--{name} {value!r}" in capsys.readouterr().err
    assert WHO["maintainer"] not in (clone / "pyproject.toml").read_text()
