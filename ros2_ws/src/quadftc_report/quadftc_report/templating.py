"""How pages are made of templates: everything escaped, and nothing that is missing passes for empty."""

from __future__ import annotations

from typing import cast

import jinja2

from quadftc_report.wording import short

NOTHING = "–"  # in place of a number that is not there
SHARED = "quadftc_report.report"  # whose templates every page may use: base.html, macros.html, report.css


def environment(package: str) -> jinja2.Environment:
    """Return what renders the templates of a package, and those that all pages share."""
    packages = dict.fromkeys((package, SHARED))
    made = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(each) for each in packages]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    made.filters["short"] = _short  # pyright: ignore[reportUnknownMemberType]
    return made


def _short(value: object) -> str:
    return NOTHING if value is None else short(cast("float", value))
