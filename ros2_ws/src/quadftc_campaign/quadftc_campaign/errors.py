"""What can go wrong with a campaign."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path


class CampaignError(Exception):
    """A campaign that cannot be flown or finished with this input or cluster; the message says why."""


@contextlib.contextmanager
def report_refusal(path: Path, advice: str = "") -> Generator[None, None, None]:
    """Turn what the system refuses into a `CampaignError`."""
    try:
        yield
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror or error}{advice}") from None
