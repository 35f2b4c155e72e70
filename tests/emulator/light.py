"""Light that depends on the motor counts alone, in integers: the same as `host-sim trace --light` computes."""

from lab import QUIET, SEGMENT, STEP_MASK
from stm32f4.words import DIR_PINS, STEP_PINS

FULL_SCALE, FALL_SHIFT = 32760, 20
CHANNELS = (8, 9)


class Positions:
    """Counts of the motors after any number of words; asked for in any order."""

    EVERY = SEGMENT

    def __init__(self, board):
        self.words, self.kept, self.odr = board.words, [[0] * 6], [0]
        self.cache = {}

    def _go(self, counts, odr, start, stop):
        words = self.words.slice(start, stop)
        if words.count(QUIET) == len(words):
            return counts, odr & ~STEP_MASK if len(words) else odr
        counts = list(counts)
        for word in words:
            after = odr & ~(word >> 16) | word & 0xFFFF
            rising, odr = after & ~odr & STEP_MASK, after
            if rising:
                for n, step in enumerate(STEP_PINS):
                    if rising >> step & 1:
                        counts[n] += 1 if odr >> DIR_PINS[n] & 1 else -1
        return counts, odr

    def at(self, word):
        if word not in self.cache:
            while len(self.kept) <= word // self.EVERY:
                start = (len(self.kept) - 1) * self.EVERY
                counts, odr = self._go(self.kept[-1], self.odr[-1], start, start + self.EVERY)
                self.kept.append(counts)
                self.odr.append(odr)
            place = word // self.EVERY
            self.cache[word] = self._go(self.kept[place], self.odr[place], place * self.EVERY, word)[0]
        return self.cache[word]


class Spot:
    """What one input sees: `top` at the counts `at`, less `fall` / 2^20 times the square of the way from there."""

    def __init__(self, top, at, fall):
        self.top, self.at, self.fall = top, at, fall

    def sum(self, counts):
        less = sum(fall * (count - at) ** 2 for count, at, fall in zip(counts, self.at, self.fall)) >> FALL_SHIFT
        return min(max(self.top - less, 0), FULL_SCALE)

    def toml(self):
        return f"[[input]]\ntop = {self.top}\nat = {self.at}\nfall = {self.fall}\n"


class Light:
    """For `board.adc.light`: the eight conversions of a border add up to the sum of the spot at the counts there."""

    def __init__(self, board, spots):
        self.board, self.spots, self.positions = board, spots, Positions(board)
        self.border, self.sums = None, None

    def __call__(self, channel, word):
        border, made = self.board.adc.sequences[-1]
        if border != self.border:
            counts = self.positions.at(border)
            self.border, self.sums = border, [spot.sum(counts) for spot in self.spots]
        # (x + n) // 8 for n from 0 to 7 are together x
        return (self.sums[CHANNELS.index(channel)] + len(made[0])) // 8
