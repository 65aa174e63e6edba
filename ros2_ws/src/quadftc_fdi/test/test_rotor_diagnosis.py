"""Rotor diagnosis by itself: what gyro and accelerometer say of the effectiveness of each rotor."""

import dataclasses

import numpy as np
import pytest
from in_c import fly_law
from law_contract import assert_contract, outputs_of

from quadftc_fdi.rotor_diagnosis.monitor import RotorInputs, estimate_rotors, start_rotors, step_rotors
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects, RotorModel, effects_of, model_of
from quadftc_model.samples import ALARMS, FAULT_KINDS, STARTING
from quadftc_model.vehicle import load_vehicle

DT, BEGIN = 0.004, 800  # s; the sample at which faults begin
MEMS = 0.002, 0.02  # rad/s, m/s²; noise of gyro and accelerometer
QUAD = model_of(load_vehicle("x500"))


def ring(count, first=0.0):
    """A model with rotors on a circle, spinning alternately; its unit is hover thrust."""
    angle = first + 2.0 * np.pi * np.arange(count) / count
    sign = np.where(np.arange(count) % 2, 1.0, -1.0)
    arms = np.stack([40.0 * np.sin(angle), -40.0 * np.cos(angle), 1.5 * sign]) * 4.0 / count
    return RotorModel(arms, np.full(count, 9.80665 / count))


MODELS = {"quad": QUAD, "hexa": ring(6), "octo": ring(8, np.pi / 8)}


def flight(model, loss=lambda t: 0.0, count=1800, seed=1, gusts=0.5, torque=(4.0, -2.0, 0.1), change=None):
    """Inputs of a vehicle in gusts [rad/s²] whose rotors counter them, of a wrong centre of mass."""
    rng, n = np.random.default_rng(seed), model.force.shape[0]
    rows = effects_of(model).rows
    hover = float(effects_of(model).hover)
    allocate = np.linalg.pinv(rows)
    rate, wind, inputs = np.zeros(3), np.zeros(4), []
    for index in range(count):
        wind = wind * (1.0 - DT) + np.sqrt(2.0 * DT) * rng.standard_normal(4) * [
            gusts,
            gusts,
            0.1 * gusts,
            0.1,
        ]
        lost = np.asarray(loss((index - BEGIN) * DT)) * np.ones(n)
        wanted = np.append(-np.array(torque) - wind[:3] - 8.0 * rate, 0.0)
        thrusts = hover + allocate @ wanted
        acts = rows @ (thrusts * (1.0 - lost)) + wind + np.append(torque, 0.0)
        rate = rate + DT * acts[:3]
        read, force = rate + MEMS[0] * rng.standard_normal(3), acts[3] + MEMS[1] * rng.standard_normal()
        if change is not None and index >= BEGIN:
            read, force = change((index - BEGIN) * DT, read, force)
        seen = thrusts, read, np.zeros(3), np.float64(force), np.zeros(3), np.False_, thrusts
        inputs.append(RotorInputs(*seen, measured=np.False_))
    return inputs


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """The diagnosis as a law."""

    effects: Effects

    def init(self, inputs):
        return start_rotors(self.effects, inputs)

    def step(self, state, inputs, dt):
        state = step_rotors(state, self.effects, inputs, DT)
        return state, estimate_rotors(state)


def diagnose(model, inputs):
    """Estimates of a flight, in C."""
    return fly_law(Diagnosis(effects_of(model)), inputs, DT)[1]


def named(estimates):
    """Whether each rotor is named, (samples, n)."""
    return np.isin(np.stack([each.state for each in estimates]), ALARMS)


def one_rotor(model, index, size):
    """A loss of one rotor from `BEGIN` on."""
    return lambda t: size * (np.arange(model.force.shape[0]) == index) * (t >= 0.0)


@pytest.mark.parametrize(("layout", "size"), [("quad", 0.15), ("quad", 1.0), ("hexa", 0.4), ("octo", 1.0)])
def test_rotor_that_loses_thrust_is_named_and_its_loss_measured(layout, size):
    model = MODELS[layout]
    index = round(10 * size) % model.force.shape[0]
    estimates = diagnose(model, flight(model, one_rotor(model, index, size), 1060))
    faulty = named(estimates)
    assert not np.delete(faulty, index, axis=1).any()
    assert BEGIN <= np.argmax(faulty[:, index]) < BEGIN + (25 if size > 0.2 else 100)  # 0.1 s, 0.4 s
    last = estimates[BEGIN + 250]
    assert abs(last.effectiveness[index] - (1.0 - size)) < (0.06 if layout == "octo" else 0.03)
    assert abs(last.effectiveness[index] - (1.0 - size)) < 4.0 * last.std_dev[index] < 0.2
    assert last.onset_age[index] == pytest.approx(1.0, abs=0.03)
    assert FAULT_KINDS[last.kind[index]] == ("off" if size == 1.0 else "loss")


def test_rotor_is_named_without_an_accelerometer():
    inputs = flight(QUAD, one_rotor(QUAD, 2, 0.3), 1060, change=lambda t, read, force: (read, force + 10.0))
    inputs = [*inputs[:BEGIN], *(each._replace(deaf=np.True_) for each in inputs[BEGIN:])]
    faulty = named(diagnose(QUAD, inputs))
    assert BEGIN <= np.argmax(faulty[:, 2]) < BEGIN + 25
    assert not np.delete(faulty, 2, axis=1).any()


def stand_in(inputs, std_dev):
    """Rates that are not the gyro's from half a second before `BEGIN` on: they err for 0.1 s."""
    rng, error, told = np.random.default_rng(5), np.zeros(3), list(inputs)
    for index in range(BEGIN - 125, len(inputs)):
        error = error * (1.0 - 10.0 * DT) + std_dev * np.sqrt(20.0 * DT) * rng.standard_normal(3)
        told[index] = inputs[index]._replace(rate=inputs[index].rate + error, vague=np.full(3, std_dev**2))
    return told


@pytest.mark.parametrize("layout", ["quad", "hexa"])
def test_rotor_is_named_by_a_rate_that_stands_in_for_the_gyro(layout):
    model = MODELS[layout]
    estimates = diagnose(model, stand_in(flight(model, one_rotor(model, 2, 0.3), 1400), 0.2))
    faulty, last = named(estimates), estimates[-1]
    assert BEGIN + 10 < np.argmax(faulty[:, 2]) < BEGIN + 125  # later than by a gyro, within 0.5 s
    assert not faulty[:BEGIN].any()
    assert not np.delete(faulty[-1], 2).any()
    assert abs(last.effectiveness[2] - 0.7) < 4.0 * last.std_dev[2] < 0.4


@pytest.mark.parametrize("layout", ["quad", "hexa"])
def test_rate_that_stands_in_blames_no_rotor(layout):
    model = MODELS[layout]
    assert not named(diagnose(model, stand_in(flight(model, count=1400), 0.2))).any()


def test_push_is_no_rotor_without_a_gyro():
    pushed = flight(QUAD, count=1100, change=lambda t, read, force: (read, force - 2.0))
    assert not named(diagnose(QUAD, stand_in(pushed, 0.2))).any()


def test_ambiguous_rotor_is_told_by_later_residuals():
    model = MODELS["octo"]
    told = stand_in(flight(model, one_rotor(model, 3, 0.4), 1400), 0.5)
    vague = diagnose(model, told)
    better = told[: BEGIN + 100] + flight(model, one_rotor(model, 3, 0.4), 1400)[BEGIN + 100 :]
    settled = diagnose(model, better)
    assert any(estimate.ambiguous.any() for estimate in vague[BEGIN : BEGIN + 100])
    assert np.flatnonzero(named(settled)[-1]).tolist() == [3]
    assert not settled[-1].ambiguous.any()


def test_rotor_that_recovers_is_healthy_again():
    estimates = diagnose(QUAD, flight(QUAD, lambda t: 0.3 * np.eye(4)[2] * (0.0 <= t < 1.0), 1350))
    assert named(estimates)[BEGIN + 200, 2]
    assert not named(estimates)[-1].any()


@pytest.mark.parametrize("scale", [0.7, 1.3])
def test_wrong_inertia_thrust_and_centre_of_mass_are_no_fault(scale):
    wrong = RotorModel(QUAD.angular * np.array([[scale], [2.0 - scale], [1.0]]), QUAD.force * 1.1)
    for seed in range(2):
        assert not named(diagnose(wrong, flight(QUAD, count=1800, seed=seed))).any()


SENSOR_FAULTS = {
    "gyro x": lambda t, rate, force: (rate + 0.3 * np.eye(3)[0], force),
    "gyro": lambda t, rate, force: (rate + 0.3, force),
    "gyro drifts": lambda t, rate, force: (rate + 0.5 * t * np.eye(3)[1], force),
    "accelerometer": lambda t, rate, force: (rate, force - 2.0),
}


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
def test_sensor_fault_is_no_fault_of_a_rotor(fault):
    assert not named(diagnose(QUAD, flight(QUAD, count=1100, change=SENSOR_FAULTS[fault]))).any()


@pytest.mark.parametrize("push", [(6.0, 0.0, 0.0, 0.0), (4.0, 4.0, 0.0, 0.0), (0.0, 0.0, 0.0, -3.0)])
def test_step_of_the_wind_is_no_fault_of_a_rotor(push):
    turned = np.array(push[:3])
    change = lambda t, rate, force: (rate + turned * min(t, 0.5), force + push[3])  # noqa: E731
    assert not named(diagnose(QUAD, flight(QUAD, count=1100, change=change))).any()


def test_rotor_is_not_judged_before_something_is_learned():
    estimates = diagnose(QUAD, flight(QUAD, count=300))
    assert np.all(estimates[250].state == STARTING)


def measured(inputs, speeds):
    """The same with measured thrusts: what they shall be is known beside."""
    return [
        each._replace(thrusts=speeds(index, each.thrusts), measured=np.True_)
        for index, each in enumerate(inputs)
    ]


@pytest.mark.parametrize(("thrust", "kind"), [(0.0, "off"), (2.5, "stuck")])
def test_rotor_that_does_not_follow_its_command_is_named(thrust, kind):
    def speeds(index, wanted):
        return np.where((np.arange(4) == 1) & (index >= BEGIN), thrust, wanted)

    inputs = flight(QUAD, lambda t: np.eye(4)[1] * (1.0 - thrust / 5.06) * (t >= 0.0), 900)
    estimates = diagnose(QUAD, measured(inputs, speeds))
    faulty = named(estimates)
    assert not np.delete(faulty, 1, axis=1).any()
    assert np.argmax(faulty[:, 1]) < BEGIN + 15  # 60 ms
    assert estimates[BEGIN + 50].effectiveness[1] == pytest.approx(float(kind == "stuck"), abs=0.02)
    assert FAULT_KINDS[estimates[BEGIN + 50].kind[1]] == kind


def test_diagnosis_keeps_the_contract_of_a_law():
    law = Diagnosis(effects_of(QUAD))
    flights = [flight(QUAD, one_rotor(QUAD, 2, 0.3), 850, seed) for seed in (1, 2)]
    flights[1] = measured(flights[1], lambda _, wanted: wanted)
    with np.errstate(all="ignore"):
        assert_contract(law, flights, rtol=1e-7, atol=1e-9)
        assert named(outputs_of(law, flights[0]))[-1, 2]
