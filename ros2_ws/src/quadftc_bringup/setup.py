"""Build script of quadftc_bringup (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "quadftc_bringup"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Launch files, parameter files, Foxglove layout and RViz configuration of the quadftc graph.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/config", sorted(glob("config/*.yaml"))),
        (f"share/{PACKAGE}/diagnostics", sorted(glob("diagnostics/*.yaml"))),
        (f"share/{PACKAGE}/foxglove", sorted(glob("foxglove/*.json"))),
        (f"share/{PACKAGE}/rviz", sorted(glob("rviz/*.rviz"))),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
