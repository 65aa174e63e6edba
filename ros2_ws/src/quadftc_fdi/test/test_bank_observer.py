"""The observer bank on a vehicle that hovers in gusts: what it names, and what it takes for no fault."""

import functools

import numpy as np
import pytest
from in_c import as_flown, fly_arrays

from quadftc_fdi.bank import decide, modes, readings
from quadftc_fdi.fault_observer import is_usable_estimate
from quadftc_fdi.fault_observers.bank import BankObserver
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import earth_z_in_body, euler_from_quaternion, quaternion_from_euler, turn
from quadftc_model.samples import (
    ALARMS,
    FAULT_KINDS,
    FAULTY,
    STANDARD_GRAVITY,
    FaultObserverInputs,
    ImuSample,
)
from quadftc_model.vehicle import load_vehicle

DEG = np.pi / 180.0
DT, SECONDS, ONSET = 0.004, 10.0, 6.0  # s
ROWS, FIRST = round(SECONDS / DT), round(ONSET / DT)
TIME = np.arange(ROWS) * DT
ELAPSED = np.maximum(TIME - ONSET, 0.0)[:, None]
ON = TIME >= ONSET
STIFF, DAMPED = 60.0, 12.0  # 1/s², 1/s; of the controller
SENSORS = ("attitude", "gyro")
QBALL = load_vehicle("qball_x4")
OFFSET, STUCK, NOISE, ABSENT = (FAULT_KINDS.index(name) for name in ("offset", "stuck", "noise", "absent"))


@functools.cache
def hovering(seed=1, push=(0.0, 0.0, 0.0), seconds=SECONDS):
    """Samples of a vehicle in gusts of 0.5 rad/s², with a push [rad/s²] for 0.3 s from `ONSET` on."""
    rng, count = np.random.default_rng(seed), round(seconds / DT)
    keep = np.exp(-DT)
    noise = rng.standard_normal((3, count, 3))
    q_xyzw, rate, gust = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3)
    told, seen, torque, true = (np.empty((count, n)) for n in (4, 3, 3, 4))
    wanted = np.zeros(3)
    for k in range(count):
        gust = keep * gust + 0.5 * np.sqrt(1.0 - keep**2) * noise[0, k]
        pushed = np.array(push) * (0.0 <= k * DT - ONSET < 0.3)
        after = rate + (wanted + gust + pushed) * DT
        q_xyzw, rate = turn(q_xyzw, 0.5 * (rate + after) * DT), after
        torque[k] = wanted * QBALL.inertia
        true[k] = q_xyzw
        told[k], seen[k] = turn(q_xyzw, 0.1 * DEG * noise[1, k]), rate + 0.002 * noise[2, k]
        wanted = -STIFF * euler_from_quaternion(told[k]) - DAMPED * seen[k]
    there = np.ones(count, bool)
    imu = ImuSample(told, seen, felt(true), there, there, there)
    return FaultObserverInputs(imu, torque, driven=there)


def felt(q_xyzw):
    """Specific force [m/s²] at an attitude on a test stand."""
    noise = 0.05 * np.random.default_rng(3).standard_normal((len(q_xyzw), 3))
    return STANDARD_GRAVITY * earth_z_in_body(q_xyzw) + noise


def with_imu(flight, **channels):
    return flight._replace(imu=flight.imu._replace(**channels))


def with_fault(sensor, fault):
    """A flight with a fault (ROWS, 3) of a sensor [rad, rad/s]."""
    flight = hovering()
    if sensor == "gyro":
        return with_imu(flight, body_rate=flight.imu.body_rate + fault)
    return with_imu(flight, q_xyzw=quaternion_from_euler(euler_from_quaternion(flight.imu.q_xyzw) + fault))


def felt_too(flight):
    """The flight, if its attitude is true."""
    return with_imu(flight, specific_force=felt(flight.imu.q_xyzw))


def said_of(flight, vehicle=QBALL, **parameters):
    """What the observer says of its sensors, arrays (ROWS, ...)."""
    estimate = fly_arrays(*as_flown(BankObserver(vehicle=vehicle, **parameters), flight), DT)[1].said
    assert np.all(is_usable_estimate(estimate))
    return {name: getattr(estimate.sensors, name) for name in (*SENSORS, "accelerometer")}


def alarms(said):
    """Who is named at some time after the start, and who is ambiguous: sets of sensor and axis."""
    found = set(), set()
    for name, each in said.items():
        alarm = np.isin(each.state, ALARMS)
        for kind, rows in zip(found, (alarm & ~each.ambiguous, alarm & each.ambiguous), strict=True):
            kind.update((name, axis) for axis in range(3) if rows[250:, axis].any())
    return found


def test_a_healthy_flight_has_no_alarm():
    assert alarms(said_of(hovering(2, seconds=20.0))) == (set(), set())


def test_a_small_jump_of_the_attitude_and_back_accuses_nobody():
    jumps = (0.4 * DEG) * (ON & (TIME < ONSET + 1.0))[:, None] * np.array([1.0, -0.5, 0.2])
    assert alarms(said_of(with_fault("attitude", jumps)))[0] == set()


def test_vibration_that_comes_and_goes_accuses_nobody():
    loud = 0.03 * np.random.default_rng(5).standard_normal((ROWS, 3)) * (ON & (TIME < ONSET + 2.0))[:, None]
    assert alarms(said_of(with_fault("gyro", loud)))[0] == set()


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_of_the_gyro_that_alone_scatters_is_noisy_until_it_is_quiet(axis):
    """Vibration is shared by the axes. The gyro is still weighed: what is flown stays near the truth."""
    loud = 0.05 * np.random.default_rng(6).standard_normal((ROWS, 1)) * (ON & (TIME < ONSET + 2.0))[:, None]
    said = said_of(with_fault("gyro", loud * np.eye(3)[axis]))
    assert alarms(said)[0] == {("gyro", axis)}
    gyro = said["gyro"]
    named = np.isin(gyro.state[:, axis], ALARMS)
    assert not named[TIME < ONSET].any()
    assert named[(TIME > ONSET + 1.0) & (TIME < ONSET + 2.0)].all()
    assert not named[TIME > ONSET + 3.0].any()
    assert set(gyro.kind[named, axis]) == {NOISE}
    onset = (TIME - gyro.onset_age[:, axis])[named]
    assert np.max(abs(onset - ONSET)) < 0.2


@pytest.mark.parametrize("quiet", range(3))
def test_two_axes_that_scatter_alike_may_be_vibration(quiet):
    loud = 0.05 * np.random.default_rng(6).standard_normal((ROWS, 3)) * (ON & (TIME < ONSET + 2.0))[:, None]
    assert alarms(said_of(with_fault("gyro", loud * (1.0 - np.eye(3)[quiet]))))[0] == set()


@pytest.mark.parametrize("is_late", [False, True])
@pytest.mark.parametrize("axis", range(3))
def test_a_gyro_that_is_dead_or_late_while_its_axis_swings_is_named_and_no_attitude(axis, is_late):
    """Its error is no line of size and slope, and an attitude that creeps explains the discrepancy better."""
    unit, fast = np.eye(3)[axis], 2.0 * np.pi * ELAPSED
    turned, rate = 0.1 * (1.0 - np.cos(fast)), 0.2 * np.pi * np.sin(fast)
    flight = felt_too(with_fault("attitude", turned * unit))
    torque = flight.torque + QBALL.inertia[axis] * np.gradient(rate[:, 0], DT)[:, None] * unit
    late = np.interp(TIME - 0.1, TIME, rate[:, 0])[:, None]
    read = flight.imu.body_rate + (late if is_late else 0.0) * unit
    said = said_of(with_imu(flight, body_rate=read)._replace(torque=torque))
    assert alarms(said)[0] == {("gyro", axis)}


@pytest.mark.parametrize(("hertz", "reads"), [(0.25, 0.1), (0.25, 0.4), (0.5, 0.4)])
def test_a_gyro_of_a_wrong_scale_about_yaw_is_named_and_no_attitude_that_creeps(hertz, reads):
    """Neither gravity nor a line tells whose error it is: the rate without the gyro does."""
    still, unit, turns = hovering(2), np.eye(3)[2], 2.0 * np.pi * hertz
    angle, rate = 0.1 / turns * (1.0 - np.cos(turns * ELAPSED)), 0.1 * np.sin(turns * ELAPSED)
    told = quaternion_from_euler(euler_from_quaternion(still.imu.q_xyzw) + angle * unit)
    torque = still.torque + QBALL.inertia * np.gradient(rate[:, 0], DT)[:, None] * unit
    read = (still.imu.body_rate + rate * unit) * np.where(ON[:, None], 1.0 - (1.0 - reads) * unit, 1.0)
    said = said_of(felt_too(with_imu(still, q_xyzw=told, body_rate=read)._replace(torque=torque)))
    assert alarms(said)[0] == {("gyro", 2)}


def test_of_a_sensor_that_is_beyond_doubt_the_likeliest_mode_is_believed():
    """A wild gyro needs twice the certainty: a step that explains less must not take its place."""
    p, doubt, few = np.zeros(modes.MODES), np.ones(modes.MODES), 1e-3
    step, wild = 3 * modes.GYRO, 3 * modes.WILD
    p[step], p[wild], doubt[step], doubt[wild] = few, 1.0 - few, few, few
    witnesses = np.zeros(3, bool), np.ones(3, bool), np.ones(1, bool)
    given = decide.Probabilities(np.zeros(0), p, doubt, np.log(np.maximum(p, 1e-9)), p)
    named = decide.named_mode(given, p, *witnesses, few=0.01, repeats_gyro=False)
    assert np.flatnonzero(named).tolist() == [wild]


@pytest.mark.parametrize("slope", [-0.5 * DEG, 0.8 * DEG])
@pytest.mark.parametrize("hertz", [0.25, 0.5])
def test_an_attitude_that_creeps_about_yaw_is_named_and_no_gyro_of_a_wrong_scale(hertz, slope):
    still, unit, turns = hovering(2), np.eye(3)[2], 2.0 * np.pi * hertz
    angle, rate = 0.1 / turns * (1.0 - np.cos(turns * TIME)), 0.1 * np.sin(turns * TIME)
    told = euler_from_quaternion(still.imu.q_xyzw) + (angle[:, None] + slope * ELAPSED) * unit
    torque = still.torque + QBALL.inertia * np.gradient(rate, DT)[:, None] * unit
    flight = with_imu(still, q_xyzw=quaternion_from_euler(told))._replace(torque=torque)
    said = said_of(with_imu(felt_too(flight), body_rate=still.imu.body_rate + rate[:, None] * unit))
    assert alarms(said)[0] == {("attitude", 2)}


@pytest.mark.parametrize(("hertz", "reads"), [(0.5, 0.4), (0.5, 0.6), (0.8, 0.2)])
def test_an_attitude_of_a_wrong_scale_about_yaw_is_named_and_no_gyro_that_drifts(hertz, reads):
    """While the vehicle begins to turn, its error is that of a gyro that drifts."""
    still, unit, turns = hovering(2), np.eye(3)[2], 2.0 * np.pi * hertz
    turned = turns * ELAPSED[:, 0]
    angle, rate = 0.1 / turns * (1.0 - np.cos(turned)), 0.1 * np.sin(turned)
    told = (np.where(ON, reads, 1.0) * angle)[:, None] * unit + euler_from_quaternion(still.imu.q_xyzw)
    torque = still.torque + QBALL.inertia * np.gradient(rate, DT)[:, None] * unit
    flight = with_imu(still, q_xyzw=quaternion_from_euler(told))._replace(torque=torque)
    said = said_of(with_imu(flight, body_rate=still.imu.body_rate + rate[:, None] * unit))
    assert alarms(said)[0] == {("attitude", 2)}


@pytest.mark.parametrize("by", [0.2, 0.3])
@pytest.mark.parametrize("axis", range(3))
def test_an_attitude_that_is_late_while_its_axis_swings_is_named_and_no_gyro(axis, by):
    unit, fast = np.eye(3)[axis], 2.0 * np.pi * ELAPSED
    turned, rate = 0.1 * (1.0 - np.cos(fast)), 0.2 * np.pi * np.sin(fast)
    late = np.interp(TIME - by, TIME, turned[:, 0])[:, None]
    force = felt_too(with_fault("attitude", turned * unit)).imu.specific_force
    flight = with_imu(with_fault("attitude", late * unit), specific_force=force)
    torque = flight.torque + QBALL.inertia[axis] * np.gradient(rate[:, 0], DT)[:, None] * unit
    read = flight.imu.body_rate + rate * unit
    said = said_of(with_imu(flight, body_rate=read)._replace(torque=torque))
    assert alarms(said)[0] == {("attitude", axis)}


def test_an_accelerometer_that_lies_along_z_while_the_vehicle_is_tilted_lies_along_z_alone():
    tilted = felt_too(with_fault("attitude", np.array([0.1, -0.1, 0.0])))
    fault = -4.0 * ON[:, None] * np.array([0.0, 0.0, 1.0])
    said = said_of(with_imu(tilted, specific_force=tilted.imu.specific_force + fault))
    assert alarms(said)[0] == {("accelerometer", 2)}


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("size", "power"), [(0.8, 0), (0.4, 1)])
def test_an_accelerometer_that_jumps_or_drifts_is_named_and_nobody_else(axis, size, power):
    flight, fault = hovering(), size * (ELAPSED**power * ON[:, None]) * np.eye(3)[axis]
    said = said_of(with_imu(flight, specific_force=flight.imu.specific_force + fault))
    assert alarms(said)[0] == {("accelerometer", axis)}
    assert said["accelerometer"].size[-1, axis] == pytest.approx(fault[-1, axis], rel=0.3)


def test_gravity_holds_the_tilt_while_the_attitude_is_absent_and_the_gyro_drifts():
    drift = 0.01 * ELAPSED / (SECONDS - ONSET) * np.eye(3)[0]
    flight = with_imu(with_fault("gyro", drift), attitude_valid=~ON)
    off: list[float] = []
    for feels_gravity in (True, False):
        law = BankObserver(vehicle=QBALL, feels_gravity=feels_gravity)
        flown = fly_arrays(*as_flown(law, flight), DT)[1].said.corrected.q_xyzw
        apart = euler_from_quaternion(flown) - euler_from_quaternion(hovering().imu.q_xyzw)
        off.append(abs(apart[-100:, 0].mean()))
    assert off[0] < 0.5 * DEG
    assert off[1] > 2.0 * off[0], "by the gyro alone"


@pytest.mark.parametrize("ends", [False, True])
def test_in_flight_drag_is_no_fault_of_the_accelerometer_but_silence_is(ends):
    """Without a position: the accelerometer shows thrust and drag, whatever the tilt."""
    unit, fast = np.array([1.0, -0.5, 0.0]), 2.0 * np.pi * TIME[:, None]
    rate, still = 0.4 * np.pi * np.sin(fast) * unit, hovering()
    torque = still.torque + QBALL.inertia * np.gradient(rate, DT, axis=0)
    angles = euler_from_quaternion(still.imu.q_xyzw) + 0.2 * (1.0 - np.cos(fast)) * unit
    drag = 1.5 * np.stack([np.sin(TIME), np.cos(TIME), 0.0 * TIME], axis=-1)
    flight = with_imu(
        still._replace(torque=torque),
        q_xyzw=quaternion_from_euler(angles),
        body_rate=still.imu.body_rate + rate,
        specific_force=felt(np.tile([0.0, 0.0, 0.0, 1.0], (ROWS, 1))) + drag,
        force_valid=~(ON & ends),
    )
    named = {("accelerometer", axis) for axis in range(3)} if ends else set()
    assert alarms(said_of(flight, feels_gravity=False)) == (named, set())


@pytest.mark.parametrize("axis", range(3))
def test_a_gyro_that_oscillates_is_named_and_no_attitude(axis):
    sine = np.sin(2.0 * np.pi * 2.5 * ELAPSED) * np.eye(3)[axis]
    assert alarms(said_of(with_fault("gyro", sine)))[0] == {("gyro", axis)}


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("sensor", "size", "power", "within"),
    [
        ("gyro", 0.3, 0, 0.008),
        ("gyro", -0.08, 0, 0.1),
        ("gyro", 0.2, 1, 0.6),
        ("attitude", -3.0 * DEG, 0, 0.012),
        ("attitude", 3.0 * DEG, 1, 2.0),
    ],
)
def test_a_step_or_ramp_is_named_with_its_sensor_axis_sign_and_size(sensor, axis, size, power, within):
    fault = size * (ELAPSED**power * ON[:, None]) * np.eye(3)[axis]
    said = said_of(with_fault(sensor, fault))
    assert alarms(said)[0] == {(sensor, axis)}
    each = said[sensor]
    named = np.isin(each.state, ALARMS)[:, axis] & ~each.ambiguous[:, axis]
    first = int(np.argmax(named))
    assert 0 <= first - FIRST <= round(within / DT)
    assert named[first:].all()
    assert np.all(each.kind[first:, axis] == OFFSET)
    settled = slice(first + round(0.1 / DT), first + round(1.0 / DT))
    apart = each.size[settled, axis] - fault[settled, axis]
    # sigma of a gyro is that of a reading, not of its wandering bias
    bound = 3.0 * each.std_dev[settled, axis] if sensor == "attitude" else 0.07
    assert np.mean(abs(apart) < bound) > 0.99
    assert np.all(np.sign(each.size[settled, axis]) == np.sign(size))


@pytest.mark.parametrize("push", [(3.0, 0.0, 0.0), (0.0, -8.0, 0.0), (0.0, 0.0, 5.0), (6.0, 6.0, 0.0)])
def test_a_push_accuses_nobody(push):
    assert alarms(said_of(hovering(3, push))) == (set(), set())


@pytest.mark.parametrize(("sensor", "channel"), [("gyro", "body_rate"), ("attitude", "q_xyzw")])
def test_a_sensor_that_repeats_itself_is_stuck(sensor, channel):
    read = getattr(hovering().imu, channel)
    ends = TIME >= ONSET + 1.0
    held = np.where((ON & ~ends)[:, None], read[FIRST], read)
    said = said_of(with_imu(hovering(), **{channel: held}))
    each, rows = said[sensor], slice(FIRST + 50, FIRST + 250)
    assert np.all(each.state[rows] == FAULTY)
    assert np.all(each.kind[rows] == STUCK)
    assert not np.isin(said["gyro" if sensor == "attitude" else "attitude"].state, ALARMS).any()
    assert not np.isin(each.state[FIRST + 500 :], ALARMS).any()


@pytest.mark.parametrize(("sensor", "there"), [("gyro", "rate_valid"), ("attitude", "attitude_valid")])
def test_a_sensor_without_readings_is_absent(sensor, there):
    silent = ~(ON & (TIME < ONSET + 1.0))
    said = said_of(with_imu(hovering(), **{there: silent}))
    each, rows = said[sensor], slice(FIRST + 4, FIRST + 250)
    assert np.all(each.state[rows] == FAULTY)
    assert np.all(each.kind[rows] == ABSENT)
    assert not np.isin(said["gyro" if sensor == "attitude" else "attitude"].state, ALARMS).any()
    assert not np.isin(each.state[FIRST + 500 :], ALARMS).any()


def test_a_fault_that_is_known_has_a_size_while_readings_are_absent_and_after():
    gap = slice(FIRST + 100, FIRST + 110)
    flight = with_fault("attitude", 3.0 * DEG * ON[:, None] * np.eye(3)[1])
    there = flight.imu.attitude_valid.copy()
    there[gap] = False
    said = said_of(with_imu(flight, attitude_valid=there))["attitude"]
    assert np.all(said.kind[gap][5:] == ABSENT)
    assert np.all(abs(said.size[FIRST + 50 :, 1] / DEG - 3.0) < 0.7)


def test_an_absent_attitude_has_no_estimate_and_is_not_said_to_be_off():
    flight = with_imu(hovering(), attitude_valid=~ON)
    estimate = fly_arrays(*as_flown(BankObserver(vehicle=QBALL), flight), DT)[1].said
    assert np.all(estimate.sensors.attitude.state[FIRST + 4 :] == FAULTY)
    assert not np.isin(estimate.state, ALARMS).any()
    assert np.all(estimate.onset_age[FIRST:] == -1.0)


def test_an_attitude_that_is_not_believed_has_no_hypothesis():
    """What it reads does not count, so a fault that began meanwhile would be as likely for ever."""
    flight = with_fault("attitude", 3.0 * DEG * ON[:, None] * np.eye(3)[1])
    state = fly_arrays(*as_flown(BankObserver(vehicle=QBALL), flight), DT)[0].law
    assert state.attitude.faulty.tolist() == [False, True, False]
    own = (modes.NAME == modes.ATTITUDE)[: modes.EFFECTS]
    kept = (state.bank.age[own] >= 0.0).any(axis=-1)
    assert np.array_equal(kept, modes.AXIS[: modes.EFFECTS][own] != 1)


@pytest.mark.parametrize(("sensor", "size"), [("gyro", 0.3), ("gyro", -0.1), ("attitude", 3.0 * DEG)])
def test_a_fault_that_ends_is_over_within_a_second(sensor, size):
    ends = FIRST + round(1.5 / DT)
    fault = size * (ON & (np.arange(ROWS) < ends))[:, None] * np.eye(3)[1]
    said = said_of(with_fault(sensor, fault))
    assert alarms(said)[0] == {(sensor, 1)}
    named = np.isin(said[sensor].state, ALARMS)[:, 1]
    assert named[ends - 1]
    assert not named[ends + round(1.0 / DT) :].any()


def test_a_drift_of_a_sensor_that_has_jumped_is_not_the_other_sensors():
    """Roll jumps and yaw drifts with it: too slowly to say whose that is, had roll not jumped."""
    fault = DEG * (ON[:, None] * np.array([5.0, 0.0, 0.0]) + ELAPSED * np.array([0.0, 0.0, 0.5]))
    named, ambiguous = alarms(said_of(with_fault("attitude", fault)))
    assert named == {("attitude", 0), ("attitude", 2)}
    assert ("gyro", 2) not in ambiguous


def test_an_attitude_that_sways_is_named_again_and_no_gyro():
    """It looks right wherever it passes zero."""
    still = hovering(2, seconds=20.0)
    elapsed = np.maximum(np.arange(round(20.0 / DT)) * DT - ONSET, 0.0)[:, None]
    sways = 5.0 * DEG * np.sin(3.0 * elapsed) * np.eye(3)[2]
    flight = with_imu(still, q_xyzw=quaternion_from_euler(euler_from_quaternion(still.imu.q_xyzw) + sways))
    assert alarms(said_of(flight))[0] == {("attitude", 2)}


def test_one_of_the_two_sensors_of_an_axis_is_always_believed():
    """Faults of both, one after the other: by torque alone nobody could fly."""
    wild = np.sin(2.0 * np.pi * 2.5 * ELAPSED) * np.array([1.0, 0.0, 0.0])
    flight = with_fault("gyro", wild)
    jumped = (20.0 * DEG) * (TIME >= ONSET + 1.0)[:, None] * np.array([1.0, 0.0, 0.0])
    angles = euler_from_quaternion(flight.imu.q_xyzw) + jumped
    said = said_of(with_imu(flight, q_xyzw=quaternion_from_euler(angles)))
    named = [(said[name].state == FAULTY) & ~said[name].ambiguous for name in SENSORS]
    faulty = np.stack([each[:, 0] for each in named])
    assert faulty.any(axis=1).all()
    assert not faulty.all(axis=0).any()


def test_a_torque_that_is_not_the_vehicles_accuses_no_attitude():
    flight = hovering()
    said = said_of(flight._replace(torque=hovering(4).torque + 0.02))
    assert {name for name, _ in set.union(*alarms(said))} <= {"gyro"}


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_a_wrong_inertia_accuses_nobody(share):
    flight = hovering()
    assert alarms(said_of(flight._replace(torque=share * flight.torque))) == (set(), set())


def slower(flight, every=8):
    """The same flight with an attitude at each eighth sample only."""
    there = np.arange(ROWS) % every == 0
    told = np.where(there[:, None], flight.imu.q_xyzw, [0.0, 0.0, 0.0, 1.0])
    return with_imu(flight, q_xyzw=told, attitude_valid=there)


@pytest.mark.parametrize(("sensor", "size"), [("gyro", 0.3), ("gyro", -0.1), ("attitude", 3.0 * DEG)])
def test_an_attitude_slower_than_the_gyro_is_there_and_its_faults_are_named(sensor, size):
    assert alarms(said_of(slower(hovering()))) == (set(), set())
    said = said_of(slower(with_fault(sensor, size * ON[:, None] * np.eye(3)[0])))
    assert alarms(said)[0] == {(sensor, 0)}
    assert np.isin(said[sensor].state, ALARMS)[FIRST + 25 :, 0].all()


def test_a_slower_attitude_is_absent_once_several_readings_have_not_come():
    flight = slower(hovering())
    said = said_of(with_imu(flight, attitude_valid=flight.imu.attitude_valid & ~ON))["attitude"]
    assert not np.isin(said.state[: FIRST + 16], ALARMS).any()
    assert np.all(said.kind[FIRST + 32 :] == ABSENT)


def test_a_smooth_attitude_at_rest_is_not_stuck():
    """That of an estimator before take-off: its changes are far below what is known of its noise at first."""
    rng, there = np.random.default_rng(2), np.ones(ROWS, bool)
    told = quaternion_from_euler(5e-6 * rng.standard_normal((ROWS, 3)).cumsum(axis=0))
    imu = hovering().imu._replace(q_xyzw=told, body_rate=0.001 * rng.standard_normal((ROWS, 3)))
    said = said_of(FaultObserverInputs(imu, np.zeros((ROWS, 3)), driven=there))["attitude"]
    assert not np.isin(said.state, ALARMS).any()


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_rate_that_is_flown_is_good_without_a_gyro_or_an_attitude(sensor):
    there = {"gyro": "rate_valid", "attitude": "attitude_valid"}[sensor]
    flight = with_imu(hovering(3, (0.0, 6.0, 0.0)), **{there: ~ON})
    corrected = fly_arrays(*as_flown(BankObserver(vehicle=QBALL), flight), DT)[1].said.corrected
    assert corrected.rate_valid.all()
    assert corrected.attitude_valid.all()
    assert np.max(abs(corrected.body_rate - hovering(3, (0.0, 6.0, 0.0)).imu.body_rate)[FIRST:]) < 0.6


def test_readings_without_noise_that_come_to_rest_are_not_stuck():
    time = DT * np.arange(4000)[:, None]
    swings = np.sin(3.0 * time) * np.exp(-np.maximum(time - 2.0, 0.0) / 0.3) * np.ones(3)
    state, usual = readings.start_readings(swings[0]), np.full(3, np.mean(np.diff(swings, axis=0) ** 2))
    for each in swings[1:]:
        state = readings.take_reading(state, each, np.True_, usual, DT)
        assert not readings.is_stuck(state).any()
    assert abs(np.diff(swings, axis=0)[-1]).max() < 1e-12


def test_a_constant_that_dithers_below_the_noise_is_stuck():
    read, dither = hovering().imu.body_rate, 2e-6 * np.random.default_rng(1).integers(2, size=(ROWS, 3))
    said = said_of(with_imu(hovering(), body_rate=np.where(ON[:, None], read[FIRST] + dither, read)))
    assert np.all(said["gyro"].kind[FIRST + 50 :] == STUCK)


def test_a_coarse_sensor_at_rest_is_healthy():
    """Half of the readings repeat the last, as the noise is half of the resolution."""
    rng, there = np.random.default_rng(1), np.ones(ROWS, bool)
    told = quaternion_from_euler(0.1 * DEG * rng.standard_normal((ROWS, 3)))
    rate = np.round(0.5 * rng.standard_normal((ROWS, 3))) * 1e-3
    imu = hovering().imu._replace(q_xyzw=told, body_rate=rate)
    said = said_of(felt_too(FaultObserverInputs(imu, np.zeros((ROWS, 3)), driven=there)))
    assert alarms(said) == (set(), set())


def test_vehicles_together_are_as_one_by_one():
    both = with_fault("gyro", 0.4 * (TIME >= 80 * DT)[:, None] * np.eye(3)[0]), hovering(5)
    law = BankObserver(vehicle=QBALL)
    together = FaultObserverInputs(
        ImuSample(*(np.stack(pair, axis=1) for pair in zip(*(each.imu for each in both), strict=True))),
        np.stack([each.torque for each in both], axis=1),
        driven=np.stack([each.driven for each in both], axis=1),
    )
    last = []
    for flight in (together, *both):
        state = law.init(rows_of(flight, 0))
        for k in range(100):
            state, estimate = law.step(state, rows_of(flight, k), DT if k else 0.0)
        last.append((state.bank, state.motion, estimate.sensors.gyro, estimate.corrected))
    assert last[1][2].state.tolist() != last[2][2].state.tolist()  # the first has a fault
    for k in range(2):
        for joint, own in zip(flat(last[0]), flat(last[1 + k]), strict=True):
            assert np.allclose(joint[k], own, rtol=1e-9, atol=1e-12)


def flat(tree):
    return [leaf for part in tree for leaf in flat(part)] if isinstance(tree, tuple) else [tree]
