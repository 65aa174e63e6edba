"""Build script of quadftc_ros (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_ros"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="What all nodes share: QoS, parameters, conversions, stamp joining, diagnostics, recorder.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["loopback.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "recorder = quadftc_ros.executables:recorder",
            "scene = quadftc_ros.executables:scene",
        ],
    },
)
