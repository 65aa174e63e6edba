"""Which faults can be told apart: against published answers, proofs by hand, and independent algebra."""

import dataclasses
import functools
import json

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from layouts import SIXTH, circle, with_rotors

from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import earth_z_in_body, euler_rates, quaternion_from_euler, to_earth
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.isolability import analyse, analyse_model, strong_isolability
from quadftc_theory.vehicle_equations import (
    SENSORS,
    STANDARD_GRAVITY,
    TURN_RATE,
    Assumptions,
    linearised,
    motion_point,
    vehicle_model,
)

QBALL = load_vehicle("qball_x4")
AXES = ("roll", "pitch", "yaw")
IMU = ("attitude", "gyro", "accelerometer")
CASES = [
    {"sensor_set": ("attitude",)},
    {"sensor_set": ("attitude", "gyro")},
    {"sensor_set": ("attitude", "gyro"), "actuators": "rotors"},
    {"sensor_set": ("attitude", "gyro"), "disturbances": "unknown_inputs", "motion": "turn"},
    {"sensor_set": IMU, "disturbances": "unknown_inputs"},
    {"sensor_set": IMU, "actuators": "rotors", "air": "wind"},
    {"sensor_set": IMU, "air": "no_drag", "motion": "turn"},
    {"sensor_set": ("gyro", "heading", "velocity"), "disturbances": "absent"},
    {"sensor_set": (*IMU, "position"), "disturbances": "unknown_inputs", "air": "wind"},
]
EVERY_CASE = pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case.values())))


model_of, analyse_once = functools.cache(vehicle_model), functools.cache(analyse)


def analysed(vehicle=QBALL, **assumptions):
    return analyse_once(vehicle, Assumptions(**assumptions))


def entry(result, matrix, first, second):
    return bool(getattr(result, matrix)[result.faults.index(first), result.faults.index(second)])


def test_electric_motor_has_the_isolability_that_its_tutorial_states():
    # faultdiagnosistoolbox.github.io, "Isolability analysis and sensor placement": all faults are detected,
    # f_w and f_T are isolated uniquely, f_R and f_i from the other two but not from each other
    symbols = "V yi yw yT dI I dw w T Tm Tl fR fi fw fT"
    V, yi, yw, yT, dI, I, dw, w, T, Tm, Tl, fR, fi, fw, fT = sympy.symbols(symbols)  # noqa: E741
    K, b, R, J, L = 0.7, 0.3, 1.9, 0.23, 0.41
    model = linearised(
        "electric motor",
        [
            -V + I * (R + fR) + L * dI + K * I * w,
            -Tm + K * I**2,
            -J * dw + T - b * w,
            -T + Tm - Tl,
            -yi + I + fi,
            -yw + w + fw,
            -yT + T + fT,
        ],
        states=["I", "w"],
        unknowns=["T", "Tm", "Tl"],
        faults=["fR", "fi", "fw", "fT"],
        point={"I": 1.3, "w": 2.1, "fR": 0.0},
    )
    result = analyse_model(model)
    assert result.undetectable == ()
    assert result.groups == (("fR", "fi"),)


@pytest.mark.parametrize("motion", ["hover", "turn"])
@pytest.mark.parametrize("sensors", [("attitude",), ("attitude", "gyro"), IMU, tuple(SENSORS)], ids="+".join)
def test_torque_fault_and_disturbance_of_one_axis_are_never_told_apart(sensors, motion):
    result = analysed(sensor_set=sensors, motion=motion)
    for axis in AXES:
        assert not entry(result, "isolable", f"actuator {axis}", f"disturbance {axis}")
        assert not entry(result, "isolable", f"disturbance {axis}", f"actuator {axis}")


def test_imu_attitude_and_gyro_tell_all_else_apart_where_disturbances_are_single_faults():
    result = analysed(sensor_set=("attitude", "gyro"))
    assert result.undetectable == ()
    assert result.groups == tuple((f"actuator {axis}", f"disturbance {axis}") for axis in AXES)


def test_attitude_and_gyro_of_one_axis_are_not_told_apart_where_disturbances_are_unknown():
    result = analysed(sensor_set=("attitude", "gyro"), disturbances="unknown_inputs")
    assert result.undetectable == tuple(f"actuator {axis}" for axis in AXES)
    assert result.groups == tuple((f"attitude {axis}", f"gyro {axis}") for axis in AXES)


def test_output_of_the_paper_detects_nothing_where_disturbances_are_unknown():
    result = analysed(sensor_set=("attitude",), disturbances="unknown_inputs")
    assert result.undetectable == result.faults


def test_constant_attitude_fault_leaves_no_trace_in_hover_without_accelerometer():
    result = analysed(sensor_set=("attitude", "gyro"))
    assert result.transient == tuple(f"attitude {axis}" for axis in AXES)


@pytest.mark.parametrize(("air", "seen"), [("still", True), ("wind", False), ("no_drag", False)])
def test_accelerometer_sees_a_constant_tilt_fault_by_drag_in_still_air_only(air, seen):
    result = analysed(sensor_set=IMU, air=air)
    assert (result.transient == ("attitude yaw",)) is seen
    assert (result.transient == tuple(f"attitude {axis}" for axis in AXES)) is not seen


def test_second_attitude_shows_a_constant_fault_but_only_its_onset_tells_whose():
    sensors = ("attitude", "gyro", "second_attitude")
    result = analysed(sensor_set=sensors, disturbances="unknown_inputs")
    assert result.transient == ()
    assert result.groups == ()
    for pair in (("attitude yaw", "second attitude yaw"), ("second attitude yaw", "attitude yaw")):
        assert not entry(result, "strongly_isolable", *pair)


def test_steady_turn_tells_attitude_from_gyro_and_shows_constant_tilt_faults():
    result = analysed(sensor_set=("attitude", "gyro"), disturbances="unknown_inputs", motion="turn")
    assert result.groups == ()
    assert result.transient == ("attitude yaw",)


@pytest.mark.parametrize("drag", [0.0, 0.012])
def test_constant_gyro_fault_is_told_from_an_attitude_fault_by_rotational_drag_alone(drag):
    vehicle = dataclasses.replace(QBALL, rotational_drag=np.full(3, drag))
    result = analysed(vehicle, sensor_set=("attitude", "gyro"))
    assert entry(result, "isolable", "gyro roll", "attitude roll")
    assert entry(result, "strongly_isolable", "gyro roll", "attitude roll") is (drag > 0.0)


def test_hexarotor_confuses_opposite_rotors():
    hexarotor = with_rotors(QBALL, circle(SIXTH, 0.2), "PNPNPN")
    result = analysed(hexarotor, sensor_set=("attitude", "gyro"), actuators="rotors")
    assert result.groups == tuple((f"rotor {number}", f"rotor {number + 3}") for number in (1, 2, 3))


@settings(max_examples=settings().max_examples // 10)
@given(
    sensors=st.sets(st.sampled_from(list(SENSORS)), min_size=1, max_size=4),
    more=st.sampled_from(list(SENSORS)),
    motion=st.sampled_from(["hover", "turn"]),
    disturbances=st.sampled_from(["faults", "unknown_inputs"]),
)
def test_one_more_sensor_never_takes_away_what_could_be_told_apart(sensors, more, motion, disturbances):
    assumed = {"motion": motion, "disturbances": disturbances}
    fewer = analysed(sensor_set=tuple(sorted(sensors)), **assumed)
    richer = analysed(sensor_set=tuple(sorted({*sensors, more})), **assumed)
    kept = [richer.faults.index(fault) for fault in fewer.faults]
    for mask in ("detectable", "strongly_detectable"):
        assert np.all(getattr(fewer, mask) <= getattr(richer, mask)[kept]), mask
    for mask in ("isolable", "strongly_isolable"):
        assert np.all(getattr(fewer, mask) <= getattr(richer, mask)[np.ix_(kept, kept)]), mask


@EVERY_CASE
def test_strong_detectability_is_the_limit_of_the_residuals_at_low_frequency(case):
    model = model_of(QBALL, Assumptions(**case))
    strongly, _ = strong_isolability(model)
    s = 1e-7  # 1/s; a response that vanishes with s is below the threshold, one that does not above
    unknowns = np.hstack([s * model.E + model.A, model.B])
    left, size, _ = np.linalg.svd(unknowns)
    # all states are seen, or enter with a column s: the rank at this s is the generic one
    blind = left[:, np.count_nonzero(size > 1e-12 * size[0]) :]
    response = np.linalg.norm(blind.T @ np.sign(np.abs(model.F)), axis=0)
    np.testing.assert_array_equal(response > 1e-5, strongly)


@pytest.mark.parametrize("air", ["still", "no_drag"])
@pytest.mark.parametrize(("motion", "rate"), [("hover", 0.0), ("turn", TURN_RATE)])
def test_motion_is_steady_by_the_equations_of_the_plant(motion, rate, air):
    point = motion_point(QBALL, Assumptions(motion=motion, air=air))
    values = {name: np.array([point[part] for part in parts]) for name, parts in VECTORS.items()}
    up = earth_z_in_body(quaternion_from_euler(values["angles"]))
    turning = gyroscopic_acceleration(QBALL.inertia, values["rate"])
    torque = values["torque"] - QBALL.rotational_drag * values["rate"]
    acceleration = values["force"] - np.cross(values["rate"], values["velocity"]) - STANDARD_GRAVITY * up
    np.testing.assert_allclose(euler_rates(values["angles"], values["rate"]), [0.0, 0.0, rate], atol=1e-15)
    np.testing.assert_allclose(turning + torque / QBALL.inertia, 0.0, atol=1e-15)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)


def test_linear_model_is_the_derivative_of_the_equations_of_the_plant():
    assumptions = Assumptions(motion="turn")
    model, point = model_of(QBALL, assumptions), motion_point(QBALL, assumptions)
    angles, rate = (np.array([point[part] for part in VECTORS[name]]) for name in ("angles", "rate"))

    def change(state):
        turning = gyroscopic_acceleration(QBALL.inertia, state[3:])
        return np.concatenate(
            [
                euler_rates(state[:3], state[3:]),
                turning - QBALL.rotational_drag / QBALL.inertia * state[3:],
            ]
        )

    state, step = np.concatenate([angles, rate]), 1e-6
    differences = [
        (change(state + step * unit) - change(state - step * unit)) / (2.0 * step) for unit in np.eye(6)
    ]
    np.testing.assert_array_equal(model.E[:6, :6], np.eye(6))
    np.testing.assert_allclose(-model.A[:6, :6], np.stack(differences, axis=1), atol=1e-8)


@pytest.mark.parametrize("actuators", ["axes", pytest.param("rotors", marks=pytest.mark.thorough)])
def test_a_position_tells_attitude_from_gyro_in_roll_and_pitch(actuators):
    known = {"disturbances": "unknown_inputs", "air": "wind", "actuators": actuators}
    without, position, heading = (
        analysed(sensor_set=(*IMU, *more), **known) for more in ((), ("position",), ("position", "heading"))
    )
    for axis, told in zip(AXES, (True, True, False), strict=True):
        pair = f"attitude {axis}", f"gyro {axis}"
        assert not entry(without, "isolable", *pair)
        assert entry(position, "isolable", *pair) == entry(position, "isolable", *pair[::-1]) == told
        assert entry(heading, "isolable", *pair)
    assert not entry(position, "isolable", "accelerometer x", "position east")


def test_the_path_is_the_velocity_in_earth_axes():
    assumptions = Assumptions(sensor_set=("position",), motion="turn")
    model, point = model_of(QBALL, assumptions), motion_point(QBALL, assumptions)
    rows = [np.flatnonzero(model.E[:, model.states.index(name)])[0] for name in ("east", "north", "up")]
    columns = [model.states.index(name) for name in VECTORS["velocity"]]
    q_xyzw = quaternion_from_euler(np.array([point[name] for name in VECTORS["angles"]]))
    turned = np.stack([to_earth(q_xyzw, unit) for unit in np.eye(3)], axis=1)
    np.testing.assert_allclose(-model.A[np.ix_(rows, columns)], turned, atol=1e-12)


def test_result_survives_json():
    result = analysed(sensor_set=("gyro", "attitude"), disturbances="unknown_inputs")
    read = json.loads(json.dumps(result.to_dict()))
    assert read["assumptions"]["sensor_set"] == ["attitude", "gyro"]
    assert np.array_equal(read["isolable"], result.isolable)
    assert read["groups"] == [list(group) for group in result.groups]


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"sensor_set": ("compass",)}, "sensor_set: 'compass' is none of attitude, gyro"),
        ({"sensor_set": ()}, "expected at least one sensor, each once"),
        ({"sensor_set": ("gyro", "gyro")}, "expected at least one sensor, each once"),
        ({"air": "storm"}, "air = 'storm': expected one of still, wind, no_drag"),
    ],
)
def test_wrong_assumption_is_refused(wrong, line):
    with pytest.raises(ValueError, match=line):
        Assumptions(**wrong)


def test_fault_in_two_equations_is_refused():
    x, f = sympy.symbols("x f")
    with pytest.raises(ValueError, match="fault 'f' is in 2 equations, expected 1"):
        linearised("twice", [x + f, x - f], states=[], unknowns=["x"], faults=["f"], point={})


VECTORS = {
    "angles": ("phi", "theta", "psi"),
    "rate": ("p", "q", "r"),
    "velocity": ("v_x", "v_y", "v_z"),
    "torque": ("tau_x", "tau_y", "tau_z"),
    "force": ("f_x", "f_y", "f_z"),
}
