"""Independent watchdog (RM0090, 21), fed by the LSI oscillator."""

from .bus import Peripheral
from .events import UNITS_PER_US

_LSI_PERIOD = UNITS_PER_US * 1_000_000 // 32_000


class Iwdg(Peripheral):
    """Once started only a reset stops it. The data sheet allows the LSI 17 to 47 kHz; here it has 32."""

    def __init__(self, board):
        super().__init__(board, "IWDG", 0x4000_3000)
        self.alarm = None
        self.reset()

    def reset(self):
        self.prescaler, self.reload, self.unlocked, self.started = 0, 0xFFF, False, False
        self.frozen_left = None
        if self.alarm:
            self.alarm.cancel()

    def attach(self, events):
        self.alarm = events.alarm(lambda: self.board.machine.request_reset("watchdog"))

    @property
    def period(self):
        """From feeding to reset, in units."""
        return (self.reload + 1) * (4 << min(self.prescaler, 6)) * _LSI_PERIOD

    def read(self, offset):
        return {4: self.prescaler, 8: self.reload}.get(offset, 0)

    def write(self, offset, value):
        if offset == 0:
            self.unlocked = value == 0x5555
            if value == 0xCCCC:
                self.started = True
            if value in (0xAAAA, 0xCCCC) and self.started:
                self.alarm.set(self.board.machine.now + self.period)
        elif self.unlocked and offset == 4:
            self.prescaler = value & 7
        elif self.unlocked and offset == 8:
            self.reload = value & 0xFFF
        else:
            self.board.bus.warn(f"a store to IWDG+{offset:#x} while it is locked")

    def freeze(self):
        """A debugger holds the core and DBGMCU says that the watchdog waits too."""
        if self.started and self.frozen_left is None:
            self.frozen_left = self.alarm.time - self.board.machine.now
            self.alarm.cancel()

    def thaw(self):
        if self.frozen_left is not None:
            self.alarm.set(self.board.machine.now + self.frozen_left)
            self.frozen_left = None
