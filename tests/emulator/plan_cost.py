#!/usr/bin/env python3
"""What check and plan of a pose cost on a Cortex-M4F, for every pose of the golden files, each from the one before.

Runs the program `plan_cost` of tests/target; the calibration blocks come from host-sim. See m4.py for what the
model of cycles leaves out.
"""

import argparse
import collections
import json
import pathlib
import struct
import subprocess
import tempfile

import m4

ROOT = pathlib.Path(__file__).parents[2]
FOLDERS = [ROOT / "host-sim/machines", ROOT / "tests/golden/machines"]
LOAD, POSE = 1, 2


def tasks(host_sim):
    """(name, kind, bytes) in their order: a block, then the poses of its machine."""
    with tempfile.TemporaryDirectory() as folder:
        for path in sorted((ROOT / "tests/golden").glob("*.json")):
            machine = next((f / f"{path.stem}.toml" for f in FOLDERS if (f / f"{path.stem}.toml").exists()), None)
            if machine is None:
                continue
            block = pathlib.Path(folder) / "block"
            subprocess.run([host_sim, "calibrate", machine, "-o", block], check=True, stdout=subprocess.DEVNULL)
            yield path.stem, LOAD, block.read_bytes()
            for pose in json.loads(path.read_text())["poses"]:
                yield path.stem, POSE, struct.pack("<6i", *pose["pose_nm_nrad"])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("elf")
    parser.add_argument("--host-sim", default=ROOT / "target/release/host-sim")
    parser.add_argument("--spread", type=int, default=0, help="print as many functions")
    parser.add_argument("--most", type=int, help="fail above as many cycles for check and plan together")
    arguments = parser.parse_args()
    image = m4.Image(arguments.elf)
    mu, reset = m4.machine(image)
    waiting = tasks(arguments.host_sim)
    at = {name: image.object(name) for name in ("NEXT", "LENGTH", "BLOCK", "POSE", "ORDERS")}
    word = lambda address: struct.unpack("<I", bytes(mu.mem_read(address, 4)))[0]
    calls, refused = collections.defaultdict(list), 0
    pending = []
    name = ""

    def told(value):
        nonlocal name, refused
        if value != 0xFFFFFFFF:
            return
        if pending and word(at["ORDERS"]):
            calls[name].append(tuple(pending))
        elif pending:
            refused += 1
        pending.clear()
        name, kind, data = next(waiting, ("", 0, b""))
        tell["kind"] = kind
        if not kind:
            mu.emu_stop()
        if kind == LOAD:
            mu.mem_write(at["BLOCK"], data)
            mu.mem_write(at["LENGTH"], struct.pack("<I", len(data)))
        elif kind == POSE:
            mu.mem_write(at["POSE"], data)

    tell = {"kind": 0}
    m4.watch_word(mu, at["NEXT"], told)
    # the store itself comes after the hook: what the program then reads is put there at its load
    mu.hook_add(m4.UC_HOOK_MEM_READ, lambda _mu, _k, a, _s, _v, _d: mu.mem_write(a, struct.pack("<I", tell["kind"])),
                begin=at["NEXT"], end=at["NEXT"] + 3)
    m4.Counter(mu, image, ["counted_pose", "counted_plan"], pending.append)
    mu.emu_start(reset, 0)
    pairs = [pair for machine in calls.values() for pair in machine]
    spent = lambda pair: sum(call.cycles for call in pair)
    print(f"{len(pairs)} poses planned, {refused} refused")
    for machine, own in sorted(calls.items()):
        worst = max(own, key=spent)
        mean = sum(spent(p) for p in own) / len(own)
        print(f"{machine:12} {len(own):3}  worst: check {worst[0].instructions:7} plan {worst[1].instructions:7} "
              f"instructions, together {spent(worst):7} cycles; mean {mean:9.0f}")
    worst = max(pairs, key=spent)
    print(f"figure: check and plan of the worst golden pose: {sum(c.instructions for c in worst)} instructions, {spent(worst)} cycles")
    if arguments.spread:
        counter = m4.Counter(mu, image, [], None)
        for what, call in zip(("check", "plan"), worst):
            print(f"worst {what}, instructions by function:")
            for function, count in counter.spread(call.blocks, image.at).most_common(arguments.spread):
                print(f"{count:8} {function}")
    if arguments.most and spent(worst) > arguments.most:
        raise SystemExit(f"more than {arguments.most} cycles")


if __name__ == "__main__":
    main()
