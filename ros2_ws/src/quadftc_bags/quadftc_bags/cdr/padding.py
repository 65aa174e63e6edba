"""Serialised messages that depend on their values only: padding is zero, nothing stands behind the end.

Fast DDS leaves the bytes between fields, and sometimes a few behind the last field, as it finds them in
memory. Without cleaning, two recordings of the same values would differ there.
"""

from __future__ import annotations

from quadftc_bags.cdr.layout import Layout, find_layout, find_leaves, installed_fields


class PaddingCleaner:
    """Clean the messages of one topic; fast while strings and sequences keep their lengths.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.

    Raises ValueError if the type is not installed, or has a field that has no known layout (``wstring``).
    """

    def __init__(self, type_name: str) -> None:
        self._leaves = find_leaves(installed_fields, type_name)
        self._layout: Layout | None = None

    def clean(self, data: bytes) -> bytes:
        """Return the message with zero padding, cut at its end; unchanged if it does not fit its type."""
        layout = self._layout
        if layout is None or not layout.fits(data):
            layout = self._layout = find_layout(self._leaves, data)
        if layout is None:
            return data
        cleaned = bytearray(data[: layout.end])
        for start, stop in layout.gaps:
            cleaned[start:stop] = bytes(stop - start)
        return bytes(cleaned)
