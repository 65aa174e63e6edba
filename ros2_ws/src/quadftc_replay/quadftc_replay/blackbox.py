r"""Blackbox logs of Betaflight, INAV and their relatives (``.bbl``, ``.bfl``): their bytes as columns.

    header:  lines ``H name:value``; of each kind of frame the fields, how they are encoded and predicted
    frames:  a letter and the encoded fields: I whole, P less a prediction from the two before,
             S, G, H slow fields and GPS, E events

A frame is known to be one if a letter, or the end, follows. Behind bytes that make no frame the next one is
looked for; P frames count again from the next I frame on. A main frame whose time goes back, or on by more
than 10 s, ends the chain as well.

Frames have no length, so that they seem to need a loop over all bytes. Instead, all places that may begin a
frame are followed at once, and only the chain of the true ones is a loop. The prediction works on all
stretches from I frame to I frame at once. That decodes 30 000 frames in 0.03 s. orangebox, the reader in
Python, takes 0.6 s and is GPL; this one is written by the format.
Source: cleanflight/blackbox-log-viewer and betaflight, src/main/blackbox/blackbox_encoding.c,
blackbox_fielddefs.h (formats only).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray
from quadftc_replay.blackbox_frames import (
    ENCODINGS,
    NONE,
    Block,
    Group,
    Ints,
    block_of,
    groups_of,
    read_frame,
)
from quadftc_replay.thinning import Blocks, Data, Forgetting, mapped

MARKER = b"H Product:Blackbox flight data recorder"
VERSION = "2"
LETTERS = b"IPSGHE"
IS_LETTER = np.isin(np.arange(256), list(LETTERS))
WRAP = 1 << 32  # of a time [µs], and of other fields
MOST_HEADER = 1 << 18  # bytes
BLOCK = 1 << 21  # bytes decoded at a time
PAD = 64  # zero bytes behind a block, for places that run over its end
MAX_STEP = 10_000_000  # µs between two main frames
PREVIOUS, STRAIGHT_LINE, AVERAGE, MOTOR_0, INCREMENT = 1, 2, 3, 5, 6  # predictors
CONSTANTS = {4: "minthrottle", 9: "vbatref", 11: "motorOutput"}  # predictor -> name in the header
ONE_AND_A_HALF = 8  # predictor: 1500
ADJUSTMENT, LOG_END = 13, 255  # events
NUMBERS = {0: 1, 14: 2, 15: 1, 30: 2, 40: 1, 50: 1}  # event -> unsigned numbers in it
END = b"End of log"
LONGEST_END = 64  # bytes behind that, up to a zero: why the vehicle was disarmed


class BlackboxLog(NamedTuple):
    """One of the logs in a file."""

    header: Mapping[str, str]
    columns: Mapping[str, AnyArray]  # of the main frames, by field (n,); ``time`` [µs] without its wraps
    notes: tuple[str, ...]  # one line each


class _Frame(NamedTuple):
    fields: tuple[str, ...]
    groups: tuple[Group, ...]
    predictors: tuple[int, ...]


def read_blackbox(path: Path, log: int, wanted: Collection[str]) -> BlackboxLog:
    """Read fields of a log, whose names begin so; ``log`` is one of several, 0 the only one.

    BagError if there is no such log, or several and none is chosen.
    """
    with mapped(path) as data:
        start, stop, note = _choose(data, path, log)
        header, at = _read_header(data, start, stop)
        columns, notes = _Decoder(data, header, f"{path}: log {max(log, 1)}", wanted).run(at, stop)
    return BlackboxLog(header, columns, (*note, *notes))


def _choose(data: Data, path: Path, log: int) -> tuple[int, int, tuple[str, ...]]:
    """Return where a log begins and ends, and which one it is."""
    starts, at = list[int](), data.find(MARKER)
    while at >= 0:
        starts.append(at)
        at = data.find(MARKER, at + len(MARKER))
    ends = [*starts[1:], len(data)]
    if not starts:
        raise BagError(f"{path}: not a blackbox log: no '{MARKER.decode()}' in it")
    if len(starts) > 1 and not 0 < log <= len(starts):
        problem = f"no log {log}; {len(starts)}" if log else f"{len(starts)}"
        sizes = ", ".join(
            f"{n} ({(end - start) / 1e6:.2g} MB)"
            for n, (start, end) in enumerate(zip(starts, ends, strict=True), 1)
        )
        raise BagError(f"{path}: {problem} logs in the file; choose one with --log: {sizes}")
    if log > len(starts):
        raise BagError(f"{path}: no log {log}; the file has one")
    chosen = max(log, 1) - 1
    note = (f"log {chosen + 1} of {len(starts)} in the file",) if len(starts) > 1 else ()
    return starts[chosen], ends[chosen], note


def _read_header(data: Data, start: int, stop: int) -> tuple[dict[str, str], int]:
    """Return the lines of a header by name, and where the frames begin."""
    header, at = dict[str, str](), start
    while data[at : at + 2] == b"H " and at < min(stop, start + MOST_HEADER):
        end = data.find(b"\n", at, stop)
        end = stop if end < 0 else end
        name, _, value = data[at + 2 : end].decode("ascii", "replace").partition(":")
        header.setdefault(name.strip(), value.strip())
        at = end + 1
    return header, min(at, stop)


def whole_number(text: str) -> int:
    """Return a number of up to nine digits that a header has; -1: it is none."""
    text = text.strip()
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else -1


def _frames(header: Mapping[str, str], where: str) -> dict[str, _Frame]:
    """Kinds of frames that a header defines; BagError if that of the main ones makes no sense."""
    frames = dict[str, _Frame]()
    for letter in "IPSGH":
        names = header.get(f"Field {'I' if letter == 'P' else letter} name", "")
        encodings, predictors = (
            [whole_number(each) for each in header.get(f"Field {letter} {what}", "").split(",")]
            for what in ("encoding", "predictor")
        )
        fields = tuple(name.strip() for name in names.split(","))
        if len(fields) == len(encodings) == len(predictors) and ENCODINGS.issuperset(encodings):
            # an increment is not written at all
            pairs = zip(encodings, predictors, strict=True)
            encodings = [NONE if predictor == INCREMENT else encoding for encoding, predictor in pairs]
            frames[letter] = _Frame(fields, groups_of(encodings), tuple(predictors))
    if missing := [letter for letter in "IP" if letter not in frames]:
        lines = ", ".join(f"Field {letter} name, encoding, predictor" for letter in missing)
        raise BagError(f"{where}: the header lacks, or has what is not known in, {lines}")
    if len(frames["P"].fields) != len(frames["I"].fields) or "time" not in frames["I"].fields:
        raise BagError(f"{where}: no field 'time'; fields: {', '.join(frames['I'].fields)}")
    return frames


class _Chain(NamedTuple):
    """The frames of a block that follow each other."""

    letters: NDArray[np.uint8]  # (n,)
    places: Ints  # (n,) behind their letters
    breaks: NDArray[np.bool_]  # (n,) bytes that make no frame are before it
    skipped: int  # such bytes
    after: int  # place where the next block begins, or behind the end mark
    is_ended: bool


class _Decoder:
    def __init__(self, data: Data, header: Mapping[str, str], where: str, wanted: Collection[str]) -> None:
        self.data, self.where = data, where
        if header.get("Data version") != VERSION:
            version = header.get("Data version", "not given")
            raise BagError(f"{where}: data version {version}; expected {VERSION}")
        self.frames = _frames(header, where)
        fields = self.frames["I"].fields
        written = [predictor != INCREMENT for predictor in self.frames["P"].predictors]
        chosen = [
            name
            for name, is_written in zip(fields, written, strict=True)
            if is_written and name != "time" and name.startswith(("motor[0]", *wanted))
        ]
        self.names = ["time", *chosen]
        self.numbers = [fields.index(name) for name in self.names]
        self.constants = {0: 0, ONE_AND_A_HALF: 1500}
        for predictor, name in CONSTANTS.items():
            self.constants[predictor] = max(whole_number(header.get(name, "").split(",")[0]), 0)
        self.skipped = self.dropped = 0

    def run(self, at: int, stop: int) -> tuple[dict[str, AnyArray], tuple[str, ...]]:
        """Decode the frames between two places; BagError if there are none."""
        blocks, is_ended = Blocks(), False
        blocks.add(np.empty((0, len(self.names)), np.int32))
        forgetting = Forgetting(self.data)
        while at < stop and not is_ended:
            forgetting.passed(at)
            raw = self.data[at : min(at + BLOCK, stop)]
            block = block_of(raw, PAD)
            chain = self._follow(block, len(raw), at + len(raw) == stop)
            blocks.add(_wrapped(self._decode(block, chain)).astype(np.int32))
            self.skipped += chain.skipped
            at, is_ended = at + chain.after, chain.is_ended
        is_ended &= self.data.find(b"\0", at, min(at + LONGEST_END, stop)) >= 0
        rows = blocks.rows()
        if not len(rows):
            raise BagError(f"{self.where}: no frames that make sense")
        time = rows[:, 0].astype(np.int64)
        steps = _wrapped(np.diff(time))
        time = np.cumsum(np.concatenate([time[:1] % WRAP, steps]))
        columns = {name: rows[:, k] for k, name in enumerate(self.names)} | {"time": time}
        return columns, (*self._notes(is_ended), *blocks.thinning.notes("frames"))

    def _notes(self, is_ended: bool) -> Iterator[str]:
        if self.skipped:
            yield f"{self.skipped} bytes are no frames; left out"
        if self.dropped:
            yield f"{self.dropped} frames whose predecessors are damaged or missing left out"
        if not is_ended:
            yield "cut short: the log has no end mark"

    def _follow(self, block: Block, size: int, is_last: bool) -> _Chain:
        """Find the frames of a block, up to its last I frame if another block follows."""
        starts = np.flatnonzero(IS_LETTER[block.data[:size]])
        letters, behind = block.data[starts], np.full(len(starts), -1)
        for letter, frame in self.frames.items():
            rows = np.flatnonzero(letters == ord(letter))
            behind[rows] = read_frame(block, starts[rows] + 1, frame.groups)[0]
        rows = np.flatnonzero(letters == ord("E"))
        behind[rows], is_end = _events(block, starts[rows] + 1)
        ends_log = np.zeros(len(starts), np.bool_)
        ends_log[rows] = is_end
        follows = IS_LETTER[block.data[np.clip(behind, 0, size)]] & (behind < size)
        good = (behind > 0) & (follows | (behind == size) | (ends_log & (behind <= size)))
        following = np.where(good, np.searchsorted(starts, behind), np.arange(1, len(starts) + 1))
        # the chain of the true frames
        chain, row, count = list[int](), 0, len(starts)
        steps, is_good, is_final = following.tolist(), good.tolist(), ends_log.tolist()
        while row < count:
            if is_good[row]:
                chain.append(row)
                if is_final[row]:
                    break
            row = steps[row]
        found = np.array(chain, np.int64)
        is_ended = bool(len(found)) and is_final[chain[-1]] and is_good[chain[-1]]
        last = np.flatnonzero(letters[found] == ord("I"))
        after = int(behind[found[-1]]) if is_ended else size
        if not is_last and not is_ended and len(last) and starts[found[last[-1]]] > 0:
            after = int(starts[found[last[-1]]])
            found = found[: last[-1]]
        before = np.concatenate([[0], behind[found][:-1]])
        gaps = starts[found] - before
        rest = 0 if is_ended or not is_last else size - int(behind[found[-1]] if len(found) else 0)
        return _Chain(letters[found], starts[found] + 1, gaps > 0, int(gaps.sum()) + rest, after, is_ended)

    def _decode(self, block: Block, chain: _Chain) -> Ints:
        """Decode the main frames of a block (n, k): their wanted fields."""
        is_main = (chain.letters == ord("I")) | (chain.letters == ord("P"))
        rows = np.flatnonzero(is_main)
        whole = chain.letters[rows] == ord("I")
        broken = np.diff(np.cumsum(chain.breaks)[rows], prepend=0) > 0
        if not whole.any():
            self.dropped += len(rows)
            return np.empty((0, len(self.names)), np.int64)
        # P frames before the first I frame have nothing to be predicted from
        first = int(np.flatnonzero(whole)[0])
        self.dropped += first
        rows, whole, broken = rows[first:], whole[first:], broken[first:]
        values = np.empty((len(rows), len(self.names)), np.int64)
        for letter, chosen in (("I", whole), ("P", ~whole)):
            places = chain.places[rows[chosen]]
            _, fields = read_frame(block, places, self.frames[letter].groups, self.numbers)
            values[chosen] = np.stack([fields[number] for number in self.numbers], axis=-1)
        begins = np.flatnonzero(whole)
        self._predict(values, begins)
        # the rest of a stretch behind damage counts no more
        steps = _wrapped(np.diff(values[:, 0], prepend=values[0, 0]))
        bad = ~whole & (broken | (steps < 0) | (steps > MAX_STEP))
        count = np.cumsum(bad)
        good = count == np.repeat(count[begins], np.diff([*begins.tolist(), len(rows)]))
        self.dropped += int(np.sum(~good))
        return values[good]

    def _predict(self, values: Ints, begins: Ints) -> None:
        """Add the predictions to the frames (n, k), for all stretches that begin with an I frame at once."""
        lengths = np.diff([*begins.tolist(), len(values)])
        begins = begins[np.argsort(-lengths, kind="stable")]
        lengths = np.sort(lengths)[::-1]
        whole, changes = (np.array(self.frames[each].predictors)[self.numbers] for each in "IP")
        self._add(values, begins, whole, np.zeros((len(begins), len(self.names)), np.int64))
        previous, line, average = (
            np.flatnonzero(changes == each) for each in (PREVIOUS, STRAIGHT_LINE, AVERAGE)
        )
        for step in range(1, int(lengths[0])):
            rows = begins[: np.searchsorted(-lengths, -step)] + step
            one, two = values[rows - 1], values[rows - (2 if step > 1 else 1)]
            predicted = np.zeros_like(one)
            predicted[:, previous] = one[:, previous]
            predicted[:, line] = 2 * one[:, line] - two[:, line]
            total = one[:, average] + two[:, average]
            predicted[:, average] = (total + (total < 0)) >> 1  # towards zero
            self._add(values, rows, changes, predicted)

    def _add(self, values: Ints, rows: Ints, predictors: AnyArray, predicted: Ints) -> None:
        for predictor, constant in self.constants.items():
            predicted[:, predictors == predictor] = constant
        values[rows] += predicted
        if len(like_motor := np.flatnonzero(predictors == MOTOR_0)) and "motor[0]" in self.names:
            first = values[rows, self.names.index("motor[0]")]
            values[np.ix_(rows, like_motor)] += first[:, None]


def _wrapped(values: Ints) -> Ints:
    """Numbers as the firmware has them, in 32 bits with a sign."""
    return (values + WRAP // 2) % WRAP - WRAP // 2


def _events(block: Block, places: Ints) -> tuple[Ints, NDArray[np.bool_]]:
    """Places behind events, -1 where it is none that is known; and whether it ends the log."""
    data = block.data
    kinds, at = data[places], places + 1
    behind = np.full(len(places), -1)
    for kind, count in NUMBERS.items():
        after = at
        for _ in range(count):
            after = block.ends[np.minimum(after, len(data) - 1)]
        behind = np.where(kinds == kind, after, behind)
    is_float = data[np.minimum(at, len(data) - 1)] >= 0x80
    adjusted = np.where(is_float, at + 5, block.ends[np.minimum(at + 1, len(data) - 1)])
    behind = np.where(kinds == ADJUSTMENT, adjusted, behind)
    is_end = kinds == LOG_END
    for k, letter in enumerate(END):
        is_end &= data[np.minimum(at + k, len(data) - 1)] == letter
    return np.where(is_end, at + len(END), behind), is_end
