"""The plant of MuJoCo against our own: open-loop manoeuvres, the ground, the accelerometer; and refusals."""

import dataclasses
import sys

import jax
import numpy as np
import pytest
from in_c import moving
from sampling import sampled

from quadftc_model.parameters import build
from quadftc_model.rotations import quaternion_from_euler, turn
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_sim.disturbance import disturbances
from quadftc_sim.plant import plants
from quadftc_sim.plants.free_flight import SINKING, FreeFlight
from quadftc_sim.plants.mujoco import Mujoco
from quadftc_sim.wind import winds

pytest.importorskip("mujoco")

DT, DURATION = 0.004, 1.5  # s
HIGH = (3.0, -2.0, 50.0)  # m
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def offset(vehicle, time):
    """Constant speeds, each a little off hover."""
    return [1.01, 0.99, 1.005, 1.0]


def roll_doublet(vehicle, time):
    """To one side and back, over 0.4 s."""
    push = 0.05 * ((time < 0.2) - 1.0 * (0.2 <= time < 0.4))
    return 1.0 + push * np.sign(vehicle.rotors.positions[:, 1])


def yaw_spin(vehicle, time):
    """Those that turn one way are faster."""
    return 1.0 + 0.05 * vehicle.rotors.yaw_sign


def free_fall(vehicle, time):
    """No rotor is driven."""
    return np.zeros(4)


# manoeuvre -> largest difference of position [m], velocity [m/s], attitude [deg] and body rate [rad/s]
BOUNDS = {
    offset: (0.005, 0.01, 0.2, 0.005),
    roll_doublet: (0.006, 0.01, 0.05, 0.003),
    yaw_spin: (0.001, 0.003, 1.5, 0.03),
    free_fall: (0.002, 0.003, 0.01, 0.0002),
}


def plant_of(kind, vehicle, **options):
    """A plant in wind and a disturbance."""
    sine = build(disturbances.get("sine"), {"amplitude": list(0.2 * vehicle.inertia), "frequency": 2.0})
    air = build(winds.get("constant"), {"velocity_mean": [3.0, -2.0, 0.5]})
    return kind(vehicle=vehicle, disturbances=(sine,), winds=(air,), start=HIGH, **options)


def differences(vehicle, manoeuvre, **options):
    """How far the two plants come apart: position, velocity, attitude [deg], body rate."""
    pair = [plant_of(FreeFlight, vehicle), plant_of(Mujoco, vehicle, **options)]
    states = [plant.init(quaternion_from_euler(np.array([0.05, -0.1, 0.5])), np.zeros(3)) for plant in pair]
    steps, worst = (moving(pair[0], 4), pair[1].step), np.zeros(4)
    for index in range(round(DURATION / DT)):
        speeds = vehicle.hover_speed * np.array(manoeuvre(vehicle, index * DT))
        states = [step(state, speeds, index * DT, DT) for step, state in zip(steps, states, strict=True)]
        ours, theirs = states
        apart = np.abs(ours.q_xyzw @ theirs.q_xyzw)
        found = [
            np.linalg.norm(getattr(ours, name) - getattr(theirs, name)) for name in ("position", "velocity")
        ]
        found += [
            np.degrees(2.0 * np.arccos(min(apart, 1.0))),
            np.linalg.norm(ours.body_rate - theirs.body_rate),
        ]
        worst = np.maximum(worst, found)
    return worst


@pytest.mark.parametrize(("name", "manoeuvre"), sampled(vehicle_names(), BOUNDS, every=5))
def test_mujoco_agrees_on_an_open_loop_manoeuvre(name, manoeuvre):
    assert np.all(differences(load_vehicle(name), manoeuvre) < BOUNDS[manoeuvre])


def test_what_mujoco_differs_by_falls_with_its_step():
    coarse, fine = (differences(load_vehicle("x500"), offset, substeps=count) for count in (4, 16))
    assert np.all(fine[:3] < 0.4 * coarse[:3])  # of order 1, as drag is held during a step


@pytest.mark.parametrize("name", sampled(vehicle_names(), every=3))  # the lightest and the heaviest
def test_vehicle_that_falls_to_the_ground_comes_to_rest_as_in_our_plant(name):
    rests = []
    for kind in (FreeFlight, Mujoco):
        plant = kind(vehicle=load_vehicle(name))
        state = plant.init(quaternion_from_euler(np.array([0.2, 0.1, 0.3])), np.zeros(3))
        step = plant.step if kind is Mujoco else moving(plant, 4)
        for index in range(1000):
            state = step(state, np.zeros(4), index * DT, DT)
        np.testing.assert_allclose(
            plant.specific_force(state, 4.0), [0.0, 0.0, STANDARD_GRAVITY], atol=0.01 * STANDARD_GRAVITY
        )
        rests.append(state)
    ours, theirs = rests
    assert np.abs(theirs.velocity).max() < 1e-3
    assert abs(ours.position[2] - theirs.position[2]) < SINKING
    assert np.linalg.norm(ours.position[:2] - theirs.position[:2]) < 0.3
    assert np.linalg.norm(theirs.q_xyzw[:2]) < np.sin(np.radians(0.5) / 2.0)  # level


def test_accelerometer_off_the_centre_agrees_with_that_of_our_plant():
    vehicle = load_vehicle("x500")
    body = dataclasses.replace(vehicle.aerodynamics, imu_position=np.array([0.1, -0.05, 0.02]))
    vehicle = dataclasses.replace(vehicle, aerodynamics=body)
    ours, theirs = (plant_of(kind, vehicle) for kind in (FreeFlight, Mujoco))
    state = ours.init(quaternion_from_euler(np.array([0.3, -0.2, 1.0])), np.array([1.0, -2.0, 3.0]))
    state = state._replace(velocity=np.array([4.0, 1.0, -2.0]), speeds=state.speeds * [1.1, 0.9, 1.0, 1.05])
    # as a rotor on its hinge does not follow the angular acceleration of the body
    np.testing.assert_allclose(theirs.specific_force(state, 0.3), ours.specific_force(state, 0.3), atol=0.02)


def test_step_depends_on_its_arguments_alone():
    plant = plant_of(Mujoco, load_vehicle("qball_x4"))
    low = plant.init(LEVEL, np.array([0.1, 0.2, -0.3]))._replace(position=np.array([0.0, 0.0, 0.1]))
    before, speeds = [part.copy() for part in low[:5]], np.array([400.0, 450.0, 420.0, 430.0])
    first = plant.step(low, speeds, 0.1, DT)
    plant.step(plant.init(turn(LEVEL, np.ones(3)), np.ones(3)), speeds, 7.0, 0.01)
    for a, b, given, kept in zip(first[:5], plant.step(low, speeds, 0.1, DT), low, before, strict=False):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(given, kept)


def test_many_vehicles_at_once_and_tracers_are_refused():
    plant = Mujoco(vehicle=load_vehicle("x500"))
    many = plant.init(np.tile(LEVEL, (3, 1)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="plant 'mujoco' flies one vehicle in NumPy"):
        plant.step(many, np.full((3, 4), 700.0), 0.0, DT)
    one = plant.init(LEVEL, np.zeros(3))
    with pytest.raises(ValueError, match=r"plant 'mujoco' flies one vehicle in NumPy, not .*Tracer"):
        jax.jit(lambda speeds: plant.step(one, speeds, 0.0, DT))(np.full(4, 700.0))


def test_without_mujoco_the_plant_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ValueError, match=r"plant 'mujoco': .*pip install"):
        plants.get("mujoco")(vehicle=load_vehicle("x500"))


def test_inertia_that_no_body_has_is_refused():
    with pytest.raises(ValueError, match=r"plant 'mujoco', vehicle 'x500': .*inertia"):
        Mujoco(vehicle=load_vehicle("x500"), inertia_factor=(0.2, 0.2, 5.0))
