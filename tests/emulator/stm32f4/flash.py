"""Flash memory (RM0090, 3): what it takes to erase and to program it, how long it stalls the core, and what a power cut leaves."""

import random

from .bus import Peripheral
from .core import FLASH_BASE
from .events import units

_ACR, _KEYR, _SR, _CR = 0x00, 0x04, 0x0C, 0x10
_PG, _SER, _MER, _STRT, _EOPIE, _ERRIE, _LOCK = 1, 2, 4, 1 << 16, 1 << 24, 1 << 25, 1 << 31
_EOP, _OPERR, _WRPERR, _PGAERR, _PGPERR, _PGSERR = 1, 2, 1 << 4, 1 << 5, 1 << 6, 1 << 7
_IRQ = 4
SECTORS = [(0x4000 * i, 0x4000) for i in range(4)] + [(0x1_0000, 0x1_0000)] + [(0x2_0000 * i, 0x2_0000) for i in range(1, 8)]


class PowerCut(Exception):
    """The supply went away in a flash operation; go on with `board.power_cycle()`."""


class Flash(Peripheral):
    """One bank: while it erases or programs, the core stands still.

    `erase_us` is for a sector of 16 KB (larger ones take in proportion, at most five times), `program_us` for one word.
    `cut_at`: the supply fails in this operation, counted from 0 with `operations`. `fail_at`: this operation ends with `fail_with`."""

    def __init__(self, board):
        super().__init__(board, "FLASH", 0x4002_3C00)
        self.content = board.core.flash
        self.erase_us, self.program_us = 400_000, 16
        self.operations = 0
        self.log = []  # (operation, 'erase' or 'program', sector or address)
        self.cut_at = self.fail_at = None
        self.fail_with = _WRPERR
        self.reset()

    def reset(self):
        self.regs = {}
        self.sr, self.cr, self.keys, self.key_error = 0, _LOCK, 0, False

    def read(self, offset):
        return {_SR: self.sr, _CR: self.cr}.get(offset, self.regs.get(offset, 0))

    def write(self, offset, value):
        if offset == _KEYR:
            wanted = (0x4567_0123, 0xCDEF_89AB)[self.keys]
            if value != wanted:
                self.key_error = True  # locked until the next reset
            elif self.keys == 0:
                self.keys = 1
            elif not self.key_error:
                self.keys = 0
                self.cr &= ~_LOCK
        elif offset == _SR:
            self.sr &= ~(value & 0xF3)
            self._lines()
        elif offset == _CR:
            if self.cr & _LOCK:
                self.board.bus.warn("FLASH_CR was written while it is locked")
                return
            self.cr = value & ~_STRT
            if value & _STRT:
                self.board.machine.later(self._erase)
        else:
            self.regs[offset] = value

    def _lines(self):
        self.board.nvic.set_line(_IRQ, bool(self.cr & _EOPIE and self.sr & _EOP or self.cr & _ERRIE and self.sr & 0xF2))

    def _begin(self, what, where):
        """Counts an operation; true if it is to fail."""
        number, self.operations = self.operations, self.operations + 1
        self.log.append((number, what, where))
        if self.fail_at == number:
            self.fail_at = None
            self.sr |= self.fail_with
            self._lines()
            return True
        return False

    def _cut(self):
        return self.cut_at is not None and self.operations - 1 == self.cut_at

    def _done(self, duration_us):
        if self.cr & _EOPIE:
            self.sr |= _EOP
        self.board.machine.freeze(self.board.machine.now + units(duration_us))
        self._lines()

    def _erase(self):
        if self.cr & _MER:
            self.board.bus.warn("mass erase is not modelled")
            return
        sector = self.cr >> 3 & 15
        if not self.cr & _SER or sector >= len(SECTORS):
            self.sr |= _PGSERR
            return
        if self._begin("erase", sector):
            return
        start, size = SECTORS[sector]
        if self._cut():
            # Half erased: every bit has either gone to one or kept its value.
            noise = random.Random(self.operations).randbytes(size)
            self.content[start:start + size] = bytes(a | b for a, b in zip(self.content[start:start + size], noise))
            self.board.cut_power(f"power cut while sector {sector} was erased")
        self.content[start:start + size] = b"\xff" * size
        self._forget_code(start, size)
        self._done(self.erase_us * min(size // 0x4000, 5))

    def stored(self, address, size, value):
        """The core stores into flash; the memory gets what programming makes of it once the store has ended."""
        start = address - FLASH_BASE
        old = bytes(self.content[start:start + size])
        self.board.machine.later(lambda: self._program(start, size, value, old))

    def _program(self, start, size, value, old):
        self.content[start:start + size] = old
        if self.cr & _LOCK or not self.cr & _PG:
            self.sr |= _PGSERR
            self.board.bus.warn(f"a store into flash at {FLASH_BASE + start:#010x} without PG set")
            return
        if size != 1 << (self.cr >> 8 & 3):
            self.sr |= _PGPERR
            return
        if start % size:
            self.sr |= _PGAERR
            return
        if self._begin("program", FLASH_BASE + start):
            return
        wanted = bytes(a & b for a, b in zip(old, value.to_bytes(size, "little")))
        if self._cut():
            # Each bit that was to be cleared has either made it or not.
            noise = random.Random(self.operations).randbytes(size)
            self.content[start:start + size] = bytes(w | o & n for w, o, n in zip(wanted, old, noise))
            self.board.cut_power(f"power cut while {FLASH_BASE + start:#010x} was programmed")
        self.content[start:start + size] = wanted
        self._forget_code(start, size)
        self._done(self.program_us)

    def _forget_code(self, start, size):
        if start + size > 0xC000:
            self.board.core.uc.ctl_flush_tb()
