"""Reset and clock control (RM0090, 7): oscillators, PLL, prescalers, enables, resets, and what reset the chip last."""

from .bus import Peripheral
from .events import UNITS_PER_US, units

NMI_OF_CSS = 2
_HSI_HZ, _HSE_HZ = 16_000_000, 8_000_000
_UNIT_HZ = UNITS_PER_US * 1_000_000
_CR, _PLLCFGR, _CFGR, _CIR, _BDCR, _CSR = 0x00, 0x04, 0x08, 0x0C, 0x70, 0x74
_RESETS = {0x10: 0x30, 0x14: 0x34, 0x18: 0x38, 0x20: 0x40, 0x24: 0x44}
# Bits of CSR.
CAUSES = {
    "low power": 1 << 31, "window watchdog": 1 << 30, "watchdog": 1 << 29, "software": 1 << 28, "power": 1 << 27,
    "pin": 1 << 26, "brown-out": 1 << 25,
}
# The crystal's start-up time, the PLL's lock time (data sheet: typical 2 ms; 75 to 200 us).
_HSE_START_US, _PLL_LOCK_US, _LSI_START_US = 2000, 100, 40


class Rcc(Peripheral):
    """`crystal` is 'ok' or 'dead'; `kill_crystal()` lets it die now."""

    def __init__(self, board, crystal):
        super().__init__(board, "RCC", 0x4002_3800)
        if crystal not in ("ok", "dead"):
            raise ValueError(f"crystal is {crystal!r}: say 'ok' or 'dead'")
        self.crystal_alive = crystal == "ok"
        self.regs = {}
        self._ready_at = {}
        self._cause_flags = 0
        self._css_flag = False
        self._use = "HSI"
        # Periods in units, as HSI gives them; zero: the clock stands.
        self.ahb = self.apb1 = self.apb2 = self.timer1 = self.timer2 = _UNIT_HZ // _HSI_HZ

    def note_cause(self, cause):
        """Adds a reset cause; any reset pulls the pin too."""
        self._cause_flags |= CAUSES[cause] | CAUSES["pin"]
        if cause == "power":
            self._cause_flags |= CAUSES["brown-out"]

    def forget_causes(self):
        self._cause_flags = 0

    def reset(self):
        self.regs = {
            _CR: 0x83, _PLLCFGR: 0x2400_3010, 0x30: 0x0010_0000, 0x50: 0x7E67_91FF, 0x54: 0xF1, 0x58: 1,
            0x60: 0x36FE_C9FF, 0x64: 0x0007_5F33, _CSR: 0,
        }
        self._ready_at = {}
        self._use = "HSI"
        self._css_flag = False
        self._apply()

    # Clocks.

    def clocked(self, clock):
        offset, bit = clock
        return self.regs.get(offset, 0) >> bit & 1

    def _ready(self, name):
        at = self._ready_at.get(name)
        return at is not None and self.board.machine.now >= at

    @property
    def hse_ready(self):
        return bool(self.regs[_CR] >> 16 & 1 and self.crystal_alive and self._ready("HSE"))

    @property
    def pll_from_hse(self):
        return bool(self.regs[_PLLCFGR] >> 22 & 1)

    @property
    def pll_ready(self):
        source = self.hse_ready if self.pll_from_hse else self.regs[_CR] & 1
        return bool(self.regs[_CR] >> 24 & 1 and source and self._ready("PLL"))

    def pll_hz(self):
        setting = self.regs[_PLLCFGR]
        m, n, p = setting & 0x3F, setting >> 6 & 0x1FF, 2 * (setting >> 16 & 3) + 2
        return (_HSE_HZ if self.pll_from_hse else _HSI_HZ) * n // max(m, 2) // p

    def usb_hz(self):
        """The clock of USB and of the random numbers: the PLL's second output; 0 while there is none."""
        setting = self.regs[_PLLCFGR]
        if not self.pll_ready:
            return 0
        m, n, q = setting & 0x3F, setting >> 6 & 0x1FF, setting >> 24 & 15
        return (_HSE_HZ if self.pll_from_hse else _HSI_HZ) * n / max(m, 2) / max(q, 2)

    def _system_hz(self):
        if self._use == "HSI":
            return _HSI_HZ
        if self._use == "HSE":
            return _HSE_HZ if self.hse_ready else 0
        return self.pll_hz() if self.pll_ready else 0

    def _apply(self):
        """Brings all clocks to what the registers say, peripherals counted up to now first."""
        for peripheral in self.board.bus.peripherals:
            peripheral.clocks_change()
        cfgr = self.regs.get(_CFGR, 0)
        hpre, ppre1, ppre2 = cfgr >> 4 & 15, cfgr >> 10 & 7, cfgr >> 13 & 7
        ahb = (1, 2, 4, 8, 16, 64, 128, 256, 512)[hpre - 7 if hpre >= 8 else 0]
        apb1, apb2 = (2 << ppre1 - 4 if ppre1 >= 4 else 1), (2 << ppre2 - 4 if ppre2 >= 4 else 1)
        self.system_hz = self._system_hz()
        period = round(_UNIT_HZ / (self.system_hz / ahb)) if self.system_hz else 0
        self.ahb, self.apb1, self.apb2 = period, period * apb1, period * apb2
        self.timer1 = period * apb1 // (1 if apb1 == 1 else 2)
        self.timer2 = period * apb2 // (1 if apb2 == 1 else 2)
        self.board.machine.set_clock(period)
        for peripheral in self.board.bus.peripherals:
            peripheral.clocks_changed()

    def _select(self, wanted):
        name = ("HSI", "HSE", "PLL", self._use)[wanted]
        if name != self._use:
            self._use = name
            self._apply()

    # The crystal.

    def kill_crystal(self):
        """The crystal stops. With CSS on, the hardware goes to HSI and raises NMI; else a system that runs from it stands still."""
        was = self.hse_ready
        self.crystal_alive = False
        if not was:
            return
        if self.regs[_CR] >> 19 & 1:
            used = self._use == "HSE" or self._use == "PLL" and self.pll_from_hse
            self.regs[_CR] &= ~(1 << 16)
            self.regs[_CR] |= 1
            if used:
                if self._use == "PLL":
                    self.regs[_CR] &= ~(1 << 24)
                self._use = "HSI"
                self.regs[_CFGR] = self.regs.get(_CFGR, 0) & ~3
            self._css_flag = True
            self._apply()
            self.board.nvic.pend_system(NMI_OF_CSS)
        else:
            self._apply()

    # Registers.

    def read(self, offset):
        if offset == _CR:
            value = self.regs[_CR] & ~(1 << 1 | 1 << 17 | 1 << 25 | 1 << 27)
            value |= (value & 1) << 1 | self.hse_ready << 17 | self.pll_ready << 25 | (value >> 26 & 1) << 27
            return value
        if offset == _CFGR:
            return self.regs.get(_CFGR, 0) & ~0xC | {"HSI": 0, "HSE": 1, "PLL": 2}[self._use] << 2
        if offset == _CIR:
            return self.regs.get(_CIR, 0) & 0x7F00 | self._css_flag << 7
        if offset == _BDCR:
            value = self.regs.get(_BDCR, 0)
            return value & ~2 | (value & 1) << 1
        if offset == _CSR:
            value = self.regs.get(_CSR, 0) & 1
            return value | (value and self._ready("LSI")) << 1 | self._cause_flags
        return self.regs.get(offset, 0)

    def other_bytes(self, offset):
        return self.read(offset)

    def write(self, offset, value):
        machine = self.board.machine
        if offset == _CR:
            old = self.regs[_CR]
            for bit, name, wait in ((16, "HSE", _HSE_START_US), (24, "PLL", _PLL_LOCK_US)):
                if value >> bit & 1 and not old >> bit & 1:
                    self._ready_at[name] = machine.now + units(wait)
            if self._use == "PLL" and not value >> 24 & 1:
                self.board.bus.warn("the PLL was switched off while it clocked the system: the chip ignores that")
                value |= 1 << 24
            if self._use == "HSI" and not value & 1:
                self.board.bus.warn("HSI was switched off while it clocked the system: the chip ignores that")
                value |= 1
            self.regs[_CR] = value
        elif offset == _PLLCFGR:
            if self.regs[_CR] >> 24 & 1 and value != self.regs[_PLLCFGR]:
                self.board.bus.warn("PLLCFGR was written while the PLL was on: the chip ignores that")
            else:
                self.regs[_PLLCFGR] = value
        elif offset == _CFGR:
            old = self.regs.get(_CFGR, 0)
            self.regs[_CFGR] = value
            wanted = value & 3
            if wanted == 2 and not self.pll_ready or wanted == 1 and not self.hse_ready:
                self.board.bus.warn("CFGR chose a clock that is not ready")
                wanted = {"HSI": 0, "HSE": 1, "PLL": 2}[self._use]
            self._select(wanted)
            if (old ^ value) & 0xFCF0:
                self._apply()
        elif offset == _CIR:
            self.regs[_CIR] = value & 0x7F00
            if value >> 23 & 1:
                self._css_flag = False
        elif offset == _CSR:
            if value & 1 and not self.regs.get(_CSR, 0) & 1:
                self._ready_at["LSI"] = machine.now + units(_LSI_START_US)
            self.regs[_CSR] = value & 1
            if value >> 24 & 1:
                self._cause_flags = 0
        else:
            old = self.regs.get(offset, 0)
            self.regs[offset] = value
            if offset in _RESETS:
                self._reset_peripherals(_RESETS[offset], value & ~old)

    def nmi_again(self):
        """NMI comes again as long as the flag of CSS stands."""
        return self._css_flag

    def _reset_peripherals(self, enable, bits):
        for peripheral in self.board.bus.peripherals:
            if peripheral.clock and peripheral.clock[0] == enable and bits >> peripheral.clock[1] & 1:
                peripheral.reset()
