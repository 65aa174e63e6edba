"""What every disturbance observer of the registry keeps."""

import jax
import numpy as np
import pytest

from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_model.numbers import numbers_of, with_numbers
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


def lane(inputs, index):
    return DisturbanceObserverInputs(*(array[index] for array in inputs))


def flown(law, sequence):
    """All estimates over a sequence of inputs; the first step takes no time."""
    state, estimates = law.init(sequence[0]), []
    for index, inputs in enumerate(sequence):
        state, estimate = law.step(state, inputs, 0.0 if index == 0 else DT)
        estimates.append(estimate)
    return np.array(estimates)


@EVERY_OBSERVER
@pytest.mark.parametrize("vehicle", vehicle_names())
@pytest.mark.parametrize("batched", [False, True])
def test_estimate_has_the_shape_of_the_rate_and_is_finite(name, vehicle, batched):
    sequence = [inputs_at(index) if batched else lane(inputs_at(index), 0) for index in range(COUNT)]
    estimates = flown(observer(name, vehicle), sequence)
    assert estimates.shape == ((COUNT, LANES, 3) if batched else (COUNT, 3))
    assert estimates.dtype == np.float64
    assert np.all(np.isfinite(estimates))


@EVERY_OBSERVER
def test_estimate_starts_at_zero(name):
    assert not np.any(flown(observer(name), [inputs_at(0)]))


@EVERY_OBSERVER
def test_same_inputs_give_the_same_estimates(name):
    sequence = [inputs_at(index) for index in range(COUNT)]
    np.testing.assert_array_equal(flown(observer(name), sequence), flown(observer(name), sequence))


@EVERY_OBSERVER
def test_batch_equals_the_loop(name):
    sequence = [inputs_at(index, valid=index not in (30, 31)) for index in range(COUNT)]
    batch = flown(observer(name), sequence)
    for one in range(LANES):
        alone = flown(observer(name), [lane(inputs, one) for inputs in sequence])
        np.testing.assert_allclose(batch[:, one], alone, rtol=1e-12, atol=1e-12)


@EVERY_OBSERVER
def test_number_in_an_absent_rate_does_not_matter(name):
    sequence = [inputs_at(index, valid=index not in (30, 31)) for index in range(COUNT)]
    spoilt = [
        inputs if inputs.rate_valid[0] else inputs._replace(body_rate=inputs.body_rate + 50.0)
        for inputs in sequence
    ]
    np.testing.assert_array_equal(flown(observer(name), spoilt), flown(observer(name), sequence))


@EVERY_OBSERVER
def test_start_without_rate_gives_no_kick_when_the_rate_comes(name):
    absent = [inputs_at(index, valid=False) for index in range(5)]
    absent = [inputs._replace(body_rate=np.zeros((LANES, 3))) for inputs in absent]
    estimates = flown(observer(name), [*absent, inputs_at(5)])
    assert np.max(np.abs(estimates)) < 0.1


@EVERY_OBSERVER
def test_jax_gives_the_same_numbers(name):
    """Compiled, with the state carried by its loop."""
    jax.config.update("jax_enable_x64", True)
    law, sequence = observer(name), [inputs_at(index, valid=index != 30) for index in range(COUNT)]
    state, first = jax.jit(lambda inputs: law.step(law.init(inputs), inputs, 0.0))(sequence[0])
    rest = jax.tree.map(lambda *rows: np.stack(rows), *sequence[1:])
    _, found = jax.lax.scan(lambda state, inputs: law.step(state, inputs, DT), state, rest)
    np.testing.assert_allclose(np.stack([first, *found]), flown(law, sequence), rtol=1e-12, atol=1e-12)


def shapes(tree):
    """Structure, shapes and types of nested tuples of arrays."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, [(np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves]


@pytest.mark.parametrize(("name", "parameters"), EVERY_STRUCTURE)
def test_state_keeps_its_structure_from_the_first_sample_on(name, parameters):
    law, inputs = observer(name, **parameters), lane(inputs_at(0), 0)
    state = law.init(inputs)
    assert shapes(law.resumed(inputs, np.ones(3))) == shapes(state)
    for index in range(10):
        state, estimate = law.step(state, lane(inputs_at(index, index != 5), 0), DT * (index > 0))
        assert shapes(state) == shapes(law.init(inputs))
        assert shapes(estimate) == shapes(np.zeros(3))


@pytest.mark.parametrize(("name", "parameters"), EVERY_STRUCTURE)
def test_step_is_traced_with_all_its_numbers(name, parameters):
    jax.config.update("jax_enable_x64", True)
    law, inputs = observer(name, **parameters), lane(inputs_at(0), 0)
    state = law.init(inputs)

    def step(values, *arguments):
        return with_numbers(law, values).step(*arguments)

    _, traced = jax.make_jaxpr(step, return_shape=True)(numbers_of(law), state, inputs, DT)
    leaves, structure = jax.tree.flatten(traced)
    assert shapes(law.step(state, inputs, DT)) == (structure, [(leaf.shape, leaf.dtype) for leaf in leaves])


@EVERY_OBSERVER
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_number_raises_nothing(name, bad):
    law, inputs = observer(name), lane(inputs_at(0), 0)
    with np.errstate(all="ignore"):
        state, _ = law.step(law.init(inputs), inputs._replace(torque=np.full(3, bad)), DT)
        law.step(state, inputs._replace(body_rate=np.full(3, bad)), DT)
