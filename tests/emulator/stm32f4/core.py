"""The processor: Unicorn with the C hooks of core.c, and the memories that are plain bytes."""

import ctypes
import hashlib
import os
import random
import subprocess
import tempfile
from pathlib import Path

from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_HOOK_INTR, UC_HOOK_MEM_WRITE, UC_MODE_MCLASS, UC_MODE_THUMB
from unicorn import UC_PROT_ALL, Uc
from unicorn import arm_const as arm
from unicorn.unicorn_py3.unicorn import uclib

FLASH_BASE, FLASH_SIZE = 0x0800_0000, 1 << 20
SRAM_BASE, SRAM_SIZE = 0x2000_0000, 128 << 10
CCM_BASE, CCM_SIZE = 0x1000_0000, 64 << 10
SYSTEM_BASE, SYSTEM_SIZE = 0x1FFF_0000, 64 << 10

STOP_NONE, STOP_LIMIT, STOP_WFE, STOP_WFI, STOP_EXCEPTION = range(5)
FOREVER = (1 << 64) - 1

_SECTIONS = 64
_REGISTERS = (
    arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3, arm.UC_ARM_REG_R12, arm.UC_ARM_REG_LR,
    arm.UC_ARM_REG_SP, arm.UC_ARM_REG_XPSR, arm.UC_ARM_REG_CONTROL, arm.UC_ARM_REG_FPSCR, arm.UC_ARM_REG_S0,
    arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_PRIMASK,
)
_ON_STORE = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)


class _Section(ctypes.Structure):
    _fields_ = [("pc", ctypes.c_uint32), ("end_pc", ctypes.c_uint32), ("longest", ctypes.c_uint64), ("times", ctypes.c_uint64)]


class _State(ctypes.Structure):
    """`struct core` of core.c, field by field."""

    _fields_ = [
        ("count", ctypes.c_uint64), ("limit", ctypes.c_uint64), ("store_sync", ctypes.c_uint64),
        ("last_pc", ctypes.c_uint32), ("reason", ctypes.c_uint32), ("exception", ctypes.c_uint32),
        ("event", ctypes.c_uint32), ("it_start", ctypes.c_uint32), ("it_end", ctypes.c_uint32), ("watch_masks", ctypes.c_uint32),
        ("ring_base", ctypes.c_uint32), ("ring_size", ctypes.c_uint32), ("window", ctypes.c_uint32 * 2), ("window_size", ctypes.c_uint32),
        ("flash_base", ctypes.c_uint32), ("flash_size", ctypes.c_uint32), ("flash", ctypes.c_void_p),
        ("emu_stop", ctypes.c_void_p), ("reg_read", ctypes.c_void_p), ("reg_write", ctypes.c_void_p),
        ("mem_read", ctypes.c_void_p), ("mem_write", ctypes.c_void_p), ("on_store", _ON_STORE),
        ("reg", ctypes.c_int32 * len(_REGISTERS)),
        ("basepri", ctypes.c_uint32), ("primask", ctypes.c_uint32), ("faultmask", ctypes.c_uint32),
        ("section_start", ctypes.c_uint64), ("excluded", ctypes.c_uint64), ("preempted_at", ctypes.c_uint64),
        ("section_pc", ctypes.c_uint32), ("section_depth", ctypes.c_uint32), ("depth", ctypes.c_uint32), ("sections_used", ctypes.c_uint32),
        ("sections", _Section * _SECTIONS), ("profile", ctypes.c_void_p),
    ]


def _build():
    """Compiles core.c once per content; the object is kept beside the other temporary files of this user."""
    source = Path(__file__).with_name("core.c")
    text = source.read_bytes()
    target = Path(tempfile.gettempdir()) / f"stm32f4-core-{os.getuid()}-{hashlib.sha256(text).hexdigest()[:16]}.so"
    if not target.exists():
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "core.so"
            compiler = os.environ.get("CC", "cc")
            try:
                subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", made, source], check=True)
            except (OSError, subprocess.CalledProcessError) as cause:
                raise RuntimeError(f"the C compiler `{compiler}` did not build {source.name}: install one or set CC") from cause
            ready = target.with_suffix(f".{os.getpid()}")
            ready.write_bytes(made.read_bytes())
            ready.rename(target)
    library = ctypes.CDLL(str(target))
    library.exception_enter.argtypes = [ctypes.c_void_p, ctypes.c_void_p] + [ctypes.c_uint32] * 3
    library.exception_leave.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32]
    library.exception_leave.restype = ctypes.c_uint32
    return library


class Core:
    """Registers, memories and execution up to an instruction count. Knows neither time nor interrupts."""

    def __init__(self, on_store):
        """`on_store(address, size, value)` is called before stores into the watched range and into flash."""
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self.flash = self._memory(FLASH_BASE, FLASH_SIZE)
        self.sram = self._memory(SRAM_BASE, SRAM_SIZE)
        self.ccm = self._memory(CCM_BASE, CCM_SIZE)
        self.system = self._memory(SYSTEM_BASE, SYSTEM_SIZE)
        self.state = _State()
        self._library = _build()
        self._on_store = _ON_STORE(on_store)
        self._install()

    def _memory(self, base, size):
        buffer = (ctypes.c_uint8 * size)()
        self.uc.mem_map_ptr(base, size, UC_PROT_ALL, ctypes.addressof(buffer))
        view = memoryview(buffer).cast("B")
        return view

    def _install(self):
        state, pointer = self.state, ctypes.c_void_p
        for name in ("emu_stop", "reg_read", "reg_write", "mem_read", "mem_write"):
            setattr(state, name, ctypes.cast(getattr(uclib, f"uc_{name}"), pointer).value)
        state.reg[:] = _REGISTERS
        state.flash_base, state.flash_size = FLASH_BASE, FLASH_SIZE
        state.flash = ctypes.addressof(ctypes.c_uint8.from_buffer(self.flash))
        state.store_sync = FOREVER
        state.on_store = self._on_store
        self._pointer = ctypes.addressof(state)
        self._hook(UC_HOOK_CODE, "code_hook", 1, 0)
        self._hook(UC_HOOK_INTR, "exception_hook", 1, 0)
        # Bounded: a store inside the bounds of a hook costs much more than one outside.
        self._hook(UC_HOOK_MEM_WRITE, "store_hook", FLASH_BASE, FLASH_BASE + FLASH_SIZE - 1)
        self._ring_hook = None

    def _hook(self, kind, name, begin, end):
        handle = ctypes.c_size_t()
        function = ctypes.cast(getattr(self._library, name), ctypes.c_void_p)
        status = uclib.uc_hook_add(self.uc._uch, ctypes.byref(handle), kind, function, ctypes.c_void_p(self._pointer),
                                   ctypes.c_uint64(begin), ctypes.c_uint64(end))
        assert status == 0, f"Unicorn refused the hook {name}: {status}"
        return handle

    def watch_ring(self, base, size):
        """Stores into this memory that DMA shares report themselves; size 0: none do."""
        state = self.state
        if (base, size) == (state.ring_base, state.ring_size):
            return
        if self._ring_hook is not None:
            uclib.uc_hook_del(self.uc._uch, self._ring_hook)
            self._ring_hook = None
        state.ring_base, state.ring_size = base, size
        if size:
            self._ring_hook = self._hook(UC_HOOK_MEM_WRITE, "store_hook", base, base + size - 1)

    def randomise(self, memory, seed):
        """What a memory holds after power comes on: noise, the same for the same seed."""
        memory[:] = random.Random(seed).randbytes(len(memory))

    def reset(self):
        """All registers as after a reset; the caller sets the stack pointer and jumps."""
        write, state = self.uc.reg_write, self.state
        for register in (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_FAULTMASK, arm.UC_ARM_REG_CONTROL):
            write(register, 0)
        write(arm.UC_ARM_REG_XPSR, 1 << 24)
        write(arm.UC_ARM_REG_LR, 0xFFFF_FFFF)
        state.basepri = state.primask = state.faultmask = state.event = state.watch_masks = state.depth = 0
        state.it_start = state.it_end = 0
        self.watch_ring(0, 0)
        state.store_sync = FOREVER

    def execute(self, pc):
        """Runs from `pc` until the limit or an event of the core; answers the STOP_ reason. Faults raise UcError."""
        self.state.reason = STOP_NONE
        self.uc.emu_start(pc | 1, 0xFFFF_FFFE)
        return self.state.reason

    def enter_exception(self, pc, number, from_handler):
        """Stacks and switches to handler mode; true if the stack could not be written."""
        return bool(self._library.exception_enter(self.uc._uch, self._pointer, pc, number, from_handler))

    def leave_exception(self, exc_return):
        """Unstacks; answers the return address, None if the stack could not be read."""
        pc = self._library.exception_leave(self.uc._uch, self._pointer, exc_return)
        return None if pc == 1 else pc

    @property
    def sp(self):
        return self.uc.reg_read(arm.UC_ARM_REG_SP)

    @sp.setter
    def sp(self, value):
        self.uc.reg_write(arm.UC_ARM_REG_SP, value)

    @property
    def pc(self):
        return self.uc.reg_read(arm.UC_ARM_REG_PC)

    def masks(self):
        """PRIMASK, BASEPRI, FAULTMASK as last written by the program."""
        return self.state.primask, self.state.basepri, self.state.faultmask

    def clear_faultmask(self):
        """What a return from any exception but NMI does."""
        if self.state.faultmask:
            self.state.faultmask = 0
            self.uc.reg_write(arm.UC_ARM_REG_FAULTMASK, 0)

    def sections(self):
        """Masked sections as (begin, end of the longest, longest in instructions, times)."""
        return [(s.pc, s.end_pc, s.longest, s.times) for s in self.state.sections[: self.state.sections_used]]

    def memory_at(self, address, length):
        """The bytes behind a plain memory's address as (view, offset), None outside."""
        for base, view in ((SRAM_BASE, self.sram), (FLASH_BASE, self.flash), (CCM_BASE, self.ccm), (SYSTEM_BASE, self.system)):
            if base <= address and address + length <= base + len(view):
                return view, address - base
        return None
