"""What can go wrong with a campaign."""


class CampaignError(Exception):
    """A campaign that cannot be flown or finished with this input or cluster; the message says why."""
