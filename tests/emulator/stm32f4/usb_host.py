"""A USB host at the other end of the cable: transactions at the speed of the wire, transfers, enumeration (USB 2.0).

Transfers of several endpoints go on side by side, also while the test does something else; the calls of `UsbHost` that wait
let the board live meanwhile. A transfer that the device answers with NAK is tried again once something has changed in the
device, an interrupt endpoint once in its interval."""

from .board import Timeout
from .events import NEVER, UNITS_PER_US, units
from .otg import ACK, NAK, SILENCE, STALL

IN, OUT = 0x80, 0x00
# bmRequestType (9.3): direction, type, recipient.
STANDARD, CLASS, VENDOR = 0x00, 0x20, 0x40
DEVICE, INTERFACE, ENDPOINT = 0, 1, 2
(GET_STATUS, CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS, GET_DESCRIPTOR, GET_CONFIGURATION, SET_CONFIGURATION, GET_INTERFACE,
 SET_INTERFACE) = 0, 1, 3, 5, 6, 8, 9, 10, 11
DEVICE_DESCRIPTOR, CONFIGURATION_DESCRIPTOR, STRING_DESCRIPTOR, BOS_DESCRIPTOR = 1, 2, 3, 15
ENDPOINT_HALT = 0
ENGLISH = 0x0409

# A host looks again at an endpoint that had nothing this long after something changed in the device.
_RETRY_US = 3
_TRIES = 3
# USB 2.0 asks for 100 ms of debouncing (7.1.7.3) and 50 ms of reset from the root port (7.1.7.5); a hub resets for 10 ms.
# Nothing in the device counts them.
_DEBOUNCE_US, _RESET_US, _RECOVERY_US, _RESUME_US = 5_000, 10_000, 2_000, 20_000


class Stall(Exception):
    """The device refused: STALL."""


class NoAnswer(Exception):
    """The device did not answer three times, or is no longer there."""


def _bus_units(count):
    """A transaction with so many bytes, at full speed (5.11.3), the host's own delay left out."""
    return round((9.107 + 0.08354 * (3.167 + 7 / 6 * 8 * count)) * UNITS_PER_US)


class Transfer:
    """One transfer: `done`, then `result` or `error`; `packets`, the length of each packet that came or went."""

    def __init__(self, steps):
        self.steps, self.request = steps, None
        self.done, self.result, self.error = False, None, None
        self.data, self.packets = bytearray(), []
        self.tries = 0

    def __repr__(self):
        return f"transfer with {len(self.data)} bytes come, packets {self.packets[-8:]}"


class _Pipe:
    """An endpoint as the host sees it."""

    def __init__(self, address):
        self.address = address
        self.packet, self.interval_us, self.toggle = 64, None, 0
        self.queue = []
        self.ready_at, self.waits = 0, False
        self.naks = 0


class UsbHost:
    """`plug()` first. Endpoints are named by their address, 0x81 for IN 1. Times are in microseconds."""

    def __init__(self, board):
        self.board, self.otg = board, board.otg
        self.otg.host = self
        self.slot = board.machine.events.alarm(self._transact)
        self.plugged = self.frames = False
        self.bus_free = 0
        self._waiting = None
        self._forget()

    def _forget(self):
        self.address = 0
        self.pipes = {}
        self.device = self.configuration = self.bos = b""
        self.strings = {}
        self.retransmitted = 0  # packets of the device that came with the wrong DATA0 or DATA1: dropped

    # The cable.

    def plug(self):
        """The cable goes in; the device may need some time before it shows itself."""
        self.plugged = True
        self.otg.plugged(True)

    def unplug(self):
        """The cable comes out: whatever was under way fails."""
        self.plugged = self.frames = False
        self._fail_all("unplugged")
        self.otg.plugged(False)

    @property
    def attached(self):
        """The device shows itself at the plug."""
        return self.plugged and self.otg.attached

    def reset(self, us=_RESET_US):
        """Drives a reset; the device is in its default state then."""
        if not self.attached:
            raise NoAnswer("there is no device at the cable")
        self._fail_all("the bus was reset")
        self._forget()
        self.otg.bus_reset()
        self.board.run(us)
        self.frames = True
        self.otg.enumerated()
        self.otg.keep_awake(True)
        self.board.run(_RECOVERY_US)

    def suspend(self, us=10_000):
        """No frames any more."""
        self.frames = False
        self.otg.keep_awake(False)
        self.board.run(us)

    def resume(self):
        self.otg.resume()
        self.board.run(_RESUME_US)
        self.frames = True
        self.otg.keep_awake(True)
        self._plan()

    # Transfers.

    def submit(self, address, steps):
        """Queues a transfer: a generator of ('SETUP' | 'IN' | 'OUT', pid or None for the endpoint's own, data)."""
        pipe = self._pipe(address)
        transfer = Transfer(steps)
        transfer.pipe = pipe
        pipe.queue.append(transfer)
        self._advance(pipe, transfer, None)
        pipe.ready_at = min(pipe.ready_at, self.board.machine.now) if pipe.interval_us is None else pipe.ready_at
        self._plan()
        return transfer

    def wait(self, transfer, timeout_us=1_000_000, what="the transfer"):
        """Lets the board live until it is done; answers its result or raises its error."""
        machine = self.board.machine
        self._waiting = transfer
        try:
            if not transfer.done:
                machine.run_to(machine.now + units(timeout_us))
        finally:
            self._waiting = machine.stop_request = None
        if not transfer.done:
            self.cancel(transfer)
            raise Timeout(f"{what} did not end within {timeout_us} us: {transfer}; {self.board.describe()}")
        if transfer.error:
            raise transfer.error
        return transfer.result

    def cancel(self, transfer):
        """The host gives it up; the device is told nothing."""
        if not transfer.done:
            transfer.pipe.queue.remove(transfer)
            transfer.pipe.waits, transfer.pipe.ready_at = False, self.board.machine.now
            transfer.done, transfer.error = True, NoAnswer("cancelled")

    def control_in(self, kind, request, value, index, length, timeout_us=1_000_000):
        """A control transfer that reads; `kind`: type and recipient."""
        steps = self._control(bytes([kind | IN, request]) + _u16(value) + _u16(index) + _u16(length), length, None)
        return self.wait(self.submit(0, steps), timeout_us, f"control request {request:#x}")

    def control_out(self, kind, request, value, index, data=b"", timeout_us=1_000_000):
        """A control transfer that writes `data`, or has no data stage."""
        steps = self._control(bytes([kind, request]) + _u16(value) + _u16(index) + _u16(len(data)), 0, data)
        self.wait(self.submit(0, steps), timeout_us, f"control request {request:#x}")

    def bulk_out(self, address, data, timeout_us=1_000_000, zlp=False):
        """Writes; `zlp` ends data of whole packets with an empty one."""
        self.wait(self.start_out(address, data, zlp), timeout_us, f"bulk OUT {address:#x} of {len(data)} bytes")

    def start_out(self, address, data, zlp=False):
        """The same, not waited for."""
        return self.submit(address, self._bulk_out(address, bytes(data), zlp))

    def bulk_in(self, address, size, timeout_us=1_000_000):
        """Reads until `size` bytes have come or a short packet."""
        return self.wait(self.start_in(address, size), timeout_us, f"bulk IN {address:#x}")

    def start_in(self, address, size=NEVER, on_packet=None, forever=False):
        """The same, not waited for; `on_packet(data)` hears of each packet, `forever` reads on behind a short one."""
        return self.submit(address, self._bulk_in(address, size, on_packet, forever))

    def interrupt_in(self, address, timeout_us=1_000_000):
        """One packet of an interrupt endpoint."""
        return self.wait(self.start_in(address, self._pipe(address).packet), timeout_us, f"interrupt IN {address:#x}")

    def clear_halt(self, address, timeout_us=1_000_000):
        """CLEAR_FEATURE(ENDPOINT_HALT): DATA0 comes next on both sides (9.4.5)."""
        self.control_out(STANDARD | ENDPOINT, CLEAR_FEATURE, ENDPOINT_HALT, address, timeout_us=timeout_us)
        self._pipe(address).toggle = 0

    def halted(self, address):
        """GET_STATUS of an endpoint."""
        return self.control_in(STANDARD | ENDPOINT, GET_STATUS, 0, address, 2) == b"\x01\x00"

    # Steps of transfers.

    def _control(self, setup, length, data):
        yield "SETUP", 0, setup
        got, pid, size = bytearray(), 1, self._pipe(0).packet
        while setup[0] & IN and len(got) < length:
            packet = yield "IN", pid, b""
            got += packet
            pid ^= 1
            if len(packet) < size:
                break
        for at in range(0, len(data or b""), size):
            yield "OUT", pid, data[at:at + size]
            pid ^= 1
        # status: the other direction, DATA1
        if setup[0] & IN and length:
            yield "OUT", 1, b""
        else:
            assert (yield "IN", 1, b"") == b"", "the status stage carries no data"
        return bytes(got)

    def _bulk_out(self, address, data, zlp):
        size = self._pipe(address).packet
        for at in range(0, len(data), size):
            yield "OUT", None, data[at:at + size]
        if not data or zlp and len(data) % size == 0:
            yield "OUT", None, b""

    def _bulk_in(self, address, size, on_packet, forever):
        got, packet = bytearray(), self._pipe(address).packet
        while len(got) < size:
            data = yield "IN", None, b""
            if on_packet:
                on_packet(data)
            else:
                got += data
            if len(data) < packet and not forever:
                break
        return bytes(got)

    # The bus.

    def _pipe(self, address):
        return self.pipes.setdefault(address, _Pipe(address))

    def changed(self):
        """Something is different in the device: who heard NAK may try again."""
        again = self.board.machine.now + units(_RETRY_US)
        for pipe in self.pipes.values():
            if pipe.waits:
                pipe.waits, pipe.ready_at = False, again
        self._plan()

    def _plan(self):
        at = NEVER
        if self.frames:
            for pipe in self.pipes.values():
                if pipe.queue and pipe.ready_at < at:
                    at = pipe.ready_at
        self.slot.set(max(at, self.bus_free, self.board.machine.now) if at < NEVER else NEVER)

    def _transact(self):
        now = self.board.machine.now
        ready = [pipe for pipe in self.pipes.values() if pipe.queue and pipe.ready_at <= now]
        if self.frames and ready:
            pipe = min(ready, key=lambda pipe: pipe.ready_at)
            self._transaction(pipe, pipe.queue[0])
        self._plan()

    def _transaction(self, pipe, transfer):
        kind, pid, data = transfer.request
        number, expected = pipe.address & 15, pipe.toggle if pid is None else pid
        came = None
        if kind == "SETUP":
            answer = self.otg.setup(self.address, data)
        elif kind == "OUT":
            answer = self.otg.out(self.address, number, expected, data)
        else:
            answer, came, data = self.otg.in_(self.address, number)
        now = self.board.machine.now
        self.bus_free = pipe.ready_at = now + _bus_units(len(data or b""))
        if answer == ACK:
            transfer.tries = 0
            if came is not None and came != expected:
                self.retransmitted += 1
                return
            if pid is None:
                pipe.toggle ^= 1
            if kind != "SETUP":
                transfer.packets.append(len(data))
            if kind == "IN":
                transfer.data += data
            if pipe.interval_us is not None:
                pipe.ready_at = now + units(pipe.interval_us)
            self._advance(pipe, transfer, data)
        elif answer == NAK:
            pipe.naks += 1
            transfer.tries = 0
            if pipe.interval_us is not None:
                pipe.ready_at = now + units(pipe.interval_us)
            else:
                pipe.waits, pipe.ready_at = True, NEVER
        elif answer == STALL:
            self._end(transfer, error=Stall(f"endpoint {pipe.address:#04x} answered STALL"))
        else:
            assert answer == SILENCE
            transfer.tries += 1
            if transfer.tries == _TRIES:
                self._end(transfer, error=NoAnswer(f"endpoint {pipe.address:#04x} of address {self.address} does not answer"))

    def _advance(self, pipe, transfer, data):
        try:
            transfer.request = transfer.steps.send(data)
        except StopIteration as end:
            self._end(transfer, result=end.value)

    def _end(self, transfer, result=None, error=None):
        transfer.pipe.queue.remove(transfer)
        transfer.done, transfer.result, transfer.error = True, result, error
        if transfer is self._waiting:
            self.board.machine.stop_request = True

    def _fail_all(self, why):
        for pipe in self.pipes.values():
            for transfer in list(pipe.queue):
                self._end(transfer, error=NoAnswer(why))
        self.slot.cancel()

    # Enumeration.

    def descriptor(self, kind, index=0, language=0, length=255, timeout_us=1_000_000):
        return self.control_in(STANDARD | DEVICE, GET_DESCRIPTOR, kind << 8 | index, language, length, timeout_us)

    def string(self, index):
        """A string descriptor as text."""
        return self.descriptor(STRING_DESCRIPTOR, index, ENGLISH)[2:].decode("utf-16-le")

    def address_it(self, address=5):
        """Reset, the first look, reset, SET_ADDRESS: as PCs do."""
        self.board.run_until(lambda: self.attached, 300_000, "a device at the plug", step_us=1000)
        self.board.run(_DEBOUNCE_US)
        self.reset()
        first = self.descriptor(DEVICE_DESCRIPTOR, length=64)
        packet = first[7]
        self.reset()
        self._pipe(0).packet = packet
        self.control_out(STANDARD | DEVICE, SET_ADDRESS, address, 0)
        self.address = address
        self.board.run(2000)  # 9.2.6.3

    def enumerate(self, address=5):
        """Addresses the device, reads its descriptors and configures it."""
        self.address_it(address)
        self.device = self.descriptor(DEVICE_DESCRIPTOR, length=18)
        if int.from_bytes(self.device[2:4], "little") >= 0x0201:
            head = self.descriptor(BOS_DESCRIPTOR, length=5)
            self.bos = self.descriptor(BOS_DESCRIPTOR, length=int.from_bytes(head[2:4], "little"))
        head = self.descriptor(CONFIGURATION_DESCRIPTOR, length=9)
        self.configuration = self.descriptor(CONFIGURATION_DESCRIPTOR, length=int.from_bytes(head[2:4], "little"))
        for name, index in zip(("manufacturer", "product", "serial"), self.device[14:17]):
            if index:
                self.strings[name] = self.string(index)
        self.configure()
        return self

    def configure(self):
        """SET_CONFIGURATION of the only configuration: all endpoints begin with DATA0 (9.1.1.5)."""
        self.control_out(STANDARD | DEVICE, SET_CONFIGURATION, self.configuration[5], 0)
        for parts in descriptors(self.configuration):
            if parts[1] == 5:
                pipe = self._pipe(parts[2])
                pipe.packet, pipe.toggle = int.from_bytes(parts[4:6], "little"), 0
                pipe.interval_us = parts[6] * 1000 if parts[3] & 3 == 3 else None

    def interfaces(self):
        """{number: (class, subclass, protocol, [endpoint addresses])} of the configuration."""
        found, number = {}, None
        for parts in descriptors(self.configuration):
            if parts[1] == 4:
                number = parts[2]
                found[number] = (*parts[5:8], [])
            elif parts[1] == 5:
                found[number][3].append(parts[2])
        return found


def descriptors(data):
    """Splits what GET_DESCRIPTOR gave."""
    out = []
    while data:
        out.append(data[:data[0]])
        data = data[data[0]:]
    return out


def _u16(value):
    return value.to_bytes(2, "little")
