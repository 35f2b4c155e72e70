"""DMA controllers (RM0090, 10): circular and single transfers, direct mode with its word read ahead."""

from .bus import Peripheral
from .core import CCM_BASE, CCM_SIZE

_EN, _DMEIE, _TEIE, _HTIE, _TCIE = 1, 1 << 1, 1 << 2, 1 << 3, 1 << 4
_CIRC, _PINC, _MINC = 1 << 8, 1 << 9, 1 << 10
_FEIF, _DMEIF, _TEIF, _HTIF, _TCIF = 1, 1 << 2, 1 << 3, 1 << 4, 1 << 5
_FLAG_SHIFT = (0, 6, 16, 22)
# A request that is raised again before the last one was served is one request (AN4031, "service time").
SERVICE_CYCLES = 8
# EN reads as set until the transfer in flight has ended.
_DISABLE_CYCLES = 12


class Stream:
    """One stream. `remaining` is NDTR: transfers on the peripheral's side still to come."""

    def __init__(self, dma, index, irq):
        self.dma, self.board, self.index, self.irq = dma, dma.board, index, irq
        self.name = f"{dma.name} stream {index}"
        self.reset()

    def reset(self):
        self.cr = self.par = self.m0ar = self.m1ar = self.remaining = 0
        self.fcr = 0x21
        self.flags = 0
        self.enabled = False
        self.busy_until = 0
        self.last_service = -1 << 62
        self.total = 0  # NDTR as the program last wrote it
        self.slot = 0
        self.ahead = None
        self.memory = None

    @property
    def channel(self):
        return self.cr >> 25 & 7

    @property
    def to_peripheral(self):
        return self.cr >> 6 & 3 == 1

    def lines(self):
        wanted = (self.cr & _DMEIE and _DMEIF) | (self.cr & _TEIE and _TEIF) | (self.cr & _HTIE and _HTIF) | (self.cr & _TCIE and _TCIF)
        wanted |= self.fcr & 0x80 and _FEIF
        self.board.nvic.set_line(self.irq, bool(self.flags & wanted))

    def requests_to_interrupt(self):
        """How many requests from now raise an interrupt, None if none does."""
        if not self.enabled:
            return None
        counts = []
        if self.cr & _TCIE and not self.flags & _TCIF:
            counts.append(self.remaining)
        if self.cr & _HTIE and not self.flags & _HTIF:
            half = self.total // 2
            counts.append(self.remaining - half if self.remaining > half else self.remaining + self.total - half)
        return min(counts) if counts else None

    # Control.

    def write_cr(self, value):
        was = self.enabled
        if was and value & _EN:
            self.cr = value
        elif was:
            self.cr = value
            self._stop()
            self.busy_until = self.board.machine.now + _DISABLE_CYCLES * self.board.rcc.ahb
            self.flags |= _TCIF
        elif value & _EN:
            self.cr = value
            self._start()
        else:
            self.cr = value
        self.lines()

    def _start(self):
        if self.board.machine.now < self.busy_until:
            self.board.bus.warn(f"{self.name} was enabled before EN read as cleared")
        if self.flags & (_TEIF | _HTIF | _TCIF):
            self.board.bus.warn(f"{self.name} was enabled with flags of its last run still set")
        self.width = 1 << (self.cr >> 11 & 3)
        if not self.fcr & 4 and self.cr >> 13 & 3 != self.cr >> 11 & 3:
            self.board.bus.warn(f"{self.name}: direct mode moves PSIZE on both sides")
        if not self.remaining:
            self.remaining = self.total
        if not self.board.dma_resumes:
            self.slot = 0
        length = self.width * (self.total if self.cr & _MINC else 1)
        in_ccm = CCM_BASE <= self.m0ar < CCM_BASE + CCM_SIZE
        self.memory = None if in_ccm else self.board.core.memory_at(self.m0ar, length)
        if not self.total:
            self.cr &= ~_EN
            return
        if self.memory is None:
            self.error()
            return
        self.enabled = True
        self.ahead = self._fetch() if self.to_peripheral and not self.fcr & 4 else None
        self.board.dma_ready()

    def _stop(self):
        self.enabled, self.ahead = False, None
        self.cr &= ~_EN

    def error(self):
        """A transfer error: the hardware clears EN."""
        self._stop()
        self.flags |= _TEIF
        self.lines()
        self.board.stream_changed()

    # Transfers.

    def _at(self, slot):
        view, offset = self.memory
        return view, offset + (self.width * slot if self.cr & _MINC else 0)

    def _fetch(self):
        view, offset = self._at(self.slot)
        return bytes(view[offset:offset + self.width])

    def serve(self, count, time=None, step=0):
        """Serves `count` requests, the first at `time`, `step` units apart; answers how many it took."""
        done = 0
        while count > done and self.enabled:
            some = min(count - done, self.remaining)
            first = None if time is None else time + done * step
            if self.to_peripheral:
                self._out(some, first, step)
            else:
                self._in(some)
            self._counted(some)
            done += some
        if done:
            self.last_service = self.board.machine.now
            self.lines()
        return done

    def _out(self, some, time, step):
        view, offset = self._at(self.slot)
        width = self.width
        if not self.cr & _MINC:
            data = bytes(view[offset:offset + width]) * some
        else:
            data = bytes(view[offset:offset + width * some])
        if self.ahead is not None:
            data = self.ahead + data[width:]
        self.board.dma_output(self, data, time, step)

    def _in(self, some):
        view, offset = self._at(self.slot)
        width, source = self.width, self.board.core.memory_at(self.par, self.width)
        if source and not self.cr & _PINC:
            item = bytes(source[0][source[1]:source[1] + width])
            if self.cr & _MINC:
                view[offset:offset + width * some] = item * some
            else:
                view[offset:offset + width] = item
            return
        for i in range(some):
            item = (self.board.bus.load(self.par & ~3) >> 8 * (self.par & 3) & (1 << 8 * width) - 1).to_bytes(width, "little")
            at = offset + (width * i if self.cr & _MINC else 0)
            view[at:at + width] = item

    def _counted(self, some):
        before = self.remaining
        self.remaining -= some
        self.slot += some
        half = self.total // 2
        if before > half >= self.remaining:
            self.flags |= _HTIF
        if self.remaining == 0:
            self.flags |= _TCIF
            self.slot = 0
            if self.cr & _CIRC:
                self.remaining = self.total
            else:
                self._stop()
                return
        if self.ahead is not None:
            self.ahead = self._fetch()


class Dma(Peripheral):
    """A controller of eight streams."""

    def __init__(self, board, number):
        super().__init__(board, f"DMA{number}", 0x4002_6000 + 0x400 * (number - 1))
        self.clock = (0x30, 20 + number)
        irqs = (11, 12, 13, 14, 15, 16, 17, 47) if number == 1 else (56, 57, 58, 59, 60, 68, 69, 70)
        self.streams = [Stream(self, i, irq) for i, irq in enumerate(irqs)]

    def reset(self):
        for stream in self.streams:
            stream.reset()
            stream.lines()
        self.board.stream_changed()

    def _flags(self, first):
        return sum(s.flags << _FLAG_SHIFT[i] for i, s in enumerate(self.streams[first:first + 4]))

    def read(self, offset):
        self.board.sync_stream()
        if offset < 8:
            return self._flags(offset)
        if offset < 0x10 or offset >= 0xD0:
            return 0
        stream, register = self.streams[(offset - 0x10) // 0x18], (offset - 0x10) % 0x18
        if register == 0:
            return stream.cr | (self.board.machine.now < stream.busy_until)
        level = 0 if stream.ahead else 4  # empty
        control = stream.fcr & ~0x38 | level << 3
        return (0, stream.remaining, stream.par, stream.m0ar, stream.m1ar, control)[register // 4]

    def other_bytes(self, offset):
        return 0 if offset < 0x10 else self.read(offset)

    def write(self, offset, value):
        self.board.sync_stream()
        if offset in (8, 12):
            first = 0 if offset == 8 else 4
            for i, stream in enumerate(self.streams[first:first + 4]):
                stream.flags &= ~(value >> _FLAG_SHIFT[i] & 0x3D)
                stream.lines()
        elif 0x10 <= offset < 0xD0:
            stream, register = self.streams[(offset - 0x10) // 0x18], (offset - 0x10) % 0x18
            if register == 0:
                stream.write_cr(value)
            elif register == 20:
                stream.fcr = value & 0x87 if not stream.enabled else stream.fcr & ~0x80 | value & 0x80
            elif stream.enabled:
                self.board.bus.warn(f"{stream.name}: a register was written while it runs")
            elif register == 4:
                stream.remaining = stream.total = value & 0xFFFF
                stream.slot = 0
            elif register == 8:
                stream.par = value
            elif register == 12:
                stream.m0ar, stream.slot = value, 0
            elif register == 16:
                stream.m1ar = value
        self.board.stream_changed()
