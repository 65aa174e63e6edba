"""Golden verdicts: alarms found in estimates, counts that one can check by hand, differences and files."""

from __future__ import annotations

import numpy as np
import pytest

from quadftc_cli.commands import BAD_INPUT
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.samples import (
    FAULT_KINDS,
    FAULTY,
    HEALTHY,
    RECOVERING,
    FaultEstimate,
    SensorDiagnosis,
    SensorEstimate,
    level_sample,
)
from quadftc_model.vehicle import load_vehicle
from quadftc_tools.study import golden
from quadftc_tools.study.golden_alarms import (
    Alarm,
    Event,
    Verdict,
    alarms_of,
    count,
    differences,
    read_verdicts,
    write_verdicts,
)
from quadftc_tools.study.golden_trials import flights_of, recorded_trials, simulated_trials

ROLL = Alarm("attitude/roll", "FAULTY", 1.0, 0.9, 2.0, 0.99, 0.1, "offset")
GYRO = Alarm("gyro/x", "AMBIGUOUS", 1.5, 1.4, 3.0, 0.5, 0.2, "offset")
PITCH = Alarm("gyro/y", "FAULTY", 5.0, 5.0, 6.0, 0.9, 0.3, "stuck")


def estimate(rows: int, state, size, ambiguous) -> FaultEstimate:
    """What is said of gyro y; all else is healthy."""

    def sensor(column=None) -> SensorEstimate:
        zeros = np.zeros((rows, 3))
        states, sizes, doubts = np.full((rows, 3), HEALTHY, np.uint8), zeros.copy(), zeros > 0.0
        kinds = np.full((rows, 3), FAULT_KINDS.index("offset"), np.uint8)
        if column is not None:
            states[:, column], sizes[:, column], doubts[:, column] = state, size, ambiguous
        return SensorEstimate(states, sizes, zeros, zeros + 0.02, zeros + 0.75, kinds, doubts)

    healthy = sensor()
    zeros = np.zeros((rows, 3))
    return FaultEstimate(
        zeros, zeros, healthy.state, zeros, level_sample(), SensorDiagnosis(healthy, sensor(1), healthy)
    )


def test_alarm_is_what_is_declared_without_a_break_and_in_one_state():
    law = fault_observers.get("isolating")(vehicle=load_vehicle("qball_x4"))
    state = [HEALTHY, FAULTY, FAULTY, FAULTY, RECOVERING, HEALTHY, FAULTY, FAULTY]
    ambiguous = [False, True, False, False, False, True, False, False]
    size = [0.0, 0.9, 0.118, 0.122, 0.5, 0.0, 1.0, 2.0]
    said = alarms_of(law, 0.1 * np.arange(8), estimate(8, state, size, ambiguous))
    assert said == (
        Alarm("gyro/y", "AMBIGUOUS", 0.1, 0.08, 0.2, 0.75, 0.9, "offset"),
        Alarm("gyro/y", "FAULTY", 0.2, 0.18, 0.5, 0.75, 0.12, "offset"),
        Alarm("gyro/y", "FAULTY", 0.6, 0.58, 0.7, 0.75, 1.5, "offset"),  # lasts
    )


def test_every_alarm_of_a_healthy_recording_that_lasts_where_it_counts_is_false():
    found = count([Verdict((ROLL, GYRO, PITCH), judged=(0.5, 10.5))])
    assert (found.flown, found.alarms, found.alarmed) == (10.0, 2, 3.0)  # one axis counts once
    assert count([Verdict((ROLL, GYRO, PITCH), judged=(2.0, 5.5))])[1:3] == (2, 1.5)
    assert count([Verdict((ROLL, GYRO, PITCH), judged=(3.0, 5.0))])[1:3] == (0, 0.0)
    absent = Event("attitude", 0.8, 1.1), Event("attitude", 4.0, 4.9)
    assert count([Verdict((ROLL, GYRO, PITCH), judged=(0.5, 10.5), absences=absent)])[1:3] == (1, 1.0)


def test_fault_is_named_by_its_element_alone_while_it_lasts():
    gyro = Event("gyro/x", 1.2, 4.0)
    found = count([Verdict((GYRO, PITCH), 3.0, (0.0, 10.0), (gyro,))])
    assert (found.delays, found.declared, found.misnamed) == ((None,), 1, 0)
    assert (found.alarms, found.errors) == (1, (3.0,))  # pitch, after its end
    named = GYRO._replace(state="FAULTY")
    found = count([Verdict((ROLL, named), 3.0, (0.0, 10.0), (gyro._replace(start=0.5),))])
    assert (found.delays, found.declared, found.misnamed, found.alarms) == ((1.0,), 1, 1, 0)
    both = gyro._replace(start=0.5), Event("attitude/roll", 0.5, 4.0)
    assert count([Verdict((ROLL, named), 3.0, (0.0, 10.0), both)]).misnamed == 0


@pytest.mark.parametrize(
    ("changed", "lines"),
    [
        (ROLL._replace(declared=1.004, end=1.996, size=0.11, probability=0.98), 0),
        (ROLL._replace(declared=1.006), 2),
        (ROLL._replace(onset=0.8), 2),
        (ROLL._replace(size=0.12), 2),
        (ROLL._replace(size=-0.1), 2),
        (ROLL._replace(probability=0.9), 2),
        (ROLL._replace(state="AMBIGUOUS"), 2),
        (ROLL._replace(kind="stuck"), 2),
    ],
)
def test_alarm_that_is_said_otherwise_is_a_difference(changed, lines):
    stored = {"one": Verdict((ROLL, PITCH), 1.0)}
    assert len(differences(stored, {"one": Verdict((changed, PITCH), 1.0)})) == lines


def test_alarm_more_or_less_another_error_and_another_trial_are_differences():
    stored = {"one": Verdict((ROLL,), 1.0), "other": Verdict(())}
    assert differences(stored, stored) == differences(stored, {}) == []
    assert len(differences(stored, {"one": Verdict((ROLL, ROLL), 1.0)})) == 1
    assert len(differences(stored, {"one": Verdict((), 1.2)})) == 2
    assert differences(stored, {"new": Verdict(())}) == ["new: not stored"]


def test_verdicts_are_read_as_they_were_written(tmp_path):
    verdicts = {"one": Verdict((ROLL, PITCH), 0.43), "other": Verdict(())}
    path = tmp_path / "golden" / "some.json"
    write_verdicts(path, verdicts)
    assert read_verdicts(path) == verdicts


@pytest.mark.parametrize("text", ["", "[]", '{"one": 3}', '{"one": {"alarms": [[1]], "error_deg": null}}'])
def test_file_that_holds_no_verdicts_is_refused_by_its_name(tmp_path, text):
    path = tmp_path / "some.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"some\.json: .*expected verdicts"):
        read_verdicts(path)


def test_recording_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match="10_slow_translation_a: not there"):
        list(recorded_trials(tmp_path))


def test_flights_of_a_seed_are_those_of_the_set_with_that_seed():
    stored = {trial.name: trial for trial in simulated_trials()}
    (other,) = flights_of("two_faults", 61, 1)
    assert other.part == "other"
    assert other.judge("isolating") == stored[other.name].judge("isolating")


def test_an_observer_that_there_is_not_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["golden", "--observer", "nobody", "--campaign", "two_faults"])
    assert golden.main() == BAD_INPUT
    assert "nobody" in capsys.readouterr().err
