"""Samples of light: what the converters gave at a border, and where the motors stood there, exactly."""

import math
import struct

import pytest

from lab import SEGMENT, STOP, ask, enable_all, errors, figure, power_up, start_moving
from light import CHANNELS, Positions
from stm32f4.core import SRAM_BASE

PLACES, PLACE = 16, 64
# played, counts, steps, taking up, moving (left out), sums (src/words/refill/border.rs)
SAMPLE = struct.Struct("<Q6i6iBxHH")


class Light:
    """A Gaussian peak over the counts of the motors, behind a linear and a logarithmic meter."""

    PEAK, WIDTH = (300, -200, 250, 150, -100, 120), 900

    def __init__(self, board):
        self.positions = Positions(board)

    def __call__(self, channel, word):
        way = sum((a - b) ** 2 for a, b in zip(self.positions.at(word), self.PEAK)) / self.WIDTH ** 2
        return round(4000 * math.exp(-way)) if channel == CHANNELS[0] else round(max(3500 - 400 * way, 0))


class Samples:
    """What the firmware sends up, read from its memory before it is written over."""

    def __init__(self, board):
        self.board = board
        (address,) = [address for name, address in board.image.symbols.items() if "refill5LIGHT" in name]
        self.at = address - SRAM_BASE
        self.taken, self.all = self._written(), []

    def _written(self):
        return int.from_bytes(self.board.core.sram[self.at + PLACES * PLACE:][:4], "little")

    def look(self):
        written = self._written()
        assert written - self.taken <= PLACES, "asked too late"
        for n in range(self.taken, written):
            place = self.at + n % PLACES * PLACE
            played, *rest = SAMPLE.unpack(self.board.core.sram[place:place + SAMPLE.size])
            self.all.append((played, rest[:6], rest[6:12], rest[12], tuple(rest[13:])))
        self.taken = written

    def run(self, us):
        """Lets the board live, and takes all samples."""
        while us > 0:
            self.board.run(min(8 * SEGMENT, us))
            us -= 8 * SEGMENT
            self.look()


@pytest.fixture
def board(firmware):
    board = power_up(firmware)
    enable_all(board, "AXIS1:LIM:HARD:POL HIGH;STAT ON")
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"


@pytest.fixture
def bench(board):
    """The board in the light, and its samples."""
    board.adc.light = Light(board)
    board.run(2 * SEGMENT)
    samples = Samples(board)
    return board, samples


def border_of(board, first, origin):
    """Word of the border that a sample names, while the stream runs that began with segment `origin` at word `first`."""
    return lambda played: first + (played - origin) * SEGMENT


def runs(board):
    """(first word, first segment) of each stretch of the stream: behind a stop follows the next segment."""
    out, origin = [], 0
    starts = [first for first, _, _ in board.words.runs]
    for first, after in zip(starts, starts[1:] + [None]):
        out.append((first, origin))
        if after is not None:
            origin += (after - first) // SEGMENT + 1
    return out


def check(board, samples, stretches=None):
    """Every sample says what was converted at its border, and the counts that the words give there."""
    board.sync_stream()
    assert samples.all
    converted = {word: codes for word, codes in board.adc.sequences if all(len(c) == 8 for c in codes)}
    positions = board.adc.light.positions
    stretches = stretches or runs(board)
    for played, counts, _, _, sums in samples.all:
        first, origin = [s for s in stretches if s[1] <= played][-1]
        word = first + (played - origin) * SEGMENT
        assert counts == positions.at(word), f"segment {played}"
        assert word in converted, f"segment {played}: nothing was triggered there"
        assert sums == tuple(map(sum, converted[word])), f"segment {played}"
        for codes, channel in zip(converted[word], CHANNELS):
            assert codes[0] == board.adc.light(channel, word) or codes[0] == board.adc.light(channel, word + 1)
    return [sample[0] for sample in samples.all]


def test_while_six_motors_turn_every_border_has_its_sample_with_exact_counts_and_both_inputs(bench):
    board, samples = bench
    board.serial.write("POSE 40,-30,35,0.05,-0.04,0.045\n")
    samples.run(300_000)
    numbers = check(board, samples)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), "none is missing"
    assert len(numbers) >= 300_000 // SEGMENT - 1
    apart = {tuple(counts) for _, counts, _, _, _ in samples.all}
    assert len(apart) > 200 and all(len({c[n] for c in apart}) > 100 for n in range(6)), "all six have moved"
    assert len({sums for *_, sums in samples.all}) > 150
    assert board.adc.ignored == 0
    figure(f"light: {len(numbers)} samples in a row with six motors turning, sums, counts and ticks exact")


def test_conversions_begin_with_the_border_and_take_twelve_microseconds_at_most(bench):
    board, samples = bench
    samples.run(20 * SEGMENT)
    board.sync_stream()
    first, origin = runs(board)[-1]
    assert all((word - first) % SEGMENT == 0 for word, _ in board.adc.sequences)
    channels = [board.adc._channels(n) for n in (0, 1)]
    assert channels == [[8] * 8, [9] * 8]
    us = sum(board.adc._sampling(0, c) + 12 for c in channels[0]) * board.adc._cycle / 672
    assert 5 < us <= 12
    figure(f"light: 8 conversions of both inputs at once within {us:.2f} us of a border")


@pytest.mark.parametrize("lost", (1, 2, 3, 5))
def test_a_lost_trigger_costs_its_sample_and_some_more_and_none_is_wrong(bench, lost):
    board, samples = bench
    board.serial.write("POSE 40,-30,35,0.05,-0.04,0.045\n")
    samples.run(60_000)
    board.adc.lose = lost
    samples.run(60_000)
    numbers = check(board, samples)
    missing = set(range(numbers[0], numbers[-1])) - set(numbers)
    assert lost <= len(missing) <= 2 * lost + 2, missing


def test_an_overrun_in_the_middle_of_a_sequence_is_recovered_from(bench):
    board, samples = bench
    board.serial.write("POSE 40,-30,35,0.05,-0.04,0.045\n")
    samples.run(60_000)
    for conversion in range(8):
        first, _ = runs(board)[-1]
        board.run_ticks(SEGMENT - (board.played() - first) % SEGMENT - 1, 1000)
        board.run(1.3 * conversion)
        before = samples.all[-1][0]
        board.adc.hold = 1
        samples.run(20 * SEGMENT)
        assert board.adc.hold == 0
        numbers = check(board, samples)
        missing = set(range(before, numbers[-1])) - set(numbers)
        assert 1 <= len(missing) <= 3, missing


def test_a_transfer_error_of_the_stream_is_recovered_from(bench):
    board, samples = bench
    samples.run(20 * SEGMENT)
    board.dma_error(4)
    samples.run(20 * SEGMENT)
    numbers = check(board, samples)
    missing = set(range(numbers[0], numbers[-1])) - set(numbers)
    assert 1 <= len(missing) <= 4 and numbers[-1] - numbers[0] > 35


@pytest.mark.parametrize("late_us", (3, 9, 30, 120, 200, 250, 300))
def test_a_refill_that_comes_late_gives_the_right_sample_or_none(bench, late_us):
    board, samples = bench
    board.serial.write("POSE 40,-30,35,0.05,-0.04,0.045\n")
    samples.run(60_000)
    for n in range(5):
        first, _ = runs(board)[-1]
        board.run_ticks(SEGMENT - (board.played() - first) % SEGMENT - 1, 1000)
        samples.look()
        board.mask_interrupts(late_us)
        samples.run(3000)
    numbers = check(board, samples)
    assert len(numbers) > 200
    errors(board)


@pytest.mark.parametrize("after", range(0, SEGMENT, 37))
def test_an_abort_in_mid_segment_leaves_no_sample_with_wrong_counts(bench, after):
    board, samples = bench
    start_moving(board, "AXIS1:MOVE 200", 60)
    samples.taken, samples.all = samples._written(), []
    board.run(after)
    board.serial.write("!\n" if after % 2 else "ABOR\n")
    samples.run(20_000)
    assert len(board.words.runs) > 1
    numbers = check(board, samples)
    assert len(set(numbers)) == len(numbers)


def test_an_emergency_stop_ends_the_samples_and_arming_begins_them_anew_with_exact_counts(bench):
    board, samples = bench
    start_moving(board, "AXIS1:MOVE 200", 60)
    samples.taken, samples.all = samples._written(), []
    board.pin(*STOP, 0)
    samples.run(5000)
    before = len(samples.all)
    samples.run(5000)
    assert len(samples.all) == before, "no border, no sample"
    assert errors(board) == [103]
    board.pin(*STOP, 1)
    board.run(3000)
    assert ask(board, "SYST:EST:CLE;*OPC?") == "1"
    samples.run(10_000)
    board.serial.write("AXIS1:MOVE 5\n")
    samples.run(100_000)
    numbers = check(board, samples)
    assert len(numbers) > before + 350


def test_a_pause_for_saving_ends_the_samples_and_they_go_on_with_exact_counts(bench):
    board, samples = bench
    board.serial.write("AXIS1:MOVE 20\n")
    assert ask(board, "*OPC?") == "1"
    samples.taken, samples.all = samples._written(), []
    samples.run(3000)
    board.serial.write("*SAV\n")
    samples.run(60_000)
    assert len(board.words.runs) == 2, "the stream stood meanwhile"
    board.serial.write("AXIS1:MOVE 40\n")
    samples.run(50_000)
    stretches = [s for s in board.words.runs]
    # a pause is at standstill: what was made ahead and not played is silence that is left out
    (one, two) = [first for first, _, _ in stretches]
    numbers = [sample[0] for sample in samples.all]
    jump = next(n for n, (a, b) in enumerate(zip(numbers, numbers[1:])) if b - a > 1)
    origin = (two - one) // SEGMENT + 3
    assert numbers[jump + 1] > origin
    check(board, samples, [(one, 0), (two, origin)])
    assert errors(board) == []
