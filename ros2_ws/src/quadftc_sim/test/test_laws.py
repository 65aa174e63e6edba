"""What every law of this package keeps: structure, batches, the same in JAX; and the laws of an injection."""

import jax
import numpy as np
import pytest
from law_contract import assert_alike, assert_contract, structure
from sampling import sampled

from quadftc_model.composition import PlainCalls
from quadftc_model.numbers import numbers_of, with_numbers
from quadftc_model.parameters import build, parameters_of
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import vehicle_from
from quadftc_sim.barometer import Barometer
from quadftc_sim.disturbance import disturbances
from quadftc_sim.fault import faults
from quadftc_sim.injection import make_injection
from quadftc_sim.injector import (
    ChannelFault,
    ChannelInputs,
    FaultDraws,
    FaultInjector,
    RotorInputs,
    RotorsFault,
    Split,
    begin,
    inject,
    laws_of,
)
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.plant import plants
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.rotor_fault import healthy_rotors, rotor_faults
from quadftc_sim.sensor_draws import SensorDraws
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_sim.vehicle_simulation import VehicleInputs
from quadftc_sim.wind import winds

DT, COUNT, LANES = 0.004, 8, 3
PERIOD_NS = 4_000_000
TIMES = np.linspace(0.0, 6.0, 13)
TIMES.setflags(write=False)


def sized(registry, kind, **values):
    """A component whose vectors have an amount that is not zero."""
    vectors = [spec.name for spec in parameters_of(registry.get(kind)) if spec.is_vector]
    return build(registry.get(kind), {**dict.fromkeys(vectors, 0.3), **values})


def samples(lane):
    """Samples of an IMU that moves."""
    there, rng = np.bool_(True), np.random.default_rng(lane)
    for _ in range(COUNT):
        angles, rate, force = rng.uniform(-0.5, 0.5, (3, 3))
        yield ImuSample(quaternion_from_euler(angles), rate, force, there, there, there)


def channel_inputs(injection, lane):
    """What a fault sees of samples; it begins at the fourth."""
    rng, found = np.random.default_rng(100 + lane), []
    for index, sample in enumerate(samples(lane)):
        channel = getattr(Split().step((), sample, 0.0)[1], injection.channel)
        draws = FaultDraws(rng.standard_normal(3), rng.random(3)) if injection.law.is_random else None
        time, dt = np.float64(index * DT), np.float64(DT if index else 0.0)
        found.append(ChannelInputs(channel, time, dt, draws))
    return found


def fault(kind, **values):
    """A fault on two axes, from the fourth sample on."""
    law = faults.get(kind)
    vectors = [spec.name for spec in parameters_of(law) if spec.is_vector]
    axes = {} if law.whole_channel else {"axes": ["x", "z"]}
    given = {**dict.fromkeys(vectors, 0.3), **axes, "channel": "gyro", "start": 3 * DT, **values}
    return make_injection(kind, given).for_period(DT)


@pytest.mark.parametrize("kind", faults.names())
def test_every_fault_keeps_the_contract(kind):
    injection = fault(kind, **({"delay": 2 * DT} if kind == "delay" else {}))
    lanes = [channel_inputs(injection, lane) for lane in range(LANES)]
    assert_contract(ChannelFault(injection), lanes)


@pytest.mark.parametrize("kind", rotor_faults.names())
def test_every_rotor_fault_keeps_the_contract(kind):
    amounts = {spec.name: spec.high for spec in parameters_of(rotor_faults.get(kind)) if spec.high < np.inf}
    values = {"channel": "rotor", "rotors": [1, 3], "start": 3 * DT, **amounts}
    injection = make_injection(kind, values, rotors=4)
    condition = healthy_rotors(np.zeros(4))
    sequence = [RotorInputs(condition, np.float64(index * DT)) for index in range(COUNT)]
    assert_contract(RotorsFault(injection), [sequence] * LANES)


EVERY_PUSH = pytest.mark.parametrize(
    ("registry", "kind"), [(each, kind) for each in (disturbances, winds) for kind in each.names()]
)


@EVERY_PUSH
def test_every_disturbance_and_wind_is_the_same_for_many_times_and_in_jax_with_its_numbers_unknown(
    registry, kind
):
    law = sized(registry, kind, start=2.0, stop=5.0)
    loop = np.array([law.at(float(time)) for time in TIMES])
    assert (loop.shape, loop.dtype) == ((len(TIMES), 3), np.float64)
    assert np.all(np.isfinite(loop))
    assert np.any(loop != 0.0)
    np.testing.assert_allclose(law.at(TIMES), loop, rtol=1e-12, atol=1e-14)
    with jax.enable_x64(True):
        unknown = jax.jit(lambda values, time: with_numbers(law, values).at(time))
        np.testing.assert_allclose(unknown(numbers_of(law), TIMES), loop, rtol=1e-12, atol=1e-13)


@EVERY_PUSH
def test_disturbance_or_wind_acts_from_start_inclusive_to_stop_exclusive(registry, kind):
    law = sized(registry, kind, start=2.0, stop=3.0)
    acting = [bool(np.any(law.at(time) != 0.0)) for time in (1.999, 2.001, 2.999, 3.0, 9.0)]
    assert acting == [False, True, True, False, False]
    np.testing.assert_array_equal(law.at(2.0), law.shape(np.zeros(1)))


@EVERY_PUSH
@pytest.mark.parametrize("stop", [2.0, 1.0])
def test_window_that_ends_before_it_starts_is_refused(registry, kind, stop):
    with pytest.raises(ValueError, match=f"stop = {stop:g} s: must be later than start = 2 s"):
        build(registry.get(kind), {"start": 2.0, "stop": stop})


def vehicle(kind, grade, **options):
    """A vehicle in wind and disturbance with all the sensors that it can have."""
    frame = load_vehicle("x500")
    sine = sized(disturbances, "sine", amplitude=list(frame.inertia))
    imu = build(ImuSensor, GRADES[grade])
    if not plants.get(kind).flies:
        return vehicle_from(plants.get(kind)(vehicle=frame, disturbances=(sine,), **options), imu, PERIOD_NS)
    air = (sized(winds, "dryden"), sized(winds, "gust"))
    plant = plants.get(kind)(vehicle=frame, disturbances=(sine,), winds=air, start=(0.0, 0.0, 0.2), **options)
    place = PositionSensor(rate=100.0, delay=0.008, noise=(0.1, 0.1, 0.2), wander=(1.0, 1.0, 1.0))
    others = Magnetometer(rate=50.0, noise=1e-7), Barometer(rate=125.0, noise=1.0, wander=10.0)
    return vehicle_from(plant, imu, PERIOD_NS, place, *others)


def vehicle_inputs(law, lane):
    """Inputs of a vehicle under a command that varies, with a weak rotor in free flight."""
    random, rng, found = SensorDraws(lane), np.random.default_rng(200 + lane), []
    first, rotors = random.first(law.due(0)), None
    for index in range(COUNT):
        due, plant = law.due(index), law.plant
        command = rng.uniform(-0.1, 0.1, 3)
        if plant.flies:
            command = plant.first_command * rng.uniform(0.5, 1.2, plant.command_size)
            weak = np.array([1.0, 0.7, 1.0, 1.0])
            rotors = healthy_rotors(command)._replace(effectiveness=weak, unbalance=1e-6 * weak)
        before, now = np.float64(max(index - 1, 0) * DT), np.float64(index * DT)
        found.append(VehicleInputs(command, rotors, before, now, due, random.sample(due), first))
    return found


VEHICLES = [
    ("test_stand", {}),
    ("test_stand", {"motor_lag": True, "substeps": 2}),
    ("free_flight", {}),
    ("free_flight", {"motor_lag": False, "ground": False}),
]


@pytest.mark.parametrize(("grade", "chosen"), sampled(GRADES, VEHICLES, every=5))
def test_every_vehicle_keeps_the_contract(grade, chosen):
    kind, options = chosen
    law = vehicle(kind, grade, **options)
    assert_contract(law, [vehicle_inputs(law, lane) for lane in range(LANES)], rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("kind", plants.names())
def test_vehicle_does_not_move_without_time(kind):
    law = vehicle(kind, "ideal")
    inputs = law.example()
    motion = law.init(inputs).motion
    after = law.step(law.init(inputs), inputs, 0.0)[0].motion
    for before, now in zip(motion[:2], after[:2], strict=True):
        np.testing.assert_array_equal(now, before)


def test_example_is_what_the_law_takes():
    for kind in ("test_stand", "free_flight"):
        law = vehicle(kind, "ahrs")
        assert structure(law.example()) == structure(vehicle_inputs(law, 0)[0])


INJECTIONS = [
    ("bias", {"value": "5 deg", "start": 2 * DT, "axis": "roll"}),
    ("delay", {"delay": 2 * DT, "channel": "gyro", "start": 4 * DT}),
    ("delay", {"delay": 3 * DT, "channel": "attitude", "stop": 12 * DT}),
    ("noise", {"sigma": 0.1, "channel": "gyro", "axes": ["x"]}),
    ("spikes", {"amplitude": 1.0, "rate": 100.0, "channel": "accelerometer", "start": 3 * DT}),
    ("stuck", {"channel": "accelerometer", "start": 9 * DT}),
    ("dropout", {"channel": "imu", "probability": 0.3}),
    ("loss", {"rotors": [2], "value": 0.4, "rise": 0.02, "start": 3 * DT}),
    ("off", {"rotors": [1], "start": 5 * DT, "stop": 9 * DT}),
]


def test_injector_gives_bit_for_bit_what_the_pure_step_gives():
    injections = [make_injection(kind, values, rotors=4) for kind, values in INJECTIONS]
    injector, drawing = (FaultInjector(5, injections, rotors=4) for _ in range(2))
    prepared = [each.for_period(DT) for each in injections]
    calls, healthy = PlainCalls(laws_of(prepared)), healthy_rotors(np.zeros(4))
    states = begin(calls, prepared)
    for index, sample in enumerate([*samples(1), *samples(2)]):
        stamp_ns, time = index * PERIOD_NS, index * PERIOD_NS / 1e9
        found = injector.apply(stamp_ns, sample)
        # numbers are drawn for those that run
        running = {n for n, each in enumerate(injections, 1) if each.start <= time < each.stop}
        draws = [
            scheduled.draw() if number in running else FaultDraws(np.zeros(3), np.zeros(3))
            for number, scheduled in drawing._scheduled.items()
        ]
        dt = DT if index else 0.0
        states, expected = inject(calls, prepared, states, sample, healthy, time, dt, draws)
        assert_alike(found, expected, rtol=0.0, atol=0.0)


def test_delay_counts_the_samples_of_the_first_time_step():
    injector = FaultInjector(0, [make_injection("delay", {"delay": 0.01, "channel": "gyro"})])
    stamps = np.cumsum([0, *[4_000_000] * 3, 9_000_000, 1_000_000, 4_000_000, 4_000_000])
    rates = [sample.body_rate for sample in samples(3)]
    found = [
        injector.apply(int(stamp), sample).sample.body_rate
        for stamp, sample in zip(stamps, samples(3), strict=True)
    ]
    np.testing.assert_array_equal(found, [rates[max(index - 3, 0)] for index in range(COUNT)])


class Engine:
    """An engine with laws that are ready, and others."""

    def __init__(self, ready):
        self.ready, self.made = ready, []

    def __call__(self, law):
        from quadftc_model.stepper import NumpyRunner

        self.made.append(type(law).__name__)
        return NumpyRunner(law)

    def is_ready(self, law, inputs):
        return self.ready


@pytest.mark.parametrize("ready", [False, True])
def test_fault_that_comes_later_does_not_wait_for_a_compiler(ready):
    bias = make_injection("bias", {"value": 0.1, "channel": "gyro"})
    engine = Engine(ready)
    injector = FaultInjector(0, [bias], engine=engine)
    assert engine.made == ["Split", "Join", "ChannelFault"]
    injector.add(bias)
    assert engine.made == ["Split", "Join", "ChannelFault", *["ChannelFault"] * ready]
    for index, sample in enumerate(samples(0)):
        found = injector.apply(index * PERIOD_NS, sample)
        np.testing.assert_allclose(found.gyro, 0.2, rtol=1e-12)
