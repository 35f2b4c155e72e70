"""What is counted while the board runs."""

from collections import Counter, defaultdict

from .events import UNITS_PER_US

TIM2_EXCEPTION = 16 + 28


class Stats:
    """Per exception number: entries, own instructions (without those of handlers that interrupt it), the most in one entry."""

    def __init__(self, board):
        self.board = board
        self.clear()

    def clear(self):
        self.entries = Counter()
        self.instructions = Counter()
        self.longest = Counter()
        self.longest_us = defaultdict(float)
        self.refill_latency_us = Counter()  # TIM2: from the tick that asked for it to the handler, by tenths of a microsecond
        self.faults = []  # (exception, address of the instruction, address of the access)
        self._stack = []  # [number, instructions so far, count at the last resumption, time of entry]
        self._thread = 0

    def interrupted(self, count):
        if self._stack:
            top = self._stack[-1]
            top[1] += count - top[2]

    def entered(self, number, now, count):
        self.entries[number] += 1
        self._stack.append([number, 0, count, now])
        if number == TIM2_EXCEPTION:
            self._note_refill(now)

    def _note_refill(self, now):
        board = self.board
        board.sync_stream()
        counter, clock = board.tim2, board.tim8
        late = (counter.cnt - counter.ccr[0]) & 0xFFFF_FFFF
        if counter.sr & 2 and late < 1 << 31:
            tick = clock.tick * (clock.arr + 1)
            since = late * tick + now - clock.ref + clock.cnt * clock.tick
            self.refill_latency_us[round(since / UNITS_PER_US, 1)] += 1

    def left(self, number, now, count):
        if not self._stack:
            return
        number, so_far, since, entry = self._stack.pop()
        own = so_far + count - since
        self.instructions[number] += own
        self.longest[number] = max(self.longest[number], own)
        self.longest_us[number] = max(self.longest_us[number], (now - entry) / UNITS_PER_US)
        if self._stack:
            self._stack[-1][2] = count

    def restarted(self):
        self._stack = []

    def fault(self, number, pc, address):
        self.faults.append((number, pc, address))

    def irq_instructions(self, irq):
        """Instructions spent in the handler of an interrupt number."""
        return self.instructions[16 + irq]

    def irq_entries(self, irq):
        return self.entries[16 + irq]
