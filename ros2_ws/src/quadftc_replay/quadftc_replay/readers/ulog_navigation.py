# pyright: basic
"""Magnetometers, barometers and satellite receivers of a PX4 log.

``vehicle_magnetometer`` and ``vehicle_air_data`` are what the estimator gets; instances of the drivers stand
beside them. Positions are whole numbers (1e-7 deg, mm) before version 1.14. Pressures are in hPa before 1.13.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from quadftc_model.frames import enu_from_ned, flu_from_frd
from quadftc_replay.flight_log import Floats
from quadftc_replay.readers.positioning import Fixes, add_receiver, pressure_height
from quadftc_replay.readers.signals import Signals
from quadftc_replay.readers.ulog_datasets import Dataset, fields_of, stamps_of, vectors

FIELDS, FIELD_DRIVER = "vehicle_magnetometer", "sensor_mag"
AIR, AIR_DRIVER = "vehicle_air_data", "sensor_baro"
SATELLITES, SATELLITES_DRIVER = "vehicle_gps_position", "sensor_gps"
NAVIGATION = (FIELDS, FIELD_DRIVER, AIR, AIR_DRIVER, SATELLITES, SATELLITES_DRIVER)  # topics
MILLIGAUSS = 1e3  # of a gauss
HECTOPASCAL, LARGEST = 100.0, 2000.0  # Pa; hPa that no air has
VELOCITY = ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
# latitude, longitude, height: name -> unit [deg, m]
PLACES = (
    {"latitude_deg": 1.0, "longitude_deg": 1.0, "altitude_msl_m": 1.0},
    {"lat": 1e-7, "lon": 1e-7, "alt": 1e-3},
)

Data = Mapping[tuple[str, int], Dataset]  # topic and instance


def add_navigation(signals: Signals, data: Data) -> None:
    """Add every magnetometer, barometer and satellite receiver."""
    for name, table in _named(data, FIELDS) or _named(data, FIELD_DRIVER):
        value = vectors(table, "magnetometer_ga")
        value = fields_of(table, "x", "y", "z") if value is None else value
        if value is not None:
            signals.add("magnetometers", stamps_of(table), MILLIGAUSS * flu_from_frd(value), FIELDS, name)
    _add_barometers(signals, data)
    drivers = _named(data, SATELLITES_DRIVER)
    chosen = _named(data, SATELLITES)
    if len(drivers) < 2 and chosen:  # what was chosen of several, or blended, says nothing of each
        drivers = max(chosen[:1], drivers, key=lambda each: len(each[0][1]["timestamp"]) if each else 0)
    for name, table in drivers:
        if (said := _fixes(table)) is not None:
            add_receiver(signals, stamps_of(table), said, SATELLITES, name)


def _named(data: Data, topic: str) -> list[tuple[str, Dataset]]:
    """Instances of a topic by name; the first one has none."""
    instances = sorted(instance for name, instance in data if name == topic)
    return [("" if k == instances[0] else str(k), data[topic, k]) for k in instances]


def _add_barometers(signals: Signals, data: Data) -> None:
    """Add the height by the air that the estimator gets, and that of other barometers."""
    main = data.get((AIR, 0))
    if main is not None and "baro_alt_meter" in main:
        signals.add("barometers", stamps_of(main), main["baro_alt_meter"], AIR)
    device = main.get("baro_device_id") if main is not None else None
    for number, (name, table) in enumerate(_named(data, AIR_DRIVER)):
        own = table.get("device_id")
        is_main = number == 0 if device is None or own is None else int(own[0]) == int(device[-1])
        if "pressure" not in table or (is_main and signals.has("barometers")):
            continue
        pressure = np.asarray(table["pressure"], np.float64)
        pressure = np.where(pressure < LARGEST, HECTOPASCAL * pressure, pressure)
        key = name or ("0" if signals.has("barometers") else "")
        signals.add("barometers", stamps_of(table), pressure_height(pressure), AIR_DRIVER, key)


def _fixes(table: Dataset) -> Fixes | None:
    """What a receiver said; None without a position."""
    place = next((names for names in PLACES if names.keys() <= table.keys()), None)
    if place is None:
        return None
    latitude, longitude, height = (unit * np.asarray(table[name], float) for name, unit in place.items())
    unknown: Floats = np.full(len(latitude), np.nan)
    velocity = fields_of(table, *VELOCITY)
    return Fixes(
        *(latitude, longitude, height),
        velocity=np.full((len(latitude), 3), np.nan) if velocity is None else enu_from_ned(velocity),
        fix=np.asarray(table.get("fix_type", unknown), float),
        satellites=np.asarray(table.get("satellites_used", unknown), float),
        accuracy=np.asarray(table.get("eph", unknown), float),
    )
