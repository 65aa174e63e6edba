# pyright: basic
"""Samples of one topic of a PX4 log: their times, vectors and other fields."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from quadftc_model.arrays import AnyArray
from quadftc_replay.flight_log import Floats
from quadftc_replay.readers.signals import Stamps, columns

Dataset = Mapping[str, AnyArray]  # field, elements as name[k] -> (n,)


def stamps_of(data: Dataset) -> Stamps:
    """Time of each sample [ns] (n,)."""
    micro = data["timestamp"].astype(np.int64)
    sampled = data.get("timestamp_sample", micro).astype(np.int64)
    return np.where(sampled > 0, sampled, micro) * 1000


def vectors(data: Dataset, field: str, width: int = 3) -> Floats | None:
    """Elements of a field (n, width); None if they are not there."""
    names = [f"{field}[{k}]" for k in range(width)]
    return columns(data, names) if all(name in data for name in names) else None


def fields_of(data: Dataset, *names: str) -> Floats | None:
    """Fields side by side (n, k); None if one is not there."""
    return columns(data, names) if all(name in data for name in names) else None
