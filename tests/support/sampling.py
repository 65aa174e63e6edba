"""Parametrisations of which the usual run takes a sample, and `--thorough` all."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import pytest


def sampled(*axes: Iterable[Any], every: int) -> list[Any]:
    """Parameters of all combinations of some lists; the usual run has one in ``every``, from the first on.

    Of several lists, the sample has each value at least once: `ValueError` if it has not.
    """
    lists = [list(axis) for axis in axes]
    rows = list(itertools.product(*lists))
    for place, values in enumerate(lists if len(lists) > 1 else []):
        if missing := [each for each in values if each not in [row[place] for row in rows[::every]]]:
            raise ValueError(f"one in {every} of {len(rows)}: {missing} would be left out")
    marks = [() if index % every == 0 else pytest.mark.thorough for index in range(len(rows))]
    return [pytest.param(*row, marks=mark) for row, mark in zip(rows, marks, strict=True)]
