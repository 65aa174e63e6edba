"""Pooled diagnosis as a table for people: a line for each set of flights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HEADINGS = (
    *("", "faults", "missed", "delay, step (max)", "delay, ramp (median)", "delay, sine (median)"),
    *("estimate RMSE per fault, median / 95 %", "false alarms"),
)
NOTHING = "-"

_DIGITS = 3  # significant


def show_table(pools: Mapping[str, Mapping[str, Any]]) -> str:
    """Write pooled diagnoses as a Markdown table.

    Parameters
    ----------
    pools : mapping
        What a line is called, to what `pool` returns.
    """
    lines = [
        HEADINGS,
        ("---",) * len(HEADINGS),
        *((name, *show_row(pooled)) for name, pooled in pools.items()),
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def show_row(pooled: Mapping[str, Any]) -> tuple[str, ...]:
    """Write one pool, in the order of ``HEADINGS`` behind the name."""
    rmse = (pooled[name].get("all") for name in ("estimate_rmse_median_deg", "estimate_rmse_p95_deg"))
    return (
        str(pooled["fault_count"]),
        _missed(pooled),
        _time(pooled["delay_max_s"].get("step")),
        _time(pooled["delay_median_s"].get("ramp")),
        _time(pooled["delay_median_s"].get("sine")),
        f"{' / '.join(map(_short, rmse))} deg",
        _alarms(pooled),
    )


def _missed(pooled: Mapping[str, Any]) -> str:
    missed, already = pooled["missed"], pooled["already_declared"]
    if missed is None:
        return NOTHING
    return f"{missed} ({already} declared before the onset)" if already else str(missed)


def _alarms(pooled: Mapping[str, Any]) -> str:
    count, share, rate = (
        pooled[f"total_{name}"] for name in ("false_alarms", "false_alarm_share", "false_alarms_per_hour")
    )
    if count is None or share is None or rate is None:
        return NOTHING
    if count == 0:
        left_over = f"; {_short(100.0 * share)} % of healthy time left over from faults"
        return f"none{left_over if share else ''}"
    return f"{count}, {_short(rate)} an hour, {_short(100.0 * share)} % of healthy time"


def _time(value: float | None) -> str:
    if value is None:
        return NOTHING
    return f"{_short(value)} s" if value >= 1.0 else f"{_short(1e3 * value)} ms"


def _short(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.{_DIGITS}g}"
