"""Build script of quadftc_cli (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_cli"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="The quadftc command.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["live_page/*.css", "live_page/*.js"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["quadftc = quadftc_cli.main:main"]},
)
