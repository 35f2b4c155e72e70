"""Counts the instructions of a Cortex-M4F program under Unicorn and models its cycles.

The model is the instruction table of the Cortex-M4 (ARM 100166, 3.3.1) with a pipeline refill of two cycles for
a taken branch, loads and stores that follow each other pipelined, and a division of six cycles. It leaves out flash
wait states, misses of the flash accelerator, contention on the bus and interrupt entry. An instruction that an IT
block skips counts as one of one cycle.
"""

import bisect
import collections
import struct

from capstone import CS_ARCH_ARM, CS_MODE_MCLASS, CS_MODE_THUMB, Cs
from elftools.elf.elffile import ELFFile
from unicorn import UC_ARCH_ARM, UC_HOOK_BLOCK, UC_HOOK_MEM_READ, UC_HOOK_MEM_WRITE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_SP, UC_CPU_ARM_CORTEX_M4

REFILL = 2
DIVISION = 6


class Image:
    """An ELF file: its segments, functions and objects."""

    def __init__(self, path):
        with open(path, "rb") as file:
            elf = ELFFile(file)
            self.segments = [
                (s["p_paddr"], s.data(), s["p_vaddr"]) for s in elf.iter_segments()
                if s["p_type"] == "PT_LOAD" and s["p_filesz"]
            ]
            self.functions, self.objects = [], {}
            for symbol in elf.get_section_by_name(".symtab").iter_symbols():
                kind = symbol["st_info"]["type"]
                if kind == "STT_FUNC":
                    self.functions.append((symbol["st_value"] & ~1, symbol["st_size"], short(symbol.name)))
                elif kind == "STT_OBJECT":
                    self.objects[short(symbol.name)] = symbol["st_value"]
            self.functions.sort()
            self.lines = self._lines(elf)
        self._starts = [f[0] for f in self.functions]
        self._line_starts = [line[0] for line in self.lines]

    @staticmethod
    def _lines(elf):
        """(address, file, line), sorted, from the line tables."""
        lines = []
        if not elf.has_dwarf_info():
            return lines
        dwarf = elf.get_dwarf_info()
        for unit in dwarf.iter_CUs():
            program = dwarf.line_program_for_CU(unit)
            if program is None:
                continue
            files = program["file_entry"]
            # before version 5 the files are numbered from 1
            first = 0 if program["version"] >= 5 else 1
            for entry in program.get_entries():
                state = entry.state
                if state is None:
                    continue
                at = state.file - first
                name = files[at].name.decode() if 0 <= at < len(files) else "?"
                lines.append((state.address, None if state.end_sequence else name, state.line))
        lines.sort(key=lambda line: (line[0], line[1] is not None))
        return lines

    def function(self, name):
        """Address of the one function whose name ends with `name`."""
        found = sorted({a for a, _, n in self.functions if n == name or n.endswith("::" + name)})
        if len(found) != 1:
            raise SystemExit(f"{name}: {len(found)} functions of that name; it must be one, never inlined")
        return found[0]

    def object(self, name):
        """Address of the one object whose name ends with `name`."""
        found = {a for n, a in self.objects.items() if n == name or n.endswith("::" + name)}
        if len(found) != 1:
            raise SystemExit(f"{name}: {len(found)} objects of that name")
        return found.pop()

    def code(self, address, size=4):
        """Bytes at an address."""
        for base, data, _ in self.segments:
            if base <= address < base + len(data):
                return data[address - base : address - base + size]
        return b""

    def at(self, address):
        """Name of the function at an address."""
        k = bisect.bisect_right(self._starts, address) - 1
        return self.functions[k][2] if k >= 0 else hex(address)

    def line(self, address):
        """(file, line) at an address."""
        k = bisect.bisect_right(self._line_starts, address) - 1
        return (self.lines[k][1] or "?", self.lines[k][2]) if k >= 0 else ("?", 0)

    def size(self, name):
        """Bytes of all functions of that name."""
        return sum({a: s for a, s, n in self.functions if n == name}.values())


def short(name):
    """A mangled name (legacy scheme) without its hash, readable enough."""
    if not name.startswith("_ZN"):
        return name
    parts, at = [], 3
    while at < len(name) and name[at].isdigit():
        end = at
        while name[end].isdigit():
            end += 1
        size = int(name[at:end])
        parts.append(name[end : end + size])
        at = end + size
    text = "::".join(parts[:-1] if len(parts) > 1 else parts)
    for code, sign in (("$LT$", "<"), ("$GT$", ">"), ("$u20$", " "), ("$RF$", "&"), ("..", "::"), ("$C$", ",")):
        text = text.replace(code, sign)
    return text


def is_access(mnemonic, stem):
    """Single load or store of any width: ldr, ldrb, ldrsh …"""
    return mnemonic == stem or (mnemonic[:3] == stem and mnemonic[3:] in ("b", "h", "sb", "sh"))


def cost(instruction):
    """(cycles, single access?) of an instruction, without the refill of a taken branch."""
    mnemonic = instruction.mnemonic.split(".")[0]
    stem = mnemonic
    for condition in ("eq", "ne", "hs", "lo", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le"):
        if mnemonic.endswith(condition) and (is_access(mnemonic[:-2], "ldr") or is_access(mnemonic[:-2], "str")):
            stem = mnemonic[:-2]
    if is_access(stem, "ldr"):
        return 2, True
    if is_access(stem, "str"):
        return 1, True
    if mnemonic.startswith(("ldrd", "strd")):
        return 3, False
    if mnemonic.startswith(("push", "pop", "ldm", "stm", "vpush", "vpop", "vldm", "vstm")):
        listed = instruction.op_str[instruction.op_str.find("{") : instruction.op_str.find("}")]
        return 2 + listed.count(","), False
    if mnemonic.startswith(("udiv", "sdiv")):
        return DIVISION, False
    if mnemonic.startswith("vdiv"):
        return 14, False
    if mnemonic.startswith("vldr"):
        return 2, False
    if mnemonic.startswith(("dsb", "isb", "dmb")):
        return 3, False
    if mnemonic.startswith("mrs"):
        return 2, False
    return 1, False


class Call:
    """One call of a counted function, everything that it calls included."""

    __slots__ = ("name", "tag", "instructions", "cycles", "blocks")

    def __init__(self, name, tag):
        self.name, self.tag = name, tag
        self.instructions = self.cycles = 0
        self.blocks = collections.Counter()


class Counter:
    """Counts the calls of some functions of a program that an emulator runs.

    `tag()` is asked at every call and kept with it. `done(call, total)` is told of each call that returns. It needs
    only the emulator and the image, so that it can watch any program: of an interrupt handler name the function
    that it calls.
    """

    def __init__(self, mu, image, functions, done, tag=lambda: None):
        self.mu, self.image, self.done, self.tag = mu, image, done, tag
        self.entries = {image.function(name): name for name in functions}
        self.decoder = Cs(CS_ARCH_ARM, CS_MODE_THUMB | CS_MODE_MCLASS)
        self.known = {}
        self.call = None
        self.returns = None
        self.next = None
        self.pipelined = False
        mu.hook_add(UC_HOOK_BLOCK, self._block)

    def _decode(self, address, size):
        """(instructions, cycles, begins with a load that can be pipelined, ends with a single access)."""
        code = bytes(self.mu.mem_read(address, size))
        count = cycles = 0
        access = first = False
        length = 0
        for i in self.decoder.disasm(code, address):
            spent, single = cost(i)
            if count == 0:
                first = single and spent == 2
            if single and access and spent == 2:
                spent = 1
            access = single
            count += 1
            cycles += spent
            length += i.size
        while length < size:  # what capstone does not know
            count, cycles, length, access = count + 1, cycles + 1, length + 4, False
        return count, cycles, first, access

    def _block(self, mu, address, size, _):
        if self.call is None:
            name = self.entries.get(address)
            if name is None:
                return
            self.call = Call(name, self.tag())
            self.returns = (mu.reg_read(UC_ARM_REG_LR) & ~1, mu.reg_read(UC_ARM_REG_SP))
            self.next, self.pipelined = address, False
        elif address == self.returns[0] and mu.reg_read(UC_ARM_REG_SP) == self.returns[1]:
            call, self.call = self.call, None
            call.cycles += REFILL
            self.done(call)
            return
        key = (address, size)
        known = self.known.get(key)
        if known is None:
            known = self.known[key] = self._decode(address, size)
        count, cycles, first, access = known
        call = self.call
        if address != self.next:
            cycles += REFILL
        elif first and self.pipelined:
            cycles -= 1
        call.instructions += count
        call.cycles += cycles
        call.blocks[key] += 1
        self.next, self.pipelined = address + size, access

    def spread(self, blocks, key):
        """Instructions of counted blocks by `key(address)`."""
        spread = collections.Counter()
        for (address, size), times in blocks.items():
            code = bytes(self.mu.mem_read(address, size))
            for i in self.decoder.disasm(code, address):
                spread[key(i.address)] += times
        return spread


def machine(image):
    """An emulator with the program loaded, memories and peripherals as plain RAM, ready to run from its reset vector.

    Below the stack there is more room than on the chip: what a stack needs is measured elsewhere.
    """
    mu = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
    mu.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M4)
    for base, size in (
        (0x08000000, 0x100000), (0x0FF00000, 0x110000), (0x20000000, 0x20000),
        (0x40000000, 0x100000), (0xE0000000, 0x100000),
    ):
        mu.mem_map(base, size)
    for address, data, _ in image.segments:
        mu.mem_write(address, data)
    stack, reset = struct.unpack("<II", bytes(mu.mem_read(0x08000000, 8)))
    mu.reg_write(UC_ARM_REG_SP, stack)
    return mu, reset


def watch_word(mu, address, told):
    """Calls `told(value)` when the word at an address is written."""
    mu.hook_add(UC_HOOK_MEM_WRITE, lambda _mu, _kind, _at, _size, value, _data: told(value & 0xFFFFFFFF),
                begin=address, end=address + 3)
