#!/usr/bin/env python3
"""What a refill costs on a Cortex-M4F: instructions counted, cycles modelled (see m4.py for what the model leaves out).

Runs the program `cost` of tests/target. With --check the figures are compared with those kept in cost.json: more
than 5 % above one of them, or beyond a limit that must hold, fails. With --keep they are kept.
"""

import argparse
import json
import pathlib
import struct
import sys

import m4

HERE = pathlib.Path(__file__).parent
KEPT = HERE / "cost.json"
SCENES = ["between", "idle", "6 x 100 k", "6 x 490 k", "reversal", "finished"]
CLOCK_HZ = 168_000_000
SEGMENT_US = 128
DEADLINE = CLOCK_HZ // 1_000_000 * SEGMENT_US
SLACK = 1.05
# What must hold: instructions per step, and the share of the deadline of the worst segment.
MUST = {"6 x 100 k": 25.0, "6 x 490 k": 13.0}
WORST_SHARE = 0.5


class Scene:
    """Sums over the calls of a scene."""

    def __init__(self):
        self.calls = self.instructions = self.cycles = self.worst = self.worst_instructions = 0
        self.steps = self.rate = 0
        self.blocks = m4.collections.Counter()

    def add(self, call):
        self.calls += 1
        self.instructions += call.instructions
        self.cycles += call.cycles
        self.worst = max(self.worst, call.cycles)
        self.worst_instructions = max(self.worst_instructions, call.instructions)
        self.blocks.update(call.blocks)


class Run:
    """Runs the program and collects what it costs."""

    def __init__(self, elf, refill, pose):
        self.image = m4.Image(elf)
        self.refill, self.pose = refill, pose
        self.mu, self.reset = m4.machine(self.image)
        self.scenes = {}
        self.poses = []
        self.scene = 0
        self.failed = False
        self.last_steps = 0
        self.steps_at = self.image.object("STEPS")
        self.rate_at = self.image.object("RATE")
        self.counter = m4.Counter(self.mu, self.image, [refill, pose], self.done, lambda: self.scene)
        m4.watch_word(self.mu, self.image.object("SCENE"), self.told)
        self.counted = None

    def word(self, address):
        return struct.unpack("<I", bytes(self.mu.mem_read(address, 4)))[0]

    def told(self, scene):
        """The program enters a scene: the steps since the last one belong to the scene that was counted last."""
        if scene >= len(SCENES) or SCENES[scene] == "finished":
            self.failed = scene >= len(SCENES)
            self.mu.emu_stop()
            return
        steps = self.word(self.steps_at)
        if self.counted is not None:
            self.counted.steps += (steps - self.last_steps) & 0xFFFFFFFF
        self.last_steps, self.scene = steps, scene
        rate = self.word(self.rate_at)
        if rate and scene:
            self.scenes.setdefault(SCENES[scene], Scene()).rate = rate
            if self.counted is not None or True:
                self.mu.mem_write(self.rate_at, bytes(4))
        if scene:
            self.counted = None

    def done(self, call):
        if call.name == self.pose:
            self.poses.append(call)
            return
        self.counted = self.scenes.setdefault(SCENES[call.tag], Scene())
        self.counted.add(call)

    def go(self):
        self.mu.emu_start(self.reset | 1, 0xFFFFFFFE)
        if self.failed:
            raise SystemExit("the program panicked: a move was refused")
        return self


def figures(run):
    """The figures by name."""
    found = {}
    for name in ("idle", "6 x 100 k", "6 x 490 k", "reversal"):
        scene = run.scenes[name]
        found[name] = {
            "segments": scene.calls,
            "steps": scene.steps,
            "slowest motor, steps/s": scene.rate,
            "instructions per segment": round(scene.instructions / scene.calls, 1),
            "instructions per step": round(scene.instructions / scene.steps, 2) if scene.steps else None,
            "cycles per segment": round(scene.cycles / scene.calls, 1),
            "cycles per step": round(scene.cycles / scene.steps, 2) if scene.steps else None,
            "load": round(scene.cycles / scene.calls / DEADLINE, 4),
            "worst segment, cycles": scene.worst,
        }
    worst = max(scene.worst for scene in run.scenes.values())
    found["worst segment"] = {"cycles": worst, "share of the deadline": round(worst / DEADLINE, 4)}
    dearest = max(run.poses, key=lambda call: call.cycles)
    found["planning one POSE"] = {
        "instructions": dearest.instructions,
        "cycles": dearest.cycles,
        "us at 168 MHz": round(dearest.cycles * 1e6 / CLOCK_HZ, 1),
    }
    return found


def table(run, found, top, lines):
    """Prints the figures and where they go."""
    print("Cortex-M4 at 168 MHz: instructions counted, cycles modelled without wait states and bus contention")
    head = f"{'':12}{'segments':>9}{'steps':>9}{'slowest':>9}{'instr/seg':>11}{'cyc/seg':>9}{'instr/step':>11}{'cyc/step':>9}{'load':>7}{'worst':>7}"
    print(head)
    for name in ("idle", "6 x 100 k", "6 x 490 k", "reversal"):
        f = found[name]
        per = lambda key: "" if f[key] is None else f"{f[key]:.2f}"
        print(f"{name:12}{f['segments']:>9}{f['steps']:>9}{f['slowest motor, steps/s'] or '':>9}"
              f"{f['instructions per segment']:>11.1f}{f['cycles per segment']:>9.1f}"
              f"{per('instructions per step'):>11}{per('cycles per step'):>9}{f['load']:>7.1%}{f['worst segment, cycles']:>7}")
    f = found["worst segment"]
    print(f"worst segment of all: {f['cycles']} cycles, {f['share of the deadline']:.1%} of its {DEADLINE}")
    f = found["planning one POSE"]
    print(f"planning one POSE (check and plan): {f['instructions']} instructions, {f['cycles']} cycles, {f['us at 168 MHz']} us")
    for name in ("idle", "6 x 100 k", "6 x 490 k", "reversal"):
        scene = run.scenes[name]
        print(f"\n{name}: instructions a segment by function")
        where(run, scene.blocks, scene.calls, top, lines)
    dearest = max(run.poses, key=lambda call: call.cycles)
    print("\nplanning one POSE: instructions by function")
    where(run, dearest.blocks, 1, 2 * top, False)
    refill = m4.collections.Counter()
    for scene in run.scenes.values():
        refill.update(scene.blocks)
    names = set(run.counter.spread(refill, run.image.at))
    print(f"\nflash of the functions that a refill runs: {sum(run.image.size(name) for name in names)} bytes")


def where(run, blocks, calls, top, lines):
    for name, count in run.counter.spread(blocks, run.image.at).most_common(top):
        print(f"  {count / calls:10.1f}  {name}")
    if lines:
        print("  by source line")
        by_file = m4.collections.Counter()
        spread = run.counter.spread(blocks, run.image.line)
        for (file, _), count in spread.items():
            by_file[file] += count
        print("   ", ", ".join(f"{file} {count / calls:.0f}" for file, count in by_file.most_common(16)))
        for (file, line), count in spread.most_common(lines):
            print(f"  {count / calls:10.1f}  {file}:{line}")


def check(found):
    """What is worse than kept or than it must be."""
    kept = json.loads(KEPT.read_text())
    bad = []
    for name, limit in MUST.items():
        if found[name]["instructions per step"] > limit:
            bad.append(f"{name}: {found[name]['instructions per step']} instructions per step, {limit} must hold")
    if found["worst segment"]["share of the deadline"] > WORST_SHARE:
        bad.append(f"worst segment: {found['worst segment']['cycles']} cycles of {DEADLINE}")
    for name, key in GATED:
        now, then = found[name][key], kept[name][key]
        if now > then * SLACK:
            bad.append(f"{name}: {key} {now}, was {then}")
    return bad


GATED = [
    ("idle", "instructions per segment"),
    ("6 x 100 k", "instructions per step"),
    ("6 x 490 k", "instructions per step"),
    ("reversal", "instructions per segment"),
    ("worst segment", "cycles"),
    ("planning one POSE", "instructions"),
]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    target = HERE.parent.parent / "target"
    parser.add_argument("--elf", default=target / "thumbv7em-none-eabihf/release/cost")
    parser.add_argument("--symbol", default="counted_refill", help="function that makes one segment")
    parser.add_argument("--pose", default="counted_pose", help="function that checks and plans a move")
    parser.add_argument("--top", type=int, default=10, help="functions to print")
    parser.add_argument("--lines", type=int, default=0, help="source lines to print")
    parser.add_argument("--json", action="store_true", help="print the figures alone")
    parser.add_argument("--check", action="store_true", help="fail if something costs more than what is kept")
    parser.add_argument("--keep", action="store_true", help="keep these figures")
    args = parser.parse_args()
    run = Run(args.elf, args.symbol, args.pose).go()
    found = figures(run)
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        table(run, found, args.top, args.lines)
    if args.keep:
        KEPT.write_text(json.dumps(found, indent=2) + "\n")
    if args.check:
        bad = check(found)
        print("\n".join(f"cost: {line}" for line in bad) or "cost: within what is kept")
        sys.exit(bool(bad))


if __name__ == "__main__":
    main()
