"""The overview of replays: faults missed, delays, errors and false alarms of one or of several, in a row."""

from __future__ import annotations

from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_report.wording import NOTHING, duration, plain, short

HEADINGS = (
    *("faults", "missed", "delay, step (max)", "delay, ramp (median)", "delay, sine (median)"),
    *("estimate RMSE per fault, median / 95 %", "false alarms"),
)
DELAYS = (("delay_max_s", "step"), ("delay_median_s", "ramp"), ("delay_median_s", "sine"))


def overview_row(pooled: Metrics) -> tuple[str, ...]:
    """Write what `quadftc_flight.diagnosis_metrics.pool` found, in the order of `HEADINGS`."""
    missed, already = pooled["missed"], pooled["already_declared"]
    before = f" ({already} declared before the onset)" if already else ""
    delays = [pooled[name].get(kind) for name, kind in DELAYS]
    rmse = [pooled[f"estimate_rmse_{name}_deg"].get("all") for name in ("median", "p95")]
    return (
        str(pooled["fault_count"]),
        NOTHING if missed is None else f"{missed}{before}",
        *(NOTHING if delay is None else duration(delay) for delay in delays),
        NOTHING if None in rmse else f"{' / '.join(map(short, rmse))} deg",
        _alarms(pooled),
    )


def _alarms(pooled: Metrics) -> str:
    count, share, rate = (
        pooled[f"total_{name}"] for name in ("false_alarms", "false_alarm_share", "false_alarms_per_hour")
    )
    if count is None or share is None or rate is None:
        return NOTHING
    if count == 0:
        return f"none{f'; {plain(100.0 * share)} % of healthy time left over from faults' if share else ''}"
    return f"{count}, {plain(rate)} an hour, {plain(100.0 * share)} % of healthy time"
