"""Flights through the same law at once, which takes little longer than one of them alone."""

import jax
import numpy as np

from quadftc_model.arrays import rows_of


def diagnose_together(diagnose, flights):
    """Estimates of each flight, from its inputs, by a function of a sequence of inputs of all flights.

    The shorter ones keep their last inputs until the longest is over.
    """
    rows = [[each[min(index, len(each) - 1)] for each in flights] for index in range(max(map(len, flights)))]
    estimates = diagnose([jax.tree.map(lambda *lanes: np.stack(lanes), *row) for row in rows])
    return [[rows_of(one, lane) for one in estimates[: len(each)]] for lane, each in enumerate(flights)]
