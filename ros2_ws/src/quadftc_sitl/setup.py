"""Build script of quadftc_sitl (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_sitl"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Real autopilots in the loop: their firmware flies the plant, with faults.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["guardian = quadftc_sitl.executables:guardian"]},
)
