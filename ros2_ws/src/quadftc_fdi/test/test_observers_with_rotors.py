"""Observers that know the rotors: one answer, whether a rotor or a sensor fails."""

import functools

import jax
import numpy as np
import pytest
from in_c import as_flown, fly_law

from quadftc_fdi.fault_observers.bank import BankObserver
from quadftc_fdi.fault_observers.isolating import Isolating
from quadftc_model.rotations import turn
from quadftc_model.samples import ALARMS, NO_PLACE, FaultObserverInputs, RotorReading, level_sample
from quadftc_model.vehicle import load_vehicle

DT, BEGIN = 0.004, 800  # s; the sample at which faults begin
VEHICLE = load_vehicle("x500")
ROTORS, SENSORS = VEHICLE.rotors, ("attitude", "gyro", "accelerometer")
LAG = np.exp(-DT / ROTORS.time_constant)


def flight(count, loss=lambda t: 0.0, change=lambda t, sample: sample, speeds=False, seed=1, off=()):
    """Inputs of a vehicle in gusts that holds itself level, its rotors behind their lag.

    ``off`` are the rotors that run down from `BEGIN` on.
    """
    rng, inputs = np.random.default_rng(seed), []
    allocate, hover = VEHICLE.force_allocation, VEHICLE.hover_speed
    q_xyzw, rate, gust = level_sample().q_xyzw, np.zeros(3), np.zeros(3)
    speed = command = np.full(4, hover)
    for index in range(count):
        time = (index - BEGIN) * DT
        gust = gust * (1.0 - DT) + 0.5 * np.sqrt(2.0 * DT) * rng.standard_normal(3) * [1.0, 1.0, 0.1]
        asked = np.where(np.isin(np.arange(4), off) & (time >= 0.0), 0.0, command)
        before, speed = speed, asked + LAG * (speed - asked)
        kick = -ROTORS.rotor_inertia * np.sum(ROTORS.spin_sign * (speed - before)) / DT
        wrench = VEHICLE.effectiveness @ (ROTORS.thrust_coefficient * speed**2 * (1.0 - loss(time)))
        rate = rate + DT * ((wrench[1:] + kick * np.eye(3)[2]) / VEHICLE.inertia + gust)
        q_xyzw = turn(q_xyzw, DT * rate)
        attitude = turn(q_xyzw, np.radians(0.1) * rng.standard_normal(3))
        force = [0.0, 0.0, wrench[0] / VEHICLE.mass] + 0.02 * rng.standard_normal(3)
        sample = level_sample()._replace(
            q_xyzw=attitude, body_rate=rate + 0.002 * rng.standard_normal(3), specific_force=force
        )
        sample = change(time, sample) if index >= BEGIN else sample
        told = VEHICLE.effectiveness @ (ROTORS.thrust_coefficient * command**2)
        rotors = RotorReading(command, speed, np.bool_(speeds))
        inputs.append(FaultObserverInputs(sample, told[1:], told[0], NO_PLACE, rotors))
        wanted = VEHICLE.inertia * (-40.0 * 2.0 * q_xyzw[:3] - 10.0 * rate)
        thrusts = allocate @ np.append(VEHICLE.weight, wanted)
        command = np.sqrt(np.clip(thrusts, 0.2, 8.5) / ROTORS.thrust_coefficient)
    return inputs


def diagnose(inputs, observer=Isolating):
    """Estimates of a flight."""
    return [each.said for each in fly_law(*as_flown(observer(vehicle=VEHICLE), inputs), DT)[1]]


def verdicts(estimates):
    """All that is named in some estimates, each once, in order."""
    found = {}
    for each in estimates:
        parts = {name: getattr(each.sensors, name).state for name in SENSORS} | {"rotor": each.rotors.state}
        for name, state in parts.items():
            found |= dict.fromkeys(f"{name} {index}" for index in np.flatnonzero(np.isin(state, ALARMS)))
    return list(found)


def one_rotor(index, size):
    """A loss of one rotor from `BEGIN` on."""
    return lambda t: size * (np.arange(4) == index) * (t >= 0.0)


WEAK = {0: (0.15, False), 2: (0.4, True), 3: (0.7, False)}  # rotor, its loss, whether speeds are measured
SENSOR_FAULTS = {
    "gyro 0": lambda t, sample: sample._replace(body_rate=sample.body_rate + 0.3 * np.eye(3)[0]),
    "gyro 1": lambda t, sample: sample._replace(body_rate=sample.body_rate * (1.0 - np.eye(3)[1])),
    "accelerometer 2": lambda t, sample: sample._replace(
        specific_force=sample.specific_force - 2.0 * np.eye(3)[2]
    ),
}
FLIGHTS = {  # by name, and whether speeds are measured
    **{(f"weak {index}", speeds): {"loss": one_rotor(index, size)} for index, (size, speeds) in WEAK.items()},
    **{("off", speeds): {"count": BEGIN + 60, "off": (1,)} for speeds in (False, True)},
    ("back", False): {"count": BEGIN + 300, "loss": lambda t: 0.4 * (np.arange(4) == 1) * (0.0 <= t < 0.5)},
    **{(name, False): {"count": BEGIN + 100, "change": change} for name, change in SENSOR_FAULTS.items()},
    ("healthy", False): {"count": BEGIN},
}


@functools.cache
def inputs_of(key):
    """Inputs of one of the flights."""
    return flight(**{"count": BEGIN + 260, **FLIGHTS[key], "speeds": key[1]})


@pytest.fixture(scope="module", params=[Isolating, BankObserver])
def flown(request):
    """Estimates of all flights, by each observer."""
    return {key: diagnose(inputs_of(key), request.param) for key in FLIGHTS}


@pytest.mark.parametrize("index", WEAK)
def test_weak_rotor_is_named_and_no_sensor_is(flown, index):
    size, speeds = WEAK[index]
    estimates = flown[f"weak {index}", speeds]
    assert verdicts(estimates[: BEGIN + 25]) == [f"rotor {index}"]  # 0.1 s
    assert verdicts(estimates) == [f"rotor {index}"]
    assert estimates[-1].rotors.effectiveness[index] == pytest.approx(1.0 - size, abs=0.03)
    weak = estimates[-1].rotors.effectiveness
    np.testing.assert_array_equal(np.delete(weak, index), 1.0)


@pytest.mark.parametrize("speeds", [False, True])
def test_rotor_that_is_off_is_named_and_no_sensor_is(flown, speeds):
    estimates = flown["off", speeds]
    assert verdicts(estimates[: BEGIN + 15]) == ["rotor 1"]  # 60 ms
    assert verdicts(estimates) == ["rotor 1"]
    assert estimates[-1].rotors.effectiveness[1] < 0.1


def test_rotor_that_is_back_is_no_fault_of_a_sensor(flown):
    estimates = flown["back", False]
    assert verdicts(estimates) == ["rotor 1"]
    assert verdicts(estimates[-1:]) == []


@pytest.mark.parametrize("named", SENSOR_FAULTS)
def test_faulty_sensor_is_named_and_no_rotor_is(flown, named):
    estimates = flown[named, False]
    assert verdicts(estimates[: BEGIN + 40]) == [named]
    assert not any(word.startswith("rotor") for word in verdicts(estimates))


def test_healthy_flight_names_nothing_and_without_rotors_nothing_is_said_of_them(flown):
    assert verdicts(flown["healthy", False]) == []
    assert diagnose([each._replace(rotors=None, position=None) for each in flight(10)])[-1].rotors is None


@pytest.mark.parametrize("observer", [Isolating, BankObserver])
def test_weak_rotor_is_named_without_a_gyro(observer):
    blind = {"rate_valid": np.bool_(False), "body_rate": np.zeros(3)}
    inputs = flight(BEGIN + 260, one_rotor(2, 0.4), lambda t, sample: sample._replace(**blind))
    assert verdicts(diagnose(inputs, observer)) == ["gyro 0", "gyro 1", "gyro 2", "rotor 2"]


@pytest.mark.thorough  # one by one: test_fault_observer_contract.py and test_c_equals_numpy.py
@np.errstate(all="ignore")  # as the runner of a law
def test_batch_in_numpy_gives_the_numbers_of_a_flight_in_c():
    law, state = Isolating(vehicle=VEHICLE), None
    alone = diagnose(inputs_of(("weak 2", True)))
    for index, inputs in enumerate(flight(BEGIN + 30, one_rotor(2, 0.4), speeds=True)):
        pair = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), inputs)
        state, found = law.step(law.init(pair) if state is None else state, pair, DT if index else 0.0)
        one = alone[index]
        for columns, value in zip(found.rotors, one.rotors, strict=True):
            np.testing.assert_allclose(columns, [value, value], rtol=1e-9, atol=1e-12)
    assert np.isin(one.rotors.state, ALARMS).any()
