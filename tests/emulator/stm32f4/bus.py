"""What a peripheral is, and which one an address belongs to."""


class Peripheral:
    """A block of 32-bit registers. Offsets are multiples of four; `clock` names its enable bit as (RCC register, bit)."""

    clock = None
    size = 0x400

    def __init__(self, board, name, base):
        self.board, self.name, self.base = board, name, base
        self.regs = {}

    def reset(self):
        """State after a reset of the peripheral."""
        self.regs = {}

    def read(self, offset):
        return self.regs.get(offset, 0)

    def write(self, offset, value):
        self.regs[offset] = value

    def other_bytes(self, offset):
        """What a store narrower than a word leaves in the other bytes."""
        return self.regs.get(offset, 0)

    def clocks_change(self):
        """Called before a clock changes its rate: count up to now."""

    def clocks_changed(self):
        """Called after: the new rate is known."""


class Store(Peripheral):
    """Registers that only keep what is written, for blocks whose work does not matter here."""


class Bus:
    """Dispatches loads and stores by blocks of 1 KB."""

    REGIONS = ((0x4000_0000, 0x8_0000), (0x5000_0000, 0x8_0000), (0xE000_0000, 0x10_0000))

    def __init__(self, board):
        self.board = board
        self.blocks = {}
        self.peripherals = []
        self.warnings = []
        for base, size in self.REGIONS:
            board.core.uc.mmio_map(base, size, self._read, base, self._write, base)

    def add(self, peripheral):
        self.peripherals.append(peripheral)
        for block in range(peripheral.base >> 10, (peripheral.base + peripheral.size + 0x3FF) >> 10):
            self.blocks[block] = peripheral
        return peripheral

    def warn(self, text):
        """Something that the program should not do on the chip; kept once each, in order."""
        if text not in self.warnings:
            self.warnings.append(text)

    def _find(self, address, what):
        peripheral = self.blocks.get(address >> 10)
        if peripheral is None:
            self.warn(f"{what} at {address:#010x}, where no peripheral is modelled")
            return None
        if peripheral.clock and not self.board.rcc.clocked(peripheral.clock):
            self.warn(f"{what} of {peripheral.name}+{address - peripheral.base:#x} without its clock")
            return None
        return peripheral

    def _read(self, uc, offset, size, base):
        address = base + offset
        peripheral = self._find(address, "load")
        if peripheral is None:
            return 0
        within = address - peripheral.base
        word = peripheral.read(within & ~3)
        return word if size == 4 else word >> 8 * (within & 3) & ((1 << 8 * size) - 1)

    def _write(self, uc, offset, size, value, base):
        address = base + offset
        peripheral = self._find(address, "store")
        if peripheral is None:
            return
        within = address - peripheral.base
        if size != 4:
            shift, mask = 8 * (within & 3), (1 << 8 * size) - 1
            value = peripheral.other_bytes(within & ~3) & ~(mask << shift) | (value & mask) << shift
        peripheral.write(within & ~3, value & 0xFFFF_FFFF)

    def load(self, address):
        """A word as a bus master other than the core reads it."""
        return self._read(None, address, 4, 0)

    def store(self, address, value, size=4):
        self._write(None, address, size, value, 0)
