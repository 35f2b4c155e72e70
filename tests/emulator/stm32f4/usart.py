"""USARTs at the speed of the wire (RM0090, 30), and the other end of the cable."""

from collections import deque

from .bus import Peripheral
from .events import NEVER, UNITS_PER_US

_SR, _DR, _BRR, _CR1, _CR2, _CR3 = 0, 4, 8, 12, 16, 20
_PE, _FE, _NF, _ORE, _IDLE, _RXNE, _TC, _TXE = (1 << i for i in range(8))
_RE, _TE, _IDLEIE, _RXNEIE, _TCIE, _TXEIE, _PEIE, _UE = 4, 8, 0x10, 0x20, 0x40, 0x80, 0x100, 0x2000
_EIE, _DMAR, _DMAT = 1, 0x40, 0x80
_FRAME_BITS = 10
# A receiver takes a frame whose bits are off by this much (data sheet: 3.3 to 3.9 %).
_TOLERANCE = 0.035


class Usart(Peripheral):
    """Eight data bits, no parity, one stop bit. `rx_stream`, `tx_stream`: (stream, channel) of its DMA requests."""

    def __init__(self, board, number, base, clock, irq, rx_stream=None, tx_stream=None):
        super().__init__(board, f"USART{number}", base)
        self.clock, self.irq = clock, irq
        self.fast = base >= 0x4001_0000
        self.rx_stream, self.tx_stream = rx_stream, tx_stream
        self.sent = bytearray()  # bytes that have left completely
        self.sent_times = []  # when, in us
        self.lost = 0  # bytes that an overrun destroyed
        self.arriving = deque()  # (time of the frame's end, byte, error flags, baud)
        self.on_sent = None
        self.arrival = self.idle_line = self.shift_end = self.rx_pin = None
        self.wire_free = 0
        self.reset()

    def attach(self, events):
        self.arrival = events.alarm(self._arrives)
        self.idle_line = events.alarm(self._idles)
        self.shift_end = events.alarm(self._shifted)

    def reset(self):
        self.sr, self.dr = _TC | _TXE, 0
        self.regs = {_BRR: 0, _CR1: 0, _CR2: 0, _CR3: 0}
        self.status_read = False
        self.shifting = self.waiting = None
        if self.shift_end:
            self.shift_end.cancel()
            self.idle_line.cancel()
        self._lines()

    @property
    def bit(self):
        """Units per bit."""
        clock = self.board.rcc.apb2 if self.fast else self.board.rcc.apb1
        return self.regs[_BRR] * clock

    @property
    def baud(self):
        """What the program has set, 0 before."""
        return UNITS_PER_US * 1_000_000 / self.bit if self.bit else 0

    # The other end.

    def receive(self, data, baud, flags=0, gap_bits=0):
        """Puts bytes on the line to RX, behind those under way; `flags`: FE, NF or PE of each; `gap_bits` between frames."""
        bit = UNITS_PER_US * 1_000_000 / baud
        at = max(self.wire_free, self.board.machine.now)
        for byte in data:
            at += round((_FRAME_BITS + gap_bits) * bit)
            self.arriving.append((at, byte, flags, baud))
        self.wire_free = at
        if self.arriving and self.arrival.time == NEVER:
            self.arrival.set(self.arriving[0][0])

    def receive_break(self, baud, duration_us):
        """The line is low for longer than a frame: one zero byte with a framing error; the next start bit needs an edge."""
        events, start = self.board.machine.events, max(self.wire_free, self.board.machine.now)
        end = start + round(max(duration_us * UNITS_PER_US, (_FRAME_BITS + 1) * UNITS_PER_US * 1_000_000 / baud))
        self.receive(b"\0", baud, _FE)
        self.wire_free = end
        events.at(start, lambda: self._line(0))
        events.at(end, lambda: self._line(1))

    def _line(self, level):
        if self.rx_pin:
            self.rx_pin[0].drive(self.rx_pin[1], level)

    def plug_in(self, port, pin):
        """The cable: an idle line is high. Only breaks show at the pin, not the bits of bytes."""
        self.rx_pin = (port, pin)
        self._line(1)

    def unplug(self):
        """What has not arrived never will; the open line idles high."""
        self.arriving.clear()
        self.arrival.cancel()
        self.wire_free = 0
        self._line(1)

    def _arrives(self):
        _, byte, flags, baud = self.arriving.popleft()
        if self.arriving:
            self.arrival.set(self.arriving[0][0])
        cr1 = self.regs[_CR1]
        if not cr1 & _UE or not cr1 & _RE or not self.bit:
            self.lost += 1
            return
        if abs(baud / self.baud - 1) > _TOLERANCE:
            byte, flags = byte ^ 0x5A, flags | _FE
        if self.sr & _RXNE:
            self.sr |= _ORE
            self.lost += 1
        else:
            self.dr = byte
            self.sr |= _RXNE | flags
        if flags & _FE and byte == 0:
            self.idle_line.cancel()
        # Idle: one frame of high line after the stop bit.
        if not self.arriving or self.arriving[0][0] - self.board.machine.now > 2 * _FRAME_BITS * self.bit - self.bit:
            self.idle_line.set(self.board.machine.now + _FRAME_BITS * self.bit)
        self._pump_rx()
        self._lines()

    def _idles(self):
        self.sr |= _IDLE
        self._lines()

    def inject(self, flags):
        """Sets error flags (FE, NF, ORE, PE) as noise would, with no byte."""
        self.sr |= flags
        self._lines()

    # DMA.

    def _stream(self, which):
        if which and which[0].enabled and which[0].channel == which[1]:
            return which[0]
        return None

    def _pump_rx(self):
        stream = self._stream(self.rx_stream)
        if self.sr & _RXNE and self.regs[_CR3] & _DMAR and stream:
            stream.serve(1)

    def _pump_tx(self):
        stream = self._stream(self.tx_stream)
        while self.sr & _TXE and self.regs[_CR3] & _DMAT and stream and stream.enabled and self.regs[_CR1] & _TE:
            stream.serve(1)

    def dma_ready(self):
        self._pump_rx()
        self._pump_tx()

    # Transmission.

    def transmit(self, byte):
        if not self.regs[_CR1] & _UE or not self.regs[_CR1] & _TE:
            return
        self.sr &= ~_TC
        if self.shifting is None:
            self._shift(byte)
        else:
            if self.waiting is not None:
                self.board.bus.warn(f"{self.name}: a byte was written over one that waits to be sent")
            self.waiting = byte
            self.sr &= ~_TXE
        self._lines()

    def _shift(self, byte):
        self.shifting = byte
        self.shift_end.set(self.board.machine.now + max(_FRAME_BITS * self.bit, 1))

    def _shifted(self):
        self.sent.append(self.shifting)
        self.sent_times.append(self.board.machine.now_us)
        byte, self.shifting = self.shifting, None
        if self.waiting is not None:
            following, self.waiting = self.waiting, None
            self.sr |= _TXE
            self._shift(following)
            self._pump_tx()
        else:
            self.sr |= _TC
        self._lines()
        if self.on_sent:
            self.on_sent(byte)

    # Registers.

    def _lines(self):
        sr, cr1, cr3 = self.sr, self.regs[_CR1], self.regs[_CR3]
        level = (cr1 & _RXNEIE and sr & (_RXNE | _ORE) or cr1 & _TXEIE and sr & _TXE or cr1 & _TCIE and sr & _TC
                 or cr1 & _IDLEIE and sr & _IDLE or cr1 & _PEIE and sr & _PE
                 or cr3 & _EIE and cr3 & _DMAR and sr & (_FE | _NF | _ORE))
        self.board.nvic.set_line(self.irq, bool(level))

    def read(self, offset):
        if offset == _SR:
            self.status_read = True
            return self.sr
        if offset == _DR:
            value = self.dr
            self.sr &= ~_RXNE
            if self.status_read:
                self.sr &= ~(_PE | _FE | _NF | _ORE | _IDLE)
                self.status_read = False
            self._lines()
            return value
        return self.regs.get(offset, 0)

    def other_bytes(self, offset):
        return 0 if offset == _DR else self.regs.get(offset, 0)

    def write(self, offset, value):
        if offset == _DR:
            self.transmit(value & 0xFF)
            return
        if offset == _SR:
            self.sr &= value | ~(_RXNE | _TC)
        else:
            self.regs[offset] = value
            self.dma_ready()
        self._lines()


class Serial:
    """The other end of the cable: writes at its baud rate, reads what has come."""

    def __init__(self, board, usart, baud=115_200):
        self.board, self.usart, self.baud = board, usart, baud
        self._read = 0

    def write(self, data):
        """Starts to send; bytes follow each other without a gap."""
        self.usart.receive(data.encode() if isinstance(data, str) else data, self.baud)

    def read(self):
        """Everything that has come since the last call."""
        data = bytes(self.usart.sent[self._read:])
        self._read = len(self.usart.sent)
        return data

    def peek(self):
        """The same, left for the next call."""
        return bytes(self.usart.sent[self._read:])

    def query(self, text, timeout_us=1_000_000):
        """Sends a line and runs the board until a line has come back; answers it without its end."""
        self.read()
        self.write(text + "\n")
        self.board.run_until(lambda: b"\n" in self.peek(), timeout_us, f"an answer to {text!r}, got {self.peek()!r}")
        return self.read_line()

    def read_line(self):
        """One whole line, which must have come."""
        line, _, _ = self.peek().partition(b"\n")
        self._read += len(line) + 1
        return line.rstrip(b"\r").decode("ascii", "replace")

    def send_break(self, duration_us=250_000):
        self.usart.receive_break(self.baud, duration_us)

    def noise(self):
        """One byte that arrives with noise and a framing error."""
        self.usart.receive(b"\x55", self.baud, _FE | _NF)
