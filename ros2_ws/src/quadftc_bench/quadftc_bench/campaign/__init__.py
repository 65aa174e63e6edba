"""Campaigns: thousands of flights of a scenario whose values are drawn, on any number of cores."""
