"""Timers (RM0090, 17 to 20): up-counting, compare flags, DMA requests, gating by ETR, clocking one timer from another.

Counters are computed when somebody looks; alarms stand only for what interrupts. Not modelled: capture, outputs, down- and
centre-counting, encoder mode, repetition counter, burst DMA."""

from .bus import Peripheral
from .dma import SERVICE_CYCLES
from .events import NEVER

_CR1, _CR2, _SMCR, _DIER, _SR, _EGR = range(0, 0x18, 4)
_CNT, _PSC, _ARR, _CCR1 = 0x24, 0x28, 0x2C, 0x34
_CEN, _UDIS, _URS, _OPM, _ARPE = 1, 2, 4, 8, 0x80
_UIF, _TIF = 1, 0x40
_GATED, _EXTERNAL_1 = 5, 7
_ETRF = 7
# ETR filter (SMCR.ETF): samples and clock divider of each code.
_FILTER = (
    (0, 0), (2, 1), (4, 1), (8, 1), (6, 2), (8, 2), (6, 4), (8, 4), (6, 8), (8, 8), (5, 16), (6, 16), (8, 16), (5, 32),
    (6, 32), (8, 32),
)
_SYNC_CYCLES = 3
# At most this many updates are counted at once.
_BATCH = 128
# While nothing else asks, the streams are looked after at least this often.
_LOOK_TICKS = 192


class Timer(Peripheral):
    """`irqs`: interrupt numbers of update, compare and trigger. `requests`: DMA requests as {'UP' or 'CH1'…: [(stream, channel)]}."""

    def __init__(self, board, number, base, clock, irqs, channels=4, bits=16, requests=None):
        super().__init__(board, f"TIM{number}", base)
        self.clock, self.irqs, self.channels, self.limit = clock, irqs, channels, (1 << bits) - 1
        self.fast = base >= 0x4001_0000
        self.requests = requests or {}
        self.slave, self.master = None, None  # (timer clocked by our TRGO); (TS code, the timer that clocks us)
        self.pulse = None  # called with the time of each pulse of our TRGO on a match of channel 1
        self.alarm = None
        self.gate = self.gate_pin = self.gate_alarm = None
        self.marks = []  # (word count, callback), earliest first
        self.overflows = 0
        self.reset()

    def attach(self, events):
        self.alarm = events.alarm(self._alarm)
        self.gate_alarm = events.alarm(self._gate_passes)

    def reset(self):
        if self.alarm:
            self.alarm.cancel()
        self.regs = {}
        self.cr1 = self.smcr = self.dier = self.sr = self.cnt = self.psc = self.psc_next = self.phase = 0
        self.arr = self.arr_next = self.limit
        self.ccr = [0] * 4
        self.latched = set()  # requests raised and not served
        self.gate = False
        self.frozen = False
        self.ref = self.board.machine.now if hasattr(self.board, "machine") else 0
        self._lines()

    # Counting.

    @property
    def tick(self):
        """Units per tick; zero when the clock stands."""
        return (self.board.rcc.timer2 if self.fast else self.board.rcc.timer1) * (self.psc + 1)

    @property
    def external(self):
        return self.smcr & 7 == _EXTERNAL_1

    def _counts(self):
        if not self.cr1 & _CEN or self.external or self.frozen:
            return False
        return self.smcr & 7 != _GATED or self.gate

    def sync(self):
        """Counts up to now."""
        if self.external:
            if self.master and self.master[0] == self.smcr >> 4 & 7:
                self.master[1].sync()
            return
        now, tick = self.board.machine.now, self.tick
        if tick and self._counts():
            ticks = (now - self.ref) // tick
            while ticks > 0:
                some = min(ticks, self._batch() * (self.arr + 1))
                self._advance(some, tick)
                self.ref += some * tick
                ticks = (now - self.ref) // tick if self._counts() else 0
        else:
            self.ref = now

    def _batch(self):
        """Updates that may be counted at once: neither stream may reach what the other one has just touched."""
        play, clear = self.stream_of("UP"), self.stream_of("CH1")
        if not play or not clear or not play.total:
            return _BATCH
        apart = (play.slot - clear.slot) % play.total
        return max(min(_BATCH, apart - 2, play.total - apart - 2), 1)

    def clocked(self, count, time, step):
        """Ticks from the timer whose TRGO clocks this one, the first at `time`, `step` units apart."""
        if self.external and self.cr1 & _CEN and not self.frozen:
            first = time + (self.psc - self.phase) * step
            count += self.phase
            self.phase = count % (self.psc + 1)
            self._advance(count // (self.psc + 1), 0, first, step * (self.psc + 1))

    def _advance(self, count, tick, first=None, apart=0):
        """`first`, `apart`: times of the ticks, where another timer gives them."""
        if not count or not self.arr:
            return
        if self.cnt > self.arr:  # ARR was lowered below the counter: it runs to its end first
            up = self.limit + 1 - self.cnt
            if count < up:
                self.cnt += count
                return
            count -= up
            self.cnt = 0
            self._update(1, self.ref + up * tick, tick)
        span, cnt = self.arr + 1, self.cnt
        wraps = (cnt + count) // span
        if wraps and self.cr1 & _OPM:
            count, wraps = span - cnt, 1
            self.cr1 &= ~_CEN
        self.cnt = (cnt + count) % span
        for i in range(self.channels):
            ccr = self.ccr[i]
            if ccr <= self.arr:
                hits = (cnt + count - ccr) // span - (cnt - ccr) // span
                if hits:
                    self.sr |= 2 << i
                    if self.dier >> 9 + i & 1 and not self.regs.get(_CR2, 0) & 8:
                        self._request(f"CH{i + 1}", hits)
                    if i == 0:
                        at = (ccr - cnt - 1) % span
                        begin, each = (self.ref + tick, tick) if first is None else (first, apart)
                        for hit in range(hits):
                            self._pulse(begin + (at + hit * span) * each)
        if wraps:
            self._update(wraps, self.ref + (span - cnt) * tick, span * tick)
        self._lines()

    def _pulse(self, time):
        if self.pulse and self.regs.get(_CR2, 0) >> 4 & 7 == 3:
            self.pulse(time)

    def _update(self, count, time, step):
        """`count` update events, the first at `time`, `step` units apart."""
        self.overflows += count
        if self.cr1 & _UDIS:
            return
        self.psc, self.arr = self.psc_next, self.arr_next
        self.sr |= _UIF
        if self.dier >> 8 & 1:
            self._request("UP", count, time, step)
        if self.regs.get(_CR2, 0) & 8:
            for i in range(self.channels):
                if self.dier >> 9 + i & 1:
                    self._request(f"CH{i + 1}", count)
        if self.slave and self.regs.get(_CR2, 0) >> 4 & 7 == 2:
            self.slave.clocked(count, time, step)

    def stream_of(self, source):
        for stream, channel in self.requests.get(source, ()):
            if stream.enabled and stream.channel == channel:
                return stream
        return None

    def _request(self, source, count, time=None, step=0):
        stream = self.stream_of(source)
        served = stream.serve(count, time, step) if stream else 0
        if served < count:
            self.latched.add(source)

    def _software_request(self, source):
        stream, now = self.stream_of(source), self.board.machine.now
        if stream and now - stream.last_service < SERVICE_CYCLES * self.board.rcc.ahb:
            self.board.merged_requests += 1
            self.board.bus.warn(f"{self.name}: a software event came before the DMA had served the last one and was lost")
        else:
            self._request(source, 1, now, 0)

    def dma_ready(self):
        """A stream was enabled: a request that waits is served."""
        for source in sorted(self.latched):
            if self.stream_of(source):
                self.latched.discard(source)
                self._request(source, 1, self.board.machine.now, 0)

    # What interrupts next.

    def _ticks_to_event(self):
        """Ticks of this counter until it raises an interrupt or a mark is due; None if it does not."""
        span, best = self.arr + 1, None
        if not self.arr:
            return None

        def consider(ticks):
            nonlocal best
            if best is None or ticks < best:
                best = ticks
        if self.cnt > self.arr:
            return self.limit + 1 - self.cnt if self.dier & 0x5F else None
        to_update = span - self.cnt
        if self.dier & 1 and not self.sr & _UIF:
            consider(to_update)
        for i in range(self.channels):
            if self.dier >> 1 + i & 1 and not self.sr >> 1 + i & 1 and self.ccr[i] <= self.arr:
                consider((self.ccr[i] - self.cnt - 1) % span + 1)
            if self.dier >> 9 + i & 1:
                stream = self.stream_of(f"CH{i + 1}")
                requests = stream.requests_to_interrupt() if stream else None
                if requests:
                    consider((self.ccr[i] - self.cnt - 1) % span + 1 + (requests - 1) * span)
        if self.dier >> 8 & 1:
            stream = self.stream_of("UP")
            requests = stream.requests_to_interrupt() if stream else None
            if requests:
                consider(to_update + (requests - 1) * span)
            if self.marks and stream:
                consider(to_update + max(self.marks[0][0] - len(self.board.words) - 1, 0) * span)
        if self.slave and self.slave.external and self.slave.cr1 & _CEN and self.regs.get(_CR2, 0) >> 4 & 7 == 2:
            ticks = self.slave._ticks_to_event()
            if ticks:
                consider(to_update + (ticks * (self.slave.psc + 1) - self.slave.phase - 1) * span)
        return best

    def reschedule(self):
        """Sets the alarm for what comes next."""
        if self.external:
            self.alarm.cancel()
            if self.master:
                self.master[1].reschedule()
            return
        tick = self.tick
        ticks = self._ticks_to_event() if tick and self._counts() else None
        self.alarm.set(NEVER if ticks is None else self.ref + ticks * tick)
        if self.requests:
            self._watch_ring(tick)

    def _watch_ring(self, tick):
        """What the streams may reach before the next look: a store there must first let them do what they have done."""
        machine, state = self.board.machine, self.board.core.state
        streams = [s for s in (self.stream_of("UP"), self.stream_of("CH1")) if s]
        if not streams or not tick or not self._counts() or not self.dier & 0x7F00:
            machine.watch_stores(NEVER)
            state.window_size = 0
            return
        for i, stream in enumerate((streams[0], streams[-1])):
            state.window[i] = stream.m0ar + 4 * stream.slot - state.ring_base
        state.window_size = 4 * (_LOOK_TICKS + 8)
        machine.watch_stores(self.ref + _LOOK_TICKS * (self.arr + 1) * tick)

    def _alarm(self):
        self.sync()
        while self.marks and self.marks[0][0] <= len(self.board.words):
            self.marks.pop(0)[1]()
        self.reschedule()

    def add_mark(self, count, callback):
        self.sync()
        self.marks.append((count, callback))
        self.marks.sort(key=lambda mark: mark[0])
        self.reschedule()

    def clocks_change(self):
        self.sync()
        if not self.external and self._counts() and self.tick:
            # The part of a tick that has passed is kept as whole units of the old clock: below one tick.
            self.ref = self.board.machine.now

    def clocks_changed(self):
        if self.alarm:
            self.reschedule()

    def freeze(self, frozen):
        """A debugger holds the core and DBGMCU says that this timer waits."""
        if frozen != self.frozen:
            self.sync()
            self.frozen = frozen
            self.ref = self.board.machine.now
            self.reschedule()

    # The gate.

    def watch_gate(self, port, pin, alternate):
        """ETR is this pin when it is in the alternate function of that number, low otherwise."""
        self.gate_pin = (port, pin, alternate)
        port.watchers.append(lambda changed, levels: changed >> pin & 1 and self._gate_moves())

    def _etr(self):
        port, pin, alternate = self.gate_pin
        level = port.mode(pin) == 2 and port.alternate(pin) == alternate and port.levels >> pin & 1
        return bool(level) != bool(self.smcr >> 15 & 1)

    def _gate_moves(self):
        """The level behind the filter follows once it has been stable for the filter's samples."""
        if not self.gate_alarm:
            return
        samples, divider = _FILTER[self.smcr >> 8 & 15]
        cycle = self.board.rcc.timer2 or 1
        dts = 1 if self.smcr >> 8 & 15 <= 3 else 1 << (self.cr1 >> 8 & 3)
        if self._etr() == self.gate:
            self.gate_alarm.cancel()
        else:
            self.gate_alarm.set(self.board.machine.now + (_SYNC_CYCLES + samples * divider * dts) * cycle)

    def _gate_passes(self):
        if self._etr() == self.gate:
            return
        self.sync()
        self.gate = not self.gate
        if self.smcr & 7 == _GATED and self.smcr >> 4 & 7 == _ETRF:
            if self.cr1 & _CEN:
                self.sr |= _TIF
            self.ref = self.board.machine.now
        self._lines()
        self.reschedule()

    # Registers.

    def _lines(self):
        active = self.sr & self.dier
        update, compare, trigger = self.irqs
        lines = {}
        for irq, level in ((update, active & _UIF), (compare, active & 0x1E), (trigger, active & _TIF)):
            if irq is not None:
                lines[irq] = lines.get(irq, False) or bool(level)
        for irq, level in lines.items():
            self.board.nvic.set_line(irq, level)

    def _updates_ahead(self):
        """Update events since the last look that TRGO hands on; None if it takes a look to tell."""
        tick = self.tick
        if not tick or not self._counts() or self.regs.get(_CR2, 0) >> 4 & 7 != 2:
            return 0
        if self.cnt > self.arr or not self.arr or self.cr1 & (_UDIS | _OPM):
            return None
        return (self.cnt + (self.board.machine.now - self.ref) // tick) // (self.arr + 1)

    def _count(self):
        """The counter now, without serving what its ticks ask for where that is possible."""
        if self.external and self.master and self.master[0] == self.smcr >> 4 & 7 and self.cr1 & _CEN and not self.frozen:
            ahead = self.master[1]._updates_ahead()
            ticks = None if ahead is None else (self.phase + ahead) // (self.psc + 1)
        elif not self.external and self._counts() and self.tick:
            ticks = (self.board.machine.now - self.ref) // self.tick
        else:
            ticks = 0
        if ticks is None or self.cnt + ticks > self.arr:
            self.sync()
            return self.cnt
        return self.cnt + ticks

    def read(self, offset):
        if offset == _CNT:
            return self._count()
        self.sync()
        if _CCR1 <= offset < _CCR1 + 16:
            return self.ccr[(offset - _CCR1) // 4]
        if offset == _CR1:
            return self.cr1
        return {_SMCR: self.smcr, _DIER: self.dier, _SR: self.sr, _CNT: self.cnt, _PSC: self.psc_next, _ARR: self.arr_next,
                _EGR: 0}.get(offset, self.regs.get(offset, 0))

    def write(self, offset, value):
        self.sync()
        if offset == _CR1:
            if (value ^ self.cr1) & _CEN:
                self.ref = self.board.machine.now
            self.cr1 = value
        elif offset == _SMCR:
            self.smcr = value
            self.ref = self.board.machine.now
            if self.gate_pin:
                self._gate_moves()
        elif offset == _DIER:
            self.dier = value
            kept = {"UP": value >> 8 & 1, **{f"CH{i + 1}": value >> 9 + i & 1 for i in range(4)}}
            self.latched = {source for source in self.latched if kept[source]}
        elif offset == _SR:
            self.sr &= value
        elif offset == _EGR:
            self._generate(value)
        elif offset == _CNT:
            self.cnt, self.ref = value & self.limit, self.board.machine.now
        elif offset == _PSC:
            self.psc_next = value & 0xFFFF
        elif offset == _ARR:
            self.arr_next = value & self.limit
            if not self.cr1 & _ARPE:
                self.arr = self.arr_next
        elif _CCR1 <= offset < _CCR1 + 16:
            self.ccr[(offset - _CCR1) // 4] = value & self.limit
        else:
            self.regs[offset] = value
        self._lines()
        self.reschedule()

    def _generate(self, value):
        if value & 1:
            self.cnt, self.phase, self.ref = 0, 0, self.board.machine.now
            self.psc, self.arr = self.psc_next, self.arr_next
            if not self.cr1 & _UDIS:
                if not self.cr1 & _URS:
                    self.sr |= _UIF
                    if self.dier >> 8 & 1:
                        self._software_request("UP")
                if self.slave and self.regs.get(_CR2, 0) >> 4 & 7 in (0, 2):
                    self.slave.clocked(1, self.board.machine.now, 0)
        for i in range(self.channels):
            if value >> 1 + i & 1:
                self.sr |= 2 << i
                if i == 0:
                    self._pulse(self.board.machine.now)
                if self.dier >> 9 + i & 1:
                    self._software_request(f"CH{i + 1}")
        if value & _TIF:
            self.sr |= _TIF
