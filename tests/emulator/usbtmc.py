"""A PC's driver of USB test instruments, as VISA libraries have one (USBTMC 1.00, USBTMC-USB488 1.00)."""

import struct

from stm32f4 import Timeout
from stm32f4.usb_host import CLASS, ENDPOINT, IN, INTERFACE, descriptors

# The interface: application-specific, test and measurement, USB488.
CODES = (0xFE, 0x03, 0x01)
# MsgID (USBTMC, table 2; USB488, table 1).
DEV_DEP_MSG_OUT, DEV_DEP_MSG_IN, TRIGGER = 1, 2, 128
EOM, TERM_CHAR = 1, 2
# bRequest (USBTMC, table 15; USB488, table 9).
(INITIATE_ABORT_BULK_OUT, CHECK_ABORT_BULK_OUT_STATUS, INITIATE_ABORT_BULK_IN, CHECK_ABORT_BULK_IN_STATUS, INITIATE_CLEAR,
 CHECK_CLEAR_STATUS, GET_CAPABILITIES) = range(1, 8)
READ_STATUS_BYTE, REN_CONTROL, GO_TO_LOCAL, LOCAL_LOCKOUT = 128, 160, 161, 162
# USBTMC_status (USBTMC, table 16; USB488, table 10).
SUCCESS, PENDING, INTERRUPT_IN_BUSY = 0x01, 0x02, 0x20
FAILED, NOT_IN_PROGRESS, SPLIT_NOT_IN_PROGRESS, SPLIT_IN_PROGRESS = 0x80, 0x81, 0x82, 0x83
_HEADER = struct.Struct("<BBBxIBB2x")
_SIZE = 12


class Refused(Exception):
    """A request was answered with something else than success; `status` says with what."""

    def __init__(self, what, status):
        super().__init__(f"{what}: USBTMC_status {status:#04x}")
        self.status = status


def header(message, tag, size, attributes=0, term=0):
    """The 12 bytes in front of a transfer (USBTMC, tables 1 to 9)."""
    return _HEADER.pack(message, tag, ~tag & 0xFF, size, attributes, term)


class Usbtmc:
    """One instrument. While it is open it listens to the interrupt endpoint: `requests` are the status bytes of the service
    requests that have come. `zlp`: a transfer of whole packets is ended by an empty one (USB 2.0, 5.8.3), which not every
    driver of a PC does."""

    def __init__(self, host, zlp=True):
        self.zlp = zlp
        self.host, self.board = host, host.board
        found = [(number, ends) for number, (*codes, ends) in host.interfaces().items() if tuple(codes) == CODES]
        assert found, f"the device has no interface of class USB488: {host.interfaces()}"
        (self.interface, ends), = found
        kinds = self._kinds(host.configuration)
        self.output = next(end for end in ends if not end & IN)
        self.input = next(end for end in ends if end & IN and kinds[end] == 2)
        self.interrupt = next((end for end in ends if end & IN and kinds[end] == 3), None)
        self.tag, self.status_tag = 0, 1
        self.requests, self.notices = [], {}
        self.reader = None
        if self.interrupt is not None:
            self.reader = host.start_in(self.interrupt, on_packet=self._notice, forever=True)

    @staticmethod
    def _kinds(configuration):
        return {part[2]: part[3] & 3 for part in descriptors(configuration) if part[1] == 5}

    def _notice(self, data):
        assert len(data) == 2 and data[0] & 0x80, f"no notification of USB488: {bytes(data)!r}"
        if data[0] == 0x81:
            self.requests.append(data[1])
        else:
            self.notices[data[0] & 0x7F] = data[1]

    def _next_tag(self):
        self.tag = self.tag % 255 + 1
        return self.tag

    # Messages.

    def write(self, data, end=True, timeout_us=1_000_000):
        """One message, or a part of one that goes on in the next call (`end` false), in one transfer."""
        data = data.encode() if isinstance(data, str) else bytes(data)
        self.send(header(DEV_DEP_MSG_OUT, self._next_tag(), len(data), EOM if end else 0) + data, timeout_us)

    def send(self, transfer, timeout_us=1_000_000):
        """A whole transfer as it is, filled up to a multiple of four bytes."""
        transfer += bytes(-len(transfer) % 4)
        self.host.bulk_out(self.output, transfer, timeout_us, self.zlp)

    def request(self, size=1 << 20, term=None):
        """Says that it is going to read; answers the tag."""
        tag = self._next_tag()
        attributes = 0 if term is None else TERM_CHAR
        self.send(header(DEV_DEP_MSG_IN, tag, size, attributes, term or 0))
        return tag

    def read_transfer(self, size=1 << 20, term=None, timeout_us=300_000):
        """One transfer: (bytes, attributes). Checks its header and how it ends."""
        tag = self.request(size, term)
        raw = self.host.bulk_in(self.input, _SIZE + size + 3, timeout_us)
        assert len(raw) >= _SIZE, f"a transfer of {len(raw)} bytes has no header"
        message, came, inverse, count, attributes, _ = _HEADER.unpack(raw[:_SIZE])
        assert (message, came, inverse) == (DEV_DEP_MSG_IN, tag, ~tag & 0xFF), f"asked under tag {tag}: {raw[:_SIZE]!r}"
        assert 0 < count <= size, f"{count} bytes where {size} were asked for"
        rest = len(raw) - _SIZE - count
        assert 0 <= rest <= 3, f"{count} bytes announced, {len(raw) - _SIZE} came"
        return raw[_SIZE:_SIZE + count], attributes

    def read(self, timeout_us=300_000, size=1 << 20):
        """One whole answer, up to EOM."""
        data = b""
        while True:
            part, attributes = self.read_transfer(size, timeout_us=timeout_us)
            data += part
            if attributes & EOM:
                return data

    def ask(self, text, timeout_us=300_000):
        """A query: the answer without its end."""
        self.write(text + "\n")
        answer = self.read(timeout_us)
        assert answer.endswith(b"\n"), f"{answer!r} has no end"
        return answer.decode("ascii", "replace").rstrip("\r\n")

    def trigger(self):
        """TRIGGER (USB488, 3.2.1.1)."""
        self.send(header(TRIGGER, self._next_tag(), 0))

    # Requests.

    def _in(self, request, value, length):
        return self.host.control_in(CLASS | INTERFACE, request, value, self.interface, length)

    def capabilities(self):
        return self._in(GET_CAPABILITIES, 0, 24)

    def clear(self, timeout_us=300_000):
        """Device clear, as USBTMC 4.2.1.6 tells hosts to do it."""
        self._succeed("INITIATE_CLEAR", self._in(INITIATE_CLEAR, 0, 1))
        begun = self.board.now_us
        while True:
            status, ending = self._in(CHECK_CLEAR_STATUS, 0, 2)
            if status != PENDING:
                break
            if ending & 1:
                self.drain()
            if self.board.now_us - begun > timeout_us:
                raise Timeout("the clear stays pending")
            self.board.run(1000)
        self._succeed("CHECK_CLEAR_STATUS", [status])
        self.host.clear_halt(self.output)

    def drain(self, timeout_us=20_000):
        """Reads what is left of a transfer, up to a short packet; answers the bytes."""
        return self.host.bulk_in(self.input, 1 << 20, timeout_us)

    def abort_in(self, tag=None):
        """Aborts the transfer to the host (USBTMC, 4.2.1.4); answers how many bytes the device says it had sent."""
        return self._abort("BULK_IN", INITIATE_ABORT_BULK_IN, self.input, tag)

    def abort_out(self, tag=None):
        """Aborts the transfer to the device (USBTMC, 4.2.1.2); answers how many bytes the device says have come."""
        received = self._abort("BULK_OUT", INITIATE_ABORT_BULK_OUT, self.output, tag)
        self.host.clear_halt(self.output)
        return received

    def _abort(self, what, request, end, tag):
        tag = self.tag if tag is None else tag
        answer = self.host.control_in(CLASS | ENDPOINT, request, tag, end, 2)
        self._succeed(f"INITIATE_ABORT_{what}", answer)
        assert answer[1] == tag
        begun = self.board.now_us
        while True:
            status, ending, *_, count = struct.unpack("<BBBBI", self.host.control_in(CLASS | ENDPOINT, request + 1, 0, end, 8))
            if status != PENDING:
                self._succeed(f"CHECK_ABORT_{what}_STATUS", [status])
                return count
            if ending & 1 and end & IN:
                self.drain()
            if self.board.now_us - begun > 300_000:
                raise Timeout("the abort stays pending")
            self.board.run(1000)

    def read_stb(self):
        """The status byte (USB488, 4.3.1): by the interrupt endpoint where there is one."""
        self.status_tag = self.status_tag + 1 if self.status_tag < 127 else 2
        status, tag, value = self._in(READ_STATUS_BYTE, self.status_tag, 3)
        self._succeed("READ_STATUS_BYTE", [status])
        assert tag == self.status_tag
        if self.interrupt is None:
            return value
        assert value == 0, "the status byte comes by the interrupt endpoint"
        self.board.run_until(lambda: tag in self.notices, 100_000, f"the notification with tag {tag}", step_us=500)
        return self.notices.pop(tag)

    def wait_request(self, timeout_us=300_000):
        """The status byte of the next service request."""
        self.board.run_until(lambda: self.requests, timeout_us, "a service request")
        return self.requests.pop(0)

    def remote(self, on):
        self._succeed("REN_CONTROL", self._in(REN_CONTROL, int(on), 1))

    def go_to_local(self):
        self._succeed("GO_TO_LOCAL", self._in(GO_TO_LOCAL, 0, 1))

    def local_lockout(self):
        self._succeed("LOCAL_LOCKOUT", self._in(LOCAL_LOCKOUT, 0, 1))

    @staticmethod
    def _succeed(what, answer):
        if answer[0] != SUCCESS:
            raise Refused(what, answer[0])

    def close(self):
        """Stops listening."""
        if self.reader and not self.reader.done:
            self.host.cancel(self.reader)

