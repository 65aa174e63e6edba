"""What every fault observer of the registry keeps."""

import dataclasses
import functools

import numpy as np
import pytest
from law_contract import assert_alike, assert_contract, flown_in_jax, structure

from quadftc_fdi.fault_observer import LastDiagnosis, fault_observers, is_usable_estimate
from quadftc_model.arrays import rows_of
from quadftc_model.parameters import parameters_of
from quadftc_model.rotations import body_rates, earth_z_in_body, euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import (
    FAULT_KINDS,
    HEALTHY,
    RECOVERING,
    STANDARD_GRAVITY,
    STARTING,
    FaultObserverInputs,
    ImuSample,
    PositionSample,
    RotorReading,
)
from quadftc_model.vehicle import load_vehicle, vehicle_names

EVERY_OBSERVER = pytest.mark.parametrize("name", fault_observers.names())
DT, COUNT, LANES = 0.004, 40, 5
SHAPES = {"fault": (3,), "std_dev": (3,), "state": (3,), "onset_age": (3,)}


def observer(name, vehicle="qball_x4"):
    return fault_observers.get(name)(vehicle=load_vehicle(vehicle))


def angles_at(time):
    """A smooth motion, another one in each lane: (LANES, 3) [rad]."""
    phase = np.arange(LANES)[:, None] + np.array([0.0, 1.0, 2.0])
    return 0.3 * np.sin(1.5 * time + phase)


@functools.cache
def inputs_at(index, missing=(), fault=0.02):
    """Inputs of all lanes, read-only; the attitude is faulty from sample 20 on."""
    time, step = DT * index, 1e-6
    slope = (angles_at(time + step) - angles_at(time - step)) / (2 * step)
    angles = angles_at(time) + fault * (index >= 20)
    there = np.ones(LANES, dtype=bool)
    absent = np.zeros(LANES, dtype=bool)
    imu = ImuSample(
        q_xyzw=quaternion_from_euler(angles),
        body_rate=body_rates(angles_at(time), slope),
        specific_force=np.tile([0.0, 0.0, 9.8], (LANES, 1)),
        attitude_valid=absent if "attitude" in missing else there,
        rate_valid=absent if "rate" in missing else there,
        force_valid=there,
    )
    inputs = FaultObserverInputs(imu, 0.1 * np.cos(angles), driven=there.copy())
    for array in (*imu, inputs.torque, inputs.driven):
        array.setflags(write=False)
    return inputs


def in_flight(inputs, measured):
    """The same in free flight, with what is known of the rotors of a Qball-X4."""
    speeds = 250.0 + 20.0 * np.repeat(inputs.imu.body_rate[..., :2], 2, axis=-1)
    there = np.ones(LANES, dtype=bool)
    place = PositionSample(0.1 * inputs.imu.body_rate, np.zeros((LANES, 3)), there)
    rotors = RotorReading(speeds, 1.01 * speeds, there & measured)
    return inputs._replace(thrust=np.full(LANES, 13.7), position=place, rotors=rotors)


@np.errstate(all="ignore")  # as the runner of a law
def flown(law, sequence, start=None):
    """State after a sequence of inputs, and all estimates; the first step takes no time."""
    state, estimates = start, []
    if start is None:
        state = law.init(sequence[0])
    for index, inputs in enumerate(sequence):
        first = start is None and index == 0
        state, estimate = law.step(state, inputs, 0.0 if first else DT)
        estimates.append(estimate)
    return state, estimates


@EVERY_OBSERVER
@pytest.mark.parametrize(
    ("vehicle", "batched"), [("qball_x4", True), *((each, False) for each in vehicle_names())]
)
def test_estimates_have_their_shapes_and_types_and_are_finite(name, vehicle, batched):
    sequence = [inputs_at(index) if batched else rows_of(inputs_at(index), 0) for index in range(COUNT)]
    leading = (LANES,) if batched else ()
    for estimate in flown(observer(name, vehicle), sequence)[1]:
        for field, shape in SHAPES.items():
            assert getattr(estimate, field).shape == leading + shape
            assert np.all(np.isfinite(getattr(estimate, field)))
        assert estimate.state.dtype == np.uint8
        assert np.all((estimate.state >= STARTING) & (estimate.state <= RECOVERING))
        assert estimate.corrected.q_xyzw.shape == (*leading, 4)
        assert estimate.corrected.body_rate.shape == (*leading, 3)
        assert np.asarray(estimate.corrected.attitude_valid).dtype == bool
        for sensor in estimate.sensors or ():
            for column in sensor:
                assert column.shape == (*leading, 3)
                assert np.all(np.isfinite(column))
            assert np.all((sensor.state >= STARTING) & (sensor.state <= RECOVERING))
            assert np.all((sensor.probability >= 0.0) & (sensor.probability <= 1.0))
            assert np.all((sensor.kind >= 0) & (sensor.kind < len(FAULT_KINDS)))
            assert sensor.ambiguous.dtype == bool


@EVERY_OBSERVER
def test_what_is_said_of_rotors_has_one_element_for_each(name):
    sequence = [in_flight(inputs_at(index), measured=True) for index in range(COUNT)]
    for estimate in flown(observer(name), sequence)[1]:
        for column in estimate.rotors or ():
            assert column.shape == (LANES, 4)
            assert np.all(np.isfinite(column))
        if estimate.rotors is not None:
            assert np.all((estimate.rotors.effectiveness >= 0.0) & (estimate.rotors.effectiveness <= 1.0))


@EVERY_OBSERVER
def test_description_for_people_is_of_each_axis(name):
    law = observer(name)
    state, _ = flown(law, [rows_of(inputs_at(index), 0) for index in range(30)])
    for values in law.describe(state).values():
        assert values.shape == (3,)
        assert np.all(np.isfinite(values))


@EVERY_OBSERVER
def test_standard_deviations_and_onsets_are_given_or_said_to_be_unknown(name):
    for estimate in flown(observer(name), [inputs_at(index) for index in range(COUNT)])[1]:
        for column in (estimate.std_dev, estimate.onset_age):
            assert np.all((column >= 0.0) | (column == -1.0))


@EVERY_OBSERVER
def test_corrected_attitude_is_a_unit_quaternion(name):
    for estimate in flown(observer(name), [inputs_at(index) for index in range(COUNT)])[1]:
        np.testing.assert_allclose(np.linalg.norm(estimate.corrected.q_xyzw, axis=-1), 1.0, atol=1e-12)


@EVERY_OBSERVER
def test_healthy_start_shows_no_fault_and_the_measured_attitude(name):
    inputs = inputs_at(0)
    by_gravity = STANDARD_GRAVITY * earth_z_in_body(inputs.imu.q_xyzw)
    inputs = inputs._replace(imu=inputs.imu._replace(specific_force=by_gravity))
    estimate = flown(observer(name), [inputs])[1][0]
    np.testing.assert_allclose(estimate.fault, 0.0, atol=1e-12)
    measured = euler_from_quaternion(inputs.imu.q_xyzw)
    np.testing.assert_allclose(euler_from_quaternion(estimate.corrected.q_xyzw), measured, atol=1e-12)
    assert np.all(np.isin(estimate.state, [STARTING, HEALTHY]))


def lanes_of(flies):
    """Sequences of inputs of two vehicles, channels absent for a moment."""
    missing = {25: ("attitude",), 26: ("attitude", "rate"), 27: ("rate",)}
    sequence = [inputs_at(index, missing.get(index, ())) for index in range(COUNT)]
    if flies:
        sequence = [in_flight(inputs, measured=k % 7 > 2) for k, inputs in enumerate(sequence)]
    return [[rows_of(inputs, one) for inputs in sequence] for one in (0, LANES - 1)]


WORDS = LastDiagnosis(np.zeros(3), np.zeros(3), np.eye(3)[0] > 0.0, np.zeros(3), np.eye(3)[0])


@EVERY_OBSERVER
@pytest.mark.parametrize("flies", [False, True])
def test_observer_keeps_the_contract_of_a_law(name, flies):
    law, lanes = observer(name), lanes_of(flies)
    with np.errstate(all="ignore"):
        assert_contract(law, lanes, compiled=False)
        assert structure(law.resumed(lanes[0][0], WORDS)) == structure(law.init(lanes[0][0]))


@EVERY_OBSERVER
@pytest.mark.parametrize("missing", [("attitude",), ("rate",), ("attitude", "rate")])
def test_absent_channels_are_bridged(name, missing):
    law = observer(name)
    state, before = flown(law, [inputs_at(index) for index in range(40)])
    gap = [inputs_at(index, missing) for index in range(40, 50)]
    # what stands in an absent channel must not matter
    gap = [inputs._replace(imu=spoilt(inputs.imu, missing)) for inputs in gap]
    estimates = flown(law, gap, state)[1]
    true = euler_from_quaternion(inputs_at(49, fault=0.0).imu.q_xyzw)
    for estimate in estimates:
        np.testing.assert_allclose(estimate.fault, before[-1].fault, atol=0.01)
    off = euler_from_quaternion(estimates[-1].corrected.q_xyzw) - true
    assert np.max(np.abs(off)) < 0.06  # the motion of ten samples, and the fault of who does not see it


def spoilt(imu, missing):
    """The sample with nonsense in the channels that are absent."""
    q_xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (LANES, 1)) if "attitude" in missing else imu.q_xyzw
    return imu._replace(q_xyzw=q_xyzw, body_rate=imu.body_rate + 50.0 * ("rate" in missing))


def cases_of(inputs):
    """The inputs of one vehicle on the test stand and in free flight."""
    return rows_of(inputs, 0), rows_of(in_flight(inputs, measured=True), 0)


@EVERY_OBSERVER
def test_what_is_no_number_raises_nothing(name):
    law = observer(name)
    for inputs in cases_of(inputs_at(0)):
        state, _ = law.step(law.init(inputs), inputs, 0.0)
        for bad in (np.nan, np.inf):
            torque = inputs._replace(torque=np.full(3, bad))
            imu = inputs.imu._replace(body_rate=np.full(3, bad), q_xyzw=np.full(4, bad))
            with np.errstate(all="ignore"):
                for each in (torque, inputs._replace(imu=imu)):
                    after, estimate = law.step(state, each, DT)
                    law.step(after, inputs, DT)
                assert is_usable_estimate(estimate) == np.isfinite(estimate.corrected.body_rate).all()


@EVERY_OBSERVER
def test_parameter_out_of_bounds_is_refused_by_name(name):
    component = fault_observers.get(name)
    for spec in parameters_of(component):
        if isinstance(spec.default, float) and np.isfinite(spec.low):
            with pytest.raises(ValueError, match=f"{spec.name} = "):
                dataclasses.replace(observer(name), **{spec.name: spec.low - 1.0})


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",  # XLA takes half a minute for isolating, and seconds for bank and supervised
    [
        pytest.param(name, marks=pytest.mark.thorough if name in ("isolating", "bank", "supervised") else ())
        for name in fault_observers.names()
    ],
)
def test_jax_gives_the_same_numbers(name):
    law, sequence = observer(name), lanes_of(flies=True)[0]
    found = flown_in_jax(law, sequence)
    for (_, here), there in zip(found, flown(law, sequence)[1], strict=True):
        assert_alike(here, there, rtol=1e-9, atol=1e-12)
