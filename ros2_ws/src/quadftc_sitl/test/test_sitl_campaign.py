"""Campaigns that a firmware flies: what is drawn, what is refused, the map of what was lost."""

from pathlib import Path

import pytest

from quadftc_campaign.campaign_file import load_campaign
from quadftc_flight.scenario import ScenarioError
from quadftc_sitl.sitl_campaign import campaign_flights, flights_of_file
from quadftc_sitl.sitl_report import drawn_rows

OURS = Path(__file__).parents[4] / "campaigns" / "sitl_hover.yaml"


def test_flight_of_a_campaign_is_the_same_whatever_their_number():
    flights = campaign_flights(OURS, "ardupilot", flights=4)
    names = [each.plan.name for each in flights]
    assert names == ["gyro_stuck-0", "gyro_stuck-1", "gyro_stuck-2", "rotor_loss-3"]
    again = campaign_flights(OURS, "ardupilot", flights=2)
    assert [each.plan.raw for each in again] == [each.plan.raw for each in flights[:2]]
    winds = {each.drawn["wind.1.wind_speed"] for each in flights}
    assert len(winds) == 4
    assert winds == {each.plan.raw["wind"][1]["wind_speed"] for each in flights}
    assert [each.drawn.get("faults.0.axes") for each in flights] == ["y", "x", "y", None]
    assert campaign_flights(OURS, "ardupilot", 1, seed=2)[0].drawn != flights[0].drawn


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("source: loop", "source: loop: expected sitl, to fly a firmware"),
        ("source: sitl\nchecks: []", "checks: does not go with 'source: sitl'"),
        ("source: sitl\nschemes: all", "schemes: expected one, whose observer runs beside"),
        ("source: sitl\nseeds: 3", "seeds: unknown key (did you mean 'seed'?)"),
        ("source: orbit", "source.kind: 'orbit'"),
    ],
)
def test_campaign_that_no_firmware_flies_is_refused(tmp_path, line, words):
    file = tmp_path / "campaign.yaml"
    text = OURS.read_text().replace("../scenarios", str(OURS.parents[1] / "scenarios"))
    file.write_text(text.replace("source: sitl", line))
    with pytest.raises(ScenarioError) as caught:
        flights_of_file(file, "ardupilot", "", False, 1, "", [])
    assert words in str(caught.value)


def test_campaign_of_a_firmware_is_refused_by_the_closed_loop():
    with pytest.raises(ScenarioError, match=r"source: sitl: a firmware flies it: quadftc sitl"):
        load_campaign(OURS)


def test_what_kills_is_told_by_each_value_that_varies():
    flights = [{"name": f"a-{number}", "survived": number < 6} for number in range(8)]
    drawn = {
        f"a-{number}": {"size": float(number), "axis": "xy"[number % 2], "fault": f"bias {number / 7}"}
        for number in range(8)
    }
    drawn["a-7"]["rotor"] = 2  # not drawn for the others
    drawn |= {"a-8": {"size": 99.0, "axis": "z", "fault": ""}}  # not flown
    rows = drawn_rows(flights, drawn)[1:]
    assert [row[2] for row in rows[:4]] == ["0 of 2", "0 of 2", "0 of 2", "2 of 2"]
    assert rows[4:6] == [("axis", "x", "1 of 4"), ("axis", "y", "1 of 4")]
    assert rows[-1] == ("rotor", "2", "1 of 1")
