"""Files of samples (CSV): names, then for each sample the time step [s] and all numbers of the inputs.

The example that is exported with a law reads them.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_compile.layout import Layout, flatten, leaves_of
from quadftc_compile.memory import Rows

TIME_STEP = "dt"  # the first column [s]


def number_names(layout: Layout) -> list[str]:
    """Return the names of all numbers of a struct: ``sample.body_rate[2]``."""
    return [
        ".".join(leaf.path) + "".join(f"[{k}]" for k in place)
        for leaf in leaves_of(layout)
        for place in itertools.product(*(range(n) for n in leaf.shape))
    ]


def sample_columns(layout: Layout) -> list[str]:
    """Return the columns of a file of samples whose inputs have a layout."""
    return [TIME_STEP, *number_names(layout)]


def write_samples(
    path: Path, layout: Layout, dt: Sequence[float] | NDArray[np.float64], inputs: object
) -> None:
    """Write samples: time steps (n,) [s] and inputs (n, ...); the law begins where a time step is 0.

    An array of the inputs without the first axis is the same in all samples.
    """
    rows = Rows(layout, len(dt))
    rows.write(inputs)
    columns: list[list[float]] = [[float(each) for each in dt]]
    for array in flatten(layout, rows.view(), shapes=False):
        table = array.reshape(len(dt), -1)
        columns += (table.astype(int) if table.dtype.kind == "b" else table).T.tolist()
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(sample_columns(layout))
        writer.writerows(zip(*columns, strict=True))
