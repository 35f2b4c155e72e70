"""Interrupts: the NVIC, the priorities of the system exceptions, and the system control block (ARMv7-M, B1.5 and B3.2)."""

from .bus import Peripheral

NMI, HARD_FAULT, MEM_MANAGE, BUS_FAULT, USAGE_FAULT, SVC, PEND_SV, SYS_TICK = 2, 3, 4, 5, 6, 11, 14, 15
LOWEST = 256
IRQS = 82


class Nvic(Peripheral):
    """0xE000E000: SysTick's registers (not counting), NVIC, SCB. Four bits of priority, all of them preempting."""

    size = 0x1000

    def __init__(self, board):
        super().__init__(board, "SCS", 0xE000_E000)
        self.reset()

    def reset(self):
        self.regs = {0x014: 0, 0xD00: 0x410F_C241, 0xD88: 0, 0xF34: 0xC000_0000}
        self.enabled = 0
        self.pending = 0
        self.lines = 0
        self.priority = [0] * IRQS
        self.system_priority = {}
        self.system_pending = set()
        self.active = []  # exception numbers, innermost last
        self.active_irqs = 0
        self.vector_table = 0x0800_0000
        self.fault_status = 0
        self.hard_fault_status = 0
        self.fault_address = 0

    # What peripherals do.

    def set_line(self, irq, level):
        """The request line of a peripheral: a rising edge pends, a high level pends again at the return of the handler."""
        bit = 1 << irq
        if level:
            if not self.lines & bit:
                self.lines |= bit
                if not self.active_irqs & bit:
                    self.pend(irq)
        elif self.lines & bit:
            self.lines &= ~bit

    def pend(self, irq):
        self.pending |= 1 << irq
        if self.regs.get(0xD10, 0) & 0x10:  # SEVONPEND
            self.board.core.state.event = 1
        if self.enabled >> irq & 1:
            self.board.machine.attend()

    def pend_system(self, number):
        self.system_pending.add(number)
        self.board.machine.attend()

    # What the machine asks.

    def priority_of(self, number):
        if number >= 16:
            return self.priority[number - 16]
        return {NMI: -2, HARD_FAULT: -1}.get(number, self.system_priority.get(number, 0))

    def execution_priority(self, masked=True):
        """The priority below which an exception must lie to be taken; `masked` false leaves PRIMASK out (for WFI)."""
        level = LOWEST
        for number in self.active:
            level = min(level, self.priority_of(number))
        primask, basepri, faultmask = self.board.core.masks()
        if basepri:
            level = min(level, basepri)
        if primask and masked:
            level = min(level, 0)
        if faultmask:
            level = min(level, -1)
        return level

    def next_exception(self, masked=True):
        """The exception to take now, or None. Equal priorities go by number."""
        if not self.system_pending and not self.pending & self.enabled:
            return None
        best, level = None, self.execution_priority(masked)
        for number in sorted(self.system_pending):
            if self.priority_of(number) < level:
                best, level = number, self.priority_of(number)
        if self.board.machine.interrupts_blocked:
            return best if best in (NMI, HARD_FAULT) else None
        waiting = self.pending & self.enabled
        while waiting:
            irq = (waiting & -waiting).bit_length() - 1
            waiting &= waiting - 1
            if self.priority[irq] < level:
                best, level = irq + 16, self.priority[irq]
        return best

    def anything_waits(self):
        return bool(self.system_pending or self.pending & self.enabled)

    def enter(self, number):
        self.active.append(number)
        if number >= 16:
            self.pending &= ~(1 << number - 16)
            self.active_irqs |= 1 << number - 16
        else:
            self.system_pending.discard(number)

    def leave(self):
        number = self.active.pop()
        if number >= 16:
            irq = number - 16
            self.active_irqs &= ~(1 << irq)
            if self.lines >> irq & 1:
                self.pend(irq)
        return number

    # What the program reads and writes.

    @staticmethod
    def _word(mask, index):
        return mask >> 32 * index & 0xFFFF_FFFF

    def read(self, offset):
        masks = self.enabled, self.enabled, self.pending, self.pending, self.active_irqs
        for first, mask in zip((0x100, 0x180, 0x200, 0x280, 0x300), masks):
            if first <= offset < first + 0x20:
                return self._word(mask, (offset - first) // 4)
        if 0x400 <= offset < 0x400 + IRQS + 3 & ~3:
            return sum(self.priority[i] << 8 * (i & 3) for i in range(offset - 0x400, min(offset - 0x3FC, IRQS)))
        if offset == 0xD04:
            waiting = self.pending & self.enabled
            first = (waiting & -waiting).bit_length() + 15 if waiting else 0
            number = self.active[-1] if self.active else 0
            return number | first << 12 | bool(waiting) << 22 | (len(self.active) <= 1) << 11
        if offset == 0xD08:
            return self.vector_table
        if 0xD18 <= offset < 0xD24:
            return sum(self.system_priority.get(offset - 0xD18 + 4 + i, 0) << 8 * i for i in range(4))
        return {0xD28: self.fault_status, 0xD2C: self.hard_fault_status, 0xD34: self.fault_address,
                0xD38: self.fault_address}.get(offset, self.regs.get(offset, 0xFA05_0000 if offset == 0xD0C else 0))

    def other_bytes(self, offset):
        return self.read(offset) if offset >= 0x400 else 0

    def write(self, offset, value):
        if 0x100 <= offset < 0x120:
            self.enabled |= value << 32 * ((offset - 0x100) // 4)
        elif 0x180 <= offset < 0x1A0:
            self.enabled &= ~(value << 32 * ((offset - 0x180) // 4))
        elif 0x200 <= offset < 0x220:
            self.pending |= value << 32 * ((offset - 0x200) // 4)
        elif 0x280 <= offset < 0x2A0:
            cleared = value << 32 * ((offset - 0x280) // 4)
            self.pending &= ~(cleared & ~self.lines)
        elif 0x400 <= offset < 0x400 + IRQS:
            for i in range(offset - 0x400, min(offset - 0x3FC, IRQS)):
                self.priority[i] = value >> 8 * (i & 3) & 0xF0
        elif offset == 0xD04:
            if value >> 31 & 1:
                self.system_pending.add(NMI)
            if value >> 28 & 1:
                self.system_pending.add(PEND_SV)
            if value >> 27 & 1:
                self.system_pending.discard(PEND_SV)
        elif offset == 0xD08:
            self.vector_table = value & ~0x1FF
        elif offset == 0xD0C:
            if value >> 16 == 0x05FA and value & 4:
                self.board.machine.request_reset("software")
        elif 0xD18 <= offset < 0xD24:
            for i in range(4):
                self.system_priority[offset - 0xD18 + 4 + i] = value >> 8 * i & 0xF0
        elif offset == 0xD28:
            self.fault_status &= ~value
        elif offset == 0xD2C:
            self.hard_fault_status &= ~value
        elif offset == 0xF00:
            self.pending |= 1 << (value & 0x1FF)
        else:
            self.regs[offset] = value
        if self.anything_waits():
            self.board.machine.attend()
