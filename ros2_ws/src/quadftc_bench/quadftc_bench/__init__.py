"""Scenario files, closed loop, bags, metrics and the ``quadftc`` command."""
