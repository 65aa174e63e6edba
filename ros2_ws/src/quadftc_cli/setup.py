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
    entry_points={
        "console_scripts": ["quadftc = quadftc_cli.main:main"],
        # A package of yours adds a subcommand by an entry point of this group: a function or a typer.Typer.
        "quadftc.commands": [
            "run = quadftc_cli.commands.run:run",
            "play = quadftc_cli.commands.play:play",
            "inject = quadftc_cli.commands.inject:inject",
            "clear = quadftc_cli.commands.inject:clear",
            "set = quadftc_cli.commands.set:set_",
            "watch = quadftc_cli.commands.watch:watch",
            "live = quadftc_cli.commands.live:live",
            "new = quadftc_cli.commands.new:new",
            "export = quadftc_cli.commands.export:export",
            "replay = quadftc_cli.commands.replay:replay",
            "diagnose = quadftc_cli.commands.diagnose:diagnose",
            "serve = quadftc_cli.commands.serve:serve",
            "repair = quadftc_cli.commands.repair:repair",
            "report = quadftc_cli.commands.report:report",
            "campaign = quadftc_cli.commands.campaign:campaign",
            "tune = quadftc_cli.commands.tune:tune",
            "check = quadftc_cli.commands.check:check",
            "doctor = quadftc_cli.commands.doctor:doctor",
            "list = quadftc_cli.commands.catalogue:list_",
        ],
    },
)
