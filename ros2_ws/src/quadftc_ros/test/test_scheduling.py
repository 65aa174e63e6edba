"""Sharing the machine: what is refused, what a thread gets, and that it is given back."""

import contextlib
import os

import pytest

from quadftc_ros.scheduling import ORDINARY, Scheduling, SchedulingError, scheduled


def standing():
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, os.sched_getaffinity(0)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"wait": "spin"}, "wait = 'spin': expected one of sleep, poll"),
        ({"priority": 100}, "realtime priority = 100: expected 1 to 99"),
        ({"priority": -1}, "realtime priority = -1: expected 1 to 99"),
        ({"priority": 5, "wait": "poll"}, "realtime priority: not while polling, .* 50 ms in every second"),
        ({"cores": (0, 4096)}, "cores: there is no core 4096 on this machine"),
        ({"cores": (-1,)}, "cores: there is no core -1"),
    ],
)
def test_what_cannot_be_is_refused_by_name(values, text):
    with pytest.raises(ValueError, match=text):
        Scheduling(**values)


@pytest.mark.parametrize("scheduling", [ORDINARY, Scheduling(wait="poll")])
def test_waiting_changes_neither_priority_nor_cores(scheduling):
    before = standing()
    with scheduled(scheduling):
        assert standing() == before


def test_thread_runs_on_the_cores_asked_for_and_on_all_again_afterwards():
    before = standing()
    core = min(os.sched_getaffinity(0))
    with scheduled(Scheduling(cores=(core,))):
        assert os.sched_getaffinity(0) == {core}
    assert standing() == before


def test_priority_is_given_and_taken_back_or_refused_with_the_remedy():
    before = standing()
    refused = None
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(scheduled(Scheduling(priority=3)))
        except SchedulingError as error:
            refused = str(error)
        else:
            assert standing()[:2] == (os.SCHED_RR, 3)
    assert standing() == before
    assert refused is None or "ulimit -r 3" in refused


def test_refused_priority_names_what_would_allow_it(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    before = standing()
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    wanted = Scheduling(priority=7, cores=(min(os.sched_getaffinity(0)),))
    with pytest.raises(SchedulingError) as caught, scheduled(wanted):
        pass
    assert str(caught.value).startswith(
        "realtime priority 7: Operation not permitted; allow it by 'ulimit -r 7'"
    )
    assert standing() == before  # the cores, too, which it had got already
