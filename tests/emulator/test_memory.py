"""The firmware's own copies and fills of memory, called one by one: at every alignment, each byte and none beside."""

import random

import pytest
from unicorn.arm_const import UC_ARM_REG_LR, UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R4, UC_ARM_REG_R5

from m4 import Image, machine

AREA, ROOM = 0x20001000, 256
BACK = 0x08000100
SIZES = [*range(0, 40), 63, 64, 65, 96]
KEPT = (UC_ARM_REG_R4, UC_ARM_REG_R5)


@pytest.fixture(scope="module")
def call(firmware):
    """Calls a function with three arguments on an area of known bytes: the area before and after, and what it returns."""
    image = Image(firmware)
    mu, _ = machine(image)
    before = random.Random(1).randbytes(ROOM)

    def run(name, *arguments):
        mu.mem_write(AREA, before)
        for register, value in zip((UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, *KEPT), (*arguments, 4, 5)):
            mu.reg_write(register, value)
        mu.reg_write(UC_ARM_REG_LR, BACK | 1)
        mu.emu_start(image.function(name) | 1, BACK, count=10_000)
        assert [mu.reg_read(register) for register in KEPT] == [4, 5], "what a caller keeps is kept"
        return before, bytes(mu.mem_read(AREA, ROOM)), mu.reg_read(UC_ARM_REG_R0)

    return run


def copied(area, to, start, size):
    return area[:to] + area[start:start + size] + area[to + size:]


@pytest.mark.parametrize("name, step", [("memcpy", 1), ("__aeabi_memcpy", 1), ("__aeabi_memcpy4", 4), ("__aeabi_memcpy8", 8)])
def test_a_copy_is_the_bytes_asked_for_and_no_more(call, name, step):
    for to in range(128, 136, step):
        for start in range(16, 24, step):
            for size in SIZES:
                before, after, returned = call(name, AREA + to, AREA + start, size)
                assert after == copied(before, to, start, size), (to, start, size)
                assert name != "memcpy" or returned == AREA + to


@pytest.mark.parametrize("name, step", [("memmove", 1), ("__aeabi_memmove", 1), ("__aeabi_memmove4", 4)])
def test_a_copy_may_overlap_what_it_copies(call, name, step):
    for start in range(64, 72, step):
        for to in range(start - 24, start + 25, step):
            for size in SIZES:
                before, after, returned = call(name, AREA + to, AREA + start, size)
                assert after == copied(before, to, start, size), (to, start, size)
                assert name != "memmove" or returned == AREA + to


@pytest.mark.parametrize("name, step, value", [
    ("memset", 1, 0xA5), ("__aeabi_memset", 1, 0x1A5), ("__aeabi_memset4", 4, 0xA5), ("__aeabi_memclr", 1, 0),
    ("__aeabi_memclr8", 8, 0),
])
def test_a_fill_is_the_bytes_asked_for_and_no_more(call, name, step, value):
    for to in range(16, 24, step):
        for size in SIZES:
            arguments = (value, size) if name == "memset" else (size, value or 0x77)
            before, after, returned = call(name, AREA + to, *arguments)
            assert after == before[:to] + bytes([value & 0xFF]) * size + before[to + size:], (to, size)
            assert name != "memset" or returned == AREA + to
