"""Magnetometers, barometers and satellite receivers at the rates at which autopilots log them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from quadftc_model.rotations import quaternion_from_euler, quaternion_product, to_body
from quadftc_replay.flight_log import Event, FlightLog, Signal
from quadftc_replay.inspection.attitude import Creep
from quadftc_replay.inspection.compass import Field, fields_of, owner_by_field
from quadftc_replay.inspection.flight import Interval, prepare
from quadftc_replay.inspection.heading import heading_findings
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.verdict import Finding

END, ONSET, UNTIL = 40.0, 18.05, 25.05  # s
FIELD, GRAVITY = np.array([50.0, 220.0, -420.0]), np.array([0.0, 0.0, 9.80665])  # mG, m/s²
Change = Callable[[Signal], Signal]
SENSORS = (
    *("gyros", "accelerometers", "magnetometers", "barometers"),
    *("gps_positions", "gps_velocities", "gps_status"),
)


def at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Position [m], velocity, acceleration and attitude of a vehicle that flies eights and turns."""
    size, rate = np.array([8.0, 6.0, 1.5]), np.array([0.5, 0.8, 0.4])
    angle = time[:, None] * rate
    acceleration = -size * rate**2 * np.sin(angle)
    roll, pitch = -acceleration[:, 1] / 9.8, acceleration[:, 0] / 9.8
    q = quaternion_from_euler(np.stack([roll, pitch, 2.0 * np.sin(0.3 * time)], axis=-1))
    return size * np.sin(angle), size * rate * np.cos(angle), acceleration, q


def fly(seed: int = 1, magnetometers: int = 3) -> FlightLog:
    """A healthy flight as ArduPilot logs it: a receiver that lags, hard iron, a height that wanders."""
    rng = np.random.default_rng(seed)

    def noisy(rate: float, values: Callable[[np.ndarray], np.ndarray], sigma: float) -> Signal:
        time = np.arange(0.0, END, 1.0 / rate)
        exact = values(time)
        return Signal(time, exact + sigma * rng.standard_normal(exact.shape))

    def rates(time: np.ndarray) -> np.ndarray:
        half = 1e-3  # s
        back = at(time - half)[3] * np.array([-1.0, -1.0, -1.0, 1.0])
        turn = quaternion_product(back, at(time + half)[3])
        return turn[:, :3] * np.sign(turn[:, 3:]) / half

    def wander(time: np.ndarray) -> np.ndarray:
        return at(time)[0][:, 2:] + 100.0 + 0.03 * time[:, None] + 0.5 * np.sin(0.2 * time)[:, None]

    names = ("", "1", "2")[:magnetometers]
    iron = {name: 60.0 * rng.standard_normal(3) for name in names}
    return FlightLog(
        path=Path("flight"),
        format="ArduPilot BIN",
        gyros={"": noisy(25.0, rates, 0.003)},
        accelerometers={"": noisy(25.0, lambda t: to_body(at(t)[3], at(t)[2] + GRAVITY), 0.05)},
        attitude=noisy(10.0, lambda t: at(t)[3], 0.0),
        attitude_from_gyro=True,
        magnetometers={
            name: noisy(3.3, lambda t, b=iron[name]: to_body(at(t)[3], np.tile(FIELD, (len(t), 1))) + b, 2.0)
            for name in names
        },
        barometers={name: noisy(5.0, wander, 0.1) for name in ("", "1")},
        gps_positions={"": noisy(5.0, lambda t: at(t - 0.2)[0], 0.05)},
        gps_velocities={"": noisy(5.0, lambda t: at(t - 0.2)[1], 0.05)},
        gps_status={"": noisy(5.0, lambda t: np.tile([3.0, 12.0, 0.4], (len(t), 1)), 0.0)},
        rotor_commands=noisy(10.0, lambda t: np.full((len(t), 4), 0.4), 0.01),
    )


def changed(log: FlightLog, **changes: Change) -> FlightLog:
    """The log with the first sensor of some fields changed."""
    fields = {}
    for field, change in changes.items():
        sensors = getattr(log, field)
        fields[field] = {**sensors, "": change(sensors[""])}
    return dataclasses.replace(log, **fields)


def offset(*size: float, until: float = END) -> Change:
    def change(signal: Signal) -> Signal:
        there = (signal.time >= ONSET) & (signal.time < until)
        return Signal(signal.time, signal.value + there[:, None] * np.array(size))

    return change


def drift(*rate: float) -> Change:
    return lambda signal: Signal(
        signal.time, signal.value + np.maximum(signal.time - ONSET, 0.0)[:, None] * np.array(rate)
    )


def frozen(signal: Signal) -> Signal:
    row = int(np.searchsorted(signal.time, ONSET))
    value = signal.value.copy()
    value[row:] = value[row - 1]
    return Signal(signal.time, value)


def lost(signal: Signal) -> Signal:
    kept = (signal.time < ONSET) | (signal.time > UNTIL)
    return Signal(signal.time[kept], signal.value[kept])


def first_of(log: FlightLog) -> Finding:
    """The first finding, of the only component that is named."""
    findings = inspect(log).verdict.findings
    assert len({each.component for each in findings}) == 1, findings
    return findings[0]


@pytest.mark.parametrize("magnetometers", [1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_healthy_flight_is_judged_and_nothing_is_found(seed: int, magnetometers: int):
    verdict = inspect(fly(seed, magnetometers)).verdict
    assert verdict.findings == ()
    assert {"magnetometer", "barometer", "gps"} <= set(verdict.judged)


@pytest.mark.parametrize("magnetometers", [1, 2, 3])
def test_offset_of_a_magnetometer_is_named_with_its_axis(magnetometers: int):
    found = first_of(changed(fly(magnetometers=magnetometers), magnetometers=offset(0.0, -300.0, 0.0)))
    assert (found.component, found.element, found.kind, found.unit) == ("magnetometer", "y", "offset", "mG")
    assert found.onset_s == pytest.approx(ONSET, abs=0.31)
    assert found.size == pytest.approx(-300.0, abs=2.0 * found.sigma)


def test_sensors_that_turn_noisy_are_named():
    rng = np.random.default_rng(2)

    def noisy(sigma: float) -> Change:
        def change(signal: Signal) -> Signal:
            late = (signal.time >= ONSET)[:, None]
            return Signal(signal.time, signal.value + sigma * late * rng.standard_normal(signal.value.shape))

        return change

    for field, sigma, component in (
        ("magnetometers", 40.0, "magnetometer"),
        ("barometers", 4.0, "barometer"),
        ("gps_positions", 8.0, "gps"),
    ):
        found = first_of(changed(fly(), **{field: noisy(sigma)}))
        assert (found.component, found.kind) == (component, "noise")
        assert found.onset_s == pytest.approx(ONSET, abs=2.0)
        assert found.size == pytest.approx(sigma, rel=0.4)


def test_magnetometer_that_repeats_its_reading_is_named_by_another_that_does_not():
    log = fly(magnetometers=2)
    still = np.zeros_like(log.magnetometers[""].time)
    hover = {
        name: Signal(each.time, to_body(at(still)[3], np.tile(FIELD, (len(still), 1))) + 2.0 * noise)
        for (name, each), noise in zip(
            log.magnetometers.items(),
            np.random.default_rng(3).standard_normal((2, len(still), 3)),
            strict=True,
        )
    }
    time = log.attitude.time if log.attitude is not None else still
    sway = np.stack([0.01 * np.sin(time), np.zeros_like(time), np.zeros_like(time)], axis=-1)
    upright = Signal(time, quaternion_from_euler(sway))
    log = dataclasses.replace(log, magnetometers=hover, attitude=upright)
    found = [
        each for each in inspect(changed(log, magnetometers=frozen)).verdict.findings if each.kind == "stuck"
    ]
    assert {each.component for each in found} == {"magnetometer"}


def test_magnetometers_that_turn_with_the_attitude_and_not_with_the_gyro_are_right():
    log = fly()
    q = log.attitude.value.copy()
    late = log.attitude.time >= ONSET
    yaw = quaternion_from_euler(np.array([0.0, 0.0, 1.0]))  # the estimator sets its heading anew
    q[late] = quaternion_product(np.tile(yaw, (late.sum(), 1)), q[late])
    reset = (Event(ONSET, "EV", "EKF yaw reset"),)
    log = dataclasses.replace(log, attitude=Signal(log.attitude.time, q), events=reset)
    assert not [each for each in inspect(log).verdict.findings if each.component.startswith("magnetometer")]


@pytest.mark.parametrize("since", [0.0, 0.4 * END])
def test_interference_that_follows_the_rotors_all_along_is_named(since: float):
    log = fly()
    level = 0.4 + 0.2 * np.sin(2.0 * log.rotor_commands.time)
    log = dataclasses.replace(log, rotor_commands=Signal(log.rotor_commands.time, np.tile(level, (4, 1)).T))

    def disturb(signal: Signal) -> Signal:
        added = 500.0 * np.sin(2.0 * signal.time)[:, None] * np.array([0.0, 0.0, 1.0])
        return Signal(signal.time, signal.value + np.where(signal.time[:, None] > since, added, 0.0))

    found = inspect(changed(log, magnetometers=disturb)).verdict.findings
    named = [(each.component, each.element) for each in found if each.kind == "interference"]
    assert named == ([("magnetometer", "z")] if since == 0.0 else [])


def test_field_of_the_earth_tells_whether_gyro_or_heading_creeps():
    time = np.arange(0.0, 20.0, 0.2)
    expected = np.tile([180.0, 0.0, -430.0], (len(time), 1))
    noise = np.random.default_rng(2).standard_normal((len(time), 3))
    angle = -0.1 * np.clip(time - 5.0, 0.0, 10.0)  # by which the attitude would be turned
    turned = angle[:, None] * np.cross([0.0, 0.0, 1.0], expected)

    def owner(*rests: np.ndarray, end: float = 15.0) -> str | None:
        fields = (Field(Signal(time, rest), 466.0, np.zeros(3), np.ones(3), expected) for rest in rests)
        told = owner_by_field(Creep(2, Interval(5.0, end), 0.1, 0.01, 2.0, None), fields)
        return None if told is None else told.component

    assert owner(noise) == "gyro"
    assert owner(noise + turned) == "attitude"
    assert owner(noise, noise + turned) is None
    assert owner(noise, end=7.0) is None  # no compass is that good


def test_barometers_that_jump_together_are_named_once():
    log, glitch = fly(), offset(10.0, until=UNTIL)
    barometers = {name: glitch(each) for name, each in log.barometers.items()}
    (found,) = inspect(dataclasses.replace(log, barometers=barometers)).verdict.findings
    assert (found.component, found.element, found.kind) == ("barometer", "", "offset")
    assert found.size == pytest.approx(10.0, abs=3.0 * found.sigma)
    assert (found.onset_s, found.end_s) == pytest.approx((ONSET, UNTIL), abs=0.21)
    assert "barometer 1 does the same" in found.evidence[0]


@pytest.mark.parametrize(("axis", "element"), [(0, "y"), (1, "x"), (2, "z")])  # east, north, up
def test_position_of_satellites_that_jumps_is_named_by_its_direction(axis: int, element: str):
    glitch = offset(*(8.0 * np.eye(3)[axis]), until=UNTIL)
    (found,) = inspect(changed(fly(), gps_positions=glitch)).verdict.findings
    assert (found.component, found.element, found.kind, found.unit) == ("gps", element, "offset", "m")
    assert found.size == pytest.approx(8.0, abs=2.0 * found.sigma)
    assert (found.onset_s, found.end_s) == pytest.approx((ONSET, UNTIL), abs=0.21)


def test_position_that_is_pulled_off_and_a_height_that_drifts_are_told_by_their_rate():
    found = first_of(changed(fly(), gps_positions=drift(0.0, 2.0, 0.0)))
    assert (found.component, found.element, found.kind, found.unit) == ("gps", "x", "drift", "m/s")
    assert found.size == pytest.approx(2.0, abs=0.2)
    log = fly()
    sinking = {name: drift(-3.0)(each) for name, each in log.barometers.items()}
    found = first_of(dataclasses.replace(log, barometers=sinking))
    assert (found.component, found.kind) == ("barometer", "drift")
    assert found.onset_s == pytest.approx(ONSET, abs=0.5)


def test_velocity_of_satellites_that_jumps_is_told_from_a_wrong_accelerometer():
    pull = {"gps_velocities": offset(3.0, 0.0, 0.0), "gps_positions": drift(3.0, 0.0, 0.0)}
    found = first_of(changed(fly(), **pull))
    assert (found.component, found.element, found.unit) == ("gps", "y", "m/s")
    found = first_of(changed(fly(), accelerometers=offset(3.0, 0.0, 0.0)))
    assert (found.component, found.element) == ("accelerometer", "x")


@pytest.mark.parametrize(("change", "kind"), [(frozen, "stuck"), (lost, "absent")])
@pytest.mark.parametrize("component", ["magnetometer", "barometer", "gps"])
def test_sensor_that_repeats_or_stops_comes_first(component: str, change: Change, kind: str):
    fields = {
        "magnetometer": ["magnetometers"],
        "barometer": ["barometers"],
        "gps": ["gps_positions", "gps_velocities", "gps_status"],
    }
    found = inspect(changed(fly(), **dict.fromkeys(fields[component], change))).verdict.findings[0]
    assert (found.component, found.kind) == (component, kind)
    assert found.onset_s == pytest.approx(ONSET, abs=0.4)


def test_barometer_that_holds_its_height_without_the_noise_of_the_air_is_stuck():
    def held(signal: Signal) -> Signal:
        late, row = signal.time > ONSET, int(np.searchsorted(signal.time, ONSET))
        left = signal.value[row] + 0.01 * (signal.value - signal.value[row])
        return Signal(signal.time, np.where(late[:, None], left, signal.value))

    found = first_of(changed(fly(), barometers=held))
    assert (found.component, found.kind, found.end_s) == ("barometer", "stuck", None)
    assert found.onset_s == pytest.approx(ONSET, abs=1.5)  # the noise is that of 1.6 s


@pytest.mark.parametrize("seconds", [0.6, 3.0])
def test_clock_that_jumps_is_no_fault_of_the_satellites(seconds: float):
    log = fly()

    def late(signal: Signal) -> Signal:
        return Signal(signal.time + seconds * (signal.time > ONSET), signal.value)

    named = {field: {name: late(each) for name, each in getattr(log, field).items()} for field in SENSORS}
    flown = {field: late(getattr(log, field)) for field in ("attitude", "rotor_commands")}
    assert inspect(dataclasses.replace(log, **named, **flown)).verdict.findings == ()


def test_attitude_that_goes_wrong_with_the_flight_is_no_interference():
    log, time = fly(), np.arange(0.0, END, 0.1)
    level = 0.4 + 0.2 * np.sin(2.0 * time)
    field = to_body(at(time)[3], np.tile(FIELD, (len(time), 1)))
    field[:, 2] += np.where(time > 8.0, 500.0 * np.sin(2.0 * time), 0.0)  # as the attitude is wrong
    commands = Signal(time, np.tile(level, (4, 1)).T)
    log = dataclasses.replace(log, rotor_commands=commands, magnetometers={"": Signal(time, field)})
    assert fields_of(prepare(log), until=END)[""].currents[2] > 500.0
    assert abs(fields_of(prepare(log), until=8.0)[""].currents[2]) < 100.0


def test_log_that_loses_messages_by_chance_lacks_no_sensor():
    rng = np.random.default_rng(5)
    log = fly()

    def thinned(signal: Signal) -> Signal:
        kept = rng.random(len(signal)) > 0.6
        return Signal(signal.time[kept], signal.value[kept])

    assert inspect(changed(log, barometers=thinned, magnetometers=thinned)).verdict.findings == ()


@pytest.mark.parametrize(("since", "onset"), [(0.0, 0.0), (ONSET, ONSET)])
@pytest.mark.parametrize("size", [-0.6, 2.5])
def test_heading_that_is_wrong_is_told_by_where_the_vehicle_is_pushed(
    since: float, onset: float, size: float
):
    log = fly()
    assert log.attitude is not None
    angles = np.zeros((len(log.attitude), 3))
    angles[log.attitude.time >= since, 2] = size
    turned = quaternion_product(quaternion_from_euler(angles), log.attitude.value)
    (found,) = heading_findings(
        prepare(dataclasses.replace(log, attitude=Signal(log.attitude.time, turned))), END
    )
    assert (found.finding.name, found.finding.kind) == ("attitude yaw", "offset")
    assert found.finding.size == pytest.approx(size, abs=0.1)
    assert found.finding.onset_s == pytest.approx(onset, abs=1.0)
    assert found.finding.ambiguous_with == ("magnetometer",)


def test_heading_is_right_in_a_healthy_flight_and_not_judged_in_a_hover():
    log = fly()
    assert heading_findings(prepare(log), END) == []
    assert log.attitude is not None
    half_a_turn = np.tile([0.0, 0.0, 1.0, 0.0], (len(log.attitude), 1))
    level = Signal(log.attitude.time, half_a_turn)
    rng = np.random.default_rng(0)
    time, slow = log.gps_velocities[""].time, log.accelerometers[""].time
    velocity = Signal(time, 0.05 * rng.standard_normal((len(time), 3)))
    force = Signal(slow, GRAVITY + 0.05 * rng.standard_normal((len(slow), 3)))
    hover = dataclasses.replace(
        log, attitude=level, gps_velocities={"": velocity}, accelerometers={"": force}
    )
    assert heading_findings(prepare(hover), END) == []
