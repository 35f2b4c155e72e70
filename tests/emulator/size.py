#!/usr/bin/env python3
"""What the firmware takes of flash and of static memory, against what it may. The memory of samples, scans and recordings
has a budget of its own.

    tests/emulator/size.py ELF

Fails when one of them is beyond its limit.
"""

import sys

from elftools.elf.elffile import ELFFile

FLASH_LIMIT, RAM_LIMIT, LIGHT_LIMIT = 192 * 1024, 64 * 1024, 39 * 1024
FLASH, RAM = range(0x0800_0000, 0x0810_0000), range(0x2000_0000, 0x2002_0000)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with open(sys.argv[1], "rb") as file:
        elf = ELFFile(file)
        allocated = [s for s in elf.iter_sections() if s["sh_flags"] & 2 and s["sh_size"]]
        # the initial values of .data lie in flash too
        flash = sum(s["sh_size"] for s in allocated if s["sh_addr"] in FLASH or s.name == ".data")
        ram = sum(s["sh_size"] for s in allocated if s["sh_addr"] in RAM)
        symbols = elf.get_section_by_name(".symtab").iter_symbols()
        light = sum(s["st_size"] for s in symbols if "firmware5LIGHT" in s.name)
    ram -= light
    print(f"figure: flash {flash} of {FLASH_LIMIT} bytes, static RAM {ram} of {RAM_LIMIT} bytes", end="")
    print(f", of light {light} of {LIGHT_LIMIT} bytes")
    assert flash > 10_000 and ram > 10_000, "these are not the sections of the firmware"
    sys.exit(flash > FLASH_LIMIT or ram > RAM_LIMIT or light > LIGHT_LIMIT)


if __name__ == "__main__":
    main()
