"""Checks from the command line, and what became of them as JUnit XML."""

import errno
import re
import resource
from xml.etree import ElementTree as ET

import pytest

from quadftc_flight.checks import check_results, parse_check
from quadftc_flight.junit import Case, check_cases, write_file, write_junit

METRICS = {"lost": False, "missed": 2, "rmse": {"roll": 0.1, "pitch": 0.3, "yaw": None}}


def test_checks_are_held_on_each_axis():
    checks = map(parse_check, ("rmse axis=roll below=0.2", "missed above=-1 below=2", "rmse below=0.2"))
    results = check_results(METRICS, checks)
    assert [(each.metric, each.axis, each.passed) for each in results] == [
        ("rmse", "roll", True),
        ("missed", None, False),
        ("rmse", "roll", True),
        ("rmse", "pitch", False),
        ("rmse", "yaw", False),  # no value
    ]


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("rmse", "check 'rmse': expected 'above' or 'below', or both"),
        ("rmse below=x", "check 'rmse below=x': expected numbers as above and below"),
        ("rmse axis=rol below=1", "check 'rmse axis=rol below=1': axis: Input should be 'roll'"),
        ("rmse above=2 below=1", "above = 2: must be less than below = 1"),
    ],
)
def test_wrong_specification_is_refused_in_one_line(spec, said):
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        parse_check(spec)
    assert "\n" not in str(refused.value)


def test_junit_counts_what_failed_and_what_was_not_judged(tmp_path):
    checks = [each._asdict() for each in check_results(METRICS, [parse_check("rmse below=0.2")])]
    cases = [
        *check_cases("a-run", checks),
        *check_cases("other", []),
        Case("log", "gps", skipped="not logged"),
    ]
    suite = ET.parse(write_junit(tmp_path / "new" / "junit.xml", "quadftc run", cases)).getroot()
    assert [suite.get(key) for key in ("tests", "failures", "skipped")] == ["5", "2", "1"]
    assert [case.get("name") for case in suite][:2] == ["rmse roll below 0.2", "rmse pitch below 0.2"]
    assert [failure.get("message") for failure in suite.iter("failure")] == [
        "rmse pitch = 0.3, required below 0.2",
        "rmse yaw = no value, required below 0.2",
    ]


def test_file_that_finds_no_room_is_named_and_leaves_the_one_before(tmp_path):
    path = write_file(tmp_path / "verdict.json", "before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(OSError, match="File too large") as caught:
            write_file(path, "x" * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))
    assert [each.name for each in tmp_path.iterdir()] == ["verdict.json"]
    assert path.read_text() == "before"
