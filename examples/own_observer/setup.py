"""Build script of own_observer (ament_python)."""

from setuptools import find_packages, setup

PACKAGE = "own_observer"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="A fault observer for quadftc in a package of its own.",
    license="Apache-2.0",
    maintainer="you",
    maintainer_email="you@example.com",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    # The name on the left is what scenario files and the command line say.
    entry_points={"quadftc.fault_observers": ["washout = own_observer.washout:Washout"]},
)
