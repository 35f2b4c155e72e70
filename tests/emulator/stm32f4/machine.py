"""The run of time: instructions, sleep, exceptions, stalls and events in one order."""

from unicorn import UC_HOOK_MEM_INVALID, UcError

from .core import CCM_BASE, CCM_SIZE, FOREVER, STOP_EXCEPTION, STOP_WFE, STOP_WFI
from .events import NEVER, UNITS_PER_US, Events
from .nvic import BUS_FAULT, HARD_FAULT, NMI, SVC, USAGE_FAULT

# Cycles per instruction: 3/2. The Cortex-M4 needs one for most instructions, two to three for loads, stores and taken
# branches; flash wait states come on top where the ART accelerator misses. One factor for all keeps time repeatable.
CYCLES_TIMES_2 = 3
# Stacking and unstacking, each (Cortex-M4 TRM, 3.9.1).
EXCEPTION_CYCLES = 12
# UcError number for an instruction that the decoder refuses.
_UC_ERR_INSN_INVALID = 10
_PAINT = 0xC5
# cortex-m-rt paints the stack too, before main.
_PAINTS = bytes([_PAINT, 0xCC])


class Machine:
    """Owns `now`; everything else on the board asks it."""

    def __init__(self, board):
        self.board = board
        self.core = board.core
        self.events = Events(self._event_earlier)
        self.core.uc.hook_add(UC_HOOK_MEM_INVALID, self._invalid)
        self._time, self._count = 0, 0  # now = _time + (count - _count) * instruction
        self.instruction = 63  # units per instruction
        self.cycle = 42  # units per cycle
        self.pc = 0
        self.running = False
        self._fault_address = 0
        self.stop_request = None
        self.restart()

    # Time.

    @property
    def now(self):
        return self._time + (self.core.state.count - self._count) * self.instruction

    @property
    def now_us(self):
        return self.now / UNITS_PER_US

    def _jump(self, time):
        """Lets time pass without instructions."""
        self._time, self._count = time, self.core.state.count

    def set_clock(self, cycle):
        """The core's clock period in units; zero when there is none."""
        self._jump(self.now)
        self.no_clock = cycle == 0
        if cycle:
            self.cycle, self.instruction = cycle, cycle * CYCLES_TIMES_2 // 2
        self.core.state.limit = 0

    def _event_earlier(self, time):
        if self.running:
            self._limit_to(time)

    def _limit_to(self, time):
        state = self.core.state
        allowed = -(-(time - self._time) // self.instruction) + self._count
        if allowed < state.limit:
            state.limit = max(allowed, 0)

    def watch_stores(self, due):
        """Stores into the watched range report themselves from the time `due` on."""
        self.store_due = due
        state = self.core.state
        if due < NEVER:
            state.store_sync = max(self._count - (self._time - due) // self.instruction, 0)
        else:
            state.store_sync = FOREVER

    def attend(self):
        """Something may be deliverable: stop the core before its next instruction and look."""
        self.core.state.limit = 0

    # Control.

    def restart(self):
        """The core as after a reset, not yet started."""
        self.asleep = None
        self.locked_up = False
        self.no_clock = False
        self.frozen_until = 0  # stalled by flash, or halted by a debugger
        self.halted = False
        self.blocked_until = 0
        self.reset_request = None
        self.after_instruction = []
        self.store_due = NEVER

    def start(self, stack, entry):
        """Begins at the reset vector."""
        self.core.sp = stack
        self.pc = entry & ~1

    @property
    def interrupts_blocked(self):
        return self.now < self.blocked_until

    def block_interrupts(self, duration):
        self.blocked_until = self.now + duration
        self.events.at(self.blocked_until, self.attend)

    def freeze(self, until):
        """No instruction and no interrupt before `until`; the rest of the chip goes on."""
        self.frozen_until = max(self.frozen_until, until)
        self.events.at(self.frozen_until, self.attend)
        self.attend()

    def request_reset(self, cause):
        self.reset_request = cause
        self.attend()

    def later(self, action):
        """Runs `action` once the instruction in flight has ended."""
        self.after_instruction.append(action)
        self.attend()

    # The loop.

    def run_to(self, end):
        """Lets the board live until `end` (units). Exceptions of callbacks pass through."""
        state, events, nvic = self.core.state, self.events, self.board.nvic
        while True:
            while self.after_instruction:
                self.after_instruction.pop(0)()
            if self.reset_request:
                cause, self.reset_request = self.reset_request, None
                self.board.reset_by(cause)
            now = self.now
            due = events.next_time()
            if due <= now:
                events.fire_one()
                continue
            if self.stop_request is not None or now >= end:
                return
            horizon = due if due < end else end
            if now < self.frozen_until or self.locked_up or self.no_clock or self.halted:
                self._jump(horizon)
                continue
            exception = nvic.next_exception() if nvic.pending & nvic.enabled or nvic.system_pending else None
            if exception is not None:
                self._enter(exception)
                continue
            if self.asleep:
                if self._wakes():
                    self.asleep = None
                else:
                    self._jump(horizon)
                    continue
            state.limit = state.count - (now - horizon) // self.instruction
            state.watch_masks = nvic.anything_waits()
            self.watch_stores(self.store_due)
            self._execute()

    def _wakes(self):
        if self.asleep == STOP_WFE:
            if self.core.state.event:
                self.core.state.event = 0
                return True
            return False
        return self.board.nvic.next_exception(masked=False) is not None

    def _execute(self):
        state = self.core.state
        self.running = True
        try:
            reason = self.core.execute(self.pc)
        except UcError as error:
            self._fault(error)
            return
        finally:
            self.running = False
        self.pc = state.last_pc
        if reason in (STOP_WFE, STOP_WFI):
            self.pc += 2
            state.count += 1
            if reason == STOP_WFE and state.event:
                state.event = 0
            else:
                self.asleep = reason
        elif reason == STOP_EXCEPTION:
            if state.exception == 8:
                self._leave()
            elif state.exception == 2:
                self.pc = self.core.pc
                self.board.nvic.pend_system(SVC)
            elif state.exception == 7:
                self.board.bus.warn(f"breakpoint instruction at {state.last_pc:#010x}")
                self._raise_fault(USAGE_FAULT, 1 << 16, state.last_pc)
            else:
                self._raise_fault(USAGE_FAULT, 1 << 16, state.last_pc)

    # Exceptions.

    def _enter(self, number):
        nvic, stats = self.board.nvic, self.board.stats
        self.asleep = None
        stats.interrupted(self.core.state.count)
        failed = self.core.enter_exception(self.pc, number, bool(nvic.active))
        self._jump(self.now + EXCEPTION_CYCLES * self.cycle)
        self.core.state.event = 1
        nvic.enter(number)
        if failed:
            nvic.fault_status |= 1 << 12  # STKERR
            if number == NMI or number == HARD_FAULT:
                pass  # the handler runs; a handler that sets its own stack pointer survives
            else:
                nvic.leave()
                nvic.hard_fault_status |= 1 << 30
                nvic.enter(HARD_FAULT)
                number = HARD_FAULT
        stats.entered(number, self.now, self.core.state.count)
        address = nvic.vector_table + 4 * number
        where = self.core.memory_at(address, 4)
        self.pc = int.from_bytes(where[0][where[1]:where[1] + 4], "little") & ~1 if where else 0

    def _leave(self):
        nvic, state = self.board.nvic, self.core.state
        # The magic address stands where the program counter would.
        exc_return = self.core.pc | 0xFFFF_FF01
        if not nvic.active:
            self._raise_fault(USAGE_FAULT, 1 << 18, state.last_pc)
            return
        number = nvic.leave()
        if number != NMI:
            self.core.clear_faultmask()
        elif self.board.rcc.nmi_again():
            nvic.pend_system(NMI)
        self.board.stats.left(number, self.now, state.count)
        pc = self.core.leave_exception(exc_return)
        self._jump(self.now + EXCEPTION_CYCLES * self.cycle)
        state.event = 1
        if pc is None:
            nvic.fault_status |= 1 << 11  # UNSTKERR
            self._raise_fault(BUS_FAULT, 1 << 11, state.last_pc)
            return
        self.pc = pc

    def _invalid(self, uc, access, address, size, value, data):
        self._fault_address = address
        return False

    def _fault(self, error):
        pc = self.core.state.last_pc
        if error.errno == _UC_ERR_INSN_INVALID:
            self._raise_fault(USAGE_FAULT, 1 << 16, pc)
        elif error.errno in (8, 14):  # fetch from unmapped or protected memory
            self._raise_fault(BUS_FAULT, 1 << 8, self._fault_address & ~1)
        else:
            self.board.nvic.fault_address = self._fault_address
            self._raise_fault(BUS_FAULT, 1 << 9 | 1 << 15, pc)

    def _raise_fault(self, number, status, pc):
        """Takes a fault at `pc`: the enabled handler, else HardFault, else lock-up."""
        nvic = self.board.nvic
        nvic.fault_status |= status
        self.board.stats.fault(number, pc, self._fault_address)
        self.pc = pc
        level = nvic.execution_priority()
        own = nvic.regs.get(0xD24, 0) >> {BUS_FAULT: 17, USAGE_FAULT: 18}[number] & 1
        if own and nvic.priority_of(number) < level:
            self._enter(number)
        elif level > -1:
            nvic.hard_fault_status |= 1 << 30
            self._enter(HARD_FAULT)
        else:
            self.locked_up = True

    def jump_into_fault(self):
        """The next fetch fails."""
        self.asleep = None
        self._fault_address = 0x3000_0000
        self._raise_fault(BUS_FAULT, 1 << 8, 0x3000_0000)

    # Stack.

    def paint_stack(self, below=CCM_BASE + CCM_SIZE):
        """Forgets what the stack has taken below an address; the stack pointer, say."""
        self.core.ccm[:below - CCM_BASE] = bytes([_PAINT]) * (below - CCM_BASE)

    def lowest_sp(self):
        """The lowest address of the stack's memory that was ever written since it was painted."""
        content = bytes(self.core.ccm)
        return CCM_BASE + len(content) - len(content.lstrip(_PAINTS))
