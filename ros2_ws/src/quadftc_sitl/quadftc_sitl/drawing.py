"""Faults of a catalogue whose sizes, axes and times are drawn, as campaigns draw: `{uniform: [1, 2]}`.

>>> draw({"axes": {"choice": ["x", "y"]}, "value": {"uniform": [0.1, 0.2]}}, np.random.default_rng(1))
{'axes': 'x', 'value': 0.1950...}
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from quadftc_campaign.distributions import KINDS, distribution


def draw(raw: object, generator: np.random.Generator) -> object:
    """Return plain data with each distribution in it replaced by a value; ValueError for a wrong one."""
    if isinstance(raw, list):
        return [draw(each, generator) for each in cast("list[object]", raw)]
    if not isinstance(raw, Mapping):
        return raw
    given = cast("Mapping[str, object]", raw)
    if any(key in KINDS for key in given):
        return distribution(given).draw(generator)
    return {key: draw(value, generator) for key, value in given.items()}
