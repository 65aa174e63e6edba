"""When a node that has died is started again, and when it has died too often. Pure."""

from __future__ import annotations

from collections import Counter

FIRST_DELAY, LAST_DELAY = 0.1, 3.0  # s; the delay doubles with every death within `MEMORY`
MOST_DEATHS = 5  # of one node within `MEMORY`; with the next the graph ends
MEMORY = 60.0  # s


class Respawn:
    """Keeps the deaths of each node."""

    def __init__(self) -> None:
        self._deaths: dict[str, list[float]] = {}
        self._due: dict[str, float] = {}
        self.restarts: Counter[str] = Counter()

    def died(self, name: str, now: float) -> float | None:
        """Note a death at a time [s], once until `started`; return the delay [s], None if it died too often.

        Noted again before it was started, the delay is what is left of it.
        """
        if name in self._due:
            return max(0.0, self._due[name] - now)
        deaths = [each for each in self._deaths.get(name, ()) if now - each <= MEMORY]
        self._deaths[name] = [*deaths, now]
        if len(deaths) >= MOST_DEATHS:
            return None
        delay = min(LAST_DELAY, FIRST_DELAY * 2.0 ** len(deaths))
        self._due[name] = now + delay
        return delay

    def waits(self, name: str) -> bool:
        """Whether a node is dead and known to be."""
        return name in self._due

    def started(self, name: str) -> int:
        """Note that a node was started again; return how often it was so far."""
        del self._due[name]
        self.restarts[name] += 1
        return self.restarts[name]
