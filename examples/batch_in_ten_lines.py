"""Thousands of flights in about ten lines: how does the tracking error grow with the size of a fault?

Call it by ``. scripts/lib/env.sh && python examples/batch_in_ten_lines.py [FLIGHTS]``.
"""

from __future__ import annotations

import sys

import numpy as np

from quadftc_campaign.batch.engine import fly_all
from quadftc_campaign.batch.records import flight_record
from quadftc_campaign.flights import batch_flight
from quadftc_flight.scenario import find_scenario, load_scenario


def fly(flights: int, scheme: str = "supervised") -> tuple[np.ndarray, np.ndarray]:
    """Fly ``mems_faults``; return the sizes of the first faults and the RMS errors of roll [deg]."""
    path = find_scenario("mems_faults")
    sizes = np.random.default_rng(1).uniform(0.5, 10.0, flights)  # deg
    changes = [[f"faults.0.value={size} deg", f"seed={number}"] for number, size in enumerate(sizes)]
    scenarios = [load_scenario(path, each) for each in changes]
    outcomes = fly_all([batch_flight(scenario, scheme) for scenario in scenarios])
    return sizes, np.array([flight_record(outcome)["tracking_rmse_deg.roll"] for outcome in outcomes])


if __name__ == "__main__":
    sizes, errors = fly(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
    for low in range(0, 10, 2):
        some = errors[(sizes >= low) & (sizes < low + 2)]
        if some.size:
            middle, worst = np.median(some), some.max()
            print(f"{low:2}-{low + 2} deg: median {middle:.3f}, worst {worst:.3f} deg ({some.size} flights)")
