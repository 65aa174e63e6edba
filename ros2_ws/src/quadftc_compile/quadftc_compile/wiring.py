# pyright: basic
"""Several compiled laws flown together for a stretch of samples, in C.

A `quadftc_model.composition.Composition` is run once with tokens for its values. Its calls of
laws and moves of values become a list of instructions. A small function in C repeats them sample by sample.
So nothing is compiled but the laws, which nodes and closed loop share.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from quadftc_compile import cache
from quadftc_compile.build import BuildError, Library, cache_key, compile_c
from quadftc_compile.engine import CEngine
from quadftc_compile.fingerprint import Compiler, fingerprint
from quadftc_compile.layout import Layout, layout_of, leaves_of, unflatten
from quadftc_compile.memory import Memory, Rows
from quadftc_compile.runner import numbers_in, write_numbers
from quadftc_model.arrays import alike
from quadftc_model.composition import Composition, PlainCalls, RunnerCalls
from quadftc_model.stepper import Engine

T = TypeVar("T")

BLOCK = 2048  # samples that are flown in one call
CALL, COPY, SKIP = range(3)
INSTRUCTION = np.dtype([("kind", "i8"), ("first", "i8"), ("last", "i8")])
CALLED = np.dtype(
    [(name, "i8") for name in ("init", "step", "numbers", "one", "other", "inputs", "dt", "output", "now")]
)
COPIED = np.dtype([(name, "i8") for name in ("to", "to_stride", "from", "from_stride", "bytes")])
HEADER = """\
#include <stdint.h>

typedef struct {
    int64_t kind, first, last;
} instruction;

typedef struct {
    void (*init)(const void *numbers, const void *inputs, void *after);
    void (*step)(const void *numbers, const void *before, const void *inputs, const double *dt,
                 void *after, void *output);
    const void *numbers;
    void *states[2];
    const void *inputs;
    const double *dt;
    void *output;
    int64_t now; /* which of the states is that of now */
} call;

typedef struct {
    char *to;
    int64_t to_stride; /* bytes to the next sample */
    const char *from;
    int64_t from_stride;
    int64_t bytes;
} copy;

void conduct(const instruction *instructions, int64_t count, call *calls, const copy *copies,
             int64_t samples);
"""
SOURCE = """\
#include <string.h>

/* Repeat instructions for each sample: 0 call a law, 1 copy, 2 go on at `last` unless a flag holds. */
void conduct(const instruction *instructions, int64_t count, call *calls, const copy *copies,
             int64_t samples)
{
    for (int64_t sample = 0; sample < samples; sample++) {
        for (int64_t k = 0; k < count; k++) {
            const int64_t first = instructions[k].first, last = instructions[k].last;
            if (instructions[k].kind == 0) {
                call *law = &calls[first];
                if (*law->dt == 0.0) law->init(law->numbers, law->inputs, law->states[law->now]);
                law->step(law->numbers, law->states[law->now], law->inputs, law->dt, law->states[!law->now],
                          law->output);
                law->now = !law->now;
            } else if (instructions[k].kind == 1) {
                for (int64_t n = first; n < last; n++) {
                    char *to = copies[n].to + sample * copies[n].to_stride;
                    const char *from = copies[n].from + sample * copies[n].from_stride;
                    switch (copies[n].bytes) { /* the usual sizes without a call */
                    case 1: *to = *from; break;
                    case 8: memcpy(to, from, 8); break;
                    case 24: memcpy(to, from, 24); break;
                    case 32: memcpy(to, from, 32); break;
                    default: memcpy(to, from, (size_t)copies[n].bytes);
                    }
                }
            } else if (!copies[first].from[sample * copies[first].from_stride]) {
                k = last - 1;
            }
        }
    }
}
"""


CONDUCTOR = fingerprint("conductor", HEADER, SOURCE)  # its key


@functools.cache
def conductor() -> Callable[[int, int, int, int, int], None]:
    """Return the function that repeats instructions; BuildError if it cannot be compiled."""
    function = _conductor().conduct
    pointer, number = ctypes.c_void_p, ctypes.c_int64
    function.argtypes, function.restype = [pointer, number, pointer, pointer, number], None
    return function


def compile_conductor(cc: Compiler | None = None) -> bytes:
    """Return the library of the conductor; ``cc`` as in `compile_c`."""
    return compile_c("conductor", HEADER, SOURCE, cc)


def _conductor() -> ctypes.CDLL:
    with contextlib.suppress(OSError):
        if (carried := cache.load_carried(CONDUCTOR)) is not None:
            return ctypes.CDLL(str(carried[0]))
    key = cache_key(CONDUCTOR)
    try:
        found = cache.load_entry(key)
        return ctypes.CDLL(
            str(cache.store_entry(key, compile_conductor(), {}) if found is None else found[0])
        )
    except OSError:
        with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
            path = Path(folder) / "conductor.so"
            path.write_bytes(compile_conductor())
            return ctypes.CDLL(str(path))


@dataclasses.dataclass(frozen=True)
class Token:
    """An array that lies somewhere; a composition can only pass it on."""

    address: int
    stride: int  # bytes to that of the next sample; 0: it lies there at every sample
    dtype: np.dtype
    shape: tuple[int, ...]

    @property
    def bytes(self) -> int:
        """How many bytes it has."""
        return int(np.prod(self.shape, dtype=int)) * self.dtype.itemsize

    def __bool__(self) -> bool:
        raise TypeError("a composition of laws cannot decide by a value: use `calls.branch`")


@dataclasses.dataclass(frozen=True)
class StateToken:
    """The state of a law."""

    name: str


class Flown(Protocol):
    """A composition that flies one vehicle."""

    def begin(self) -> None:
        """Go to the begin of a flight."""
        ...

    def configure(self, composition: Composition) -> None:
        """Go to the begin of a flight of a composition of the same structure."""
        ...

    def run(self, inputs: object, count: int) -> Any:
        """Fly ``count`` samples, at most a `BLOCK`; inputs and outputs are arrays (count, ...)."""
        ...

    def state_of(self, name: str) -> Any:
        """Return the state of a law at the last sample."""
        ...


def flown_by(engine: Engine, composition: Composition, inputs: object) -> Flown:
    """Return what flies a composition, for inputs like an example: in C, if all its laws can be compiled."""
    libraries = engine.libraries(composition.laws) if isinstance(engine, CEngine) else None
    if libraries is None or not _can_conduct():
        return OneByOne(composition, engine, inputs)
    return Wiring(composition, libraries, inputs)


def _can_conduct() -> bool:
    try:
        return conductor() is not None
    except BuildError:  # laws that a wheel carries, and neither conductor nor compiler
        return False


class OneByOne:
    """A composition whose laws are called one by one, sample by sample."""

    def __init__(self, composition: Composition, engine: Engine, inputs: object) -> None:
        self._engine, self._layout = engine, layout_of(inputs)
        self.configure(composition)

    def begin(self) -> None:
        """Go to the begin of a flight."""
        self._state = self._composition.init(self._calls)

    def configure(self, composition: Composition) -> None:
        """Go to the begin of a flight of another composition."""
        self._composition, self._calls = composition, RunnerCalls(composition.laws, self._engine)
        self.begin()

    def run(self, inputs: object, count: int) -> Any:
        """Fly ``count`` samples; inputs and outputs are arrays (count, ...)."""
        given, made = Rows(self._layout, count), None
        given.write(inputs)
        for row in range(count):
            self._state, output = self._composition.step(self._calls, self._state, given.row(row))
            made = made or Rows(layout_of(output), count)
            made.write_row(row, output)
        return None if made is None else made.view()

    def state_of(self, name: str) -> Any:
        """Return the state of a law at the last sample."""
        return self._calls.state_of(name)


class Wiring:
    """A composition of compiled laws for one vehicle."""

    def __init__(
        self, composition: Composition, libraries: Mapping[str, Library], inputs: object, block: int = BLOCK
    ) -> None:
        """Wire laws for inputs like an example; ValueError if the composition does more than move values."""
        self._composition, self._libraries, self._block = composition, libraries, block
        self._held: list[object] = []  # memory that instructions point to
        self._instructions: list[tuple[int, int, int]] = []
        self._copies: list[tuple[int, int, int, int, int]] = []
        self._calls: list[tuple[int, ...]] = []
        self._laws: dict[str, _Law] = {}
        self._called_laws: set[str] = set()
        self._memories: dict[Token, Memory] = {}  # of constants, and of what goes from sample to sample
        kept = self._kept = self._keep(composition.init(self))
        given = Rows(layout_of(inputs), block)
        after, output = composition.step(self, kept, _tokens(given.layout, given.address, given.size))
        made = Rows(self._layout(output), block)
        self._move(output, _tokens(made.layout, made.address, made.size))
        settled = self._keep_like(after)  # what becomes of a value may need another as it was
        self._move(after, settled)
        self._move(settled, kept)
        self._given, self._made = given, made
        self._program = np.array(self._instructions, INSTRUCTION)
        self._called, self._copied = np.array(self._calls, CALLED), np.array(self._copies, COPIED)
        self.begin()

    def begin(self) -> None:
        """Go to the begin of a flight."""
        with np.errstate(all="ignore"):
            state = self._composition.init(PlainCalls(self._composition.laws))
        for value, place in _pairs(state, self._kept):
            is_state = isinstance(place, StateToken)
            memory = self._laws[place.name].states[0] if is_state else self._memories[place]
            memory.write(value)
        self._called["now"] = 0

    def configure(self, composition: Composition) -> None:
        """Go to the begin of a flight of a composition of the same structure, with numbers of its own.

        What its step gives to laws as constants must not depend on numbers.
        """
        self._composition, laws = composition, composition.laws
        for name, law in self._laws.items():
            write_numbers(self._libraries[name], laws[name], law.numbers)
        self.begin()

    def state_of(self, name: str) -> Any:
        """Return the state of a law at the last sample."""
        law = self._laws[name]
        return law.states[int(self._called["now"][law.number])].read()

    def run(self, inputs: object, count: int) -> Any:
        """Fly ``count`` samples, at most a block; inputs and outputs are arrays (count, ...).

        Outputs are views, which the next call changes.
        """
        if not 0 <= count <= self._block:
            raise ValueError(f"count = {count}: expected at most {self._block} samples")
        self._given.write(inputs, count)
        conductor()(
            self._program.ctypes.data,
            len(self._program),
            self._called.ctypes.data,
            self._copied.ctypes.data,
            count,
        )
        return self._made.view(count)

    # -- what a composition calls ------------------------------------------------------------------------

    def init(self, name: str) -> StateToken:
        """Give a law its memory."""
        law, library = self._composition.laws[name], self._libraries[name]
        entry, init = library.entries["step"], library.entries["init"]
        places = {key: Memory(layout) for key, layout in {**entry.arguments, **entry.results}.items()}
        numbers = numbers_in(library, law)
        self._held += [numbers, *places.values(), library]
        functions = (ctypes.cast(each.call, ctypes.c_void_p).value or 0 for each in (init, entry))
        order = (numbers, *(places[key] for key in ("before", "after", "inputs", "dt", "output")))
        inputs, dt, output = (
            _tokens(places[key].layout, places[key].address, 0) for key in ("inputs", "dt", "output")
        )
        states = (places["before"], places["after"])
        self._laws[name] = _Law(len(self._calls), numbers, states, inputs, dt, output)
        self._calls.append((*functions, *(each.address for each in order), 0))
        return StateToken(name)

    def step(self, name: str, state: object, inputs: object, dt: object) -> tuple[object, Any]:
        """Note the call of a law."""
        if name not in self._laws and state == ():
            state = self.init(name)
        law = self._laws[name]
        if state != StateToken(name):
            raise ValueError(f"{name}: expected its own state")
        if name in self._called_laws:
            raise ValueError(f"{name}: called twice at a sample")
        self._called_laws.add(name)
        self._move((inputs, dt), (law.inputs, law.dt), constants_stay=True)
        self._instructions.append((CALL, law.number, 0))
        return state, law.output

    def branch(self, flag: object, then: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """Note what is done where a flag holds."""
        if not isinstance(flag, Token):  # it is known
            return then() if flag else otherwise()
        at, others = len(self._instructions), otherwise()
        if len(self._instructions) != at:
            raise ValueError("a composition of laws cannot call them where a flag does not hold")
        chosen = self._keep_like(others)
        self._move(others, chosen)
        skip = len(self._instructions)
        self._instructions.append((SKIP, len(self._copies), 0))
        self._copies.append((0, 0, flag.address, flag.stride, 0))
        self._move(then(), chosen)
        self._instructions[skip] = (SKIP, self._instructions[skip][1], len(self._instructions))
        return chosen

    # -- memory ------------------------------------------------------------------------------------------

    def _keep(self, state: object) -> object:
        """Return tokens for a state."""
        if isinstance(state, tuple):
            return alike(state, [self._keep(each) for each in state])
        return state if state is None or isinstance(state, StateToken) else self._constant(state)

    def _constant(self, value: object) -> Token:
        memory, array = Memory(layout_of(value)), np.asarray(value)
        memory.write(value)
        token = Token(memory.address, 0, array.dtype, array.shape)
        self._memories[token] = memory
        return token

    def _keep_like(self, tree: Any) -> Any:
        """Return tokens of new memory, as large as what is in a tree; states stay themselves."""
        if isinstance(tree, tuple):
            return alike(tree, [self._keep_like(each) for each in tree])
        if tree is None or isinstance(tree, StateToken):
            return tree
        array = tree if isinstance(tree, Token) else np.asarray(tree)
        return self._constant(np.zeros(array.shape, array.dtype))

    def _layout(self, tree: object) -> Layout:
        if isinstance(tree, Token):
            return ["array", tree.dtype.str[1:], list(tree.shape)]
        if isinstance(tree, tuple):
            layout = layout_of(alike(tree, [None] * len(tree)))
            return [
                "tuple",
                layout[1],
                [[n, self._layout(e)] for (n, _), e in zip(layout[2], tree, strict=True)],
            ]
        return layout_of(tree)

    # -- moves -------------------------------------------------------------------------------------------

    def _move(self, source: object, target: object, constants_stay: bool = False) -> None:
        """Note moves of values; constants are moved at every sample, or now, if they stay where they are."""
        begin = len(self._copies)
        for value, place in _pairs(source, target):
            if isinstance(value, StateToken) or isinstance(place, StateToken):
                if value != place:
                    raise ValueError(f"{value}, {place}: the state of one law cannot become that of another")
                continue
            token = value if isinstance(value, Token) else self._constant(value)
            if token.shape != place.shape or token.dtype != place.dtype:
                raise ValueError(f"{token.dtype} {token.shape}: expected {place.dtype} {place.shape}")
            if not token.bytes:
                continue
            if constants_stay and token is not value:
                ctypes.memmove(place.address, token.address, token.bytes)
            elif token != place:
                self._note(token, place, begin)
        if len(self._copies) > begin:
            self._instructions.append((COPY, begin, len(self._copies)))

    def _note(self, value: Token, place: Token, begin: int) -> None:
        """Note a move; one together with that before where both places lie side by side."""
        copied = (place.address, place.stride, value.address, value.stride, value.bytes)
        if len(self._copies) > begin:
            to, to_stride, source, stride, size = self._copies[-1]
            gap = place.address - to
            alike = (to_stride, stride, gap) == (place.stride, value.stride, value.address - source)
            if alike and size <= gap < size + 8:
                self._copies[-1] = (to, to_stride, source, stride, gap + value.bytes)
                return
        self._copies.append(copied)


@dataclasses.dataclass(frozen=True)
class _Law:
    number: int
    numbers: Memory
    states: tuple[Memory, Memory]
    inputs: object  # tokens
    dt: object
    output: object


def _tokens(layout: Layout, address: int, stride: int) -> Any:
    """Return tokens for the arrays of a struct."""
    found = [Token(address + leaf.offset, stride, leaf.dtype, leaf.shape) for leaf in leaves_of(layout)]
    return unflatten(layout, iter(found))


def _pairs(source: object, target: object) -> Iterator[tuple[Any, Any]]:
    """Yield the arrays of two nested tuples alike; ValueError if they are not."""
    if isinstance(target, tuple):
        if not isinstance(source, tuple) or len(source) != len(target):
            raise ValueError(f"{type(source).__name__}: expected {type(target).__name__}")
        for a, b in zip(source, target, strict=True):
            yield from _pairs(a, b)
    elif target is None or source is None:
        if source is not target:
            raise ValueError(f"{source!r}: expected {target!r}")
    else:
        yield source, target
