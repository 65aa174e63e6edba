"""The rigid body against references that share no code with it: SciPy's integrator, and MuJoCo."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quadftc_model.rigid_body import angular_acceleration, propeller_momentum, rk4
from quadftc_model.rotations import normalise, quaternion_rate
from quadftc_model.vehicle import load_vehicle

INERTIA = np.array([0.02, 0.03, 0.045])  # kg m²; no two alike
DRAG = 0.012  # N m s/rad
QBALL = load_vehicle("qball_x4")
BODY = dataclasses.replace(
    QBALL,
    inertia=INERTIA,
    rotational_drag=np.full(3, DRAG),
    rotors=dataclasses.replace(QBALL.rotors, rotor_inertia=0.0),
)
FREE = dataclasses.replace(BODY, rotational_drag=np.zeros(3))
TRIM = np.full(4, QBALL.rotors.command_trim)
START_RATE = np.array([1.0, -0.7, 0.4])  # rad/s
DURATION = 4.0  # s
# torques in body axes [N m], one for each second
HELD = np.array([[0.05, -0.03, 0.02], [-0.04, 0.06, -0.03], [0.0, -0.05, 0.04], [0.03, 0.02, -0.06]])


def torque_that_varies(time):
    return np.array([0.05, 0.04, 0.06]) * np.sin(np.array([2.0, 1.3, 0.7]) * time + np.array([0.0, 2.0, 1.0]))


def torque_held(time):
    return HELD[min(int(time + 1e-9), len(HELD) - 1)]


def flown(vehicle, torque, dt, held=False, duration=DURATION, body_rate=START_RATE):
    """Attitude q_xyzw and body rate [rad/s] at the end, by the law under test."""
    state = (np.array([0.0, 0.0, 0.0, 1.0]), body_rate)
    for start in dt * np.arange(round(duration / dt)):

        def derivative(time, arrays, start=start):
            q_xyzw, rate = arrays
            acting = torque(start if held else time)
            acceleration = angular_acceleration(vehicle, rate, acting, propeller_momentum(vehicle, TRIM))
            return quaternion_rate(q_xyzw, rate), acceleration

        q_xyzw, rate = rk4(derivative, start, state, dt)
        state = (normalise(q_xyzw), rate)
    return state


def integrated_by_scipy(torque):
    """The same, with a rotation matrix for attitude and Euler's equation as a linear system to be solved."""

    def derivative(time, state):
        R, omega = state[:9].reshape(3, 3), state[9:]
        p, q, r = omega
        cross = np.array([[0.0, -r, q], [r, 0.0, -p], [-q, p, 0.0]])
        moment = torque(time) - DRAG * omega - cross @ np.diag(INERTIA) @ omega  # (1)
        return np.concatenate([(R @ cross).ravel(), np.linalg.solve(np.diag(INERTIA), moment)])

    start = np.concatenate([np.eye(3).ravel(), START_RATE])
    solved = solve_ivp(derivative, (0.0, DURATION), start, "DOP853", rtol=1e-12, atol=1e-13)
    return Rotation.from_matrix(solved.y[:9, -1].reshape(3, 3)).as_quat(), solved.y[9:, -1]


def simulated_by_mujoco(torque, dt):
    """The same in MuJoCo: a free body without gravity, and three motors that turn it about its own axes."""
    motors = "".join(
        f'<motor site="hub" gear="0 0 0 {axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")
    )  # the torque is in the axes of the site, which turns with the body
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0" integrator="RK4" timestep="{dt}"/><worldbody><body>
        <joint type="free" damping="{DRAG}"/><site name="hub"/>
        <inertial pos="0 0 0" mass="1" diaginertia="{" ".join(map(str, INERTIA))}"/>
        </body></worldbody><actuator>{motors}</actuator></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qvel[3:] = START_RATE  # of a free joint: body axes
    for index in range(round(DURATION / dt)):
        data.ctrl[:] = torque(index * dt)
        mujoco.mj_step(model, data)
    w, x, y, z = data.qpos[3:]
    return np.array([x, y, z, w]), data.qvel[3:].copy()


def distance(one, other):
    """Largest difference of attitude (q and -q are the same) and body rate."""
    sign = np.sign(one[0] @ other[0])
    return max(np.max(np.abs(sign * one[0] - other[0])), np.max(np.abs(one[1] - other[1])))


def test_motion_under_torque_agrees_with_scipy_at_tight_tolerance():
    # error of the law: 4e-7 at 40 ms, so by its order (below) 2.7e-12 at 2 ms; that of the reference is 1e-12
    expected = integrated_by_scipy(torque_that_varies)
    assert distance(flown(BODY, torque_that_varies, 0.002), expected) < 1e-11


def test_motion_under_torque_converges_to_that_of_scipy_with_order_four():
    expected = integrated_by_scipy(torque_that_varies)
    errors = [distance(flown(BODY, torque_that_varies, dt), expected) for dt in (0.04, 0.02, 0.01)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.1)


def test_motion_under_torque_agrees_with_mujoco():
    # both are of order 4: the law is 1e-10 off at 8 ms, so 4e-13 at 2 ms; MuJoCo's step is a quarter of that
    found = flown(BODY, torque_held, 0.002, held=True)
    assert distance(found, simulated_by_mujoco(torque_held, 0.0005)) < 2e-12


@pytest.mark.parametrize("body_rate", [[5.0, 0.1, 0.1], [0.1, 5.0, 0.1], [3.0, 2.0, -4.0]])
def test_momentum_and_energy_without_torque_drift_only_with_the_order_of_the_integrator(body_rate):
    start, drifts = np.array(body_rate), []
    for dt in (0.02, 0.01):
        q_xyzw, rate = flown(FREE, lambda _time: np.zeros(3), dt, duration=10.0, body_rate=start)
        momentum = Rotation.from_quat(q_xyzw).apply(INERTIA * rate) - INERTIA * start  # in earth axes
        energy = np.sum(INERTIA * rate**2) / np.sum(INERTIA * start**2) - 1.0
        drifts.append((np.linalg.norm(momentum) / np.linalg.norm(INERTIA * start), abs(energy)))
    order = np.log2(np.array(drifts[0]) / np.array(drifts[1]))
    assert order[0] == pytest.approx(4.0, abs=0.3)
    assert order[1] > 4.5  # of the energy: one more than of the motion
    assert max(drifts[1]) < 1e-7
