#!/usr/bin/env python3
"""Shows that no panic can be reached from the interrupts that make or stop steps.

    tests/emulator/panic_paths.py ELF

Walks the calls of the linked program from each of those handlers: every function that can be reached is decoded, and
none may be one that panics. A call through a register could lead anywhere: there must be none but those whose register
was loaded with the address of a function in the same run of instructions, which is shorter where there are several.
"""

import bisect
import re
import sys

from capstone import CS_ARCH_ARM, CS_MODE_MCLASS, CS_MODE_THUMB, Cs
from capstone.arm import ARM_GRP_CALL, ARM_GRP_JUMP, ARM_OP_IMM, ARM_OP_MEM, ARM_OP_REG, ARM_REG_PC
from elftools.elf.elffile import ELFFile

HANDLERS = [
    "TIM2", "EXTI1", "EXTI2", "EXTI3", "EXTI9_5", "EXTI15_10", "EXTI0", "DMA2_STREAM1", "DMA2_STREAM2",
]
PANICS = re.compile(r"panic|unwrap_failed|expect_failed|slice_.*_fail|unreachable|defmt|HardFault|UsageFault")


class Program:
    """Functions of an ELF and their calls."""

    def __init__(self, path):
        elf = ELFFile(open(path, "rb"))
        text = elf.get_section_by_name(".text")
        self.base, self.code = text["sh_addr"], text.data()
        self.names, self.extent = {}, {}
        mapping = []
        for symbol in elf.get_section_by_name(".symtab").iter_symbols():
            address = symbol["st_value"]
            if symbol["st_info"]["type"] == "STT_FUNC":
                self.names.setdefault(address & ~1, []).append(symbol.name)
                self.extent[address & ~1] = max(symbol["st_size"], self.extent.get(address & ~1, 0))
            elif re.match(r"\$[td]", symbol.name):
                mapping.append((address, symbol.name[1]))
        self.mapping = sorted(set(mapping))
        self.starts = sorted(self.extent)
        self.disassembler = Cs(CS_ARCH_ARM, CS_MODE_THUMB | CS_MODE_MCLASS)
        self.disassembler.detail = True

    def function_at(self, address):
        """Start of the function that holds an address."""
        n = bisect.bisect_right(self.starts, address) - 1
        while n >= 0:
            start = self.starts[n]
            if start <= address < start + max(self.extent[start], 2):
                return start
            n -= 1
        return None

    def chunks(self, start):
        """Code of a function without the literals in it."""
        end = start + self.extent[start]
        at = bisect.bisect_right(self.mapping, (start, "z")) - 1
        marks = [(start, "t")]
        if at >= 0 and self.mapping[at][0] >= start:
            marks[0] = (start, self.mapping[at][1])
        marks += [mark for mark in self.mapping[at + 1:] if mark[0] < end and mark[0] > start] + [(end, "d")]
        for (begin, kind), (stop, _) in zip(marks, marks[1:]):
            if kind == "t":
                yield begin, self.code[begin - self.base:stop - self.base]

    def literal(self, insn):
        """What an instruction loads from the literals behind its function; None for any other."""
        if insn.mnemonic not in ("ldr", "ldr.w") or insn.operands[1].type != ARM_OP_MEM:
            return None
        where = insn.operands[1].mem
        if where.base != ARM_REG_PC or where.index:
            return None
        at = (insn.address + 4 & ~3) + where.disp - self.base
        return int.from_bytes(self.code[at:at + 4], "little")

    def table(self, insn):
        """Where a jump through the table behind it may lead."""
        size = {"tbb": 1, "tbh": 2}.get(insn.mnemonic)
        if size is None:
            return
        begin = insn.address + 4
        end = self.mapping[bisect.bisect_right(self.mapping, (begin, "z"))][0]
        for at in range(begin - self.base, end - self.base - size + 1, size):
            yield begin + 2 * int.from_bytes(self.code[at:at + size], "little")

    def calls(self, start):
        """Functions called or jumped to, and calls through registers as text."""
        called, unknown = set(), []
        code = [insn for begin, code in self.chunks(start) for insn in self.disassembler.disasm(code, begin)]
        jumps = {insn.address: [op.imm & ~1 for op in insn.operands if op.type == ARM_OP_IMM][-1:]
                 for insn in code if insn.group(ARM_GRP_CALL) or insn.group(ARM_GRP_JUMP)}
        entered = {target for targets in jumps.values() for target in targets}
        entered |= {target for insn in code for target in self.table(insn)}
        loaded, expected = {}, None
        for insn in code:
            if insn.address != expected or insn.address in entered:
                loaded.clear()
            expected = insn.address + insn.size
            targets = jumps.get(insn.address)
            if targets:
                target = self.function_at(targets[0])
                if target != start:
                    called.add(target)
            elif insn.mnemonic == "blx" and insn.operands[0].type == ARM_OP_REG and insn.operands[0].reg in loaded:
                called.add(self.function_at(loaded[insn.operands[0].reg] & ~1))
            elif insn.mnemonic.startswith("blx") or (insn.mnemonic == "bx" and insn.op_str != "lr"):
                unknown.append(f"{insn.address:#x} {insn.mnemonic} {insn.op_str}")
            kept_by_calls = ("r4", "r5", "r6", "r7", "r8", "sb", "sl", "fp")
            if insn.group(ARM_GRP_CALL):
                loaded = {reg: value for reg, value in loaded.items() if insn.reg_name(reg) in kept_by_calls}
            for reg in insn.regs_access()[1]:
                loaded.pop(reg, None)
            value = self.literal(insn)
            if value is not None:
                loaded[insn.operands[0].reg] = value
        return called, unknown


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    program = Program(sys.argv[1])
    addresses = {name: address for address, names in program.names.items() for name in names}
    missing = [name for name in HANDLERS if name not in addresses]
    if missing:
        sys.exit(f"no such handlers in the program: {', '.join(missing)}")
    came_from = {addresses[name]: None for name in HANDLERS}
    todo, wrong, size = list(came_from), [], 0

    def path(address):
        steps = []
        while address is not None:
            steps.append(program.names[address][0])
            address = came_from[address]
        return " <- ".join(steps)

    while todo:
        start = todo.pop()
        size += program.extent[start]
        if any(PANICS.search(name) for name in program.names[start]):
            wrong.append(f"a panic can be reached: {path(start)}")
            continue
        called, unknown = program.calls(start)
        wrong += [f"a call that cannot be followed, {text}: {path(start)}" for text in unknown]
        if None in called:
            wrong.append(f"a jump to no function: {path(start)}")
        for target in called - {None} - came_from.keys():
            came_from[target] = start
            todo.append(target)
    print("\n".join(wrong))
    print(f"figure: {len(came_from)} functions, {size} bytes, can be reached from the interrupts of the step output; "
          f"{len(wrong)} ways to a panic")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
