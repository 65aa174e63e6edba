"""Build script of quadftc_sim (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_sim"

setup(
    name=PACKAGE,
    version="0.1.0",
    description=(
        "The simulated vehicle and its faults: plant, sensors, disturbances, fault injector, and their nodes."
    ),
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
    entry_points={
        "console_scripts": [
            "plant = quadftc_sim.executables:plant",
            "fault_injector = quadftc_sim.executables:fault_injector",
            "ardupilot_backend = quadftc_sim.executables:ardupilot_backend",
            "betaflight_backend = quadftc_sim.executables:betaflight_backend",
        ],
    },
)
