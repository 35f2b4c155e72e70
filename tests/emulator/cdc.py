"""The USB serial port as a driver of the PC uses it (CDC 1.2, PSTN 1.2)."""

from stm32f4.usb_host import CLASS, INTERFACE, IN

SET_LINE_CODING, GET_LINE_CODING, SET_CONTROL_LINE_STATE = 0x20, 0x21, 0x22
_DTR, _RTS = 1, 2
CDC, CDC_DATA, ACM = 0x02, 0x0A, 0x02


class CdcPort:
    """Finds its interfaces in the configuration; while it is open it reads all that comes, unless told not to."""

    def __init__(self, host):
        self.host, self.board = host, host.board
        found = host.interfaces()
        self.control = next(n for n, (kind, sub, _, _) in found.items() if (kind, sub) == (CDC, ACM))
        ends = next(ends for kind, _, _, ends in found.values() if kind == CDC_DATA)
        self.input = next(end for end in ends if end & IN)
        self.output = next(end for end in ends if not end & IN)
        self.came, self.packets = bytearray(), []
        self.reader = None

    def open(self, read=True):
        """Line coding and DTR, as every terminal sets them."""
        coding = (115_200).to_bytes(4, "little") + bytes([0, 0, 8])
        self.host.control_out(CLASS | INTERFACE, SET_LINE_CODING, 0, self.control, coding)
        self.line_state(_DTR | _RTS)
        self.came.clear()
        self.packets.clear()
        if read:
            self.reader = self.host.start_in(self.input, on_packet=self._came, forever=True)
        return self

    def close(self):
        if self.reader:
            self.host.cancel(self.reader)
            self.reader = None
        self.line_state(0)

    def line_state(self, bits):
        self.host.control_out(CLASS | INTERFACE, SET_CONTROL_LINE_STATE, bits, self.control)

    def _came(self, data):
        self.came += data
        self.packets.append(len(data))

    def write(self, text, timeout_us=1_000_000):
        self.host.bulk_out(self.output, text.encode() if isinstance(text, str) else text, timeout_us)

    def read_line(self, timeout_us=300_000):
        self.board.run_until(lambda: b"\n" in self.came, timeout_us, f"a line over USB, got {bytes(self.came)!r}")
        line, _, rest = bytes(self.came).partition(b"\n")
        self.came[:] = rest
        return line.rstrip(b"\r").decode("ascii", "replace")

    def ask(self, text, timeout_us=300_000):
        """Sends a line, answers the line that comes back."""
        self.write(text + "\n")
        return self.read_line(timeout_us)
