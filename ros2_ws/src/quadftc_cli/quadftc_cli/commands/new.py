"""``quadftc new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_cli.screen import say


def new(
    kind: Annotated[str, Argument(metavar="observer|controller|fault", help="What to begin.")],
    name: Annotated[str, Argument(help="Its name, and that of its package: my_observer.")],
    out: Annotated[Path, Option(help="Directory that the package is made in: src of a workspace.")] = Path(),
) -> None:
    """Begin a component of your own: a ROS 2 package with a small law that flies; put yours in its place."""
    from quadftc_cli.new_package import KINDS, write_package

    written = write_package(kind, name, out)
    say(*(str(file) for file in written))
    say(f"build it: colcon build --packages-select {name} && . install/setup.bash")
    say(f"fly it:   {KINDS[kind].trial.format(name)}")
