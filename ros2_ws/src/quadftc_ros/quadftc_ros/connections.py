"""Who should be connected with whom, by the table of topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from quadftc_ros.topics import TOPICS


def missing_connections(node: str, counts: Mapping[str, int], recorders: int = 0) -> list[str]:
    """Say what a node lacks to be part of a whole graph.

    Parameters
    ----------
    node : str
        Name of the node.
    counts : mapping
        As :meth:`GraphNode.connections` gives them.
    recorders : int
        Readers of every output besides those of the table.
    """
    missing: list[str] = []
    for topic, count in counts.items():
        row = TOPICS[topic]
        if node in row.publishers:
            wanted, kind = len(row.readers) + recorders, "readers"
        else:
            wanted, kind = len(row.publishers), "publishers"
        if count < wanted:
            missing.append(f"{topic}: {count} of {wanted} {kind}")
    return missing


def crowded_topics(count_publishers: Callable[[str], int]) -> list[str]:
    """Say which topics have more publishers than one graph gives them: another graph is there, too.

    Parameters
    ----------
    count_publishers : callable
        That of a node in the namespace of the graph.
    """
    counts = {name: count_publishers(name) for name in TOPICS if not name.startswith("/")}
    return [
        f"{name} has {count} publishers"
        for name, count in counts.items()
        if TOPICS[name].publishers and count > len(TOPICS[name].publishers)
    ]
