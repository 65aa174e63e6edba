"""What a bag holds, byte by byte, of two flights that shall be the same."""

from pathlib import Path

from quadftc_bags.bag import read_bag


def messages_by_topic(directory: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Topic -> messages as bytes; the compute time, the last 8 bytes of control/status, left out.

    /diagnostics has many publishers, between which there is no order within a stamp: it is sorted.
    """
    found: dict[str, list[tuple[int, bytes]]] = {}
    for topic, log_time_ns, data in read_bag(directory).messages():
        cut = data[:-8] if topic == "/control/status" else data
        found.setdefault(topic, []).append((log_time_ns, bytes(cut)))
    found["/diagnostics"].sort()
    return found
