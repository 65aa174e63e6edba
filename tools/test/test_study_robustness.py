"""The studies of robustness: numbers worked out by hand on a table that is made up; their campaigns load."""

import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from quadftc_campaign.campaign_file import load_campaign
from quadftc_campaign.flights import flight_scenario
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_model.samples import AXES
from quadftc_tools.study.page import has_detector, publish
from quadftc_tools.study.robustness import make
from quadftc_tools.study.robustness_statistics import (
    SIZED,
    SIZES,
    STUDIES,
    share_missed,
    typical,
)

ROOT = Path(__file__).resolve().parents[2]
OBSERVERS = {"proposed": "sliding_mode", "supervised": "supervised", "conventional": "none"}


def rows(flight_number, variant, error, **values):
    """Three faults of a flight, one of each kind; the worst axis is yaw."""
    common = {"flight": flight_number, "variant": variant, "observer": OBSERVERS[variant], "finite": True}
    for name in ("tracking_rmse_deg", "fault_estimate_rmse_deg"):
        common |= {f"{name}.{axis}": error * share for axis, share in zip(AXES, (0.1, 0.5, 1.0), strict=True)}
    common |= {f"torque_total_variation.{axis}": 1.0 for axis in AXES}
    common |= {f"tracking_max_deg.{axis}": 2.0 * error for axis in AXES}
    for number, kind in enumerate(("step", "sine", "ramp")):
        fault = {"fault": number, "fault.kind": kind, "fault.detected": True, "fault.detection_delay_s": 0.1}
        fault |= {"fault.above_threshold_delay_s": 0.2, "fault.estimate_rmse_deg": error}
        yield common | fault | {"fault.tracking_rmse_deg": 2.0 * error} | values


def table(count=21, **values):
    return [
        row
        for number in range(count)
        for variant in OBSERVERS
        for row in rows(number, variant, 0.1 * (number + 1), **values)
    ]


def of(frame, variant):
    return frame.filter(pl.col("variant") == variant)


def test_worst_axis_of_each_flight_is_taken_median_and_95_percent():
    frame = of(pl.DataFrame(table()), "supervised")
    assert typical(frame, "tracking_rmse_deg") == pytest.approx((1.1, 2.0))


def test_a_vehicle_that_is_lost_is_worse_than_any_number():
    frame = pl.DataFrame(table(3))
    lost = frame.with_columns(
        pl.when(pl.col("flight") == 0).then(91.0).otherwise(1.0).alias("tracking_max_deg.roll")
    )
    assert typical(of(lost, "supervised"), "tracking_rmse_deg") == (pytest.approx(0.3), math.inf)


def test_what_nothing_estimates_has_no_error():
    frame = of(pl.DataFrame(table()), "conventional")
    assert typical(frame, "fault_estimate_rmse_deg") is None
    assert share_missed(frame) is None


def test_faults_without_a_delay_are_missed():
    frame = pl.DataFrame(table(4)).with_columns(
        pl.when(pl.col("fault") == 0).then(None).otherwise(0.1).alias("fault.detection_delay_s")
    )
    assert share_missed(of(frame, "supervised")) == pytest.approx(1 / 3)
    assert share_missed(of(frame, "proposed")) == 0.0  # by the size of its estimate


def test_document_gets_its_figures(tmp_path):
    draw = np.random.default_rng(0)
    frames = {
        study.name: pl.DataFrame([row for value in (1.0, 2.0) for row in table(3, **{study.path: value})])
        for study in STUDIES
    }
    sizes = {
        sized.path: draw.choice([-1.0, 1.0], 99 * 9) * draw.uniform(sized.edges[0], sized.edges[-1], 99 * 9)
        for sized in SIZED
    }
    frames[SIZES] = pl.DataFrame(table(99)).with_columns(
        pl.Series(name, each) for name, each in sizes.items()
    )
    (tmp_path / "robustness.md").write_text("# Robustness\n")
    files = publish(tmp_path / "robustness.md", *make(frames))
    assert len(files) == 2 + len(STUDIES)
    assert all(path.stat().st_size > 0 for path in files)


@pytest.mark.parametrize("name", [*(study.name for study in STUDIES), SIZES])
def test_campaigns_of_the_studies_vary_what_the_figures_show(name):
    campaign = load_campaign(ROOT / "campaigns" / f"study_{name}.yaml")
    assert campaign.name == f"study_{name}"
    names = [variant.name for variant in campaign.variants]
    assert names == [*campaign.base.data["schemes"], "bank"]  # which has no scheme, as it is on trial
    assert {"proposed", "supervised", "conventional"} <= {variant.name for variant in campaign.variants}
    shown = [study.path for study in STUDIES if study.name == name] or [sized.path for sized in SIZED]
    assert set(shown) <= set(campaign.vary)
    for variant in campaign.variants:
        assert len(flight_scenario(campaign, 0, variant).fault_events) == 3


def test_new_observer_takes_part_in_every_study(monkeypatch):
    class Newcomer(SlidingMode):
        """Registered by another package, say."""

    fault_observers.names()  # all are there now
    newcomers = {**fault_observers._components, "newcomer": Newcomer}
    monkeypatch.setattr(fault_observers, "_components", newcomers)
    for name in (*(study.name for study in STUDIES), SIZES):
        campaign = load_campaign(ROOT / "campaigns" / f"study_{name}.yaml")
        assert campaign.variants[-1].name == campaign.variants[-1].observer == "newcomer"
        assert campaign.variants[-1].scheme == "proposed"
        names = [variant.name for variant in campaign.variants]
        assert names == [*campaign.base.data["schemes"], "bank", "newcomer"]
    assert not has_detector("newcomer")
