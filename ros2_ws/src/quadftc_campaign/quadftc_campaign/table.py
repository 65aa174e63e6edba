"""The table of a campaign, one row for each flight, variant and fault; and its quantiles.

| columns | what |
|---|---|
| ``flight``, ``variant`` | number of the flight, from 0; what it was flown with |
| ``observer``, ``disturbance_observer``, ``controller`` | the parts of the variant |
| ``seed`` and each path that varies | the values drawn, as numbers in the unit of the campaign file |
| ``fault`` | number of the fault in the flight; null in the one row of a flight without faults |
| ``fault.<metric>`` | of this fault |
| ``<metric>``, ``<metric>.<axis>`` | of the whole flight, the same in all its rows |
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import polars as pl

from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.diagnosis_metrics.which_rotor import SAID as SAID_KINDS
from quadftc_flight.diagnosis_metrics.which_rotor import TRUE as TRUE_KINDS
from quadftc_flight.diagnosis_metrics.which_sensor import SAID, TRUE
from quadftc_flight.summary import NO_OBSERVER, Summary

if TYPE_CHECKING:
    from quadftc_campaign.campaign_file import Campaign

Row = dict[str, object]
Rows = list[Row]

ORDER = ("flight", "variant", "fault")
FLAGS = (
    *("finite", "lost", "fault.named", "fault.already_named", "fault.detected", "fault.already_declared"),
    *("fault.recovered"),
)
WHOLE = ("flight", "seed", "fault")  # columns of whole numbers
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
CONFUSION = "sensors.confusion_s"  # how the columns of the confusion matrix begin
ROTOR_CONFUSION = "rotors.confusion_s"  # and of that of the rotors
ERRORS = (
    "attitude_error_max_deg",
    "attitude_error_rms_deg",
)  # that are held against those without a diagnosis
NOT_METRICS = ("flight", "seed", "fault", "fault.start", "fault.stop")  # columns of numbers


def table_of(rows: Rows) -> pl.DataFrame:
    """Make a table of rows; columns of numbers are Float64, but for `WHOLE`."""
    frame = pl.DataFrame(rows, infer_schema_length=None, strict=False)
    types: dict[str, type[pl.DataType]] = {
        name: pl.Int64 if name in WHOLE else pl.Float64
        for name, kind in frame.schema.items()
        if kind.is_numeric() or (kind == pl.Null and name not in FLAGS)
    }
    types |= {name: pl.Boolean for name in FLAGS if name in frame.columns}
    return frame.cast(types)  # pyright: ignore[reportArgumentType]


def whole_flights(frame: pl.DataFrame) -> pl.DataFrame:
    """Return one row for each flight and variant."""
    return frame.unique(["flight", "variant"], keep="first", maintain_order=True)


def summary_of(campaign: Campaign, frame: pl.DataFrame) -> Summary:
    """Summarise the table of a campaign, ready for JSON; it says nothing of when or where it was flown."""
    return {
        "name": campaign.name,
        "description": campaign.description,
        "flights": campaign.flights,
        "seed": campaign.seed,
        "precision": campaign.flown_precision,
        "varied": {path: each.unit for path, each in campaign.vary.items()},
        "variants": {
            variant.name: _variant(campaign, frame.filter(pl.col("variant") == variant.name))
            for variant in campaign.variants
        },
    }


def quantiles(frame: pl.DataFrame, names: Iterable[str]) -> Metrics:
    """Quantiles, mean and extremes of columns; null where no row has a value."""
    found: Metrics = {}
    for column in (frame[name].drop_nulls().drop_nans() for name in names):
        values: Metrics = {}
        if len(column):
            values = {"mean": column.mean(), "min": column.min(), "max": column.max()}
            values |= {f"q{100 * q:g}": column.quantile(q, "linear") for q in QUANTILES}
        known = {key: value if math.isfinite(value) else None for key, value in values.items()}
        found[column.name] = {"count": len(column), **known}
    return found


def with_ratios(frame: pl.DataFrame) -> pl.DataFrame:
    """Relate the attitude error of each flight to that without a diagnosis, as ``<metric>_ratio``.

    That is of a variant with the fault observer ``none`` and the same disturbance observer and controller, on
    the same flight; there are no such columns if no variant is one.
    """
    parts = ["flight", "disturbance_observer", "controller"]
    found = whole_flights(frame).filter(pl.col("observer") == NO_OBSERVER)
    if ERRORS[0] not in frame.columns or not 0 < found.height < whole_flights(frame).height:
        return frame
    plain = found.unique(parts, keep="first").select(
        *parts, *(pl.col(name).alias(f"{name}_ratio") for name in ERRORS)
    )
    joined = frame.join(plain, on=parts, how="left", maintain_order="left")
    return joined.with_columns(
        (pl.col(name) / pl.col(f"{name}_ratio")).alias(f"{name}_ratio") for name in ERRORS
    )


def _kind(frame: pl.DataFrame) -> pl.Expr:
    """The kind of a fault; of another sensor than the attitude with its name: ``gyro step``."""
    if "fault.component" not in frame.columns:
        return pl.col("fault.kind").alias("kind")
    sensor = (
        pl.when(pl.col("fault.component") != "attitude")
        .then(pl.col("fault.component") + " ")
        .otherwise(pl.lit(""))
    )
    return (sensor.fill_null("") + pl.col("fault.kind")).alias("kind")


def _count(faults: pl.DataFrame, name: str, value: float, above: bool = False) -> int:
    """Count the faults that have a value, or one above it; none if there is no such column."""
    if name not in faults.columns:
        return 0
    return int(((faults[name] > value) if above else (faults[name] == value)).sum())


def _matrix(
    flights: pl.DataFrame, begin: str, truths: Sequence[str], claims: Sequence[str]
) -> dict[str, Metrics]:
    """Return a confusion matrix over all flights [s], without rows of which there are no columns."""
    return {
        true: {said: flights[f"{begin}.{true}.{said}"].sum() for said in claims}
        for true in truths
        if f"{begin}.{true}.{claims[0]}" in flights.columns
    }


def _variant(campaign: Campaign, frame: pl.DataFrame) -> Summary:
    flights, faults = whole_flights(frame), frame.filter(pl.col("fault").is_not_null())
    kinds = faults.with_columns(_kind(frame)).partition_by("kind", as_dict=True) if faults.height else {}
    parts = dict(sorted((str(key[0]), part) for key, part in kinds.items()))
    parts |= {"all": faults} if parts else {}
    left_out = {*NOT_METRICS, *campaign.vary}
    numeric = [name for name, kind in frame.schema.items() if kind.is_numeric() and name not in left_out]
    metrics = [name for name in numeric if not name.startswith((CONFUSION, ROTOR_CONFUSION))]
    of_faults = [name for name in metrics if name.startswith("fault.")]
    rotors = _matrix(flights, ROTOR_CONFUSION, TRUE_KINDS, SAID_KINDS)
    return {
        "flights": flights.height,
        "not_finite": int((~flights["finite"]).sum()),
        "lost": int(flights["lost"].sum()) if "lost" in flights.columns else None,
        "confusion_s": _matrix(flights, CONFUSION, TRUE, SAID),
        **({"rotor_confusion_s": rotors} if rotors else {}),
        "metrics": quantiles(flights, [name for name in metrics if name not in of_faults]),
        "faults": {
            kind: {
                "count": part.height,
                "judged": sum(_count(part, "fault.detected", verdict) for verdict in (True, False)),
                "missed": _count(part, "fault.detected", False),
                "unnamed": _count(part, "fault.named", False),
                "misnamed": _count(part, "fault.misnamed_share", 0.0, above=True),
                "metrics": quantiles(part, of_faults),
            }
            for kind, part in parts.items()
        },
    }
