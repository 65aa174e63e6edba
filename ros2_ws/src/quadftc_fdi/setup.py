"""Build script of quadftc_fdi (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_fdi"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Fault diagnosis: fault observers, disturbance observers, and their nodes.",
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
            "fault_observer = quadftc_fdi.executables:fault_observer",
            "attitude_estimator = quadftc_fdi.executables:attitude_estimator",
            "disturbance_observer = quadftc_fdi.executables:disturbance_observer",
        ],
    },
)
