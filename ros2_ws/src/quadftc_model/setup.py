"""Build script of quadftc_model (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "quadftc_model"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Rotations, rigid body, rotors and mixer, vehicles: pure functions over arrays.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    package_data={"quadftc_model": ["vehicles/*.toml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/meshes", sorted(glob("meshes/*.stl"))),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
