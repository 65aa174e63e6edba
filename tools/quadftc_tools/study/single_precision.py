"""The tables of docs/export.md that compare observers in single with those in double precision.

    python -m quadftc_tools.study.single_precision [--flights 500] [--docs docs]

Each flight is flown twice, in C: with the observer in double, and with state and numbers of the observer in
float, its inputs rounded to float. All else (vehicle, sensors, faults, controller) is double both times.
Without ``--docs`` the tables are printed.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadftc_campaign.campaign_file import Variant, load_campaign
from quadftc_campaign.flights import flight_scenario
from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.screen import say
from quadftc_compile.engine import CEngine
from quadftc_compile.single import SingleEngine
from quadftc_compile.wiring import BLOCK, flown_by
from quadftc_flight.closed_loop import FlightRecord, loop_of
from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.flight import Flight, Floats
from quadftc_flight.loop_draws import LoopDraws
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import Scenario, build_scenario, changed_document
from quadftc_flight.scenario.document import Keys
from quadftc_flight.scenario.files import find_scenario
from quadftc_model.rotations import wrap
from quadftc_sim.assembly import EPOCH_NS, sample_count
from quadftc_tools.study.numbers import write_number, write_numbers
from quadftc_tools.study.page import markdown, publish_tables

PAGE = "export.md"
PRECISIONS = ("double", "float")
CAMPAIGNS = Path(__file__).parents[3] / "campaigns"
# campaign, scheme, observers; all on a MEMS IMU
FLOWN = (
    ("mems_faults", "supervised", ("supervised", "isolating", "sliding_mode")),
    ("which_sensor", "isolating", ("isolating",)),
)
HOUR = 3600.0  # s
# scenario, rate [Hz], duration [s], observer
QUIET = (
    ("mems_faults", 250.0, HOUR, "supervised"),
    ("mems_faults", 250.0, HOUR, "isolating"),
    ("mems_faults", 1000.0, HOUR, "isolating"),
    ("free_circle", 250.0, HOUR, "isolating"),
)


CAMPAIGN_HEADS = (
    *("campaign", "observer", "precision", "attitude: missed", "delay, median", "RMSE, median / 95 %"),
    *("false alarms", "sensors: not named", "wrongly named", "flights judged otherwise"),
)
QUIET_HEADS = (
    *("scenario", "rate", "observer", "precision", "RMSE", "false alarms"),
    *("fault estimates apart, at most", "standard deviations apart, at most"),
)


class Told(NamedTuple):
    """What was said in a flight."""

    diagnosis: Mapping[str, Any]  # of the attitude, as in summary.json
    sensors: Mapping[str, Any]  # which sensor was named, as in summary.json
    rmse: float  # of the fault estimate, all axes [deg]


class Quiet(NamedTuple):
    """A long flight without faults, in both precisions."""

    told: tuple[Told, Told]
    apart: float  # largest difference of the fault estimates [deg]
    std_dev: float  # largest relative difference of their standard deviations, on average over a minute


@functools.cache
def engines() -> tuple[CEngine, CEngine]:
    """Return what flies the observer in double, and in float."""
    return CEngine(), SingleEngine(frozenset({"observer"}))


def flown(scenario: Scenario, engine: CEngine) -> Flight:
    """Fly a scenario with its first scheme."""
    loop, count = loop_of(scenario, scenario.scheme()), sample_count(scenario.duration, scenario.rate)
    draws = LoopDraws(loop, scenario.seed, count)
    vehicle, record = flown_by(engine, loop, LoopDraws.example(loop)), FlightRecord(loop, EPOCH_NS, count)
    for begin in range(0, count, BLOCK):
        rows = min(BLOCK, count - begin)
        record.note(begin, vehicle.run(draws.next(rows), rows))
    return record.flight()


def told_of(flight: Flight, scenario: Scenario) -> Told:
    """Judge a flight."""
    metrics = flight_metrics(flight, scenario.fault_windows, scenario.fault_events, scenario.rotor_events)
    error: Floats = wrap(flight.fault_estimate - flight.fault)
    rmse = float(np.degrees(np.sqrt(np.nanmean(error * error))))
    return Told(metrics["diagnosis"], metrics["sensors"], rmse)


def fly_number(campaign_name: str, scheme: str, observer: str, number: int) -> tuple[Told, Told]:
    """Fly one flight of a campaign in both precisions."""
    campaign = load_campaign(CAMPAIGNS / f"{campaign_name}.yaml", flights=number + 1)
    scenario = flight_scenario(campaign, number, Variant(observer, scheme, observer, None))
    double, single = (told_of(flown(scenario, engine), scenario) for engine in engines())
    return double, single


def fly_quiet(name: str, rate: float, duration: float, observer: str) -> Quiet:
    """Fly a scenario without its faults in both precisions."""
    document = changed_document(find_scenario(name), ())
    scheme: dict[str, Any] = dict(next(iter(document.data["schemes"].values())))
    changes: dict[Keys, Any] = {
        ("duration",): duration,
        ("rate",): rate,
        ("faults",): [],
        ("schemes",): {"quiet": {**scheme, "observer": observer, "checks": []}},
    }
    scenario = build_scenario(document.replaced(changes, "study of single precision"))
    double, single = (flown(scenario, engine) for engine in engines())
    minutes = round(60.0 * rate)
    deviations = [_averaged(each.fault_std_dev, minutes) for each in (double, single)]
    return Quiet(
        (told_of(double, scenario), told_of(single, scenario)),
        float(np.degrees(np.nanmax(np.abs(wrap(double.fault_estimate - single.fault_estimate))))),
        float(np.max(np.abs(deviations[1] / deviations[0] - 1.0))),
    )


def _averaged(values: Any, count: int) -> Any:
    """Average each ``count`` rows."""
    rows = len(values) // count
    return values[: rows * count].reshape(rows, count, -1).mean(axis=1)


def make(flights: int, mapped: Callable[..., Iterable[Any]]) -> dict[str, str]:
    """Fly all of them and return the tables."""
    campaigns = [
        row
        for name, scheme, observers in FLOWN
        for observer in observers
        for row in _campaign_rows(name, observer, [*_mapped(mapped, name, scheme, observer, flights)])
    ]
    found = zip(QUIET, mapped(_fly_plan, QUIET), strict=True)
    quiet = [row for plan, each in found for row in _quiet_rows(plan, each)]
    return {
        "single-campaign": markdown(CAMPAIGN_HEADS, campaigns),
        "single-quiet": markdown(QUIET_HEADS, quiet),
    }


def _mapped(
    mapped: Callable[..., Iterable[Any]], name: str, scheme: str, observer: str, flights: int
) -> Iterable[tuple[Told, Told]]:
    say(f"{name}, {observer}: {flights} flights, twice each", stderr=True)
    return mapped(functools.partial(fly_number, name, scheme, observer), range(flights))


def _fly_plan(plan: tuple[str, float, float, str]) -> Quiet:
    return fly_quiet(*plan)


def _campaign_rows(name: str, observer: str, found: Sequence[tuple[Told, Told]]) -> list[list[str]]:
    otherwise = sum(_verdict(double) != _verdict(single) for double, single in found)
    rows: list[list[str]] = []
    for precision, each in zip(PRECISIONS, zip(*found, strict=True), strict=True):
        pooled, errors = pool([one.diagnosis for one in each]), np.array([one.rmse for one in each])
        delay = pooled["delay_median_s"].get("all")
        faults, *unnamed = (
            sum(one.sensors[key]["all"] or 0 for one in each)
            for key in ("sensor_faults", "unnamed", "misnamed")
        )
        rows.append(
            [
                *(name, observer, precision, f"{pooled['missed']} of {pooled['fault_count']}"),
                "-" if delay is None else f"{write_number(1e3 * delay)} ms",
                f"{write_numbers((float(np.median(errors)), float(np.quantile(errors, 0.95))))} deg",
                str(pooled["total_false_alarms"]),
                *(f"{count} of {faults}" for count in unnamed),
                "" if precision == "double" else f"{otherwise} of {len(found)}",
            ]
        )
    return rows


def _verdict(told: Told) -> tuple[Any, ...]:
    """What is said of the faults of a flight: which are detected and named, and how often that is wrong."""
    detected = [each["detected"] for each in told.diagnosis["events"]]
    named = [each["named"] for each in told.sensors["events"]]
    return told.diagnosis["total_false_alarms"], told.sensors["false_namings"], detected, named


def _quiet_rows(plan: tuple[str, float, float, str], quiet: Quiet) -> list[list[str]]:
    name, rate, _, observer = plan
    return [
        [
            *(name, f"{rate:g} Hz", observer, precision, f"{write_number(told.rmse)} deg"),
            str(told.diagnosis["total_false_alarms"]),
            *(("", "") if precision == "double" else _differences(quiet)),
        ]
        for precision, told in zip(PRECISIONS, quiet.told, strict=True)
    ]


def _differences(quiet: Quiet) -> tuple[str, str]:
    return f"{write_number(quiet.apart)} deg", f"{write_number(100.0 * quiet.std_dev)} %"


def main() -> int:
    """Write the tables into the page, or print them."""
    parser = argparse.ArgumentParser(
        prog="single_precision", description=f"Tables of single and double precision in docs/{PAGE}."
    )
    parser.add_argument("--flights", type=int, default=500, help="of each campaign")
    parser.add_argument("--docs", type=Path, help=f"directory of {PAGE}")
    options = parser.parse_args()
    try:
        with ProcessPoolExecutor(mp_context=get_context("spawn")) as workers:
            tables = make(options.flights, functools.partial(workers.map, chunksize=1))
        publish_tables(tables, options.docs and options.docs / PAGE)
    except (ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT
    return GOOD


if __name__ == "__main__":
    raise SystemExit(main())
