"""Ports, the levels of their pins, and the external interrupts that watch them (RM0090, 8, 9 and 12)."""

from .bus import Peripheral

_MODER, _OTYPER, _PUPDR, _IDR, _ODR, _BSRR, _AFRL, _AFRH = 0x00, 0x04, 0x0C, 0x10, 0x14, 0x18, 0x20, 0x24
_RESET = {"A": {_MODER: 0xA800_0000, _PUPDR: 0x6400_0000}, "B": {_MODER: 0x0000_0280, _PUPDR: 0x0000_0100}}
INPUT, OUTPUT, ALTERNATE, ANALOG = range(4)


class Port(Peripheral):
    """One port. A pin that nobody drives follows its pull resistor; floating reads low."""

    def __init__(self, board, letter):
        self.index = "ABCDEFGHI".index(letter)
        super().__init__(board, f"GPIO{letter}", 0x4002_0000 + 0x400 * self.index)
        self.letter = letter
        self.clock = (0x30, self.index)
        self.driven, self.external = 0, 0
        self.watchers = []  # called with (changed, levels)
        self.stream = None  # words that DMA writes here, counted into ODR when somebody looks
        self._folded = 0
        self.odr, self.levels = 0, 0
        self.writes = []  # (time in us, register, value) of the core's stores to BSRR and ODR
        self.reset()

    def reset(self):
        self.regs = dict(_RESET.get(self.letter, {}))
        self.fold()
        self.odr = 0
        self.settle()

    def fold(self):
        """Brings ODR up to the last word of the stream."""
        if self.stream is not None and len(self.stream) > self._folded:
            self.odr = self.stream.fold(self.odr, self._folded)
            self._folded = len(self.stream)

    def _catch_up(self):
        if self.stream is not None:
            self.board.sync_stream()
            self.fold()

    def mode(self, pin):
        return self.regs.get(_MODER, 0) >> 2 * pin & 3

    def alternate(self, pin):
        return self.regs.get(_AFRH if pin >= 8 else _AFRL, 0) >> 4 * (pin & 7) & 15

    def drive(self, pin, level):
        """From outside: 0, 1, or None for an open contact."""
        bit = 1 << pin
        self.driven = self.driven & ~bit if level is None else self.driven | bit
        self.external = self.external | bit if level else self.external & ~bit
        self.settle()

    def level(self, pin):
        """What a meter at the pin shows."""
        self._catch_up()
        self.settle()
        return self.levels >> pin & 1

    def settle(self):
        moder, pupdr, otyper = self.regs.get(_MODER, 0), self.regs.get(_PUPDR, 0), self.regs.get(_OTYPER, 0)
        outputs = sum(1 << i for i in range(16) if moder >> 2 * i & 3 == OUTPUT)
        analog = sum(1 << i for i in range(16) if moder >> 2 * i & 3 == ANALOG)
        ups = sum(1 << i for i in range(16) if pupdr >> 2 * i & 3 == 1)
        outside = self.external & self.driven | ups & ~self.driven
        high = outputs & self.odr
        released = outputs & otyper & self.odr  # open drain, high: whoever else drives decides
        levels = (outside & ~outputs | high & ~released | outside & released) & ~analog & 0xFFFF
        changed, self.levels = levels ^ self.levels, levels
        if changed:
            self.board.exti.levels_changed(self.index, changed, levels)
            for watcher in self.watchers:
                watcher(changed, levels)

    def read(self, offset):
        if offset in (_IDR, _ODR):
            if self.stream is not None:
                self._catch_up()
                self.settle()
            return self.odr if offset == _ODR else self.levels
        return self.regs.get(offset, 0)

    def other_bytes(self, offset):
        return 0 if offset == _BSRR else self.read(offset)

    def write(self, offset, value):
        if offset in (_BSRR, _ODR):
            self._catch_up()
            self.writes.append((self.board.machine.now_us, "BSRR" if offset == _BSRR else "ODR", value))
            self.odr = self.odr & ~(value >> 16) | value & 0xFFFF if offset == _BSRR else value & 0xFFFF
        elif offset != _IDR:
            self.regs[offset] = value
        self.settle()
        if offset in (_MODER, _AFRL, _AFRH):
            for watcher in self.watchers:
                watcher(0xFFFF, self.levels)


class Syscfg(Peripheral):
    """Which port an EXTI line watches."""

    clock = (0x44, 14)

    def __init__(self, board):
        super().__init__(board, "SYSCFG", 0x4001_3800)

    def port_of(self, line):
        return self.regs.get(8 + 4 * (line // 4), 0) >> 4 * (line % 4) & 15


class Exti(Peripheral):
    """Edges of pins (lines 0 to 15) and software events."""

    _IMR, _EMR, _RTSR, _FTSR, _SWIER, _PR = 0, 4, 8, 12, 16, 20
    _IRQS = [(6 + i, 1 << i) for i in range(5)] + [(23, 0x03E0), (40, 0xFC00)]

    def __init__(self, board):
        super().__init__(board, "EXTI", 0x4001_3C00)
        self.pending = 0

    def reset(self):
        self.regs, self.pending = {}, 0

    def levels_changed(self, port, changed, levels):
        if changed >> 16:
            changed &= 0xFFFF
        edges = changed & levels & self.regs.get(self._RTSR, 0) | changed & ~levels & self.regs.get(self._FTSR, 0)
        for line in range(16):
            if edges >> line & 1 and self.board.syscfg.port_of(line) == port:
                self._trigger(1 << line)

    def _trigger(self, bits):
        self.pending |= bits
        if bits & self.regs.get(self._EMR, 0):
            self.board.core.state.event = 1
            self.board.machine.attend()
        self._lines()

    def _lines(self):
        active = self.pending & self.regs.get(self._IMR, 0)
        for irq, mask in self._IRQS:
            self.board.nvic.set_line(irq, bool(active & mask))

    def read(self, offset):
        return self.pending if offset == self._PR else self.regs.get(offset, 0)

    def write(self, offset, value):
        if offset == self._PR:
            self.pending &= ~value
            self.regs[self._SWIER] = self.regs.get(self._SWIER, 0) & ~value
        elif offset == self._SWIER:
            rising = value & ~self.regs.get(offset, 0)
            self.regs[offset] = value
            self.pending |= rising & self.regs.get(self._IMR, 0)
        else:
            self.regs[offset] = value
        self._lines()
