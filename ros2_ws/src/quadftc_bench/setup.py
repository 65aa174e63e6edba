"""Build script of quadftc_bench (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_bench"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Scenario files, the closed loop without ROS, bags, metrics, and the quadftc command.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    package_data={
        "quadftc_bench.campaign_report": ["templates/*"],
        "quadftc_bench.report": ["templates/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "quadftc = quadftc_bench.cli:main",
        ],
    },
)
