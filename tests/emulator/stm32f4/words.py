"""The record of all words that DMA wrote to the port of the motors, one per tick."""

from array import array
from bisect import bisect_right

from .events import UNITS_PER_US

TRIGGER_PIN = 2
STEP_PINS = (6, 14, 5, 13, 7, 15)
DIR_PINS = (4, 8, 9, 10, 11, 12)


class Words:
    """A sequence of 32-bit words. Long stretches of one word cost nothing.

    `runs` lists the stretches that played without a break as (first index, time of it in units, units per tick)."""

    def __init__(self):
        self._starts, self._chunks, self._length = [], [], 0
        self.runs = []
        self._next_time = None

    def append(self, data, time, step):
        """Adds the words in `data` (bytes, little endian), the first at `time`, `step` units apart."""
        count = len(data) >> 2
        if time != self._next_time or self.runs[-1][2] != step:
            if count == 1 and self.runs and self.runs[-1][0] == self._length - 1:
                step = self.runs[-1][2]  # a run of single words, each served on its own
            self.runs.append((self._length, time, step))
        self._next_time = time + count * step
        first = data[:4]
        if data == first * count:
            last = self._chunks[-1] if self._chunks else None
            if isinstance(last, list) and last[0] == first:
                last[1] += count
            else:
                self._starts.append(self._length)
                self._chunks.append([first, count])
        else:
            last = self._chunks[-1] if self._chunks else None
            if isinstance(last, bytearray) and len(last) < 65536:
                last += data
            else:
                self._starts.append(self._length)
                self._chunks.append(bytearray(data))
        self._length += count

    def __len__(self):
        return self._length

    def _pieces(self, start, stop):
        """(first index, chunk, from, to) of the chunks between two indices."""
        i = max(bisect_right(self._starts, start) - 1, 0)
        while i < len(self._chunks) and self._starts[i] < stop:
            chunk, base = self._chunks[i], self._starts[i]
            length = chunk[1] if isinstance(chunk, list) else len(chunk) >> 2
            low, high = max(start - base, 0), min(stop - base, length)
            if low < high:
                yield base + low, chunk, low, high
            i += 1

    def slice(self, start=0, stop=None):
        """The words from `start` to before `stop` as an array of unsigned 32-bit numbers."""
        out = array("I")
        for _, chunk, low, high in self._pieces(start, self._length if stop is None else stop):
            out.frombytes(bytes(chunk[0]) * (high - low) if isinstance(chunk, list) else bytes(chunk[4 * low:4 * high]))
        return out

    def __getitem__(self, index):
        if isinstance(index, slice):
            start, stop, stride = index.indices(self._length)
            return self.slice(start, stop)[::stride]
        if index < 0:
            index += self._length
        if not 0 <= index < self._length:
            raise IndexError(f"word {index} of {self._length}")
        return self.slice(index, index + 1)[0]

    def fold(self, odr, start):
        """The output register after the words from `start` on, when it was `odr` before them."""
        for _, chunk, low, high in self._pieces(start, self._length):
            words = (int.from_bytes(chunk[0], "little"),) if isinstance(chunk, list) else array("I", bytes(chunk[4 * low:4 * high]))
            for word in words:
                odr = odr & ~(word >> 16) | word & 0xFFFF
        return odr

    def changes(self, start=0, stop=None):
        """(index, word) wherever a word differs from the one before it, in order, and the first."""
        previous = None
        for base, chunk, low, high in self._pieces(start, self._length if stop is None else stop):
            words = (int.from_bytes(chunk[0], "little"),) if isinstance(chunk, list) else array("I", bytes(chunk[4 * low:4 * high]))
            for i, word in enumerate(words):
                if word != previous:
                    yield base + i, word
                    previous = word

    def first_set(self, start=0):
        """Index of the first word from `start` on that sets a STEP pin, None if there is none."""
        mask = sum(1 << pin for pin in STEP_PINS)
        for index, word in self.changes(start):
            if word & mask:
                return index
        return None

    def time_us(self, index):
        """When a word reached the pins."""
        first, time, step = self.runs[bisect_right(self.runs, index, key=lambda run: run[0]) - 1]
        return (time + (index - first) * step) / UNITS_PER_US

    def played_at(self, time):
        """Words that had reached the pins at a time in units, that of the time itself included."""
        at = bisect_right(self.runs, time, key=lambda run: run[1]) - 1
        if at < 0:
            return 0
        first, begin, step = self.runs[at]
        end = self.runs[at + 1][0] if at + 1 < len(self.runs) else self._length
        return min(first + 1 + ((time - begin) // step if step else 0), end)

    def steps(self, start=0, stop=None):
        """Rising edges of STEP as (index, motor 0 to 5, +1 or -1), in order. +1: DIR is high."""
        odr, out = 0, []
        if start:
            odr = self.fold_to(start)
        every = [(1 << s, 1 << d) for s, d in zip(STEP_PINS, DIR_PINS)]
        mask = sum(s for s, _ in every)
        for base, chunk, low, high in self._pieces(start, self._length if stop is None else stop):
            words = (int.from_bytes(chunk[0], "little"),) if isinstance(chunk, list) else array("I", bytes(chunk[4 * low:4 * high]))
            for i, word in enumerate(words):
                after = odr & ~(word >> 16) | word & 0xFFFF
                rising = after & ~odr & mask
                odr = after
                if rising:
                    for motor, (step, direction) in enumerate(every):
                        if rising & step:
                            out.append((base + i, motor, 1 if odr & direction else -1))
        return out

    def fold_to(self, index):
        """The output register after the first `index` words, from all low."""
        odr = 0
        for word in self.slice(0, index):
            odr = odr & ~(word >> 16) | word & 0xFFFF
        return odr

    def position(self, start=0, stop=None):
        """Steps of each motor, signed, between two indices."""
        out = [0] * len(STEP_PINS)
        for _, motor, sign in self.steps(start, stop):
            out[motor] += sign
        return out
