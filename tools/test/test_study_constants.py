"""The table of the numbers of `bank` has those of the code; changes can be counted by hand."""

import ast
import math
import re
from pathlib import Path

import pytest

from quadftc_tools.study import constants
from quadftc_tools.study.bank_trial import KINDS, Judged, Verdict

PAGE = Path(__file__).resolve().parents[2] / "docs" / constants.PAGE
OF_EQUATIONS = {0.0, 0.5, 1.0, 2.0, 3.0, 6.0}
ROUNDING = 1e-6


def test_page_has_every_number_of_the_observer():
    table = re.search(r"<!-- table: constants -->\n(.*?)\n<!-- end -->", PAGE.read_text(), re.DOTALL)
    assert table is not None
    rows = [line.strip("| ").split(" | ") for line in table[1].splitlines()[3:]]  # the first is of no number
    known = constants.read_constants()
    assert [row[:5] for row in rows] == [[f"`{each.name}`", f"`{each.value}`", *each[2:5]] for each in known]
    assert all(row[5] and row[6] for row in rows)
    assert 0 < len(rows) <= 50


def test_no_number_hides_in_a_function():
    for path in (constants.PACKAGE / "bank").glob("*.py"):
        for function in ast.walk(ast.parse(path.read_text())):
            if isinstance(function, ast.FunctionDef):
                parts = [each.value for each in ast.walk(function) if isinstance(each, ast.Constant)]
                numbers = {each for each in parts if isinstance(each, float) and each > ROUNDING}
                assert numbers <= OF_EQUATIONS, (path.name, function.name)


@pytest.mark.parametrize(
    ("line", "half", "double"),
    [
        ("A = math.radians(2.0)  # rad; chosen: some", math.radians(1.0), math.radians(4.0)),
        ("A = (0.5, 4)  # s; measured: 4 or 0.5", (0.25, 2), (1.0, 8)),
        ("A = 0.9  # 1; derived: a probability", 0.95, 0.8),
    ],
)
def test_number_is_halved_and_doubled(tmp_path, monkeypatch, line, half, double):
    monkeypatch.setattr(constants, "PACKAGE", tmp_path)
    for folder in ("bank", "fault_observers"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "bank.py").write_text("")
    (tmp_path / "bank/some.py").write_text(f"{line}\nINDEX = 3\nTINY = 1e-9  # 1; rounding: of sums\n")
    (found,) = constants.read_constants()
    for factor, value in zip(constants.FACTORS, (half, double), strict=True):
        names = {"math": math}
        exec(found.changed(factor), names)
        assert names["A"] == pytest.approx(value)
    (tmp_path / "bank/some.py").write_text("A = 0.3  # s, of something\n")
    with pytest.raises(ValueError, match=r"some\.py:1: expected '# unit; kind: reason'"):
        constants.read_constants()


def test_changes_are_in_points_and_of_the_same_ramps():
    none, step, ramp, *_ = [*list(KINDS)[:2], "gyro: ramp of 0.05 to 0.5 rad/s²"]
    usual = [
        Judged(none, "bank", Verdict(None, False, False)),
        Judged(step, "bank", Verdict(0.1, False, False)),
    ]
    usual += [Judged(ramp, "bank", Verdict(delay, False, False)) for delay in (0.2, 0.4, None)]
    other = [
        Judged(none, "bank", Verdict(None, True, False)),
        Judged(step, "bank", Verdict(0.3, False, False)),
    ]
    other += [
        Judged(ramp, "bank", Verdict(delay, wrong, False))
        for delay, wrong in ((0.3, 0), (None, 1), (None, 0))
    ]
    assert constants.tell_change(usual, usual) == "none"
    assert constants.tell_change(usual, other) == "alarms +100.0, named -25.0, misnamed +25.0, delay +50 %"
