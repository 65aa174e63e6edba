"""Build script of quadftc_compile (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "quadftc_compile"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Laws as C: traced, written with loops over their arrays, built, kept, run and exported.",
    license="Apache-2.0",
    maintainer="quadftc maintainers",
    maintainer_email="maintainers@quadftc.example",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["exported/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
