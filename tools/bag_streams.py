"""Print one hash for the streams of each bag: ``python tools/bag_streams.py RUN_DIRECTORY...``.

A hash covers every topic, log time and payload, topic by topic. The compute time of ``control/status``
(its last 8 bytes) is left out: no other field differs between two lock-step flights of one scenario. Two
versions of the code fly a scenario alike exactly when they print the same hash for it.
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from mcap.reader import make_reader

COMPUTE_TIME_BYTES = 8  # a float64, the last field of quadftc_msgs/ControlStatus


def stream_hash(bag: Path) -> str:
    """Return the SHA-256 of a rosbag2 directory's streams, whatever the order of messages in the file."""
    streams: dict[str, hashlib._Hash] = {}
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=True):
                name = schema.name if schema else ""
                payload = message.data
                if name == "quadftc_msgs/msg/ControlStatus":
                    payload = payload[:-COMPUTE_TIME_BYTES]
                stream = streams.setdefault(channel.topic, hashlib.sha256(name.encode()))
                stream.update(message.log_time.to_bytes(8, "little"))
                stream.update(payload)
    whole = hashlib.sha256()
    for topic, stream in sorted(streams.items()):
        whole.update(topic.encode() + b"\0" + stream.digest())
    return whole.hexdigest()


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    for name in sorted(sys.argv[1:]):
        print(f"{stream_hash(Path(name))[:16]}  {Path(name).name}")
