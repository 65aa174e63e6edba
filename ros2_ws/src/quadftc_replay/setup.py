"""Build script of quadftc_replay (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_replay"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Recorded IMU samples through the diagnosis.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["calibration/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
