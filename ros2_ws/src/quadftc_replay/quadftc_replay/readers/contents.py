"""What a file is, by its first bytes: how formats are known, and names of what is no log."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence

from quadftc_replay.thinning import Data

HEAD = 4096  # bytes that tell a format

BLACKBOX = b"H Product:Blackbox flight data recorder"
DATAFLASH_TEXT = re.compile(rb"^(FMT, *\d+, *\d+, *\w+,|\S+ \S+: [A-Z0-9]+ \{(Type|TimeUS) : )", re.MULTILINE)
STAMP = struct.Struct(">Q")  # of a message in a telemetry log: since 1970 [µs]
LATEST = 4_102_444_800_000_000  # µs; the year 2100
# MAVLink version by its first byte -> where the length of the payload is, bytes beside payload and signature
MAVLINK = {0xFE: (1, 8), 0xFD: (1, 12)}

NAMES = {  # what people try as well
    b"\x93NUMPY": "a NumPy array",
    b"MATLAB ": "a MATLAB file",
    b"\x89HDF\r\n\x1a\n": "an HDF5 file (MATLAB 7.3 writes such files, too)",
    b"\xff\xd8\xff": "a JPEG picture",
    b"\x89PNG\r\n\x1a\n": "a PNG picture",
    b"GIF8": "a GIF picture",
    b"\x7fELF": "a program or a library (ELF)",
    b"%PDF": "a PDF document",
    b"\x80\x04\x95": "a Python pickle",
    b"\x80\x05\x95": "a Python pickle",
    b"PAR1": "a Parquet table",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive, which has to be unpacked",
    b"Rar!": "a RAR archive, which has to be unpacked",
    b"BZh": "a file compressed by bzip2, which has to be unpacked",
    b"\xfd7zXZ\0": "a file compressed by xz, which has to be unpacked",
    b"\x04\x22\x4d\x18": "a file compressed by LZ4, which has to be unpacked",
    b"#ROSBAG V1": "a ROS 1 bag of version 1, which 'rosbag fix' makes new",
    b"\x0a\x0d\x0d\x0a": "a network capture (pcapng)",
    b"\xd4\xc3\xb2\xa1": "a network capture (pcap)",
    b"<?xml": "an XML file",
    b"<!DOCTYPE html": "a web page",
    b"<!doctype html": "a web page",
    b"<html": "a web page",
    b"version https://git-lfs": "a pointer of Git LFS, whose content was not fetched",
}
LATER = {(257, b"ustar"): "a tar archive, which has to be unpacked", (4, b"ftyp"): "an MP4 film"}
SHOWN = 8  # bytes of what has no name


def begins(*starts: bytes) -> Callable[[bytes], bool]:
    """Return what tells files with such a beginning."""
    return lambda head: head.startswith(starts)


def is_blackbox(head: bytes) -> bool:
    """Whether a blackbox log begins here, perhaps behind the rest of an earlier one."""
    return BLACKBOX in head


def is_dataflash_text(head: bytes) -> bool:
    """Whether an ArduPilot log as text begins here, perhaps behind lines about the firmware."""
    return DATAFLASH_TEXT.search(head) is not None


def is_mavlink(head: bytes) -> bool:
    """Whether a telemetry log begins here: a stamp and a message, and another one behind it."""
    at = 0
    for _ in range(2):
        if at + 24 > len(head) or STAMP.unpack_from(head, at)[0] > LATEST or head[at + 8] not in MAVLINK:
            return False
        at += 8 + message_length(head, at + 8)
    return True


def _is_bare_mavlink(head: bytes) -> bool:
    at = 0
    for _ in range(2):
        if at + 24 > len(head) or head[at] not in MAVLINK:
            return False
        at += message_length(head, at)
    return True


def message_length(data: Data, at: int) -> int:
    """Bytes of a MAVLink message that begins at a place, with its signature."""
    place, beside = MAVLINK[data[at]]
    is_signed = data[at] == 0xFD and data[at + 2] & 1
    return data[at + place] + beside + (13 if is_signed else 0)


def is_text(head: bytes) -> bool:
    """Whether the bytes are text: no control characters but those between lines and columns."""
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # else a character that is cut
            return False
    return bool(head) and not any(byte < 32 and byte not in b"\t\n\r" for byte in head)


def list_some(words: Sequence[str], shown: int) -> str:
    """Write the first of some words in one line, and how many more there are."""
    more = f" and {len(words) - shown} more" if len(words) > shown else ""
    return (", ".join(words[:shown]) or "none") + more


def name_content(head: bytes) -> str:
    """Name what begins so, as a noun with its article."""
    if not head:
        return "an empty file"
    named = next((name for begin, name in NAMES.items() if head.startswith(begin)), None)
    named = named or next((name for (at, word), name in LATER.items() if head.startswith(word, at)), None)
    if named:
        return named
    if not any(head):
        return "a file of zeros"
    if _is_bare_mavlink(head):
        return "MAVLink without times of receipt; a .tlog has them"
    if is_text(head):
        line = head.splitlines()[0] if head.strip() else b""
        if any(sign in line for sign in (b",", b";", b"\t")):
            return "a text file, perhaps a table, whose columns --mapping FILE explains"
        return "a text file"
    return f"a file that begins with {head[:SHOWN].hex(' ')}"
