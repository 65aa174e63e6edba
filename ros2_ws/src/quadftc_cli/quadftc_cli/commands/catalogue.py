"""``quadftc list``."""

from __future__ import annotations

from typing import Annotated

import typer

from quadftc_cli.catalogue import catalogue_table, kinds
from quadftc_cli.tables import console


def list_(
    kind: Annotated[str, typer.Argument(help=" | ".join(kinds()) + "; default: all")] = "",
) -> None:
    """Show what there is, with parameters, units and defaults."""
    for each in [kind] if kind else kinds():
        console().print(catalogue_table(each))
