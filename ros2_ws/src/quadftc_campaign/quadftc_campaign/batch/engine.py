"""The batch engine on CPUs: flights in C, one after the other; of each it keeps a tally.

>>> outcomes = [*fly_all([batch_flight(scenario) for scenario in scenarios])]

It keeps one core busy; for more, start a process for each (`quadftc_campaign` does). On a GPU flies
`quadftc_campaign.batch.jax_engine`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.judged_loop import JudgedLoop
from quadftc_campaign.batch.tally import Tally
from quadftc_compile.engine import CEngine, Log, engine_named, say
from quadftc_compile.recipe import name_of
from quadftc_compile.wiring import BLOCK, Flown, flown_by
from quadftc_flight.loop_draws import LoopDraws
from quadftc_model.composition import Composition
from quadftc_model.numbers import structure_of
from quadftc_model.stepper import seconds

JAX = "jax"
ENGINES = ("c", "numpy", JAX)

Floats = NDArray[np.float64]
Progress = Callable[[int], None]  # gets the number of samples flown since its last call


class BatchFlight(NamedTuple):
    """One flight of a batch."""

    loop: JudgedLoop
    seed: int  # of the sensors' and the injector's random numbers
    samples: int
    # of each injection, as the injector counts them from 1; 0: not in this flight
    numbers: tuple[int, ...] | None = None

    @property
    def structure(self) -> Hashable:
        """What two flights must have in common to fly together; hashable."""
        return structure_of(self.loop), self.samples, self.period

    @property
    def draws(self) -> LoopDraws:
        """Times and random numbers of the flight."""
        return LoopDraws(self.loop.loop, self.seed, self.samples, self.numbers)

    @property
    def period(self) -> float:
        """Time between two samples [s]."""
        return seconds(round(self.loop.loop.clock.period_ns))


class Outcome(NamedTuple):
    """What is left of one flight, in double precision."""

    sums: dict[str, Floats]  # as in `Tally`
    marks: dict[str, Any]  # all else of the tally
    span: float  # time from the first to the last sample [s]
    period: float  # of the samples [s]


def compile_laws(loops: Iterable[Composition], log: Log = say) -> None:
    """Compile what loops need, side by side; ``log`` gets a line on each law that cannot be compiled."""
    different = {structure_of(loop): loop for loop in loops}.values()
    laws = [law for loop in different for law in loop.laws.values()]
    libraries = CEngine(log).prepare(laws)
    slow = {name_of(law) for law, library in zip(laws, libraries, strict=True) if library is None}
    if slow:
        log(f"{', '.join(sorted(slow))}: not in C, so its flights go law by law, which is slower")


def without_words(words: str) -> None:
    """Say nothing: what a campaign needs has been compiled, or it has been said that it cannot be."""


def fly_all(
    flights: Sequence[BatchFlight],
    engine: str = "c",
    progress: Progress = lambda samples: None,
    log: Log = say,
) -> Iterator[Outcome]:
    """Fly flights one by one in C, or in NumPy where ``engine`` says so or a law cannot be compiled."""
    run, kept = engine_named(engine, log), dict[Hashable, Flown]()
    for flight in flights:
        key = structure_of(flight.loop)
        if key in kept:
            kept[key].configure(flight.loop)
        else:
            kept[key] = flown_by(run, flight.loop, LoopDraws.example(flight.loop.loop))
        yield _fly(flight, kept[key], progress)


def _fly(flight: BatchFlight, flown: Flown, progress: Progress) -> Outcome:
    draws = flight.draws
    for begin in range(0, flight.samples, BLOCK):
        rows = min(BLOCK, flight.samples - begin)
        flown.run(draws.next(rows), rows)
        progress(rows)
    return outcome_of(flight, flown.state_of("judge").tally)


def outcome_of(flight: BatchFlight, tally: Tally) -> Outcome:
    """Return what is left of a flight by its tally."""
    sums, *marks = (
        {name: value for name, value in part._asdict().items() if value is not None} for part in tally
    )
    merged = {name: value for part in marks for name, value in part.items()}
    span = (flight.samples - flight.loop.judge.delay - 1) * flight.period
    return Outcome(sums, merged, span, flight.period)
