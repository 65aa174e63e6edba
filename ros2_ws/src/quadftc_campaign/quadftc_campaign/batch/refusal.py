"""What is said of a part that a compiler cannot trace: which one, and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from quadftc_campaign.batch.parts import Loop

UNTRACEABLE = (TypeError, AttributeError, NotImplementedError, ValueError)


def refusal(error: Exception, loop: Loop, varying: Sequence[str]) -> ValueError:
    """Return the error that names the part in which tracing failed.

    Parameters
    ----------
    error : Exception
        What was raised, with its traceback.
    loop : Loop
    varying : sequence of str
        Paths of the numbers that differ between flights.
    """
    role, part = _culprit(error, loop)
    where = role if part is None else f"{role} ({type(part).__name__})"
    own = [path for path in varying if path.startswith(f"{role}.")]
    reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
    advice = "a law must not branch on data or ask for numbers; see CONTRIBUTING.md"
    if own:
        advice += f". It can if {', '.join(own)} are the same in all flights"
    return ValueError(f"{where} cannot be flown in a batch: {reason}; {advice}")


def _culprit(error: Exception, loop: Loop) -> tuple[str, Any]:
    """The innermost part of the loop in whose method the error was raised."""
    parts = dict(_parts(loop))
    found: tuple[str, Any] = ("a part", None)
    step = error.__traceback__
    while step is not None:
        owner = step.tb_frame.f_locals.get("self")
        for role, part in parts.items():
            if owner is not None and type(owner) is type(part):
                found = role, part
        step = step.tb_next
    return found


def _parts(loop: Loop) -> Iterator[tuple[str, Any]]:
    """Everything in the loop that has a step, by its path."""
    yield from (
        ("plant", loop.plant),
        ("sensor", loop.sensor),
        ("observer", loop.observer),
        ("disturbance_observer", loop.disturbance_observer),
        ("controller", loop.controller),
    )
    yield from ((f"injections.{i}.law", each.law) for i, each in enumerate(loop.injections))
    yield from ((f"references.{i}", each) for i, each in enumerate(loop.references))
    yield from ((f"plant.disturbances.{i}", each) for i, each in enumerate(loop.plant.disturbances))
