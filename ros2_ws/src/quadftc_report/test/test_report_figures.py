"""What the figures of a report say: which lines, in which unit, with which windows, moments and numbers."""

import dataclasses
import functools

import numpy as np
import pytest
from recorded_runs import recorded_run

from quadftc_flight.metrics import flight_metrics
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import parse_scenario
from quadftc_model.samples import AXES, FAULTY, HEALTHY
from quadftc_report.comparison import Comparison, compare, list_injections
from quadftc_report.description import Figure, Panel, Shade
from quadftc_report.figures import flight_figures

TEXT = """
name: small
duration: 4 s
rate: 100 Hz
vehicle: qball_x4
references: [{kind: step, angles: [5 deg, 0, 10 deg], rise: 1}]
disturbances: [{kind: constant, amplitude: [0.1, 0, 0], start: 0.5}]
faults:
  - {kind: bias, axes: roll, value: 1 deg, start: 1, stop: 2}
  - {kind: sine, axes: [roll, pitch], amplitude: 2 deg, start: 2, stop: 3}
schemes:
  proposed: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}
  conventional: {observer: none, controller: smc}
  cascade: {observer: none, controller: pid}
"""
PAIR = ("proposed", "conventional")


@functools.cache
def flown(name: str, *overrides: str) -> RecordedRun:
    return recorded_run(parse_scenario(TEXT, overrides=overrides), name)


def comparison(*names: str, overrides: tuple[str, ...] = ()) -> Comparison:
    """Runs of the small scenario, side by side."""
    (found,) = compare([flown(name, *overrides) for name in names])
    return found


def described(of: Comparison) -> dict[str, Figure]:
    return {figure.key.removeprefix(f"{of.key}-"): figure for figure in flight_figures(of)}


def changed(run: RecordedRun, **columns: np.ndarray) -> RecordedRun:
    return dataclasses.replace(run, flight=dataclasses.replace(run.flight, **columns))


def lines(panel: Panel) -> dict[str, np.ndarray]:
    return {trace.name: trace.y for trace in panel.traces}


def test_every_figure_of_two_runs_is_there_in_order():
    assert list(described(comparison(*PAIR))) == [
        *("fault-roll", "fault-pitch", "fault-yaw", "tracking-roll", "tracking-pitch", "tracking-yaw"),
        *("disturbance", "sliding_variable", "torque"),
    ]


FREE = """
name: free
duration: 2 s
rate: 100 Hz
vehicle: x500
plant: {kind: free_flight, start: [2, 0, 1]}
trajectories: [{kind: circle, rise: 0.5}]
faults: [{kind: bias, channel: gyro, axes: x, value: 0.2, start: 1}]
schemes:
  proposed: {observer: threshold, controller: ismc}
  conventional: {observer: none, controller: pid}
"""


def test_a_flight_through_space_has_its_position_its_path_and_its_errors():
    scenario = parse_scenario(FREE)
    runs = [recorded_run(scenario, name) for name in PAIR]
    (free,) = compare(runs)
    found, flight = described(free), runs[1].flight
    assert {"position", "top_view", "position_error"} <= set(found)
    for axis, panel in enumerate(found["position"].panels):
        assert list(lines(panel)) == ["reference", *PAIR]
        np.testing.assert_array_equal(lines(panel)["conventional"], flight.position[:, axis])
        assert [shade.label for shade in panel.shades] == ["gyro bias"]  # on every axis
    (path,) = found["top_view"].panels
    np.testing.assert_array_equal([path.traces[2].t, path.traces[2].y], flight.position.T[:2])
    assert found["top_view"].is_map
    assert found["top_view"].span[0] < np.min(flight.position[:, 0])
    off, wrong = (lines(panel)["conventional"] for panel in found["position_error"].panels)
    assert np.nanmax(off) == pytest.approx(flight_metrics(flight, [])["position_max_m"])
    assert np.nanmax(wrong) < np.nanmax(off)


def test_states_of_gyro_and_accelerometer_have_figures_where_an_observer_doubts_them():
    run = flown("proposed")
    state = np.full_like(run.flight.gyro_state, HEALTHY)
    watched = changed(run, gyro_state=state.copy(), accelerometer_state=state)
    watched.flight.gyro_state[200:, 1] = FAULTY
    found = described(Comparison((watched,), "small"))
    assert "state-accelerometer" not in found
    panels = found["state-gyro"].panels
    assert [panel.title for panel in panels] == ["x", "y", "z"]
    assert panels[1].traces[0].y[-1] == FAULTY
    assert panels[0].traces[0].y[-1] == HEALTHY


def test_figure_without_data_is_left_out():
    found = described(comparison("cascade", overrides=("faults=[]", "disturbances=[]")))
    assert list(found) == ["tracking-roll", "tracking-pitch", "tracking-yaw", "torque"]


def test_fault_figure_shows_fault_estimate_and_error_in_degrees():
    flight = flown("proposed").flight
    upper, lower = described(comparison(*PAIR))["fault-pitch"].panels
    shown = lines(upper)
    assert list(shown) == ["true fault", "estimate"]
    assert np.array_equal(shown["true fault"], np.degrees(flight.fault[:, 1]))
    assert np.array_equal(shown["estimate"], np.degrees(flight.fault_estimate[:, 1]))
    assert lines(lower)["estimate"] == pytest.approx(shown["estimate"] - shown["true fault"])


def test_tracking_figure_shows_the_reference_once_and_the_runs_in_their_roles():
    upper, lower = described(comparison(*PAIR))["tracking-roll"].panels
    looks = [(trace.name, trace.role, trace.rank) for trace in upper.traces]
    assert looks == [
        ("reference", "reference", 0),
        ("proposed", "proposed", 0),
        ("conventional", "compared", 0),
    ]
    assert list(lines(lower)) == ["proposed", "conventional"]
    assert np.nanmax(np.abs(upper.traces[0].y)) == pytest.approx(5.0)


def test_compared_runs_are_numbered():
    panel = described(comparison("proposed", "conventional", "cascade"))["tracking-roll"].panels[0]
    assert [(trace.name, trace.rank) for trace in panel.traces[2:]] == [("conventional", 0), ("cascade", 1)]


def test_windows_and_onsets_are_those_of_the_axis():
    found = described(comparison(*PAIR))
    roll, pitch = found["tracking-roll"].panels[0], found["tracking-pitch"].panels[0]
    assert roll.shades == (Shade(1.0, 3.0, "fault window"),)  # two that touch
    assert pitch.shades == (Shade(2.0, 3.0, "fault window"),)
    assert [mark.time for mark in roll.marks] == [0.5]
    assert pitch.marks == ()
    assert found["tracking-yaw"].panels[0].shades == ()


def test_fault_on_another_channel_has_a_window_of_its_own():
    extra = "faults.1={kind: bias, channel: gyro, axes: x, value: 0.01, start: 2, stop: 2.5}"
    panel = described(comparison(*PAIR, overrides=(extra,)))["tracking-roll"].panels[0]
    assert [(shade.label, shade.rank) for shade in panel.shades] == [("fault window", 0), ("gyro bias", 1)]


def test_disturbance_that_ends_is_marked_twice():
    found = described(comparison(*PAIR, overrides=("disturbances.0.stop=3",)))
    assert [mark.time for mark in found["disturbance"].panels[0].marks] == [0.5, 3.0]


def test_withheld_samples_are_gaps():
    flight = flown("proposed").flight
    hidden = np.zeros(len(flight), np.bool_)
    hidden[300:340] = True
    columns = {
        name: np.where(hidden[:, None], np.nan, getattr(flight, name)) for name in ("fault", "fault_estimate")
    }
    (of,) = compare([changed(flown("proposed"), **columns), flown("conventional")])
    for panel in described(of)["fault-roll"].panels:
        for trace in panel.traces:
            assert np.array_equal(np.isnan(trace.y), hidden)


def test_run_that_ends_early_is_drawn_to_its_end_and_named():
    run = flown("proposed")
    (of,) = compare([dataclasses.replace(run, flight=run.flight.first(200)), flown("conventional")])
    figure = described(of)["tracking-roll"]
    assert figure.span == (0.0, pytest.approx(4.0))
    assert len(lines(figure.panels[0])["proposed"]) == 200
    assert len(lines(figure.panels[0])["reference"]) == 400
    assert figure.caption.endswith("proposed ends at 2 s.")


def test_single_run_without_observer_shows_the_fault_alone():
    found = described(comparison("conventional"))
    (panel,) = found["fault-roll"].panels
    assert list(lines(panel)) == ["true fault"]
    assert list(lines(found["disturbance"].panels[0])) == ["disturbance d"]


def test_standard_deviation_is_shown_around_estimate_and_zero():
    run = flown("proposed")
    deviation = np.full((len(run.flight), 3), np.radians(0.5))
    deviation[:100] = -1.0  # this observer gives none yet
    (of,) = compare([changed(run, fault_std_dev=deviation)])
    upper, lower = described(of)["fault-roll"].panels
    (around,), (around_zero,) = upper.envelopes, lower.envelopes
    assert np.all(np.isnan(around.low[:100]))
    assert around.high[100:] - lines(upper)["estimate"][100:] == pytest.approx(np.ones(300))
    assert around_zero.low[100:] == pytest.approx(-np.ones(300))


def test_observer_without_standard_deviation_has_no_envelope():
    assert all(panel.envelopes == () for panel in described(comparison(*PAIR))["fault-roll"].panels)


def test_boundary_layers_are_those_of_the_controllers():
    bands = described(comparison(*PAIR))["sliding_variable"].panels[2].bands
    assert [(band.label, band.low, band.high) for band in bands] == [
        ("±Φ (proposed)", -0.1, 0.1),
        ("±Φ (conventional)", -0.5, 0.5),
    ]


@pytest.mark.parametrize(("torque", "shown"), [(0.5, False), (0.7, True)])
def test_authority_is_shown_where_the_torque_comes_near_it(torque, shown):
    run = flown("conventional")
    (of,) = compare([changed(run, torque=np.full_like(run.flight.torque, torque))])
    (limit,) = described(of)["torque"].panels[0].bands or (None,)
    assert (limit is not None) is shown
    assert limit is None or limit.high == pytest.approx(1.2)


def test_rotors_show_their_effectiveness_and_what_the_diagnosis_says_of_them():
    weak = "faults=[{kind: loss, rotors: [2], value: 20 %, start: 1}]"
    run = recorded_run(parse_scenario(FREE, overrides=[weak]), "proposed")
    assert described(compare([run])[0])["rotors"].panels[1].shades == (Shade(1.0, 2.0, "rotor loss", 1),)
    state, late = np.full((len(run.flight), 4), HEALTHY, np.uint8), run.flight.time >= 1.1
    state[late, 1] = FAULTY
    said = {"rotor_state": state, "rotor_estimate": np.where(state == FAULTY, 0.82, 1.0)}
    (of,) = compare([changed(run, **said, rotor_std_dev=np.full(state.shape, 0.01))])
    found = described(of)
    assert [panel.title for panel in found["state-rotor"].panels] == [f"rotor {n}" for n in (1, 2, 3, 4)]
    panel = found["rotors"].panels[1]
    shown = lines(panel)
    assert (shown["true effectiveness"][-1], shown["estimate"][-1]) == pytest.approx((0.8, 0.82))
    assert panel.envelopes[0].low[-1] == pytest.approx(0.8)
    assert panel.shades == (Shade(1.0, 2.0, "rotor loss", 1),)
    assert list_injections(of.runs[0]) == [("1 s on", "rotor: 2", "loss: value 0.2")]


def test_truth_that_depends_on_the_flight_is_drawn_for_each_run():
    observed = flown("proposed")
    fault = observed.flight.fault.copy()
    fault[100:200, 0] += 0.1
    (of,) = compare([observed, changed(observed, fault=fault)])
    names = [trace.name for trace in described(of)["fault-roll"].panels[0].traces if trace.role == "truth"]
    assert len(names) == 2
    assert len(set(names)) == 2
    assert "true fault" in lines(described(of)["fault-pitch"].panels[0])


def test_angle_through_half_a_turn_is_not_joined():
    run = flown("conventional")
    angles = run.flight.angles.copy()
    angles[:, 2] = np.where(run.flight.time < 1.5, np.radians(179.9), np.radians(-179.9))
    (of,) = compare([changed(run, angles=angles)])
    yaw = lines(described(of)["tracking-yaw"].panels[0])["conventional"]
    assert len(yaw) == 401
    assert np.sum(np.isnan(yaw)) == 1
    assert not np.any(np.abs(np.diff(yaw)) > 180.0)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("paper_faults", {"fault-roll": (3,), "fault-pitch": (4,), "tracking-yaw": (8,), "torque": ()}),
        ("paper_constant_disturbance", {"fault-roll": (), "tracking-roll": (9,), "tracking-yaw": (11,)}),
        ("paper_varying_disturbance", {"tracking-roll": (12,), "tracking-pitch": (13,)}),
        ("small", {"fault-roll": (), "tracking-roll": ()}),
    ],
)
def test_figures_of_the_papers_scenarios_have_the_papers_numbers(name, numbers):
    runs = [flown(scheme) for scheme in PAIR]
    named = [
        dataclasses.replace(run, scenario=run.scenario.model_copy(update={"name": name})) for run in runs
    ]
    found = described(Comparison(tuple(named), name))
    assert {key: found[key].paper_figures for key in numbers} == numbers


def test_keys_are_unique_and_fit_for_files():
    keys = [figure.key for figure in flight_figures(comparison(*PAIR))]
    assert len(set(keys)) == len(keys)
    assert all(key.replace("-", "").replace("_", "").isalnum() for key in keys)
    assert all(axis in "".join(keys) for axis in AXES)
