#!/usr/bin/env python3
"""Seeds for the fuzz targets: the examples of the command tree, and real calibration blocks.

    seeds.py TREE.json CORPUS BLOCK...

TREE.json is what `cargo run -p stage-controller` prints; a BLOCK is what `host-sim calibrate` writes.
"""
import json
import sys
from pathlib import Path


def main():
    tree, corpus, *blocks = (Path(argument) for argument in sys.argv[1:])
    lines = corpus / "parser"
    lines.mkdir(parents=True, exist_ok=True)
    for number, command in enumerate(json.loads(tree.read_text())["commands"]):
        line = command["example"].encode() + b"\n"
        # before each chunk one byte: its length in the upper six bits, a pause, and whether answers are read
        lines.joinpath(f"example-{number}").write_bytes(bytes([len(line) << 2 | 3]) + line)
    shapes = corpus / "calibration_block"
    shapes.mkdir(parents=True, exist_ok=True)
    for block in blocks:
        # mode 1 mends the CRC; twelve numbers follow the block
        numbers = b"".join(n.to_bytes(4, "little", signed=True) for n in range(-600_000, 600_000, 100_000))
        shapes.joinpath(block.stem).write_bytes(b"\x01" + block.read_bytes() + numbers)


if __name__ == "__main__":
    main()
