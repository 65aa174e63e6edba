"""All flights of the study: which there are, which are missing, and flying those on several processes."""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from quadftc_bags.bag import BagError
from quadftc_tools.diagnosis_study.flights import FlightPlan
from quadftc_tools.diagnosis_study.provenance import digest_of
from quadftc_tools.diagnosis_study.runs import Record, Task, fly
from quadftc_tools.diagnosis_study.settings import DURATION, SETTINGS, WINDOWS, Setting, Variant
from quadftc_tools.diagnosis_study.store import Store
from quadftc_tools.diagnosis_study.variants import variants_of

ONE_AXIS = 4  # to so many flights there is one with faults on one axis
SWEPT = 8  # one in so many flights is flown with other levels, too

Progress = Callable[[int], None]  # called with the number of flights that are done


class Study(NamedTuple):
    """How much is flown."""

    flights: int  # of the simulation
    bags: tuple[Path, ...]
    seeds: int  # draws of faults for each bag
    seed: int
    duration: float = DURATION  # s, of a simulated flight
    windows: tuple[tuple[float, float], ...] = WINDOWS  # s, of its faults

    def plans(self, setting: Setting) -> tuple[FlightPlan, ...]:
        """Return the flights of a setting."""
        count = self.seeds if setting.recorded else self.flights
        numbers = range(_part(count, ONE_AXIS) if setting.one_axis else count)
        if not setting.recorded:
            return tuple(FlightPlan(setting, number) for number in numbers)
        return tuple(
            FlightPlan(setting, number, bag, place)
            for place, bag in enumerate(self.bags)
            for number in numbers
        )

    def variants(self, plan: FlightPlan) -> tuple[Variant, ...]:
        """Return what a flight is flown with."""
        return variants_of(plan.setting, swept=self.in_roc(plan))

    def in_roc(self, plan: FlightPlan) -> bool:
        """Whether a flight is among those of the ROC."""
        return plan.number < _part(self.seeds if plan.setting.recorded else self.flights, SWEPT)

    def task(self, plan: FlightPlan) -> Task:
        """Return a flight with all its observers."""
        return Task(plan, self.variants(plan), self.seed, self.duration, self.windows)

    def tasks(self) -> Iterator[Task]:
        """Return all flights with all their observers."""
        return (self.task(plan) for setting in SETTINGS for plan in self.plans(setting))


def bags_in(directory: Path) -> tuple[Path, ...]:
    """Return the bags in a directory, or the directory if it is one.

    Raises
    ------
    BagError
        If there is none.
    """
    if not directory.is_dir():
        raise BagError(f"{directory}: no such directory; expected one with rosbag2 bags")
    found = sorted(path.parent for path in directory.glob("*/metadata.yaml"))
    if (directory / "metadata.yaml").is_file():
        found = [directory]
    if not found:
        raise BagError(f"{directory}: holds no bag; expected directories with a metadata.yaml")
    return tuple(found)


def stored(store: Store, task: Task, variant: Variant, any_code: bool = False) -> Record | None:
    """Return the record of a flight with one observer, if there is one of today's code (or of any)."""
    digest = None if any_code else digest_of(task, variant)
    return store.get(task.plan.setting.name, variant.name, task.plan.name, digest)


def missing(study: Study, store: Store) -> list[Task]:
    """Return the flights that are not stored, each with the observers that are missing."""
    tasks = (
        task._replace(variants=tuple(each for each in task.variants if stored(store, task, each) is None))
        for task in study.tasks()
    )
    return [task for task in tasks if task.variants]


def fly_all(tasks: Iterable[Task], store: Store, jobs: int, progress: Progress) -> None:
    """Fly and store, in whatever order the flights end.

    Parameters
    ----------
    tasks : iterable of Task
    store : Store
    jobs : int
        Processes; 1: this one.
    progress : callable

    Raises
    ------
    ValueError
        If ``jobs`` is not positive, a bag cannot be used, or a parameter of an observer is wrong.
    """
    if jobs < 1:
        raise ValueError(f"jobs = {jobs}: must be positive")
    waiting = [
        (task, {variant.name: digest_of(task, variant) for variant in task.variants}) for task in tasks
    ]
    if jobs == 1:
        for done, (task, digests) in enumerate(waiting, start=1):
            store.add(_signed(task, digests))
            progress(done)
        return
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(jobs, mp_context=context) as pool:
        with _interrupts_ignored():  # by the processes that this starts; Ctrl-C is for us
            futures = [pool.submit(_signed, task, digests) for task, digests in waiting]
        try:
            for done, future in enumerate(concurrent.futures.as_completed(futures), start=1):
                store.add(future.result())
                progress(done)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


@contextlib.contextmanager
def _interrupts_ignored() -> Generator[None, None, None]:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _signed(task: Task, digests: Mapping[str, str]) -> list[Record]:
    """Fly, and write onto each record what it was made from."""
    return [{**record, "digest": digests[record["variant"]]} for record in fly(task)]


def _part(count: int, share: int) -> int:
    """One in so many, at least one, if there is any."""
    return min(max(count // share, 1), count)
