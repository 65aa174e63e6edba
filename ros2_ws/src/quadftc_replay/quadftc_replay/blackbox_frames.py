"""Encodings of blackbox frames, at many places of a block of bytes at once.

Every function takes the bytes (uint8, with zeros behind), where each next number ends, and places (n,). It
gives the place behind, and the values (n,) of the fields that are wanted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
SVB, UVB, NEG14, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NONE, TAG2_3SVARIABLE = 0, 1, 3, 6, 7, 8, 9, 10
MEMBERS = {TAG2_3S32: 3, TAG8_4S16: 4, TAG2_3SVARIABLE: 3}  # encoding -> fields that share it
ENCODINGS = {SVB, UVB, NEG14, TAG8_8SVB, NONE, *MEMBERS}
MOST_TAGGED = 8  # fields of TAG8_8SVB
LONGEST = 5  # bytes of a number


class Group(NamedTuple):
    """Fields that are encoded together."""

    encoding: int
    fields: tuple[int, ...]  # their numbers


class Block(NamedTuple):
    """Bytes in memory."""

    data: NDArray[np.uint8]  # (n + PAD,)
    ends: NDArray[np.int64]  # (n + PAD,) place behind the number that is at a place


def block_of(raw: bytes, pad: int) -> Block:
    """Prepare bytes; behind them are zeros."""
    data = np.frombuffer(raw + bytes(pad), np.uint8)
    last = np.where(data < 0x80, np.arange(len(data)), len(data))  # a number ends with a byte below 0x80
    ends = np.minimum.accumulate(last[::-1])[::-1] + 1
    return Block(data, np.minimum(ends, len(data) - 1))


def groups_of(encodings: Sequence[int]) -> tuple[Group, ...]:
    """Group the fields of a frame by their encodings."""
    groups, field = list[Group](), 0
    while field < len(encodings):
        encoding, count = encodings[field], 1
        if encoding == TAG8_8SVB:
            while count < MOST_TAGGED and encodings[field + count : field + count + 1] == [TAG8_8SVB]:
                count += 1
        count = min(MEMBERS.get(encoding, count), len(encodings) - field)
        groups.append(Group(encoding, tuple(range(field, field + count))))
        field += count
    return tuple(groups)


def read_frame(
    block: Block, places: Ints, groups: Sequence[Group], wanted: Collection[int] = ()
) -> tuple[Ints, dict[int, Ints]]:
    """Follow the groups of a frame; return the places behind, and the wanted fields by number."""
    found = dict[int, Ints]()
    for group in groups:
        there = [number in wanted for number in group.fields]
        places, values = _read_group(block, places, group, any(there))
        if any(there):
            found |= {
                each: value for each, value in zip(group.fields, values, strict=False) if each in wanted
            }
    return places, found


def _read_group(block: Block, places: Ints, group: Group, is_wanted: bool) -> tuple[Ints, list[Ints]]:
    encoding, count = group.encoding, len(group.fields)
    if encoding == NONE:
        return places, [np.zeros(len(places), np.int64)] if is_wanted else []
    if encoding == TAG8_8SVB and count > 1:
        return _tagged(block, places, count, is_wanted)
    if encoding == TAG8_4S16:
        return _nibbles(block, places, is_wanted)
    if encoding in (TAG2_3S32, TAG2_3SVARIABLE):
        return _threes(block, places, encoding, is_wanted)
    values = [_single(block, places, encoding)] if is_wanted else []
    return block.ends[places], values


def _single(block: Block, places: Ints, encoding: int) -> Ints:
    value = unsigned(block, places)
    if encoding == UVB:
        return value
    if encoding == NEG14:
        return -_signed(value & 0x3FFF, 14)
    return _zigzag(value)


def unsigned(block: Block, places: Ints) -> Ints:
    """Numbers of seven bits a byte, the lowest first."""
    value, more = np.zeros(len(places), np.int64), np.ones(len(places), np.bool_)
    for k in range(LONGEST):
        byte = block.data[np.minimum(places + k, len(block.data) - 1)]
        value |= np.where(more, byte & np.int64(0x7F), 0) << (7 * k)
        more &= byte >= 0x80
        if not more.any():
            break
    return value & 0xFFFFFFFF


def _zigzag(value: Ints) -> Ints:
    return (value >> 1) ^ -(value & 1)


def _signed(value: Ints, bits: int | Ints) -> Ints:
    half = np.left_shift(np.int64(1), np.asarray(bits, np.int64) - 1)
    return (value ^ half) - half


def _tagged(block: Block, places: Ints, count: int, is_wanted: bool) -> tuple[Ints, list[Ints]]:
    """A byte with a bit for each field, then the signed numbers that are not zero."""
    tags, places = block.data[places], places + 1
    values = list[Ints]()
    for k in range(count):
        there = (tags >> k) & 1 == 1
        if is_wanted:
            values.append(np.where(there, _single(block, places, SVB), 0))
        places = np.where(there, block.ends[places], places)
    return places, values


def _nibbles(block: Block, places: Ints, is_wanted: bool) -> tuple[Ints, list[Ints]]:
    """A byte with two bits for each of four fields: no, 1, 2 or 4 nibbles of it follow."""
    data = block.data
    tags, first, at = data[places], places + 1, np.zeros(len(places), np.int64)
    values = list[Ints]()
    for k in range(MEMBERS[TAG8_4S16]):
        count = np.array([0, 1, 2, 4])[(tags >> (2 * k)) & 3]
        if is_wanted:
            word = _word(data, first + at // 2, 3)
            word = (word << (4 * (at & 1))) & 0xFFFFFF
            value = word >> (24 - 4 * count)
            values.append(np.where(count > 0, _signed(value, np.maximum(4 * count, 1)), 0))
        at = at + count
    return first + (at + 1) // 2, values


def _threes(block: Block, places: Ints, encoding: int, is_wanted: bool) -> tuple[Ints, list[Ints]]:
    """Three fields; the upper two bits say of how many bits they are."""
    data, lead = block.data, block.data[places].astype(np.int64)
    choice, count = lead >> 6, MEMBERS[encoding]
    widths = [((lead >> (2 * k)) & 3) + 1 for k in range(count)]  # bytes, of the fourth choice
    long = 1 + widths[0] + widths[1] + widths[2]
    after = places + np.select([choice == 0, choice == 1, choice == 2], [1, 2, 3], long)
    if not is_wanted:
        return after, []
    two, three = _word(data, places, 2), _word(data, places, 3)
    if encoding == TAG2_3S32:
        middle = [_signed((two >> (8 - 4 * k)) & 0xF, 4) for k in range(count)]
        wide = [_signed((three >> (16 - 8 * k)) & 0x3F, 6) for k in range(count)]
    else:
        middle = [_signed(two >> 9 & 0x1F, 5), _signed(two >> 4 & 0x1F, 5), _signed(two & 0xF, 4)]
        wide = [_signed(three >> 14 & 0xFF, 8), _signed(three >> 7 & 0x7F, 7), _signed(three & 0x7F, 7)]
    values, at = list[Ints](), places + 1
    for k in range(count):
        narrow = _signed((lead >> (4 - 2 * k)) & 3, 2)
        four = _word(data, at, 4, little=True) & ((np.int64(1) << (8 * widths[k])) - 1)
        full = _signed(four, 8 * widths[k])
        values.append(np.select([choice == 0, choice == 1, choice == 2], [narrow, middle[k], wide[k]], full))
        at = at + widths[k]
    return after, values


def _word(data: NDArray[np.uint8], places: Ints, count: int, *, little: bool = False) -> Ints:
    """Some bytes at each place as a number, the first one the highest or the lowest."""
    value = np.zeros(len(places), np.int64)
    for k in range(count):
        byte = data[np.minimum(places + k, len(data) - 1)].astype(np.int64)
        value |= byte << (8 * (k if little else count - 1 - k))
    return value
