"""The study of weak rotors, from rows that one can count by hand; its campaigns load."""

from pathlib import Path

import polars as pl
import pytest

from quadftc_campaign.campaign_file import load_campaign
from quadftc_tools.study.rotors import NAMES, ROWS, choose, fault_table, healthy_table, make

ROOT = Path(__file__).resolve().parents[2]
LOSS = "loss channel=rotor rotors=2 value=20.5% start=8s"


def row(flight, variant, spec, named=True, delay=0.016, wrong=0.0, lost=False, far=0.1):
    fault = {"named": named, "naming_delay_s": delay, "size_error_mean": 0.01}
    flown = {"flight": flight, "variant": variant, "faults.0": spec, "lost": lost, "position_max_m": far}
    flown |= {"rotors.false_namings": wrong, "sensors.false_namings.gyro": 0.0}
    return {**flown, **{f"fault.{name}": value for name, value in fault.items()}}


def test_faults_are_counted_by_kind_beside_the_flights_without_a_diagnosis():
    frame = pl.DataFrame(
        [
            row(0, "bank", LOSS),
            row(1, "bank", LOSS, named=False, delay=None, wrong=2.0, far=0.3),
            row(0, "undiagnosed", LOSS, named=False, delay=None, lost=True),
            row(1, "undiagnosed", LOSS, named=False, delay=None, far=0.5),
        ]
    )
    *_, line = fault_table(frame).splitlines()
    assert [cell.strip() for cell in line.strip("|").split("|")] == [
        *("rotor: 15 to 40 % lost", "2", "50 %", "50 %", "16/16 ms", "1 %/1 %"),
        *("0 %", "0.20/0.30 m", "50 %", "0.50/0.50 m"),
    ]


def test_a_slow_loss_has_a_row_of_its_own():
    frame = pl.DataFrame({"faults.0": [LOSS, LOSS.replace("20.5%", "30% rise=0.5")]})
    labels = [[each.label for each in ROWS if frame[k : k + 1].filter(choose(each)).height] for k in (0, 1)]
    assert labels == [["rotor: 15 to 40 % lost"], ["rotor: 30 % lost over 0.5 s"]]


def test_flights_in_which_something_healthy_is_named_are_counted():
    flown = {"variant": "bank", "healthy_time_s.roll": 80.0, "rotors.false_namings": 0.0}
    frame = pl.DataFrame([{"flight": k, **flown, "sensors.false_namings.gyro": 2.0 * k} for k in (0, 1)])
    assert healthy_table(frame).splitlines()[-1] == "| 2 | 0.0444 | 0 | 1 |"


@pytest.mark.parametrize("name", NAMES)
def test_campaigns_load_and_the_document_has_a_place_for_their_tables(name):
    assert load_campaign(ROOT / "campaigns" / f"{name}.yaml").variants[0].name == "bank"
    text = (ROOT / "docs" / "rotors.md").read_text(encoding="utf-8")
    assert text.count(f"<!-- table: {name.replace('_', '-')} -->") == 1


def test_directory_without_campaigns_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no study there"):
        make(tmp_path)
