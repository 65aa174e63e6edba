"""The studies of exported observers: both precisions fly the same flight, and costs are counted."""

import pytest

from quadftc_cli.exporting import exported_law
from quadftc_compile.emulation import can_emulate
from quadftc_tools.study.embedded_costs import Case, costs_of, fly
from quadftc_tools.study.single_precision import fly_quiet

pytest.importorskip("jax")


@pytest.mark.slow
def test_an_observer_in_float_says_nearly_what_it_says_in_double():
    quiet = fly_quiet("mems_faults", 250.0, 80.0, "sliding_mode")
    assert 0.0 < quiet.apart < 0.01
    double, single = quiet.told
    assert single.rmse == pytest.approx(double.rmse, rel=1e-2)


@pytest.mark.thorough
@pytest.mark.skipif(not can_emulate(), reason="there is no compiler or emulator for Cortex-M")
def test_an_observer_costs_what_its_table_says(tmp_path):
    samples = fly("sliding_mode", "mems_faults")
    case = Case("test stand", exported_law("sliding_mode", samples.law, "float"), samples, tmp_path / "law")
    costs = costs_of(case)
    assert [cost.target.name for cost in costs] == ["Cortex-M7", "Cortex-M4F"]
    for cost in costs:
        assert cost.emulated.steps == len(samples.dt) > 2400
        assert 500 < cost.emulated.instructions <= cost.emulated.most_instructions < 20000
        assert cost.apart < 1e-4
