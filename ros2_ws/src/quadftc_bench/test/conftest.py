"""Settings of the property tests: the same examples in every run, and no time limit for one."""

from hypothesis import settings

settings.register_profile("quadftc", derandomize=True, database=None, deadline=None)
settings.load_profile("quadftc")
