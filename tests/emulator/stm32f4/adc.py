"""Analog-to-digital converters (RM0090, 13): regular sequences started by TIM2's trigger output or by software, alone or
ADC1 and ADC2 simultaneously, DMA requests, overrun. Not modelled: injected groups, watchdogs, other triggers, other
multi-ADC modes, delayed and interrupted sequences.

Conversions are made up for when somebody looks, each at its own time; an alarm stands for the end of each sequence."""

from .bus import Peripheral
from .events import units

_SR, _CR1, _CR2, _SMPR1, _SQR1, _SQR3, _DR = 0x00, 0x04, 0x08, 0x0C, 0x2C, 0x34, 0x4C
_CSR, _CCR, _CDR = 0x300, 0x304, 0x308
_EOC, _STRT, _OVR = 2, 16, 32
_ADON, _DMA, _SWSTART = 1, 1 << 8, 1 << 30
_SCAN, _EOCIE = 1 << 8, 1 << 5
_IRQ = 18
_TIM2_TRGO = 0b0110
_SIMULTANEOUS = 0b00110
_CYCLES = (3, 15, 28, 56, 84, 112, 144, 480)
# Of twelve bits, after sampling.
_CONVERSION = 12
# From ADON to the first conversion (data sheet, table 67), and the fastest clock.
_WAKING_US, _CLOCK_LIMIT = 3, units(1 / 36)


class Converter:
    """One of the three."""

    def __init__(self):
        self.reset()

    def reset(self):
        self.started = None  # when its sequence began, units
        self.done = 0  # conversions of it
        self.data = 0
        self.unread = self.blocked = False  # blocked: after an overrun no conversion and no request
        self.awake = 0


class Adc(Peripheral):
    """ADC1 to 3 and their common block."""

    def __init__(self, board):
        self.converters = [Converter() for _ in range(3)]
        super().__init__(board, "ADC", 0x4001_2000)
        self.inputs = [0] * 19  # codes by channel, the same for all three
        # code of a channel when so many words have been played: in place of `inputs`, for light that depends on the motors
        self.light = None
        self.lose = 0  # so many of the next triggers do not arrive
        self.hold = 0  # so many of the next requests do not reach the DMA
        self.sequences = []  # (words played at the trigger, [codes of each conversion by converter])
        self.ignored = 0  # triggers that came while a sequence ran
        self.alarm = board.machine.events.alarm(self.sync)
        self._syncing = False

    def reset(self):
        for converter in self.converters:
            converter.reset()
        self.regs = {}
        if hasattr(self, "alarm"):
            self.alarm.cancel()

    # Time.

    @property
    def _cycle(self):
        return self.board.rcc.apb2 * (2, 4, 6, 8)[self.regs.get(_CCR, 0) >> 16 & 3]

    def _channels(self, n):
        base = 0x100 * n
        length = (self.regs.get(base + _SQR1, 0) >> 20 & 15) + 1 if self.regs.get(base + _CR1, 0) & _SCAN else 1
        place = lambda i: self.regs.get(base + _SQR3 - 4 * (i // 6), 0) >> 5 * (i % 6) & 0x1F
        return [place(i) for i in range(length)]

    def _sampling(self, n, channel):
        register, place = (_SMPR1 + 4, channel) if channel < 10 else (_SMPR1, channel - 10)
        return _CYCLES[self.regs.get(0x100 * n + register, 0) >> 3 * place & 7]

    def _code(self, channel, time):
        code = self.light(channel, self.board.words.played_at(time)) if self.light else self.inputs[channel]
        return max(0, min(4095, code))

    @property
    def _simultaneous(self):
        return self.regs.get(_CCR, 0) & 0x1F == _SIMULTANEOUS

    # Starting.

    def trigger(self, time):
        """TIM2's trigger output has pulsed."""
        self.sync()
        for n in range(3):
            control = self.regs.get(0x100 * n + _CR2, 0)
            if control & _ADON and control >> 28 & 3 in (1, 3) and control >> 24 & 15 == _TIM2_TRGO:
                if self.lose:
                    self.lose -= 1
                else:
                    self._begin(n, time)

    def _begin(self, n, time):
        pair = [0, 1] if n == 0 and self._simultaneous else [n]
        if n == 1 and self._simultaneous:
            self.board.bus.warn("ADC2 has a trigger of its own in simultaneous mode")
        if self.converters[n].started is not None:
            self.ignored += 1
            return
        if self._cycle < _CLOCK_LIMIT:
            self.board.bus.warn("the clock of the converters is above 36 MHz")
        if len(pair) == 2:
            lists = [self._channels(i) for i in pair]
            if len(lists[0]) != len(lists[1]) or any(a == b for a, b in zip(*lists)):
                self.board.bus.warn("simultaneous sequences of different length, or of one channel at once")
            if [self._sampling(0, c) for c in lists[0]] != [self._sampling(1, c) for c in lists[1]]:
                self.board.bus.warn("simultaneous sequences of different sampling times")
        for i in pair:
            converter = self.converters[i]
            if not self.regs.get(0x100 * i + _CR2, 0) & _ADON:
                self.board.bus.warn(f"ADC{i + 1} is to convert while it is off")
                return
            if time < converter.awake:
                self.board.bus.warn(f"ADC{i + 1} was triggered before it was awake")
            converter.started, converter.done = time, 0
            self.regs[0x100 * i + _SR] = self.regs.get(0x100 * i + _SR, 0) | _STRT
        self.sequences.append((self.board.words.played_at(time), [[] for _ in pair]))
        self._set_alarm()

    def _time_of(self, n, index):
        """When a conversion of the running sequence samples and when it is ready."""
        cycle, at = self._cycle, self.converters[n].started
        for channel in self._channels(n)[:index]:
            at += (self._sampling(n, channel) + _CONVERSION) * cycle
        sampling = self._sampling(n, self._channels(n)[index])
        return at + sampling * cycle, at + (sampling + _CONVERSION) * cycle

    def _set_alarm(self):
        running = [n for n in range(3) if self.converters[n].started is not None]
        if running and self._cycle:
            self.alarm.set(min(self._time_of(n, len(self._channels(n)) - 1)[1] for n in running))
        else:
            self.alarm.cancel()

    # Converting.

    def sync(self):
        """Makes up for all conversions that are ready by now."""
        if self._syncing or not self._cycle:
            return
        self._syncing = True
        try:
            for n in (0, 2) if self._simultaneous else (0, 1, 2):
                self._run(n)
        finally:
            self._syncing = False
        self._set_alarm()
        self._lines()

    def _run(self, n):
        converter, now = self.converters[n], self.board.machine.now
        while converter.started is not None:
            sampled, ready = self._time_of(n, converter.done)
            if ready > now:
                return
            pair = [0, 1] if n == 0 and self._simultaneous else [n]
            codes = [self._code(self._channels(i)[converter.done], sampled) for i in pair]
            for made, code in zip(self.sequences[-1][1], codes):
                made.append(code)
            self._ready(n, pair, codes)
            done = converter.done + 1
            for i in pair:
                self.converters[i].done = done
                if done == len(self._channels(n)):
                    self.converters[i].started = None

    def _ready(self, n, pair, codes):
        converter, base = self.converters[n], 0x100 * n
        if converter.blocked:
            return
        wants = self.regs.get(_CCR, 0) >> 14 & 3 if len(pair) == 2 else self.regs.get(base + _CR2, 0) & _DMA
        if wants and converter.unread:
            converter.blocked = True
            for i in pair:
                self.regs[0x100 * i + _SR] = self.regs.get(0x100 * i + _SR, 0) | _OVR
            return
        converter.data = sum(code << 16 * i for i, code in enumerate(codes))
        converter.unread = True
        for i in pair:
            self.regs[0x100 * i + _SR] = self.regs.get(0x100 * i + _SR, 0) | _EOC
        if wants:
            if self.hold:
                self.hold -= 1
                return
            stream = next((s for s in (self.board.dma2.streams[0], self.board.dma2.streams[4]) if s.enabled and s.channel == 0), None)
            if n == 0 and stream:
                stream.serve(1)

    # Registers.

    def _converter(self, offset):
        return offset & 0x300, offset & 0xFF

    def read(self, offset):
        self.sync()
        base, register = self._converter(offset)
        if offset == _CDR or base < 0x300 and register == _DR:
            n = 0 if offset == _CDR else base >> 8
            self.converters[n].unread = False
            self.regs[0x100 * n + _SR] = self.regs.get(0x100 * n + _SR, 0) & ~_EOC
            return self.converters[n].data if offset == _CDR else self.converters[n].data & 0xFFF
        if offset == _CSR:
            return sum((self.regs.get(0x100 * n + _SR, 0) & 0x3F) << 8 * n for n in range(3))
        return self.regs.get(offset, 0)

    def write(self, offset, value):
        self.sync()
        base, register = self._converter(offset)
        converter = self.converters[base >> 8] if base < 0x300 else None
        if converter and register == _SR:
            value &= self.regs.get(offset, 0)
        elif converter and register == _CR2:
            self._control(base, value)
            value &= ~_SWSTART
        elif offset == _CCR and not value >> 14 & 3:
            self._unblock(self.converters[0])
        self.regs[offset] = value
        self._set_alarm()
        self._lines()

    def _control(self, base, value):
        n, before = base >> 8, self.regs.get(base + _CR2, 0)
        converter, now = self.converters[n], self.board.machine.now
        if value & _ADON and not before & _ADON:
            converter.awake = now + units(_WAKING_US)
        if not value & _ADON:
            converter.started = None
            self._unblock(converter)
        if not value & _DMA and before & _DMA:
            self._unblock(converter)
        if value & _SWSTART and value & _ADON:
            # a driver that waits for the result: at once
            self.regs[base + _SR] = self.regs.get(base + _SR, 0) | _EOC | _STRT
            converter.data, converter.unread = self._code(self._channels(n)[0], now), True

    def _unblock(self, converter):
        converter.unread = converter.blocked = False

    def _lines(self):
        level = any(self.regs.get(base + _SR, 0) & _EOC and self.regs.get(base + _CR1, 0) & _EOCIE for base in (0, 0x100, 0x200))
        self.board.nvic.set_line(_IRQ, level)
