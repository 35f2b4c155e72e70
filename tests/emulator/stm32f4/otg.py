"""USB OTG FS as a device (RM0090, 34): registers, FIFOs, endpoints, and what they answer to the tokens of a host.

`usb_host.UsbHost` is the host. What the core could not do is an AssertionError at once: a FIFO written beyond its room or
beyond its transfer, a packet over the endpoint's size, an empty receive FIFO read, FIFOs larger than their RAM, endpoints
above 3. What it would do wrongly without a sign is a warning of the bus."""

from collections import deque

from .bus import Peripheral
from .events import NEVER, units

IRQ = 67
ENDPOINTS = 4
FIFO_WORDS = 320  # 1.25 KB
IDLE_US = 3000  # of an idle bus are a suspend

_GOTGINT, _GAHBCFG, _GUSBCFG, _GRSTCTL, _GINTSTS, _GINTMSK = 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18
_GRXSTSR, _GRXSTSP, _GRXFSIZ, _DIEPTXF0, _GCCFG, _CID, _DIEPTXF1 = 0x1C, 0x20, 0x24, 0x28, 0x38, 0x3C, 0x104
_DCFG, _DCTL, _DSTS, _DIEPMSK, _DOEPMSK, _DAINT, _DAINTMSK, _DIEPEMPMSK = 0x800, 0x804, 0x808, 0x810, 0x814, 0x818, 0x81C, 0x834
_IN, _OUT, _FIFO = 0x900, 0xB00, 0x1000
_CTL, _INT, _TSIZ, _TXFSTS = 0x00, 0x08, 0x10, 0x18

# GINTSTS; the first ones are levels, of what stands elsewhere.
_OTGINT, _SOF, _RXFLVL, _NPTXFE, _GINAKEFF, _GONAKEFF = 1 << 2, 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7
_ESUSP, _USBSUSP, _USBRST, _ENUMDNE, _IEPINT, _OEPINT = 1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 18, 1 << 19
_SRQINT, _WKUPINT = 1 << 30, 1 << 31
_STICKY = _SOF | _ESUSP | _USBSUSP | _USBRST | _ENUMDNE | _SRQINT | _WKUPINT
_NOT_MODELLED = _SOF | 1 << 14 | 1 << 15 | 1 << 20 | 1 << 21  # as interrupts: SOF, ISOODRP, EOPF, incomplete transfers
_SEDET = 1 << 2
# DIEPCTL, DOEPCTL.
_USBAEP, _DPID, _NAKSTS, _STALL, _CNAK, _SNAK = 1 << 15, 1 << 16, 1 << 17, 1 << 21, 1 << 26, 1 << 27
_SD0PID, _SD1PID, _EPDIS, _EPENA = 1 << 28, 1 << 29, 1 << 30, 1 << 31
_KEPT = 0x7FF | 3 << 18 | 15 << 22
# DIEPINT, DOEPINT.
_XFRC, _EPDISD, _STUP, _ITTXFE, _INEPNE, _TXFE = 1 << 0, 1 << 1, 1 << 3, 1 << 4, 1 << 6, 1 << 7
# PKTSTS of the receive FIFO.
_OUT_DATA, _OUT_DONE, _SETUP_DONE, _SETUP_DATA = 2, 3, 4, 6

ACK, NAK, STALL, SILENCE = "ACK", "NAK", "STALL", "no answer"


class _Endpoint:
    """One direction of an endpoint."""

    def __init__(self, number):
        self.number = number
        self.control = _USBAEP if number == 0 else 0
        self.interrupts = self.size = 0
        self.fifo = []  # words of an IN endpoint that wait
        self.room = 0  # words that the transfer of an IN endpoint still wants

    @property
    def packet(self):
        """The largest packet, bytes."""
        return 64 >> (self.control & 3) if self.number == 0 else self.control & 0x7FF

    @property
    def packets(self):
        return self.size >> 19 & 0x3FF

    @property
    def bytes(self):
        return self.size & 0x7FFFF

    def took(self, count):
        """One packet of so many bytes went."""
        left, packets = max(self.bytes - count, 0), max(self.packets - 1, 0)
        self.size = self.size & ~0x1FFF_FFFF | packets << 19 | left
        self.control ^= _DPID
        return packets


class OtgFs(Peripheral):
    """`host` is told by `host.changed()` of all that may make an endpoint answer otherwise than before."""

    clock = (0x34, 7)
    size = 0x4_0000

    def __init__(self, board):
        super().__init__(board, "OTG_FS", 0x5000_0000)
        self.host = None
        self.idle = None
        self.powered = False  # VBUS is there
        # An IN transfer that was enabled stays enabled over a bus reset, as NuttX found on these chips; see the README.
        self.reset_disables = False
        self.reset()

    def attach(self, events):
        self.idle = events.alarm(self._suspends)

    def reset(self):
        self.regs = {_GUSBCFG: 0x0A00, _GRXFSIZ: 0x200, _DIEPTXF0: 0x0200_0200, _CID: 0x1200}
        self.regs.update({_DIEPTXF1 + 4 * n: 0x0200_0400 + 0x200 * n for n in range(3)})
        self.status = 0
        self.otg_interrupts = 0
        self.ins = [_Endpoint(n) for n in range(ENDPOINTS)]
        self.outs = [_Endpoint(n) for n in range(ENDPOINTS)]
        self.received = deque()  # (status word, data words)
        self.popping = deque()  # data words of the packet that was popped last
        self.out_nak = self.in_nak = False
        self.setup_phase = self.suspended = False
        self.address_after_status = None
        self.frame_start = 0
        if self.idle:
            self.idle.cancel()
        self._changed()

    # The host's end of the cable.

    @property
    def attached(self):
        """The host sees a full-speed device: clock, transceiver, pins, and no soft disconnect."""
        port, rcc = self.board.ports["A"].regs, self.board.rcc
        pins = port.get(0x00, 0) >> 22 & 15 == 0b1010 and port.get(0x24, 0) >> 12 & 0xFF == 0xAA
        return bool(rcc.clocked(self.clock) and pins and self.regs.get(_GCCFG, 0) >> 16 & 1
                    and not self.regs.get(_DCTL, 0) & 2 and self._ticks())

    def _ticks(self):
        return abs(self.board.rcc.usb_hz() / 48e6 - 1) <= 0.0025

    def plugged(self, powered):
        """VBUS comes or goes; seen only where it is sensed (GCCFG.VBUSBSEN)."""
        self.powered = powered
        if self.regs.get(_GCCFG, 0) >> 19 & 1:
            if powered:
                self.status |= _SRQINT
            else:
                self.otg_interrupts |= _SEDET
        if not powered:
            self.keep_awake(False)
        self._lines()

    def keep_awake(self, on):
        """Starts of frames come every millisecond, or no more."""
        self.idle.set(NEVER if on else self.board.machine.now + units(IDLE_US))

    def resume(self):
        """Resume signalling (K)."""
        if self.suspended:
            self.suspended = False
            self.status |= _WKUPINT
            self._lines()

    def _suspends(self):
        if self.attached and not self.suspended:
            self.suspended = True
            self.status |= _ESUSP | _USBSUSP
            self._lines()

    def bus_reset(self):
        """SE0 begins: endpoints other than 0 are no longer active."""
        self.suspended = False
        self.idle.cancel()
        self.status |= _USBRST
        for side in (self.ins, self.outs):
            for ep in side[1:]:
                ep.control &= ~_USBAEP
            if self.reset_disables:
                for ep in side:
                    ep.control &= ~_EPENA
        self.setup_phase, self.address_after_status = False, None
        self.frame_start = self.board.machine.now
        self._changed()

    def enumerated(self):
        """SE0 has ended: the speed is known."""
        self.status |= _ENUMDNE
        self._lines()

    def _hears(self, address, number):
        return number < ENDPOINTS and self.attached and address == self.regs.get(_DCFG, 0) >> 4 & 0x7F

    def setup(self, address, data):
        """A SETUP transaction to endpoint 0; always taken (RM0090, 34.17.5)."""
        assert len(data) == 8
        if not self._hears(address, 0):
            return SILENCE
        for ep in (self.ins[0], self.outs[0]):
            # both directions begin anew: DATA1 comes next, nothing stands in the way but NAK
            ep.control = ep.control & ~_STALL | _NAKSTS | _DPID
        self.outs[0].size -= (1 if self.outs[0].size >> 29 & 3 else 0) << 29  # STUPCNT
        self._end_setup()
        assert self._rx_room() >= 4, "no room for a SETUP packet in the receive FIFO: GRXFSIZ is too small"
        self._push(_SETUP_DATA, 0, data)
        self.setup_phase = True
        self.address_after_status = None
        self._changed()
        return ACK

    def _end_setup(self):
        # the first token after the SETUP packets ends their stage
        if self.setup_phase:
            self.setup_phase = False
            self._push(_SETUP_DONE, 0, b"")

    def out(self, address, number, pid, data):
        """An OUT transaction with DATA0 or DATA1."""
        if not self._hears(address, number):
            return SILENCE
        ep = self.outs[number]
        if number == 0:
            self._end_setup()
            self._lines()
        if not ep.control & _USBAEP:
            return SILENCE
        if ep.control & _STALL:
            return STALL
        if ep.control & _NAKSTS or self.out_nak or self._rx_room() < 2 + -(-len(data) // 4):
            return NAK
        if len(data) > ep.packet:
            return SILENCE  # babble
        if bool(ep.control & _DPID) != bool(pid):
            return ACK  # a retransmission of what it has: dropped
        assert number == 0 or ep.packets, f"endpoint {number} receives with PKTCNT 0"
        self._push(_OUT_DATA, number, data, pid)
        if not ep.took(len(data)) or len(data) < ep.packet:
            ep.control |= _NAKSTS
            self._push(_OUT_DONE, number, b"", pid)
        self._changed()
        return ACK

    def in_(self, address, number):
        """An IN transaction; (ACK, pid, data) or (handshake, None, None)."""
        if not self._hears(address, number):
            return SILENCE, None, None
        ep = self.ins[number]
        if number == 0:
            self._end_setup()
            self._lines()
        if not ep.control & _USBAEP:
            return SILENCE, None, None
        if ep.control & _STALL:
            return STALL, None, None
        count = min(ep.bytes, ep.packet)
        words = -(-count // 4)
        if not ep.control & _EPENA or ep.control & _NAKSTS or self.in_nak or len(ep.fifo) < words:
            if not ep.fifo:
                ep.interrupts |= _ITTXFE
                self._lines()
            return NAK, None, None
        data = b"".join(word.to_bytes(4, "little") for word in ep.fifo[:words])[:count]
        del ep.fifo[:words]
        pid = ep.control >> 16 & 1
        if not ep.took(count):
            ep.control &= ~_EPENA
            ep.interrupts |= _XFRC
        if number == 0 and self.address_after_status is not None:
            self._set_address(self.address_after_status)
        self._changed()
        return ACK, pid, data

    # The receive FIFO.

    def _rx_words(self):
        return len(self.popping) + sum(1 + len(words) for _, words in self.received)

    def _rx_room(self):
        return (self.regs[_GRXFSIZ] & 0xFFFF) - self._rx_words()

    def _push(self, kind, number, data, pid=0):
        words = [int.from_bytes(data[i:i + 4], "little") for i in range(0, len(data), 4)]
        self.received.append((self._frame() % 16 << 21 | kind << 17 | 2 * pid << 15 | len(data) << 4 | number, words))

    def _pop(self):
        assert self.received, "GRXSTSP was read while the receive FIFO is empty"
        assert not self.popping, f"GRXSTSP was read with {len(self.popping)} words of the last packet left in the receive FIFO"
        status, words = self.received.popleft()
        self.popping.extend(words)
        kind, ep = status >> 17 & 15, self.outs[status & 15]
        if kind == _OUT_DONE:
            ep.control &= ~_EPENA
            ep.interrupts |= _XFRC
        elif kind == _SETUP_DONE:
            # RM0090 names this among what clears EPENA, of endpoint 0 in both directions
            ep.control &= ~_EPENA
            self.ins[0].control &= ~_EPENA
            ep.interrupts |= _STUP
        self._changed()
        return status

    # Transmit FIFOs.

    def _tx_words(self, number):
        return self.regs[_DIEPTXF0 if number == 0 else _DIEPTXF1 + 4 * (number - 1)] >> 16

    def _fill(self, number, value):
        assert number < ENDPOINTS, f"FIFO {number} was written: the core has endpoints 0 to {ENDPOINTS - 1}"
        ep = self.ins[number]
        assert ep.control & _EPENA, f"FIFO {number} was written before its endpoint was enabled"
        assert len(ep.fifo) < self._tx_words(number), f"FIFO {number} of {self._tx_words(number)} words was written beyond its room"
        assert ep.room, f"FIFO {number} was written beyond the {ep.bytes} bytes of its transfer"
        ep.fifo.append(value)
        ep.room -= 1
        if ep.room == 0:
            self._changed()

    def _txfe(self, number):
        words, size = len(self.ins[number].fifo), self._tx_words(number)
        return words == 0 if self.regs.get(_GAHBCFG, 0) & 0x80 else words <= size // 2

    def _check_fifos(self):
        """The FIFOs of active endpoints lie in the RAM and do not overlap (RM0090, 34.11, 34.16.2)."""
        top = self.regs[_GRXFSIZ] & 0xFFFF
        assert 16 <= top <= 256, f"GRXFSIZ is {top} words: 16 to 256"
        areas = [(0, top, "receive")]
        for ep in self.ins:
            if ep.control & _USBAEP:
                at = self.regs[_DIEPTXF0 if ep.number == 0 else _DIEPTXF1 + 4 * (ep.number - 1)]
                assert at >> 16 >= 16, f"FIFO {ep.number} has {at >> 16} words: 16 at least"
                assert at >> 16 >= -(-ep.packet // 4), f"FIFO {ep.number} holds no packet of {ep.packet} bytes"
                areas.append((at & 0xFFFF, (at & 0xFFFF) + (at >> 16), f"transmit {ep.number}"))
        areas.sort()
        for (_, end, name), (start, _, other) in zip(areas, areas[1:]):
            assert end <= start, f"the FIFOs {name} and {other} overlap: {areas}"
        assert areas[-1][1] <= FIFO_WORDS, f"FIFOs of {areas[-1][1]} words in a RAM of {FIFO_WORDS}"
        largest = max([ep.packet for ep in self.outs if ep.control & _USBAEP])
        wanted = 13 + largest // 4 + 1 + 2 * sum(bool(ep.control & _USBAEP) for ep in self.outs) + 1
        if top < wanted:
            self.board.bus.warn(f"OTG_FS: a receive FIFO of {top} words, RM0090 asks for {wanted}")

    def _flush(self, value):
        if value & 0x10:
            self.received.clear()
            self.popping.clear()
        if value & 0x20:
            which = value >> 6 & 31
            for ep in self.ins:
                if which in (ep.number, 16):
                    quiet = ep.control & _NAKSTS or self.status & _USBRST  # no token comes
                    if ep.fifo and ep.control & _EPENA and not quiet:
                        self.board.bus.warn(f"OTG_FS: FIFO {ep.number} was flushed while its endpoint transmits from it")
                    ep.fifo.clear()
        self._changed()

    # Endpoints' registers.

    def _control(self, ep, value, is_in):
        before = ep.control
        name = f"{'IN' if is_in else 'OUT'} endpoint {ep.number}"
        if ep.number == 0:
            control = before & ~(3 | 15 << 22) | value & (3 | 15 << 22)
            control |= value & _STALL  # cleared by the core alone, with the next SETUP
        else:
            control = before & ~(_KEPT | _USBAEP | _STALL) | value & (_KEPT | _USBAEP | _STALL)
            if value & _SD0PID:
                control &= ~_DPID
            if value & _SD1PID:
                control |= _DPID
        if value & _CNAK and value & _SNAK:
            self.board.bus.warn(f"OTG_FS: {name}: NAK set and cleared at once")
        if value & _SNAK:
            control |= _NAKSTS
            if is_in:
                ep.interrupts |= _INEPNE
        elif value & _CNAK:
            control &= ~_NAKSTS
            if is_in:
                ep.interrupts &= ~_INEPNE
        ep.control = control
        if value & _EPDIS and before & _EPENA:
            if is_in or self.out_nak:
                ep.control &= ~_EPENA
                ep.interrupts |= _EPDISD
            else:
                self.board.bus.warn(f"OTG_FS: {name} was disabled without global OUT NAK")
        elif value & _EPENA:
            if not before & _EPENA:
                self._enable(ep, is_in, name)
            ep.control |= _EPENA
        if control & ~before & _USBAEP:
            assert not is_in or control >> 22 & 15 == ep.number, f"{name} is given FIFO {control >> 22 & 15}: not modelled"
            assert control >> 18 & 3 != 1, f"{name} is isochronous: not modelled"
            assert 1 <= ep.packet <= 64, f"{name} is given packets of {ep.packet} bytes"
            self._check_fifos()
        self._changed()

    def _enable(self, ep, is_in, name):
        count, packets = ep.bytes, ep.packets
        assert packets, f"{name} was enabled with PKTCNT 0"
        assert count <= packets * ep.packet, f"{name}: {count} bytes in {packets} packets of {ep.packet}"
        if is_in:
            assert not ep.fifo, f"{name} was enabled with {len(ep.fifo)} words in its FIFO of a transfer before"
            ep.room = -(-count // 4) if packets == 1 else count // ep.packet * -(-ep.packet // 4) + -(-(count % ep.packet) // 4)

    def _set_address(self, address):
        self.regs[_DCFG] = self.regs.get(_DCFG, 0) & ~0x7F0 | address << 4
        self.address_after_status = None

    # Interrupts.

    def _endpoint_bits(self):
        bits = 0
        diepmsk, doepmsk, empty = (self.regs.get(r, 0) for r in (_DIEPMSK, _DOEPMSK, _DIEPEMPMSK))
        for n in range(ENDPOINTS):
            if self.ins[n].interrupts & diepmsk or empty >> n & 1 and self._txfe(n):
                bits |= 1 << n
            if self.outs[n].interrupts & doepmsk:
                bits |= 1 << 16 + n
        return bits

    def _flags(self):
        waiting = self._endpoint_bits() & self.regs.get(_DAINTMSK, 0)
        return (self.status | _NPTXFE | bool(self.received) * _RXFLVL | bool(self.otg_interrupts) * _OTGINT
                | self.in_nak * _GINAKEFF | self.out_nak * _GONAKEFF
                | bool(waiting & 0xFFFF) * _IEPINT | bool(waiting >> 16) * _OEPINT)

    def _lines(self):
        on = self.regs.get(_GAHBCFG, 0) & 1 and self._flags() & self.regs.get(_GINTMSK, 0)
        self.board.nvic.set_line(IRQ, bool(on))

    def _changed(self):
        self._lines()
        if self.host:
            self.host.changed()

    def _frame(self):
        return (self.board.machine.now - self.frame_start) // units(1000) & 0x3FFF

    # What the program reads and writes.

    def _endpoint_at(self, offset):
        side, base = (self.ins, _IN) if offset < _OUT else (self.outs, _OUT)
        number = offset - base >> 5
        assert number < ENDPOINTS, f"a register of endpoint {number} at {offset:#x}: the core has {ENDPOINTS}"
        return side[number], side is self.ins, offset & 0x1F

    def read(self, offset):
        if offset >= _FIFO:
            # every window reads the one receive FIFO
            assert self.popping, "the receive FIFO was read beyond the packet that GRXSTSP told of"
            word = self.popping.popleft()
            self._changed()
            return word
        if _IN <= offset < _OUT + 0x200:
            ep, is_in, register = self._endpoint_at(offset)
            if register == _TXFSTS and is_in:
                return self._tx_words(ep.number) - len(ep.fifo)
            if register == _INT and is_in:
                return ep.interrupts | self._txfe(ep.number) * _TXFE
            return {_CTL: ep.control, _INT: ep.interrupts, _TSIZ: ep.size}.get(register, 0)
        if offset == _GRXSTSR:
            assert self.received, "GRXSTSR was read while the receive FIFO is empty"
            return self.received[0][0]
        if offset == _GRXSTSP:
            return self._pop()
        if offset == _GINTSTS:
            return self._flags()
        if offset == _DAINT:
            return self._endpoint_bits()
        if offset == _GOTGINT:
            return self.otg_interrupts
        if offset == _GRSTCTL:
            return 1 << 31
        if offset == _DSTS:
            return self._frame() << 8 | 3 << 1 | self.suspended
        if offset == _DCTL:
            return self.regs.get(_DCTL, 0) & ~0x780 | self.in_nak << 2 | self.out_nak << 3
        return self.regs.get(offset, 0)

    def other_bytes(self, offset):
        assert False, f"OTG_FS+{offset:#x} was written with less than a word"

    def write(self, offset, value):
        if offset >= _FIFO:
            self._fill(offset - _FIFO >> 12, value)
        elif _IN <= offset < _OUT + 0x200:
            ep, is_in, register = self._endpoint_at(offset)
            if register == _CTL:
                self._control(ep, value, is_in)
            elif register == _INT:
                ep.interrupts &= ~value
                self._lines()
            elif register == _TSIZ:
                if is_in and ep.control & _EPENA:
                    self.board.bus.warn(f"OTG_FS: DIEPTSIZ{ep.number} was written while the endpoint is enabled")
                ep.size = value
        elif offset == _GINTSTS:
            self.status &= ~(value & _STICKY)
            self._lines()
        elif offset == _GOTGINT:
            self.otg_interrupts &= ~value
            self._lines()
        elif offset == _GRSTCTL:
            if value & 1:
                self.reset()
            self._flush(value)
        else:
            self._write_plain(offset, value)

    def _write_plain(self, offset, value):
        if offset == _DCFG:
            now, address = self.regs.get(_DCFG, 0) >> 4 & 0x7F, value >> 4 & 0x7F
            # a new address counts from the end of the status stage on
            self.address_after_status = address if address and address != now else None
            value = value & ~0x7F0 | (now if address else 0) << 4
        elif offset == _DCTL:
            self.out_nak = self.out_nak and not value & 1 << 10 or bool(value & 1 << 9)
            self.in_nak = self.in_nak and not value & 1 << 8 or bool(value & 1 << 7)
        elif offset == _GINTMSK and value & _NOT_MODELLED:
            self.board.bus.warn(f"OTG_FS: interrupts {value & _NOT_MODELLED:#x} were switched on, which are not modelled")
        self.regs[offset] = value
        if offset == _DCTL and not (self.host and self.host.frames):
            # connected to a bus where nothing moves
            self.keep_awake(False)
        self._changed()
