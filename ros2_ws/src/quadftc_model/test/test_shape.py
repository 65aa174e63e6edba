"""What a vehicle looks like."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest

from quadftc_model.shape import parts_of, rotor_radius, urdf_of
from quadftc_model.vehicle import load_vehicle, vehicle_names


@pytest.mark.parametrize("name", vehicle_names())
def test_rotors_stand_where_the_vehicle_file_says_and_do_not_touch(name):
    vehicle = load_vehicle(name)
    places = vehicle.rotors.positions
    rotors = [part for part in parts_of(vehicle) if part.name.startswith("rotor_")]
    assert np.array([part.position[:2] for part in rotors]) == pytest.approx(places)
    nearest = min(np.linalg.norm(a - b) for k, a in enumerate(places) for b in places[:k])
    assert 2.0 * rotor_radius(vehicle) < nearest
    assert {part.size[0] for part in rotors} == {2.0 * rotor_radius(vehicle)}


@pytest.mark.parametrize("name", vehicle_names())
def test_urdf_has_mass_shape_and_imu_of_the_vehicle(name):
    vehicle = load_vehicle(name)
    robot = ET.fromstring(urdf_of(vehicle))
    base, imu = robot.findall("link")
    assert (base.get("name"), imu.get("name")) == ("base_link", "imu_link")
    assert float(base.find("inertial/mass").get("value")) == pytest.approx(vehicle.mass)
    assert len(base.findall("visual")) == len(parts_of(vehicle))
    place = [float(word) for word in robot.find("joint/origin").get("xyz").split()]
    assert place == pytest.approx(vehicle.aerodynamics.imu_position)
