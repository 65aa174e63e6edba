"""Registries find their own files, and say what there is."""

import importlib
import importlib.metadata
import sys

import pytest

from quadftc_model.registry import Registry


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """A registry over a package of its own with one component in it."""
    package = tmp_path / "registry_under_test"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "base.py").write_text(
        "from quadftc_model.registry import Registry\n"
        "things = Registry('thing', 'registry_under_test.parts', 'quadftc.test_things')\n"
    )
    (package / "parts").mkdir()
    (package / "parts" / "__init__.py").write_text("")
    (package / "parts" / "one.py").write_text(
        "from registry_under_test.base import things\n\n@things.register('wheel')\nclass Wheel:\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield package
    for name in [name for name in sys.modules if name.startswith("registry_under_test")]:
        del sys.modules[name]


def things(_package):
    return importlib.import_module("registry_under_test.base").things


class Outside:
    """A component of another package."""


def test_file_in_the_package_is_found(empty):
    assert things(empty).names() == ("wheel",)


def test_entry_point_of_the_group_is_found(empty, monkeypatch):
    class Entry:
        name = "outside"

        def load(self):
            return Outside

    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [Entry()])
    assert things(empty).get("outside") is Outside


def test_unknown_name_is_refused_with_the_nearest_and_all_names(empty):
    with pytest.raises(ValueError, match=r"no thing 'weel' \(did you mean 'wheel'\?\); there are: wheel"):
        things(empty).get("weel")


def test_second_class_of_a_name_is_refused():
    registry = Registry("thing", "nowhere", "quadftc.test_things")
    registry.register("a")(type("Same", (), {"__module__": "first"}))
    with pytest.raises(ValueError, match="thing 'a': registered twice"):
        registry.register("a")(type("Same", (), {"__module__": "second"}))


def test_broken_file_is_reported_on_every_look_up(empty):
    (empty / "parts" / "two.py").write_text("import no_such_module_anywhere\n")
    registry = things(empty)
    for _ in range(2):
        with pytest.raises(ModuleNotFoundError, match="no_such_module_anywhere"):
            registry.names()
