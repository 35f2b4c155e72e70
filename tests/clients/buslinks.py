"""One way to talk to an instrument, whatever its link: VISA where pyvisa-py has it, and what replaces it elsewhere.

| | PRLGX-TCPIP and GPIB | SOCKET, ASRL |
|---|---|---|
| status byte | serial poll, `++spoll` | `*STB?` |
| service request | `++srq`, polled: pyvisa-py has no events | bit 6 of `*STB?`, polled |
| clear | `++clr` | byte 0x18; what was on its way is read away |
| trigger | `++trg` | `*TRG` |
| end of an answer | EOI at the gateway; the client sees the LF | LF |
| blocks | read here: its reads end at every LF | as VISA |
| read_termination | not supported by pyvisa-py: cut off here | as VISA |
"""
import time

CLEAR = b"\x18"
VERSION = b"1999.0\n"
RQS, ESB, MAV, ERRORS = 64, 32, 16, 4


class Link:
    """An instrument behind a VISA name."""

    def __init__(self, manager, name, timeout):
        self.name = name
        self.visa = manager.open_resource(name, write_termination="\n", timeout=timeout)
        self.write, self.write_raw = self.visa.write, self.visa.write_raw

    def read(self):
        return self.visa.read().rstrip("\n")

    def query(self, line):
        self.write(line)
        return self.read()

    def block(self, line):
        """The data of a definite block."""
        return self.visa.query_binary_values(line, datatype="B", container=bytes)


class BusLink(Link):
    """Behind a gateway."""

    has_bus = True

    def __init__(self, manager, name, gateway, timeout):
        super().__init__(manager, name, timeout)
        self.gateway = gateway

    def block(self, line):
        # pyvisa-py ends a read at every LF, also at those of the data, and without a read_termination VISA does not
        # count the last one
        self.write(line)
        answer = self.visa.read_raw()
        digits = int(answer[1:2])
        end = 2 + digits + int(answer[2 : 2 + digits])
        while len(answer) < end + 1:
            answer += self.visa.read_raw()
        assert answer[end:] == b"\n"
        return bytes(answer[2 + digits : end])

    def status(self):
        return self.visa.read_stb()

    def trigger(self):
        self.visa.assert_trigger()

    def clear(self):
        self.visa.clear()


class StreamLink(Link):
    """A socket, a serial port."""

    has_bus = False

    def __init__(self, manager, name, timeout):
        super().__init__(manager, name, timeout)
        self.visa.read_termination = "\n"

    def status(self):
        return int(self.query("*STB?"))

    def trigger(self):
        self.write("*TRG")

    def clear(self):
        # what was on its way is read away, up to an answer that is not mistaken
        self.write_raw(CLEAR)
        self.write("SYST:VERS?")
        while not self.visa.read_raw().endswith(VERSION):
            pass


def wait_for_service(link, seconds=10):
    """Polls until service is requested; the status byte."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status = link.status()
        if status & RQS:
            return status
        time.sleep(0.005)
    raise TimeoutError(f"{link.name} requests no service")
