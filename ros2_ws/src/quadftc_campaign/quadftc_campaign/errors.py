"""What can go wrong with a campaign."""

from __future__ import annotations


class CampaignError(Exception):
    """A campaign that cannot be flown or finished with this input; the message says why."""


class ClusterError(CampaignError):
    """A cluster that cannot be used; the message says why."""
