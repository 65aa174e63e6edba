"""Build script of quadftc_control (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_control"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Attitude control: controllers, references, and their nodes.",
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
            "controller = quadftc_control.executables:controller",
            "position_controller = quadftc_control.executables:position_controller",
            "reference = quadftc_control.executables:reference",
        ],
    },
)
