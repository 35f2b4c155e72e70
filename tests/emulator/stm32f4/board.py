"""The board: an STM32F407VG with the shipped ELF in it, and what a test can do to it."""

import ctypes

from .adc import Adc
from .bus import Bus, Store
from .core import FLASH_BASE, Core
from .debug import Dbgmcu, Dwt
from .dma import Dma
from .events import NEVER, UNITS_PER_US, units
from .flash import Flash, PowerCut
from .gpio_exti import Exti, Port, Syscfg
from .image import Image
from .iwdg import Iwdg
from .machine import Machine
from .nvic import Nvic
from .otg import OtgFs
from .power import BackupSram, Power
from .rcc import Rcc
from .stats import Stats
from .timers import Timer
from .usart import Serial, Usart
from .words import Words

# (number, base, clock enable, (update, compare, trigger), channels, bits)
_TIMERS = (
    (1, 0x4001_0000, (0x44, 0), (25, 27, 26), 4, 16),
    (2, 0x4000_0000, (0x40, 0), (28, 28, 28), 4, 32),
    (3, 0x4000_0400, (0x40, 1), (29, 29, 29), 4, 16),
    (4, 0x4000_0800, (0x40, 2), (30, 30, 30), 4, 16),
    (5, 0x4000_0C00, (0x40, 3), (50, 50, 50), 4, 32),
    (6, 0x4000_1000, (0x40, 4), (54, None, None), 0, 16),
    (7, 0x4000_1400, (0x40, 5), (55, None, None), 0, 16),
    (8, 0x4001_0400, (0x44, 1), (44, 46, 45), 4, 16),
    (9, 0x4001_4000, (0x44, 16), (24, 24, 24), 2, 16),
    (12, 0x4000_1800, (0x40, 6), (43, 43, 43), 2, 16),
)
_STREAM_PORT_BSRR = 0x4002_1018


class Timeout(AssertionError):
    """What was waited for did not come."""


class Board:
    """Time stands still except in `run` and its relatives; all times are emulated microseconds since power came on.

    `crystal`: 'ok' or 'dead'. `vbat`: backup SRAM is fed while the supply is off. `flash`: a flash content from `flash_content()`
    to start with; the program is written over it. `baud`: the speed of the other end of the cable."""

    def __init__(self, elf_path, crystal="ok", vbat=True, flash=None, baud=115_200):
        self.image = elf_path if isinstance(elf_path, Image) else Image(elf_path)
        self.vbat = vbat
        self.core = Core(self._stored)
        self.merged_requests = 0
        # A stream that is enabled again with no address or count written begins at its address with the count that was left
        # (RM0090, 10.3.14). Programs that count on it going on where it was, as some chips are said to do, need True here.
        self.dma_resumes = False
        self.resets = []  # (time in us, cause)
        self.words = Words()
        self.bus = Bus(self)
        self.nvic = Nvic(self)
        self.stats = Stats(self)
        self.rcc = Rcc(self, crystal)
        self.machine = Machine(self)
        self._build()
        self.serial = Serial(self, self.usart2, baud)
        if flash is not None:
            self.core.flash[:] = flash
        else:
            self.core.flash[:] = b"\xff" * len(self.core.flash)
        for address, data in self.image.segments:
            self.core.flash[address - FLASH_BASE:address - FLASH_BASE + len(data)] = data
        self._power_on()

    def _build(self):
        add, events = self.bus.add, self.machine.events
        add(self.nvic)
        add(self.rcc)
        self.syscfg, self.exti = add(Syscfg(self)), add(Exti(self))
        self.ports = {letter: add(Port(self, letter)) for letter in "ABCDEH"}
        self.ports["E"].stream = self.words
        self.power = add(Power(self))
        self.backup = add(BackupSram(self, self.power))
        self.flash = add(Flash(self))
        self.iwdg = add(Iwdg(self))
        self.iwdg.attach(events)
        self.dbgmcu, self.dwt = add(Dbgmcu(self)), add(Dwt(self))
        self.dma1, self.dma2 = add(Dma(self, 1)), add(Dma(self, 2))
        self._build_timers(add, events)
        self.usart2 = add(Usart(self, 2, 0x4000_4400, (0x40, 17), 38, (self.dma1.streams[5], 4), (self.dma1.streams[6], 4)))
        self.usart1 = add(Usart(self, 1, 0x4001_1000, (0x44, 4), 37, (self.dma2.streams[2], 4), (self.dma2.streams[7], 4)))
        for usart in (self.usart1, self.usart2):
            usart.attach(events)
        self.usart2.plug_in(self.ports["A"], 3)
        self.otg, self.adc = add(OtgFs(self)), add(Adc(self))
        self.otg.attach(events)
        self.tim2.pulse = self.adc.trigger
        for name, base, size in (("ITM", 0xE000_0000, 0x1000), ("RTC", 0x4000_2800, 0x400), ("TPIU", 0xE004_0000, 0x1000)):
            add(Store(self, name, base)).size = size
            for block in range(base >> 10, base + size >> 10):
                self.bus.blocks[block] = self.bus.blocks[base >> 10]

    def _build_timers(self, add, events):
        streams = self.dma2.streams
        requests = {8: {"UP": [(streams[1], 7)], "CH1": [(streams[2], 7), (streams[2], 0)]}}
        self.timers = {}
        for number, base, clock, irqs, channels, bits in _TIMERS:
            timer = Timer(self, number, base, clock, irqs, channels, bits, requests.get(number))
            timer.attach(events)
            self.timers[number] = add(timer)
        self.tim2, self.tim3, self.tim8 = self.timers[2], self.timers[3], self.timers[8]
        self.tim8.slave, self.tim2.master = self.tim2, (1, self.tim8)
        self.tim8.watch_gate(self.ports["A"], 0, 3)

    # Power and resets.

    def _power_on(self):
        core = self.core
        core.randomise(core.sram, "sram")
        self.machine.paint_stack()
        core.system[:] = b"\xff" * len(core.system)
        core.system[0x7A10:0x7A1C] = bytes(range(0x30, 0x3C))
        core.system[0x7A22:0x7A24] = (1024).to_bytes(2, "little")
        self.dbgmcu.power_on()
        self.rcc.forget_causes()
        if not self.vbat or not self.resets:
            core.randomise(memoryview(self.backup.content), "backup")
            self.power.lose_backup_domain()
        self.reset_by("power")

    def reset_by(self, cause):
        """A reset of the whole chip; backup domain and memories stay."""
        self.sync_stream()
        self.resets.append((self.machine.now_us, cause))
        self.rcc.note_cause(cause)
        self.core.reset()
        self.machine.restart()
        self.stats.restarted()
        for peripheral in self.bus.peripherals:
            peripheral.reset()
        for port in self.ports.values():
            port.settle()
        flash = self.core.flash
        self.machine.start(int.from_bytes(flash[0:4], "little"), int.from_bytes(flash[4:8], "little"))

    def reset(self):
        """The reset button."""
        self.reset_by("pin")

    def power_cycle(self):
        """Off and on again. Flash stays; backup SRAM stays if `vbat`."""
        self.machine.after_instruction.clear()
        self.flash.cut_at = self.flash.fail_at = None
        self.usart2.unplug()
        self._power_on()

    def cut_power(self, text):
        raise PowerCut(text)

    # Time.

    @property
    def now_us(self):
        return self.machine.now_us

    def run(self, us):
        """Lets the board live for so long."""
        self.machine.run_to(self.machine.now + units(us))
        self.sync_stream()

    def run_until(self, predicate, timeout_us, what="the condition", step_us=100):
        """Runs until `predicate()`, asked every `step_us`; Timeout after `timeout_us`. Answers the time that it took in us."""
        start = self.machine.now
        end = start + units(timeout_us)
        while not predicate():
            if self.machine.now >= end:
                raise Timeout(f"{what} did not come within {timeout_us} us; {self.describe()}")
            self.machine.run_to(min(self.machine.now + units(step_us), end))
        return (self.machine.now - start) / UNITS_PER_US

    def at(self, us, callback):
        """Calls `callback()` that many microseconds from now."""
        self.machine.events.at(self.machine.now + units(us), callback)

    def at_tick(self, tick, callback):
        """Calls `callback()` at the moment when exactly `tick` words have been played since power came on."""
        self.tim8.add_mark(tick, callback)

    def run_ticks(self, ticks, timeout_us):
        """Runs until so many more words have been played, exactly."""
        target, reached = self.played() + ticks, []

        def stop():
            reached.append(True)
            self.machine.stop_request = True
        self.at_tick(target, stop)
        self.machine.run_to(self.machine.now + units(timeout_us))
        self.machine.stop_request = None
        if not reached:
            raise Timeout(f"{ticks} ticks did not play within {timeout_us} us; {self.describe()}")

    # Pins and injuries.

    def pin(self, port, number, level):
        """Drives a pin from outside: 0, 1, or None to let go."""
        self.ports[port].drive(number, level)

    def level(self, port, number):
        """The level at a pin."""
        return self.ports[port].level(number)

    def kill_crystal(self):
        self.rcc.kill_crystal()

    def dma_error(self, stream, controller=2):
        """A transfer error in a stream."""
        self.sync_stream()
        (self.dma2 if controller == 2 else self.dma1).streams[stream].error()

    def mask_interrupts(self, for_us):
        """No interrupt is taken for so long, as if PRIMASK were set; instructions go on."""
        self.machine.block_interrupts(units(for_us))

    def halt_core(self, for_us):
        """A debugger halts the core; timers and watchdog stand still only where DBGMCU says so."""
        frozen = [timer for timer in self.timers.values() if self.dbgmcu.freezes(timer.name)]
        dog = self.dbgmcu.freezes("IWDG")

        def go():
            self.machine.halted = False
            for timer in frozen:
                timer.freeze(False)
            if dog:
                self.iwdg.thaw()
        self.machine.halted = True
        for timer in frozen:
            timer.freeze(True)
        if dog:
            self.iwdg.freeze()
        self.machine.attend()
        self.at(for_us, go)

    def hard_fault(self):
        """The program counter is led astray: the next fetch fails."""
        self.machine.later(self.machine.jump_into_fault)

    # What can be seen.

    def played(self):
        """Words played up to now since power came on first."""
        self.sync_stream()
        return len(self.words)

    def flash_content(self):
        """A copy of the whole flash."""
        return bytes(self.core.flash)

    def stack_used(self):
        """The most bytes of stack ever in use since power came on."""
        return 0x1001_0000 - self.machine.lowest_sp()

    def longest_masked(self):
        """Sections with interrupts masked, longest first: (microseconds, times, function that begins it).

        Handlers that interrupt a section do not belong to it."""
        unit = self.machine.instruction / UNITS_PER_US
        out = [(longest * unit, times, self.image.function_at(pc)) for pc, _, longest, times in self.core.sections()]
        return sorted(out, reverse=True)

    def profile(self, on=True):
        """Counts instructions by address from now on; `profile_by_function` reads them."""
        if on:
            self._profile = (ctypes.c_uint32 * (len(self.core.flash) // 2))()
            self.core.state.profile = ctypes.addressof(self._profile)
        else:
            self.core.state.profile = None

    def profile_by_function(self):
        """(instructions, function), most first."""
        sums = {}
        for index, count in enumerate(self._profile):
            if count:
                name = self.image.function_at(FLASH_BASE + 2 * index)
                sums[name] = sums.get(name, 0) + count
        return sorted(((count, name) for name, count in sums.items()), reverse=True)

    def describe(self):
        """One line for the message of a failed test."""
        m = self.machine
        state = "locked up" if m.locked_up else "no clock" if m.no_clock else "asleep" if m.asleep else "running"
        faults = "".join(f"; fault {n} at {self.image.function_at(pc)} ({address:#x})" for n, pc, address in self.stats.faults[-2:])
        return (f"at {self.now_us:.0f} us {state} in {self.image.function_at(m.pc)} (pc {m.pc:#010x}), active {self.nvic.active}, "
                f"{len(self.words)} words, resets {self.resets[-3:]}{faults}; warnings {self.bus.warnings}")

    # For the parts.

    def sync_stream(self):
        """Counts the timers of the stream, and with them the DMA and the converters, up to now."""
        self.tim8.sync()
        self.adc.sync()

    def dma_ready(self):
        """A stream was enabled: who waits for one?"""
        for peripheral in (self.usart1, self.usart2, self.tim8):
            peripheral.dma_ready()

    def dma_output(self, stream, data, time, step):
        """Items that a stream writes to its peripheral."""
        if stream.par == _STREAM_PORT_BSRR and stream.width == 4:
            self.words.append(data, self.machine.now if time is None else time, step)
            return
        for i in range(0, len(data), stream.width):
            self.bus.store(stream.par, int.from_bytes(data[i:i + stream.width], "little"), stream.width)

    def stream_changed(self):
        """A stream was enabled, disabled or changed: watch the stores into its memory, plan its interrupts."""
        low, high = NEVER, 0
        for source in ("UP", "CH1"):
            stream = self.tim8.stream_of(source)
            if stream and stream.memory and stream.total:
                low, high = min(low, stream.m0ar), max(high, stream.m0ar + stream.width * stream.total)
        self.core.watch_ring(low, high - low) if high else self.core.watch_ring(0, 0)
        self.tim8.reschedule()

    def _stored(self, address, size, value):
        if FLASH_BASE <= address < FLASH_BASE + len(self.core.flash):
            self.flash.stored(address, size, value)
        else:
            self.tim8.sync()
            self.tim8.reschedule()
