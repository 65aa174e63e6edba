"""The index of the chunks, kept in a file: the same bytes as from memory, wherever the bag ends."""

import io

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from quadftc_bags.bag_file import KEPT_BY_WRITER, ChunkIndices


def written(directory=None, chunks=50):
    """An MCAP file of some chunks on two channels; with a directory for its index."""
    stream = io.BytesIO()
    writer = Writer(stream)
    indices = None if directory is None else ChunkIndices(writer, directory)
    writer.start("ros2", library="test")
    schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 x")
    channels = [writer.register_channel(name, "cdr", schema) for name in ("/one", "/two")]
    for number in range(chunks):
        writer.add_message(channels[number % 2], number, bytes(8), number)
        writer.add_message(channels[0], number, bytes(8), number)
        writer.flush()
    writer.finish()
    if indices is not None:
        indices.close()
    return stream.getvalue()


@pytest.mark.parametrize("chunks", [0, 1, 50])
def test_file_is_that_of_the_library_byte_for_byte(tmp_path, chunks):
    found = written(tmp_path, chunks)
    assert found == written(chunks=chunks)
    assert len(make_reader(io.BytesIO(found)).get_summary().chunk_indexes) == chunks
    assert not list(tmp_path.iterdir())  # it has no name


def test_library_without_such_an_index_is_refused(tmp_path):
    writer = Writer(io.BytesIO())
    delattr(writer, KEPT_BY_WRITER)
    with pytest.raises(RuntimeError, match="chunk_indices"):
        ChunkIndices(writer, tmp_path)
