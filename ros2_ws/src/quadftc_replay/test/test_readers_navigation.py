"""Magnetometers, barometers and satellite receivers of every format: units, axes, instances, fixes."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_replay.flight_log import FlightLog
from quadftc_replay.readers import ardupilot as ardupilot_reader
from quadftc_replay.readers import read_log, ulog_navigation
from quadftc_replay.readers.positioning import pressure_height
from quadftc_replay.readers.signals import Signals

N = 20
MICRO = 200_000 * np.arange(1, N + 1)
FIXES = np.where(np.arange(N) < 5, 1, 6)  # the first second without one
LATITUDE = np.where(FIXES > 1, 45.0 + 1e-5 * np.arange(N), 0.0)


def by(add, content) -> FlightLog:
    signals = Signals(Path("log"), "a log")
    add(signals, content)
    return signals.flight_log()


def full(value: float, count: int = N) -> np.ndarray:
    return np.full(count, value)


def ardupilot(instances: bool) -> dict[str, dict[str, np.ndarray]]:
    """Messages of two magnetometers and receivers: told apart by a field, or by their names."""

    def messages(name: str, number: int, fields: dict[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
        own = {"I": full(number)} if instances else {}
        return {f"{name}{number + 1 if number else ''}": {"TimeUS": MICRO, **own, **fields}}

    tables: dict[str, dict[str, np.ndarray]] = {}
    for number in (0, 1):
        field = {"MagX": full(100.0), "MagY": full(200.0), "MagZ": full(300.0 + number)}
        place = {"Lat": LATITUDE, "Lng": full(10.0), "Alt": 400.0 + np.arange(N), "Status": FIXES}
        motion = {"Spd": full(2.0), "GCrs": full(90.0), "VZ": full(-1.0), "NSats": full(9.0)}
        tables |= messages("MAG", number, {**field, "Health": np.where(MICRO > 2e6, 0, 1)})
        tables |= messages("GPS", number, place | motion)
        tables |= messages("GPA", number, {"HAcc": full(0.7 + number)})
    if instances:
        tables = {
            name: {
                field: np.stack([values, tables[f"{name}2"][field]], axis=1).ravel()
                for field, values in tables[name].items()
            }
            for name in ("MAG", "GPS", "GPA")
        }
    return tables


@pytest.mark.parametrize("instances", [True, False])
def test_ardupilot_tells_sensors_apart_by_a_field_or_by_their_names(instances: bool):
    log = by(ardupilot_reader.add_navigation, ardupilot(instances))
    assert log.field_unit == "mG"
    np.testing.assert_allclose(log.magnetometers[""].value[0], [100.0, -200.0, -300.0])
    np.testing.assert_allclose(log.magnetometers["1"].value[0], [100.0, -200.0, -301.0])
    position = log.gps_positions["1"]
    assert len(position) == N - 5  # without a fix it is nowhere
    np.testing.assert_allclose(position.value[-1], [0.0, 14 * 1.1113, 14.0], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(log.gps_velocities[""].value[0], [2.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(log.gps_status["1"].value[0], [1.0, 9.0, 1.7])
    assert [event.text for event in log.events if event.source == "MAG 0"] == ["unhealthy"]


@pytest.mark.parametrize("is_old", [True, False])
def test_px4_positions_are_whole_numbers_before_and_degrees_now(is_old: bool):
    if is_old:
        place = {"lat": np.rint(1e7 * LATITUDE), "lon": full(1e8), "alt": full(4e5)}
    else:
        place = {"latitude_deg": LATITUDE, "longitude_deg": full(10.0), "altitude_msl_m": full(400.0)}
    velocity = {"vel_n_m_s": full(1.0), "vel_e_m_s": full(2.0), "vel_d_m_s": full(3.0)}
    status = {"fix_type": FIXES, "satellites_used": full(12.0), "eph": full(0.6)}
    pressure = {"pressure": full(900.0 if is_old else 90_000.0), "device_id": full(2.0)}
    data = {
        ("vehicle_gps_position", 0): {"timestamp": MICRO, **place, **velocity, **status},
        ("vehicle_magnetometer", 0): {
            "timestamp": MICRO,
            **{f"magnetometer_ga[{k}]": full(0.1 * (k + 1)) for k in range(3)},
        },
        ("vehicle_air_data", 0): {
            "timestamp": MICRO,
            "baro_alt_meter": full(988.0),
            "baro_device_id": full(1.0),
        },
        ("sensor_baro", 0): {"timestamp": MICRO, **pressure, "device_id": full(1.0)},
        ("sensor_baro", 1): {"timestamp": MICRO, **pressure},
    }
    log = by(ulog_navigation.add_navigation, data)
    np.testing.assert_allclose(log.magnetometers[""].value[0], [100.0, -200.0, -300.0])
    np.testing.assert_allclose(log.gps_positions[""].value[-1], [0.0, 14 * 1.1113, 0.0], rtol=1e-3)
    np.testing.assert_allclose(log.gps_velocities[""].value[0], [2.0, 1.0, -3.0])
    heights = {name: float(each.value[0, 0]) for name, each in log.barometers.items()}
    assert heights == pytest.approx({"": 988.0, "1": 988.5}, abs=0.05)


def test_telemetry_has_flat_velocity_and_height_by_pressure(tmp_path):
    link, parts = dialect.MAVLink(None, srcSystem=1, srcComponent=1), list[bytes]()
    for k in range(N):
        ms = 5000 + 100 * k
        place = (450_000_000 + 100 * k, 100_000_000, 400_000, 100, 100, 300, 9000, 9)
        for each in (
            dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3),
            dialect.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            dialect.MAVLink_raw_imu_message(1000 * ms, 0, 0, -1000, 1, 1, 1, 1, 2, 3),
            dialect.MAVLink_scaled_imu2_message(ms, 0, 0, -1000, 1, 1, 1, 1, 2, 3),
            dialect.MAVLink_gps_raw_int_message(1000 * ms, 3, *place),
            dialect.MAVLink_scaled_pressure_message(ms, 900.0, 0.0, 2000),
        ):
            parts.append(struct.pack(">Q", 1_700_000_000_000_000 + 1000 * ms) + each.pack(link))
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(parts))
    log = read_log(path)
    assert set(log.magnetometers) == {"", "2"}
    np.testing.assert_allclose(log.magnetometers[""].value[0], [1.0, -2.0, -3.0])
    np.testing.assert_allclose(log.barometers[""].value[0], 988.5, atol=0.5)
    np.testing.assert_allclose(log.gps_velocities[""].value[0], [3.0, 0.0, np.nan], atol=1e-9)
    assert log.gps_velocity is None  # what is known of it is not whole
    assert log.gps_positions[""].value[10, 1] == pytest.approx(11.1, rel=2e-3)


def test_height_of_a_pressure_is_that_of_the_standard_atmosphere():
    np.testing.assert_allclose(pressure_height([101_325.0, 89_874.6, 0.0]), [0.0, 1000.0, np.nan], atol=0.5)
