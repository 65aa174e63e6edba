"""The batch engine flies what the closed loop flies, and its tally says what the metrics say."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from accusing_observer import registered
from batch_flights import assert_same_metrics, assert_same_outcome

from quadftc_campaign.batch.engine import compile_laws, fly_all
from quadftc_campaign.batch.jax_engine import JaxEngine, with_common_faults
from quadftc_campaign.batch.judge import Judge
from quadftc_campaign.batch.judged import Motion
from quadftc_campaign.batch.records import flight_record
from quadftc_campaign.batch.schedule import schedule_of
from quadftc_campaign.flights import batch_flight
from quadftc_control.controller import controllers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.closed_loop import fly
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import build_scenario, find_scenario, load_scenario, parse_scenario, with_seed
from quadftc_model.guarded import Guarded
from quadftc_model.samples import AXES, FAULTY, HEALTHY, STARTING
from quadftc_sim.fault import faults as fault_kinds

BUSY = """
duration: 4 s
rate: 250 Hz
seed: 3
vehicle: crazyflie_2x
plant: {motor_lag: false, substeps: 2}
sensors: {grade: mems, delay: 2}
references:
  - {kind: step, angles: [5 deg, -4 deg, 10 deg], start: 0.5 s, stop: 2 s, rise: 0.5 s}
disturbances:
  - {kind: sine, amplitude: 0.0002, frequency: 3, start: 0.5 s}
  - {kind: ramp, rate: 0.0001, start: 0.5 s, stop: 2 s}
faults: []
schemes:
  tested: {observer: supervised, disturbance_observer: exosystem, controller: ismc}
"""
BIAS = {"kind": "bias", "value": 0.03, "start": 1.0, "stop": 2.0}


def busy(*faults, seconds=4.0, **parts):
    """A short flight with something of everything."""
    overrides = [f"schemes.tested.{role}={name}" for role, name in parts.items()]
    scenario = parse_scenario(BUSY, overrides=[f"duration={seconds} s", *overrides])
    document = scenario.document.replaced({("faults",): [dict(fault) for fault in faults]}, "test")
    return build_scenario(document)


def flown(scenario, scheme=None, engine="c"):
    (outcome,) = fly_all([batch_flight(scenario, scheme)], engine)
    return outcome


def traced(scenario, scheme=None):
    (outcome,) = JaxEngine().fly([batch_flight(scenario, scheme)])
    return outcome


def assert_judged_alike(scenario, scheme=None):
    """The engine and the metrics say the same of a flight, which is returned."""
    flight = fly(scenario, scheme)
    assert_same_metrics(flown(scenario, scheme), flight, scenario)
    return flight


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        ("paper_varying_disturbance", "proposed"),
        ("mems_faults", "supervised"),
        ("gyro_faults", "isolating"),
    ],
)
def test_a_scenario_is_judged_by_its_metrics_to_its_end(name, scheme):
    assert_judged_alike(load_scenario(find_scenario(name)), scheme)


EVERY_FAULT = [
    {"kind": kind, "channel": channel, "start": 0.3 + 0.2 * index, "duration": 0.5, **parameters}
    for channel, size in (("attitude", 0.03), ("gyro", 0.02), ("accelerometer", 0.3))
    for index, (kind, parameters) in enumerate(
        [
            ("bias", {"value": size}),
            ("drift", {"rate": size}),
            ("sine", {"amplitude": size}),
            ("scale", {"factor": 0.1}),
            ("stuck", {}),
            ("delay", {"delay": 0.02}),
            ("noise", {"sigma": size}),
            ("spikes", {"amplitude": size, "rate": 20.0}),
            ("nan", {}),
            ("dropout", {"probability": 0.5}),
        ]
    )
] + [
    {"kind": "saturation", "channel": channel, "limit": limit, "start": 2.5, "duration": 0.5}
    for channel, limit in (("gyro", 0.05), ("accelerometer", 0.2))
]


def test_every_fault_on_every_channel_is_judged_by_its_metrics():
    assert {fault["kind"] for fault in EVERY_FAULT} == set(fault_kinds.names())
    assert_judged_alike(busy(*EVERY_FAULT, observer="threshold"))


NOTHING_AT_FIRST = (
    {"kind": "nan", "start": 0.0, "stop": 0.4},
    {"kind": "dropout", "channel": "imu", "start": 0.0, "stop": 0.1},
    {"kind": "dropout", "channel": "imu", "start": 3.0, "stop": 3.5, "probability": 0.7},
)
NOTHING_FOR_A_WHILE = (
    *NOTHING_AT_FIRST,
    {"kind": "dropout", "channel": "imu", "start": 1.0, "stop": 2.5},  # longer than anything is carried
    {"kind": "nan", "start": 2.4, "stop": 2.7},
)


def test_a_diagnosis_that_has_to_wait_for_a_sample_is_judged_by_its_metrics():
    scenario = busy(*NOTHING_FOR_A_WHILE, observer="sliding_mode")
    flight = assert_judged_alike(scenario)
    waits = np.flatnonzero(np.any(flight.fault_state == STARTING, axis=-1)) / scenario.rate
    assert np.any(waits < 1.0)
    assert np.any(waits > 2.0)
    assert not np.all(flight.delivered)


def test_what_is_said_of_each_sensor_is_judged_by_its_metrics():
    bias = {"kind": "bias", "channel": "gyro", "axes": "x", "value": 0.3, "start": 1.0, "stop": 2.0}
    with registered() as observer:
        flight = assert_judged_alike(busy(*NOTHING_AT_FIRST, bias, observer=observer))
    assert {HEALTHY, FAULTY} <= set(np.unique(flight.gyro_state[:, 0]))


PARTS = {
    "observer": fault_observers.names(),
    "controller": controllers.names(),
    "disturbance_observer": [
        f"{{kind: exosystem, model: {model}}}"
        for model in ("constant", "ramp", "harmonic", "constant+harmonic")
    ],
}


@pytest.mark.parametrize(
    "place",  # each law by itself is held to NumPy by tests/test_c_equals_numpy.py
    [
        pytest.param(place, marks=() if name in ("sliding_mode", "supervised") else pytest.mark.thorough)
        for place, name in enumerate(PARTS["observer"])
    ],
)
def test_every_observer_and_controller_flies_in_c_as_in_numpy(place):
    scenario = busy(BIAS, seconds=2.1, **{role: names[place % len(names)] for role, names in PARTS.items()})
    assert_same_outcome(flown(scenario), flown(scenario, engine="numpy"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("observer", "faults"),
    [
        ("supervised", [BIAS]),
        ("isolating", [BIAS]),
        ("threshold", EVERY_FAULT),
        ("sliding_mode", NOTHING_FOR_A_WHILE),
    ],
)
def test_a_flight_in_jax_is_that_in_c(observer, faults):
    scenario = busy(*faults, observer=observer)
    assert_same_outcome(traced(scenario), flown(scenario))


def test_flights_of_one_batch_do_not_touch_each_other():
    """Vehicles, sensors, seeds, faults differ; they are one structure; lanes are filled up."""
    sine = {"kind": "sine", "amplitude": 0.03, "start": 0.5}
    values = [
        (0.8, 0.0, "mems", [BIAS]),
        (1.0, 60.0, "ahrs", [{**BIAS, "value": 0.02}]),
        (1.25, 20.0, "tactical", [sine]),
        (1.0, 20.0, "mems", []),
    ]
    batch = []
    for seed, (factor, bandwidth, grade, faults) in enumerate(values):
        plant = {"motor_lag": True, "inertia_factor": factor, "motor_bandwidth": bandwidth}
        changes = {("plant",): plant, ("sensors",): {"grade": grade, "delay": 2}}
        document = busy(*faults, observer="threshold").document.replaced(changes, "test")
        batch.append(with_seed(build_scenario(document), seed))
    flights = [batch_flight(scenario) for scenario in batch]
    assert len({flight.structure for flight in with_common_faults(flights)}) == 1
    together = zip(fly_all(flights), JaxEngine(lanes=3).fly(flights), batch, strict=True)
    for outcome, other, scenario in together:
        assert_same_metrics(outcome, fly(scenario), scenario)
        assert_same_outcome(other, outcome)


def test_kinds_of_faults_have_one_order_whichever_flight_comes_first():
    kinds = ({"kind": "bias", "value": 0.01}, {"kind": "sine", "amplitude": 0.03}, {"kind": "stuck"})
    flights = [batch_flight(busy({**kind, "start": 1.0}, observer="threshold")) for kind in kinds]
    orders = [with_common_faults(each) for each in (flights, flights[::-1])]
    assert len({flight.structure for flown in orders for flight in flown}) == 1


SINGLE = """
import json, sys
from quadftc_campaign.batch.jax_engine import JaxEngine
from quadftc_campaign.batch.records import flight_record
from quadftc_campaign.flights import batch_flight
from quadftc_flight.scenario import parse_scenario
scenario = parse_scenario(sys.stdin.read())
(outcome,) = JaxEngine(float32=True).fly([batch_flight(scenario)])
print(json.dumps(flight_record(outcome)))
"""


@pytest.mark.thorough
@pytest.mark.parametrize("observer", ["sliding_mode", "supervised"])
def test_single_precision_is_near_double(observer):
    """In a process of its own, as one process has one precision."""
    scenario = busy(BIAS, observer=observer)
    double = flight_metrics(fly(scenario), scenario.fault_windows, scenario.fault_events)
    run = subprocess.run(
        [sys.executable, "-c", SINGLE],
        input=json.dumps(scenario.raw),
        capture_output=True,
        text=True,
        check=True,
    )
    one, other = json.loads(run.stdout), double["tracking_rmse_deg"]
    for axis in AXES:
        assert one[f"tracking_rmse_deg.{axis}"] == pytest.approx(other[axis], rel=1e-2)
        assert one[f"tracking_rmse_deg.{axis}"] != pytest.approx(other[axis], rel=1e-9)
    JaxEngine()
    with pytest.raises(ValueError, match="this process computes in float64"):
        JaxEngine(float32=True)


@pytest.mark.parametrize(("size", "usable"), [(0.9e6, True), (1.1e6, False), (np.nan, False)])
def test_a_flight_whose_motion_is_no_number_is_lost(size, usable):
    judge = Judge(schedule=schedule_of([]), delay=0)
    inputs = judge.example()
    motion = Motion(np.array([0.0, size, 0.0]), np.zeros(3), None)
    state, _ = judge.step(judge.init(inputs), inputs._replace(motion=motion), 0.004)
    assert state.tally.ever.unusable == (not usable)


def test_a_flight_in_which_a_law_restarts_is_not_finite():
    """It flies on, as in the graph."""
    restarting = with_observer(busy(observer="threshold"), Restarting)
    (outcome,) = fly_all([restarting])
    record = flight_record(outcome)
    assert not record["finite"]
    assert record["tracking_rmse_deg.roll"] < 10.0


def with_observer(scenario, kind):
    """The flight of a scenario with its fault observer changed."""
    flight = batch_flight(scenario)
    loop = flight.loop.loop
    observation = loop.observer.law
    fields = dataclasses.fields(observation.observer)
    law = kind(**{field.name: getattr(observation.observer, field.name) for field in fields})
    guarded = Guarded(dataclasses.replace(observation, observer=law))
    loop = dataclasses.replace(loop, observer=guarded)
    return flight._replace(loop=dataclasses.replace(flight.loop, loop=loop))


Threshold = fault_observers.get("threshold")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Restarting(Threshold):
    """Says what is no number while the attitude is tilted."""

    def step(self, state, inputs, dt):
        state, said = super().step(state, inputs, dt)
        tilted = abs(inputs.imu.q_xyzw[..., :1]) > 0.03
        return state, said._replace(fault=said.fault + np.inf * tilted * tilted)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Branching(Threshold):
    """Decides by data, so that nothing can trace it."""

    def step(self, state, inputs, dt):
        if inputs.imu.body_rate[0] > 0.0:
            return super().step(state, inputs, dt)
        return super().step(state, inputs, dt)


def test_a_law_that_cannot_be_traced_flies_in_numpy_and_says_so_once():
    scenario = busy(BIAS, observer="threshold")
    flight, said = with_observer(scenario, Branching), []
    compile_laws([flight.loop, flight.loop], said.append)
    assert sum("branching" in words for words in said if "compiling" not in words) == len(said) - 1
    assert any("law by law" in words for words in said)
    count = len(said)
    (outcome,) = fly_all([flight], log=said.append)
    assert len(said) == count
    assert_same_outcome(outcome, flown(scenario))
    with pytest.raises(ValueError, match=r"observer \(branching\) cannot be traced by JAX"):
        JaxEngine().fly([flight])
