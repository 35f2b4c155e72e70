"""One way to talk to an instrument, whatever its link: VISA where pyvisa-py has it, and what replaces it elsewhere.

| | PRLGX-TCPIP and GPIB | hislip0::INSTR | SOCKET, ASRL |
|---|---|---|---|
| status byte | serial poll, `++spoll` | status query; behind a service request: here | `*STB?` |
| service request | polled: pyvisa-py has no events | polled; test_hislip.py has it pushed | bit 6 of `*STB?`, polled |
| clear | `++clr` | here: pyvisa-py leaves the rest of an answer | 0x18; the rest is read away |
| trigger | `++trg` | here: pyvisa-py has the message and no call | `*TRG` |
| blocks | read here: its reads end at every LF | read here | as VISA |
| read_termination | not supported: cut off here | cut off here | as VISA |
"""
import time

from pyvisa_py.protocols import hislip

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

    def query_slow(self, line):
        """A query whose answer takes up to some seconds."""
        return self.query(line)

    def block(self, line):
        """The data of a definite block."""
        # a gateway's client ends a read at every LF, and without a read_termination VISA does not count the last one
        self.write(line)
        answer = self.visa.read_raw()
        digits = int(answer[1:2])
        end = 2 + digits + int(answer[2 : 2 + digits])
        while len(answer) < end + 1:
            answer += self.visa.read_raw()
        assert answer[end:] == b"\n"
        return bytes(answer[2 + digits : end])


class BusLink(Link):
    """Behind a gateway."""

    has_bus = True

    def __init__(self, manager, name, gateway, timeout):
        super().__init__(manager, name, timeout)
        self.gateway = gateway

    def query_slow(self, line):
        # pyvisa-py sets 50 ms, after which a gateway gives a read up
        self.gateway.write("++read_tmo_ms 3000")
        answer = self.query(line)
        self.gateway.write("++read_tmo_ms 50")
        return answer

    def status(self):
        return self.visa.read_stb()

    def trigger(self):
        self.visa.assert_trigger()

    def clear(self):
        self.visa.clear()


class HislipLink(Link):
    """Over HiSLIP. What pyvisa-py leaves out is done with its own messages."""

    has_bus = True

    @property
    def protocol(self):
        return self.visa.visalib.sessions[self.visa.session].interface

    def status(self):
        try:
            return self.visa.read_stb()
        except RuntimeError:
            # a service request, or the notice of an interruption, came first
            while True:
                try:
                    return hislip.AsyncStatusResponse(self.protocol._async).server_status
                except RuntimeError:
                    pass

    def trigger(self):
        self.protocol.trigger()

    def clear(self):
        protocol = self.protocol
        try:
            feature = protocol.async_device_clear()
        except RuntimeError:
            feature = hislip.AsyncDeviceClearAcknowledge(protocol._async).feature_bitmap
        hislip.send_msg(protocol._sync, "DeviceClearComplete", feature, 0)
        # what was on its way is read away
        hislip.receive_flush(protocol._sync, protocol._payload_remaining)
        while (header := hislip.RxHeader(protocol._sync)).msg_type != "DeviceClearAcknowledge":
            hislip.receive_flush(protocol._sync, header.payload_length)
        protocol._message_id = 0xFFFF_FF00
        protocol.last_message_id = None


class StreamLink(Link):
    """A socket, a serial port."""

    has_bus = False

    def __init__(self, manager, name, timeout):
        super().__init__(manager, name, timeout)
        self.visa.read_termination = "\n"

    def block(self, line):
        return self.visa.query_binary_values(line, datatype="B", container=bytes)

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
