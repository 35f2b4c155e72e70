#!/usr/bin/env python3
"""Cuts the firmware's ELF into the two binary images that a flash programmer writes.

    tools/image.py target/thumbv7em-none-eabihf/firmware/stage-controller target/

writes stage-controller-vectors.bin (for 0x08000000) and stage-controller.bin (for 0x0800c000). The saved settings lie
between the two and stay as they are.
"""

import pathlib
import struct
import sys

FLASH = range(0x0800_0000, 0x0810_0000)
SETTINGS = range(0x0800_4000, 0x0800_C000)
PT_LOAD = 1


def segments(elf):
    """Load address and bytes of everything that goes to flash (ELF32, little-endian: TIS ELF 1.2)."""
    if elf[:6] != b"\x7fELF\x01\x01":
        sys.exit("not a 32-bit little-endian ELF")
    offset, = struct.unpack_from("<I", elf, 28)
    size, count = struct.unpack_from("<HH", elf, 42)
    for n in range(count):
        kind, start, _, address, length = struct.unpack_from("<5I", elf, offset + n * size)
        if kind == PT_LOAD and length and address in FLASH:
            yield address, elf[start:start + length]


def image(parts):
    """One image from its parts, gaps as erased flash."""
    begin = min(address for address, _ in parts)
    end = max(address + len(data) for address, data in parts)
    flat = bytearray(b"\xff" * (end - begin))
    for address, data in parts:
        flat[address - begin:address - begin + len(data)] = data
    return begin, bytes(flat)


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    elf, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    parts = list(segments(elf.read_bytes()))
    if any(address < SETTINGS.stop and address + len(data) > SETTINGS.start for address, data in parts):
        sys.exit("the program lies where the settings are")
    for name, chosen in (
        ("stage-controller-vectors.bin", [p for p in parts if p[0] < SETTINGS.start]),
        ("stage-controller.bin", [p for p in parts if p[0] >= SETTINGS.stop]),
    ):
        begin, data = image(chosen)
        (out / name).write_bytes(data)
        print(f"{out / name}: {len(data)} bytes for {begin:#010x}")


if __name__ == "__main__":
    main()
