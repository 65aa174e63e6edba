"""What every disturbance observer of the registry keeps."""

import numpy as np
import pytest
from law_contract import assert_contract, outputs_of, structure

from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_model.arrays import rows_of
from quadftc_model.parameters import parameters_of
from quadftc_model.samples import DisturbanceObserverInputs
from quadftc_model.vehicle import load_vehicle, vehicle_names

EVERY_OBSERVER = pytest.mark.parametrize("name", disturbance_observers.names())
# with every value of those parameters that are structure
EVERY_STRUCTURE = [
    (name, {spec.name: choice})
    for name in disturbance_observers.names()
    for spec in parameters_of(disturbance_observers.get(name))
    for choice in spec.choices
] + [(name, {}) for name in disturbance_observers.names()]
DT, COUNT, LANES = 0.004, 60, 5


def observer(name, vehicle="qball_x4", **parameters):
    return disturbance_observers.get(name)(vehicle=load_vehicle(vehicle), **parameters)


def inputs_at(index, valid=True):
    """Inputs of all lanes, read-only."""
    phase = np.arange(LANES)[:, None] + np.array([0.0, 1.0, 2.0])
    rate, torque = np.sin(2.0 * DT * index + phase), 0.01 * np.cos(DT * index + phase)
    inputs = DisturbanceObserverInputs(rate, np.full(LANES, valid), torque)
    for array in inputs:
        array.setflags(write=False)
    return inputs


def estimates_of(law, sequence):
    """All estimates over a sequence of inputs; the first step takes no time."""
    return np.array(outputs_of(law, sequence))


@EVERY_OBSERVER
@pytest.mark.parametrize("vehicle", vehicle_names())
def test_estimate_has_the_shape_of_the_rate_and_is_finite(name, vehicle):
    estimates = estimates_of(observer(name, vehicle), [rows_of(inputs_at(k), 0) for k in range(COUNT)])
    assert (estimates.shape, estimates.dtype) == ((COUNT, 3), np.float64)
    assert np.all(np.isfinite(estimates))


@EVERY_OBSERVER
def test_estimate_starts_at_zero(name):
    assert not np.any(estimates_of(observer(name), [inputs_at(0)]))


@pytest.mark.parametrize(("name", "parameters"), EVERY_STRUCTURE)
def test_observer_keeps_the_contract_of_a_law(name, parameters):
    law = observer(name, **parameters)
    sequence = [inputs_at(index, valid=index not in (30, 31)) for index in range(COUNT)]
    lanes = [[rows_of(inputs, one) for inputs in sequence] for one in range(LANES)]
    assert_contract(law, lanes)
    assert structure(law.resumed(lanes[0][0], np.ones(3))) == structure(law.init(lanes[0][0]))


@EVERY_OBSERVER
def test_number_in_an_absent_rate_does_not_matter(name):
    sequence = [inputs_at(index, valid=index not in (30, 31)) for index in range(COUNT)]
    spoilt = [
        inputs if inputs.rate_valid[0] else inputs._replace(body_rate=inputs.body_rate + 50.0)
        for inputs in sequence
    ]
    law = observer(name)
    np.testing.assert_array_equal(estimates_of(law, spoilt), estimates_of(law, sequence))


@EVERY_OBSERVER
def test_start_without_rate_gives_no_kick_when_the_rate_comes(name):
    absent = [inputs_at(index, valid=False) for index in range(5)]
    absent = [inputs._replace(body_rate=np.zeros((LANES, 3))) for inputs in absent]
    estimates = estimates_of(observer(name), [*absent, inputs_at(5)])
    assert np.max(np.abs(estimates)) < 0.1


@EVERY_OBSERVER
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_number_raises_nothing(name, bad):
    law, inputs = observer(name), rows_of(inputs_at(0), 0)
    with np.errstate(all="ignore"):
        state, _ = law.step(law.init(inputs), inputs._replace(torque=np.full(3, bad)), DT)
        law.step(state, inputs._replace(body_rate=np.full(3, bad)), DT)
