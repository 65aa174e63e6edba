# pyright: basic
"""Tuning a campaign's scheme: search on its flights, judge on others, write the gains.

The search is Adam (Kingma and Ba, 2015) on the logarithms of gains, where the theory still holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from quadftc_campaign.campaign_file import Campaign, TuneKeys
from quadftc_campaign.campaign_run import FLIGHTS_A_CHUNK, fly_chunk, pieces_of, report_refusal
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.table import Rows, table_of, whole_flights
from quadftc_campaign.tune.sensitivity import (
    Gains,
    Sensitivity,
    gains_of,
    mean_cost,
    sensitivity,
    shares_of_cost,
    with_gains,
)
from quadftc_campaign.workers import Workers, run_tasks, started_workers
from quadftc_flight.scenario import ROLES, ScenarioError, build_scenario, grade_of
from quadftc_model.samples import AXES
from quadftc_theory.checks import check_scenario

Floats = NDArray[np.float64]

HALVINGS = 8  # of a step that leads to where a condition fails
AVERAGED = 3  # the result is the mean of the last third of the steps
LARGEST = 0.3  # of a logarithm in one step

# flies flights with slopes: campaign with the gains, gains, numbers of the flights
Fly = Callable[[Campaign, Gains, Sequence[int]], Sensitivity]


class HeldOut(NamedTuple):
    """Flights not used for tuning."""

    cost: float
    metrics: dict[str, float]  # means over flights and axes
    missed: int  # faults
    false_alarms: int
    crashed: int  # flights


class Tuned(NamedTuple):
    """Gains before and after, and what they are worth."""

    start: Gains
    gains: Gains
    failing: frozenset[str]  # conditions of the theory that failed before, and may fail still
    before: HeldOut
    after: HeldOut


def checked(campaign: Campaign) -> Gains:
    """Return the gains that a campaign says to tune, as they are; an error if they cannot be tuned."""
    names = _keys(campaign).gains
    first, *others = campaign.variants
    if others or first.observer:
        source = campaign.document.source
        raise CampaignError(f"{source}: tune: one scheme is tuned, without observers to cross")
    return gains_of(campaign, build_scenario(campaign.base).scheme(first.scheme), names)


def tune(campaign: Campaign, count: int, told: Callable[[float], None]) -> Tuned:
    """Tune; nothing is written. ``told`` gets the cost at each step; ``count`` processes fly."""
    start, metrics = checked(campaign), tuple(_keys(campaign).cost)
    with started_workers(count) as workers:

        def fly(with_them: Campaign, gains: Gains, numbers: Sequence[int]) -> Sensitivity:
            pieces = pieces_of(list(numbers), -(-len(numbers) // workers.count))
            arguments = [(with_them, gains, metrics, piece) for piece in pieces]
            flown = sorted(run_tasks(workers, sensitivity, arguments), key=lambda each: each[0])
            return Sensitivity(*map(np.concatenate, zip(*(part for _, part in flown), strict=True)))

        search = Search(campaign, start, fly)
        for _, cost in search.steps():
            told(cost)
        before, after = _judge_gains(workers, campaign, (start, search.result), search.shares)
    return Tuned(start, search.result, search.failing, before, after)


class Search:
    """A search from the gains of a campaign's scheme."""

    failing: frozenset[str]  # conditions of the theory that fail from the start
    shares: Floats  # of the cost, as in `shares_of_cost`; known after `steps`, as is the result
    result: Gains

    def __init__(self, campaign: Campaign, gains: Gains, fly: Fly) -> None:
        self._campaign, self._gains, self._fly = campaign, gains, fly
        self._tune, self._scheme = _keys(campaign), campaign.variants[0].scheme
        self.failing = self._failing(gains)

    def steps(self) -> Iterator[tuple[Gains, float]]:
        """Search; yield gains and cost before each step.

        A `CampaignError` says that flights crash from the start, or wherever a step leads.
        """
        import optax

        optimiser = optax.adam(self._tune.rate)
        at = before = self._gains.logarithms
        state: Any = optimiser.init(at)
        tried, seen = 0, []
        while len(seen) < self._tune.steps:
            gains = self._gains.at(at)
            campaign = with_gains(self._campaign, self._scheme, gains)
            count = min(self._tune.flights, campaign.flights)
            turn = [(len(seen) * count + k) % campaign.flights for k in range(count)]
            flown = self._fly(campaign, gains, turn)
            # where a flight crashes, whose metrics are not finite, go halfway back, and at last all the way
            known = np.isfinite(flown.values)
            counts = known.any(axis=0)
            if not (np.isfinite(flown.slopes).all() and counts.any() and (known == counts).all()):
                tried += 1
                at = 0.5 * (at + before) if tried < HALVINGS else before
                if not seen or tried > HALVINGS:
                    raise CampaignError(f"{campaign.document.source}: flights crash with {gains.plain()}")
                continue
            # a step of Adam, as far as the theory allows
            if not seen:
                self.shares = shares_of_cost(self._tune.cost, flown.values)
            yield gains, mean_cost(self.shares, flown.values)
            gradient = np.mean(np.sum(flown.slopes * self.shares, axis=(2, 3)), axis=0)
            update, state = optimiser.update(gradient, state)
            seen.append(at)
            before, tried = at, 0
            at = self._shorten(at, at + np.clip(np.asarray(update, np.float64), -LARGEST, LARGEST))
        last = seen[-max(len(seen) // AVERAGED, 1) :]
        self.result = self._gains.at(self._shorten(last[-1], np.mean(last, axis=0))).rounded()

    def _shorten(self, start: Floats, end: Floats) -> Floats:
        """Return the end of a step, or a point on the way where no condition fails that held at first."""
        for _ in range(HALVINGS):
            if self._failing(self._gains.at(end)) <= self.failing:
                return end
            end = 0.5 * (start + end)
        return start

    def _failing(self, gains: Gains) -> frozenset[str]:
        """Names of the conditions that fail (`quadftc check`), a value out of its bounds one of them."""
        # gains are given out rounded: the rounded ones must hold
        tried = with_gains(self._campaign, self._scheme, gains.rounded())
        try:
            scenario = build_scenario(tried.base)
        except ScenarioError as error:
            return frozenset([str(error)])
        sections = check_scenario(scenario, scenario.scheme(self._scheme)).sections
        return frozenset(item.name for section in sections for item in section.conditions if item.failed)


def _keys(campaign: Campaign) -> TuneKeys:
    if campaign.tune is None:
        raise CampaignError(f"{campaign.document.source}: no key 'tune': expected gains, cost and steps")
    return campaign.tune


def _judge_gains(
    workers: Workers, campaign: Campaign, each: Sequence[Gains], shares: Floats
) -> list[HeldOut]:
    """Fly the flights after those of the campaign, with each of some gains."""
    total = campaign.flights + _keys(campaign).held_out
    pieces = pieces_of(list(range(campaign.flights, total)), FLIGHTS_A_CHUNK)
    longer = campaign.model_copy(update={"flights": total, "engine": "c"})
    tried = [with_gains(longer, campaign.variants[0].scheme, gains) for gains in each]
    rows: list[Rows] = [[] for _ in each]
    tasks = [(one, piece) for one in tried for piece in pieces]
    for place, flown in run_tasks(workers, fly_chunk, tasks):
        rows[place // len(pieces)] += flown
    metrics, judged = [*_keys(campaign).cost], list[HeldOut]()
    columns = [f"{name}.{axis}" for name in metrics for axis in AXES]
    for frame in map(table_of, rows):
        flights = whole_flights(frame)
        values = flights.select(columns).to_numpy().reshape(-1, len(metrics), len(AXES))
        there = "fault.detected" in frame.columns
        judged += [
            HeldOut(
                cost=mean_cost(shares, values),
                metrics=dict(zip(metrics, np.nanmean(values, axis=(0, 2)).tolist(), strict=True)),
                missed=int((~frame["fault.detected"].drop_nulls()).sum()) if there else 0,
                false_alarms=sum(int(flights[f"false_alarms.{axis}"].sum()) for axis in AXES),
                crashed=int((~flights["finite"]).sum()),
            )
        ]
    return judged


def write(tuned: Tuned, campaign: Campaign, path: Path) -> None:
    """Write a file of gains (`quadftc_flight.scenario.files`), with what they bring."""
    before, after, scenario = tuned.before, tuned.after, build_scenario(campaign.base)
    scheme, parts = scenario.scheme(campaign.variants[0].scheme), dict[str, dict[str, object]]()
    for name, value in tuned.gains.plain().items():
        role, _, parameter = name.partition(".")
        parts.setdefault(role, {"kind": getattr(scheme, role).kind})[parameter] = value
    document = {
        "vehicle": scenario.document.data["vehicle"],
        "grade": grade_of(scenario.document),
        **{role: parts[role] for role in ROLES if role in parts},
    }
    lines = [
        f"Gains for {document['vehicle']} with sensors of grade {document['grade']}, found by",
        "",
        f"  scripts/quadftc tune {campaign.document.source}",
        "",
        f"Means over {_keys(campaign).held_out} flights not used for it, before and after:",
        *(f"  {name}: {before.metrics[name]:.4g} -> {after.metrics[name]:.4g}" for name in before.metrics),
        f"  cost: {before.cost:.4g} -> {after.cost:.4g}",
    ]
    yaml: Any = YAML()
    yaml.default_flow_style = None
    with report_refusal(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8") as file:
            file.writelines(f"# {line}".rstrip() + "\n" for line in lines)
            file.write("\n")
            yaml.dump(document, file)
