"""Campaigns: thousands of flights of a scenario whose values are drawn, in batches, on any number of cores."""
