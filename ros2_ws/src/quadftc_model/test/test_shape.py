"""What a vehicle looks like."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from quadftc_model.shape import MESHES, parts_of, rotor_radius, urdf_of
from quadftc_model.vehicle import load_vehicle, vehicle_names

MESH_FOLDER = Path(__file__).parents[1] / "meshes"  # in the source tree


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


@pytest.mark.parametrize("name", vehicle_names())
def test_urdf_shows_a_propeller_of_the_rotor_s_turning_direction_and_radius(name):
    vehicle = load_vehicle(name)
    meshes = ET.fromstring(urdf_of(vehicle)).findall("link/visual/geometry/mesh")
    files = [mesh.get("filename").removeprefix(f"{MESHES}/") for mesh in meshes]
    turning = {"propeller_ccw.stl": 1.0, "propeller_cw.stl": -1.0}
    assert [turning[file] for file in files] == vehicle.rotors.spin_sign.tolist()
    assert all((MESH_FOLDER / file).is_file() for file in files)
    scales = np.array([mesh.get("scale").split() for mesh in meshes], dtype=float)
    assert scales == pytest.approx(rotor_radius(vehicle), rel=1e-5)


@pytest.mark.parametrize(("turning", "sign"), [("ccw", 1.0), ("cw", -1.0)])
def test_propeller_is_a_closed_mesh_of_radius_1_that_lifts_along_z(turning, sign):
    data = (MESH_FOLDER / f"propeller_{turning}.stl").read_bytes()
    assert len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    records = np.frombuffer(data[84:], dtype=[("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    normals, corners = records["vectors"][:, 0].astype(float), records["vectors"][:, 1:].astype(float)
    assert np.hypot(corners[..., 0], corners[..., 1]).max() == pytest.approx(1.0, abs=1e-6)
    assert corners[..., 2].min() == pytest.approx(0.0, abs=1e-6)  # stands on the motor
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert crosses.sum(axis=0) == pytest.approx(0.0, abs=1e-6)  # closed
    assert np.einsum("ij,ij", corners[:, 0], crosses) > 0.0  # normals point outward
    assert np.linalg.norm(crosses, axis=-1)[:, None] * normals == pytest.approx(crosses, abs=1e-6)
    _, y, z = corners[corners[..., 0] > 0.3].T  # one blade: its leading edge is its higher one
    assert np.polyfit(y, z, 1)[0] * sign > 0.2
