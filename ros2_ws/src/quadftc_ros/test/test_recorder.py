"""What the recorder decides, without a node."""

import pytest

from quadftc_bags.writer import BagStatus
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.recorder import choose_topics, judge, read_attachments
from quadftc_ros.topics import GRAPHS, TOPICS


@pytest.mark.parametrize(
    ("status", "level", "message"),
    [
        (BagStatus({"/a": 3}, {}, 0, None), OK, "recording"),
        (BagStatus({"/a": 3}, {"/a": 1}, 0, None), WARN, "messages were dropped"),
        (BagStatus({"/a": 3}, {"/a": 1}, 2, "full"), ERROR, "recording has stopped: full"),
    ],
)
def test_error_outranks_dropped_messages(status, level, message):
    assert judge(status)[:2] == (level, message)
    assert judge(status)[2] == {"stored": 3, "dropped": sum(status.dropped.values()), "lost": status.lost}


def test_topics_are_chosen_once_each_and_all_by_default():
    for plant, table in GRAPHS.items():
        assert [row.name for row in choose_topics([], plant)] == list(table)
    assert choose_topics(["/clock", "plant/imu", "/clock"]) == [TOPICS["/clock"], TOPICS["plant/imu"]]
    with pytest.raises(ValueError, match="topics: unknown imu/date; known are plant/imu"):
        choose_topics(["imu/date"])


def test_attachments_of_one_name_are_refused(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.yaml").write_text(folder)
    assert read_attachments([tmp_path / "a/x.yaml"]) == {"x.yaml": b"a"}
    with pytest.raises(ValueError, match=r"two files are named x\.yaml"):
        read_attachments([tmp_path / "a/x.yaml", tmp_path / "b/x.yaml"])
