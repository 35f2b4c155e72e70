"""What a debugger and the program share: DBGMCU's freeze bits and the cycle counter of the DWT."""

from .bus import Peripheral


# (register, bit) of what a halted core can stop.
_FREEZE = {
    "TIM2": (8, 0), "TIM3": (8, 1), "TIM4": (8, 2), "TIM5": (8, 3), "IWDG": (8, 12), "TIM1": (12, 0), "TIM8": (12, 1),
}


class Dbgmcu(Peripheral):
    """Only a power-on reset clears it."""

    def __init__(self, board):
        super().__init__(board, "DBGMCU", 0xE004_2000)

    def reset(self):
        pass

    def power_on(self):
        self.regs = {0: 0x1007_6413}

    def freezes(self, name):
        """Whether a halted core stops `name` too."""
        offset, bit = _FREEZE.get(name, (8, 31))
        return bool(self.regs.get(offset, 0) >> bit & 1)


class Dwt(Peripheral):
    """CYCCNT counts modelled cycles of the core, asleep or awake."""

    def __init__(self, board):
        super().__init__(board, "DWT", 0xE000_1000)
        self.reset()

    def reset(self):
        self.regs = {0: 0x4000_0000}
        self.base = self.counted = 0

    def _cycles(self):
        machine = self.board.machine
        return (machine.now - self.base) // machine.cycle + self.counted

    def clocks_change(self):
        if self.regs.get(0, 0) & 1:
            self.counted = self._cycles()
        self.base = self.board.machine.now

    def read(self, offset):
        if offset == 4:
            return (self._cycles() if self.regs.get(0, 0) & 1 else self.counted) & 0xFFFF_FFFF
        return self.regs.get(offset, 0)

    def write(self, offset, value):
        if offset == 0:
            if (value ^ self.regs.get(0, 0)) & 1:
                self.counted = self.read(4)
                self.base = self.board.machine.now
            self.regs[0] = value
        elif offset == 4:
            self.counted, self.base = value, self.board.machine.now
        else:
            self.regs[offset] = value
