"""The batch engine flies what the closed loop flies, and its tally says what the metrics say."""

import dataclasses
import functools
import json
import subprocess
import sys

import jax
import numpy as np
import pytest
from accusing_observer import registered
from batch_flights import AGREE, assert_same_flight, assert_same_metrics, stepped, traced

from quadftc_campaign.batch.engine import Engine
from quadftc_campaign.batch.loop_step import Row
from quadftc_campaign.batch.parts import structure_of, with_common_faults
from quadftc_campaign.batch.tally import Schedule, schedule_of, update_tally
from quadftc_campaign.flights import parts_of
from quadftc_control.controller import controllers
from quadftc_fdi.diagnosis import report_flight
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import NO_STATE
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.reported import note_reports
from quadftc_flight.scenario import (
    build_scenario,
    find_scenario,
    load_scenario,
    parse_scenario,
    with_seed,
)
from quadftc_model.arrays import rows_of
from quadftc_model.samples import AXES, FAULTY, HEALTHY, STARTING, ControllerOutput, FaultEstimate
from quadftc_model.staged_step import StagedStep
from quadftc_model.units import quantity
from quadftc_sim.fault import faults as fault_kinds

SHORTER = 0.2  # of the length of a scenario


def compiled(scenario, scheme=None, staged=None):
    (pair,) = traced([parts_of(scenario, scheme)], [scenario], Engine(staged=staged))
    return pair


def shortened(name):
    """A scenario with everything that happens in a fifth of the time."""
    path = find_scenario(name)
    document = load_scenario(path).raw
    changes = [f"duration={seconds(document['duration']) * SHORTER} s"]
    for kind in ("references", "disturbances", "faults"):
        for number, part in enumerate(document.get(kind, ())):
            times = {key: seconds(part[key]) for key in ("start", "stop", "rise", "fade") if key in part}
            changes += [f"{kind}.{number}.{key}={time * SHORTER} s" for key, time in times.items()]
    return load_scenario(path, changes)


def seconds(value):
    return quantity(value, "s")


@pytest.mark.parametrize(
    ("name", "scheme", "flown"),
    [
        ("paper_varying_disturbance", "proposed", compiled),
        *(
            pytest.param("mems_faults", "supervised", each, marks=pytest.mark.thorough)
            for each in (stepped, compiled)
        ),
    ],
)
def test_a_scenario_flies_as_in_the_closed_loop_to_its_end(name, scheme, flown):
    """The others have the same parts, or faults of `test_every_fault_on_every_channel_flies_alike`."""
    scenario = shortened(name)
    expected, (outcome, flight) = fly(scenario, scheme), flown(scenario, scheme)
    assert_same_flight(flight, expected)
    assert_same_metrics(outcome, expected, scenario)


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
  - {kind: ramp, rate: 0.0001, start: 1 s, stop: 3 s}
faults: []
schemes:
  tested: {observer: supervised, disturbance_observer: exosystem, controller: ismc}
"""


def busy(*faults, **parts):
    """A short flight with something of everything."""
    scenario = parse_scenario(
        BUSY, overrides=[f"schemes.tested.{role}={name}" for role, name in parts.items()]
    )
    document = scenario.document.replaced({("faults",): [dict(fault) for fault in faults]}, "test")
    return build_scenario(document)


def assert_flies_alike(scenario, flown=stepped):
    """Relative to what is there: some of these flights are wild."""
    expected, (outcome, flight) = fly(scenario), flown(scenario)
    assert_same_flight(flight, expected, rtol=1e-7)
    assert_same_metrics(outcome, expected, scenario)
    return expected


PARTS = {
    "observer": [name for name in fault_observers.names() if name != "supervised"],
    "controller": controllers.names(),
    "disturbance_observer": [
        f"{{kind: exosystem, model: {model}}}"
        for model in ("constant", "ramp", "harmonic", "constant+harmonic")
    ],
}


@pytest.mark.parametrize("flown", [stepped, pytest.param(compiled, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("place", range(len(PARTS["observer"])))
def test_every_observer_and_controller_flies_alike(place, flown):
    """Each in some flight; the scenarios have the others. That each compiles, the contract tests say."""
    parts = {role: names[place % len(names)] for role, names in PARTS.items()}
    assert_flies_alike(busy({"kind": "bias", "value": 0.03, "start": 1.0, "stop": 2.0}, **parts), flown)


def wandering():
    """A flight with the attitude of an AHRS."""
    sensor = {"grade": "ahrs", "attitude_wander_moving": 0.05, "delay": 1}
    return build_scenario(busy(observer="none").document.replaced({("sensors",): sensor}, "test"))


def with_plant(scenario, **options):
    return build_scenario(scenario.document.replaced({("plant",): options}, "test"))


@pytest.fixture(scope="module")
def flown_alone():
    """A flight without a trace: its scenario, its outcome, and what XLA made of it."""
    scenario = busy({"kind": "bias", "value": 0.03, "start": 1.0, "stop": 2.0})
    parts, events, engine = [parts_of(scenario)], [scenario.fault_events], Engine()
    compiled, _ = engine._prepare(parts, events, (), False)
    made = []

    def fly_as_compiled(*arguments):
        made.append(made[0] if made else stretch.lower(*arguments).compile())
        return made[0](*arguments)

    stretch, compiled.fly_stretch = compiled.fly_stretch, fly_as_compiled
    (outcome,) = engine.fly(parts, events)
    assert len(made) == 2
    return scenario, outcome, made[0].as_text()


@pytest.mark.thorough
def test_a_flight_alone_is_one_kernel_and_says_what_the_metrics_say(flown_alone):
    """The loop over its samples is compiled as a whole."""
    scenario, outcome, text = flown_alone
    assert 'xla_cpu_small_call="true"' in text
    assert_same_metrics(outcome, fly(scenario), scenario)


def test_a_vehicle_that_differs_from_its_model_flies_alike():
    factor = [0.8, 1.3, 1.1]
    expected = assert_flies_alike(
        with_plant(busy(observer="none"), motor_lag=True, motor_bandwidth=40.0, inertia_factor=factor)
    )
    nominal = fly(busy(observer="none"))
    there = nominal.disturbance != 0.0
    ratio = expected.disturbance[there] / nominal.disturbance[there]
    np.testing.assert_allclose(ratio, 1.0 / np.broadcast_to(factor, there.shape)[there], rtol=1e-12)


def test_vehicles_of_several_inertias_and_motors_are_one_structure():
    """So a campaign over them compiles once. Their attitude wanders."""
    values = [(0.8, 0.0), (1.0, 60.0), (1.25, 20.0)]
    batch = [
        with_plant(wandering(), motor_lag=True, inertia_factor=factor, motor_bandwidth=bandwidth)
        for factor, bandwidth in values
    ]
    parts = [parts_of(scenario) for scenario in batch]
    assert len({structure_of(flight.loop) for flight in parts}) == 1
    for scenario, (_, flight) in zip(batch, traced(parts, batch), strict=True):
        assert_same_flight(flight, fly(scenario))


@pytest.mark.thorough
def test_sensors_with_and_without_slow_errors_are_one_structure():
    base = busy(observer="none").document
    grades = [{"grade": name, "delay": 2} for name in ("mems", "ahrs", "tactical")]
    batch = [build_scenario(base.replaced({("sensors",): grade}, "test")) for grade in grades]
    parts = [parts_of(scenario) for scenario in batch]
    assert len({structure_of(flight.loop) for flight in parts}) == 1
    for scenario, (_, flight) in zip(batch, traced(parts, batch), strict=True):
        assert_same_flight(flight, fly(scenario))


def test_every_fault_on_every_channel_flies_alike():
    faults = [
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
    ]
    faults += [
        {"kind": "saturation", "channel": channel, "limit": limit, "start": 2.5, "duration": 0.5}
        for channel, limit in (("gyro", 0.05), ("accelerometer", 0.2))
    ]
    assert {fault["kind"] for fault in faults} == set(fault_kinds.names())
    assert_flies_alike(busy(*faults, observer="threshold"), compiled)


NOTHING_AT_FIRST = (
    {"kind": "nan", "start": 0.0, "stop": 0.4},
    {"kind": "dropout", "channel": "imu", "start": 0.0, "stop": 0.1},
    {"kind": "dropout", "channel": "imu", "start": 3.0, "stop": 3.5, "probability": 0.7},
)
NOTHING_AFTER_A_GAP = (
    {"kind": "dropout", "channel": "imu", "start": 1.0, "stop": 2.5},  # longer than anything is carried
    {"kind": "nan", "start": 2.4, "stop": 2.7},
)


@pytest.mark.parametrize(
    ("faults", "observer", "flown"),
    [
        (NOTHING_AT_FIRST, "sliding_mode", stepped),
        (NOTHING_AT_FIRST, "supervised", stepped),
        (NOTHING_AFTER_A_GAP, "sliding_mode", functools.partial(compiled, staged=False)),
    ],
)
def test_a_diagnosis_that_has_to_wait_for_a_sample_waits_alike(faults, observer, flown):
    expected = assert_flies_alike(busy(*faults, observer=observer), flown)
    assert np.any(expected.fault_state == STARTING)
    assert not np.all(expected.delivered)


def test_what_is_said_of_each_sensor_is_said_alike():
    bias = {"kind": "bias", "channel": "gyro", "axes": "x", "value": 0.3, "start": 1.0, "stop": 2.0}
    with registered() as observer:
        scenario = busy(*NOTHING_AT_FIRST, bias, observer=observer)
        expected, (outcome, flight) = fly(scenario), compiled(scenario)
        assert_same_flight(flight, expected, rtol=1e-7)
        assert_same_metrics(outcome, expected, scenario)
        rows = np.flatnonzero(flight.delivered)
        said = rows_of(jax.tree.map(np.asarray, outcome.trace.estimate), rows)
        note_reports(flight, report_flight(scenario.scheme(None).observer.law, flight.stamp_ns[rows], said))
    assert {HEALTHY, FAULTY, NO_STATE} <= set(np.unique(expected.gyro_state[:, 0]))
    for name in (
        "attitude_state",
        "gyro_state",
        "gyro_ambiguous",
        "accelerometer_state",
        "attitude_ambiguous",
    ):
        np.testing.assert_array_equal(getattr(flight, name), getattr(expected, name), err_msg=name)
    for name in ("gyro_estimate", "gyro_std_dev", "gyro_probability", "accelerometer_estimate"):
        found, wanted = getattr(flight, name), getattr(expected, name)
        np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=AGREE, err_msg=name)
    assert np.max(np.abs(flight.gyro_onset_ns - expected.gyro_onset_ns)) <= 1000  # ns


def test_a_staged_step_is_the_vmapped_step():
    """Products with constants, reductions, calls, a primitive without a rule, numbers that nothing needs."""
    import jax
    import jax.numpy as jnp

    matrix = np.array([[0.0, 2.0, 0.0], [1.0, 0.0, -1.0]])

    def step(state, inputs, common):
        used, unused = state
        dear = jnp.sin(jnp.exp(jnp.cos(used @ matrix.T * common).sum()))
        order = jnp.sort(used * inputs["a"] + dear).cumsum()
        table = jnp.stack([order, used, jnp.where(used > 0.0, dear, order)])
        spread = table.max(axis=0) - table.min(axis=0)
        return (spread @ table.T + dear**2, unused + inputs["b"]), (matrix @ table.T, (used > 0.0).any())

    draws = np.random.default_rng(0).standard_normal
    state, inputs = (draws((3, 7)), draws((2, 7))), {"a": draws((3, 7)), "b": draws((2, 7))}
    arguments = (state, inputs, 0.3)
    with jax.enable_x64(True):
        one = jax.tree.map(lambda leaf: leaf[..., 0], (state, inputs))
        staged = StagedStep(step, *one, 0.3, shown=lambda state: state[0])
        expected = jax.vmap(step, in_axes=(-1, -1, None), out_axes=-1)(*arguments)
        found = jax.jit(staged)(*arguments)
    assert staged.needed == {"a": True, "b": False}
    np.testing.assert_array_equal(found[0][1], state[1])  # nobody reads it: it stays
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12),
        (found[0][0], found[1]),
        (expected[0][0], expected[1]),
    )


def test_kinds_of_faults_have_one_order_whichever_flight_comes_first():
    kinds = ({"kind": "bias", "value": 0.01}, {"kind": "sine", "amplitude": 0.03}, {"kind": "stuck"})
    parts = [parts_of(busy({**kind, "start": 1.0}, observer="threshold")) for kind in kinds]
    orders = [with_common_faults(each) for each in (parts, parts[::-1])]
    assert len({structure_of(flight.loop) for flights in orders for flight in flights}) == 1


def test_flights_of_one_batch_do_not_touch_each_other():
    """Seeds, values and kinds of faults differ; lanes are filled up; each is as it would be alone."""
    batch = [
        with_seed(
            busy({"kind": "bias", "value": 0.01 * (index + 1), "start": 1.0}, observer="threshold"), index
        )
        for index in range(2)
    ]
    batch.append(busy({"kind": "sine", "amplitude": 0.03, "start": 0.5}, observer="threshold"))
    batch.append(busy(observer="threshold"))
    parts = [parts_of(scenario) for scenario in batch]
    together = traced(parts, batch, Engine(lanes=3))
    assert len({structure_of(flight.loop) for flight in with_common_faults(parts)}) == 1
    for scenario, (outcome, flight) in zip(batch, together, strict=True):
        expected = fly(scenario)
        assert_same_flight(flight, expected)
        assert_same_metrics(outcome, expected, scenario)


SINGLE = """
import json, sys
from quadftc_campaign.batch.engine import Engine
from quadftc_model.staged_step import StagedStep
from quadftc_campaign.batch.records import flight_record
from quadftc_campaign.flights import parts_of
from quadftc_flight.scenario import parse_scenario
scenario = parse_scenario(sys.stdin.read())
(outcome,) = Engine(float32=True).fly([parts_of(scenario)], [scenario.fault_events])
print(json.dumps(flight_record(outcome)))
"""


@pytest.mark.parametrize("observer", ["sliding_mode", pytest.param("supervised", marks=pytest.mark.thorough)])
def test_single_precision_is_near_double(observer):
    """In a process of its own, as one process has one precision."""
    scenario = busy({"kind": "bias", "value": 0.03, "start": 1.0, "stop": 2.0}, observer=observer)
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
    Engine()
    with pytest.raises(ValueError, match="this process computes in float64"):
        Engine(float32=True)


@pytest.mark.parametrize(("size", "usable"), [(0.9e6, True), (1.1e6, False), (np.nan, False)])
def test_a_flight_with_an_unusable_estimate_is_marked(size, usable):
    """There the closed loop would restart the law."""
    zero, no = np.zeros(3), np.zeros(3, dtype=bool)
    estimate = FaultEstimate(zero, zero, np.zeros(3), zero, None)
    output = ControllerOutput(zero, zero, zero, no)
    row = Row(0.0, np.True_, *[zero] * 7, estimate, np.array([0.0, size, 0.0]), output)
    schedule = Schedule(*(times[..., 0] for times in schedule_of([[]])[:4]))
    assert update_tally(None, row, schedule).ever["unusable"] == (not usable)


def test_a_part_that_asks_for_its_numbers_is_refused_by_name():
    scenario = busy(observer="none")
    parts = [parts_of(with_seed(scenario, seed)) for seed in range(2)]

    @dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
    class Branching(type(parts[0].loop.controller)):
        def step(self, state, inputs, dt):
            if inputs.imu.body_rate[0] > 0.0:
                return super().step(state, inputs, dt)
            return super().step(state, inputs, dt)

    branching = Branching(vehicle=parts[0].loop.controller.vehicle)
    wrong = [
        dataclasses.replace(flight, loop=dataclasses.replace(flight.loop, controller=branching))
        for flight in parts
    ]
    with pytest.raises(ValueError, match=r"controller \(Branching\).*cannot be flown in a batch"):
        Engine().fly(wrong, [(), ()])
