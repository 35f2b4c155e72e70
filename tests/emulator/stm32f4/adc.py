"""Analog-to-digital converters: every conversion is done at once and gives what `inputs` says."""

from .bus import Peripheral

_SR, _CR1, _CR2, _SQR3, _DR = 0x00, 0x04, 0x08, 0x34, 0x4C
_EOC, _STRT = 2, 16
_IRQ = 18


class Adc(Peripheral):
    """ADC1 to 3 and their common block. Single software-started conversions of the first channel in the sequence."""

    def __init__(self, board):
        super().__init__(board, "ADC", 0x4001_2000)
        self.inputs = [0] * 19  # counts by channel, the same for all three

    def _converter(self, offset):
        return offset & 0x300, offset & 0xFF

    def read(self, offset):
        base, register = self._converter(offset)
        if base < 0x300 and register == _DR:
            self.regs[base + _SR] = self.regs.get(base + _SR, 0) & ~_EOC
            self._lines()
            return self.inputs[self.regs.get(base + _SQR3, 0) & 0x1F] & 0xFFF
        return self.regs.get(offset, 0)

    def write(self, offset, value):
        base, register = self._converter(offset)
        if base < 0x300 and register == _SR:
            value &= self.regs.get(offset, 0)
        elif base < 0x300 and register == _CR2 and value >> 30 & 1 and value & 1:
            self.regs[base + _SR] = self.regs.get(base + _SR, 0) | _EOC | _STRT
            value &= ~(1 << 30)
        self.regs[offset] = value
        self._lines()

    def _lines(self):
        level = any(self.regs.get(base + _SR, 0) & _EOC and self.regs.get(base + _CR1, 0) & 0x20 for base in (0, 0x100, 0x200))
        self.board.nvic.set_line(_IRQ, level)
