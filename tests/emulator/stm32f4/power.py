"""Power control and backup SRAM (RM0090, 5): what keeps its content, and when it may be written."""

from .bus import Peripheral


class Power(Peripheral):
    """PWR: DBP opens the backup domain, BRE starts the backup regulator."""

    clock = (0x40, 28)

    def __init__(self, board):
        super().__init__(board, "PWR", 0x4000_7000)

    def reset(self):
        # BRE lives in the backup domain and stays.
        self.regs = {0: 0xC000, 4: self.regs.get(4, 0) & (1 << 9)}

    @property
    def backup_open(self):
        return bool(self.regs.get(0, 0) >> 8 & 1)

    @property
    def regulator_on(self):
        return bool(self.regs.get(4, 0) >> 9 & 1)

    def lose_backup_domain(self):
        self.regs[4] = 0

    def read(self, offset):
        if offset == 4:
            value = self.regs.get(4, 0) & 0x300
            return value | (value >> 9 & 1) << 3 | 1 << 14  # BRR, VOSRDY
        return self.regs.get(offset, 0)

    def write(self, offset, value):
        if offset == 4 and not self.backup_open:
            value = value & ~(1 << 9) | self.regs.get(4, 0) & 1 << 9
        self.regs[offset] = value


class BackupSram(Peripheral):
    """4 KB that VBAT feeds while the main supply is off."""

    clock = (0x30, 18)
    size = 0x1000

    def __init__(self, board, power):
        super().__init__(board, "BKPSRAM", 0x4002_4000)
        self.power = power
        self.content = bytearray(self.size)

    def reset(self):
        """A reset of the chip leaves the content alone."""

    def read(self, offset):
        return int.from_bytes(self.content[offset:offset + 4], "little")

    def other_bytes(self, offset):
        return self.read(offset)

    def write(self, offset, value):
        if not self.power.backup_open:
            self.board.bus.warn("a store into backup SRAM with the backup domain closed (PWR_CR DBP)")
            return
        self.content[offset:offset + 4] = value.to_bytes(4, "little")
