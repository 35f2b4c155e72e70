#!/usr/bin/env python3
"""What the refill interrupt of the shipped firmware costs: every instruction between its entry and its end.

    tests/emulator/isr_cost.py ELF [--check] [--keep] [--top 20]

Runs the ELF in the emulator of the board with the calibration of the machine `bench` and all compensation on: idle,
straight moves of all six motors through home at +-100 k and +-490 k steps/s, and a reversal of every motor. Cycles are
modelled from the instructions of the handler by the table in m4.py, without wait states and bus contention. With
--check the figures are compared with those kept in isr_cost.json: more than 5 % above one of them fails, and so does a
target that was met and is missed now. Each target that is missed is named. With --keep they are kept.
"""

import argparse
import collections
import ctypes
import json
import math
import pathlib
import sys

from capstone import CS_ARCH_ARM, CS_MODE_MCLASS, CS_MODE_THUMB, Cs

import m4
from lab import NO_ERROR, Follower, as_block, ask, figure, power_up
from stm32f4.core import FLASH_BASE
from stm32f4.stats import TIM2_EXCEPTION

HERE = pathlib.Path(__file__).parent
KEPT = HERE / "isr_cost.json"
BLOCK = HERE.parent / "target" / "bench.block"
TARGETS = {"6 x 100 k": 25.0, "6 x 490 k": 13.0}
SLACK = 1.05
SEGMENT_US = 256
DEADLINE = 168 * SEGMENT_US
# Segments that are counted at a time.
SLICE = 25
# The machine's steps, um and degrees.
STEP = [0.01] * 3 + [math.degrees(1e-7)] * 3
# Turned so that the axes need not be faster than the motors: what the rotary stages do at the lever, the slides undo.
SIGNS = [1, 1, -1, 1, -1, 1]
# Rate in steps/s, half the window around home and half the way, in steps.
COURSES = {"6 x 100 k": (100_000, 50_000, 60_000), "6 x 490 k": (490_000, 24_500, 102_000)}
# Segments of the reversal: longer than the longest take-up.
REVERSAL = 1700
# Above what any motor of the machine may do, in steps/s^2 and steps/s^3.
ACCELERATION, JERK = 4e6, 8e7


class Handler:
    """Counts the handler of the refill alone: the profile runs from its entry to its end."""

    def __init__(self, board):
        self.board = board
        board.profile()
        self.counts, self.address = board._profile, board.core.state.profile
        board.core.state.profile = None
        entered, left, stats = board.stats.entered, board.stats.left, board.stats

        def enter(number, *rest):
            entered(number, *rest)
            if number == TIM2_EXCEPTION and self.on:
                board.core.state.profile = self.address

        def leave(number, *rest):
            left(number, *rest)
            if number == TIM2_EXCEPTION:
                board.core.state.profile = None

        self.on = False
        stats.entered, stats.left = enter, leave

    def take(self):
        """What was counted since the last time, by address."""
        found = {FLASH_BASE + 2 * i: n for i, n in enumerate(self.counts) if n}
        ctypes.memset(self.counts, 0, ctypes.sizeof(self.counts))
        return found


class Scene:
    """Sums over the segments of a scene."""

    def __init__(self):
        self.segments = self.instructions = self.longest = self.steps = 0
        self.rate = None
        self.addresses = {}


def modelled(image, counts):
    """Cycles of counted instructions. A conditional branch is taken as often as its successor runs less often."""
    decoder = Cs(CS_ARCH_ARM, CS_MODE_THUMB | CS_MODE_MCLASS)
    total, before, access = 0, None, False
    for address in sorted(counts):
        times = counts[address]
        instruction = next(decoder.disasm(image.code(address), address, 1), None)
        if instruction is None:
            total, before = total + times, None
            continue
        cycles, single = m4.cost(instruction)
        if single and cycles == 2 and access and before == address:
            cycles = 1
        after = address + instruction.size
        left = instruction.mnemonic.split(".")[0]
        leaves = left in ("b", "bl", "bx", "blx", "cbz", "cbnz") or left[:1] == "b" and left[1:] in CONDITIONS or (
            left.startswith(("pop", "ldm")) and "pc" in instruction.op_str) or left in ("tbb", "tbh")
        total += times * cycles
        if leaves:
            always = left in ("b", "bl", "bx", "blx", "tbb", "tbh") or left.startswith(("pop", "ldm"))
            total += m4.REFILL * (times if always else max(times - counts.get(after, 0), 0))
        before, access = after, single
    return total


CONDITIONS = ("eq", "ne", "hs", "lo", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le")


class Bench:
    """The board with the machine `bench`."""

    def __init__(self, elf):
        self.board = power_up(elf)
        self.image = m4.Image(elf)
        self.handler = Handler(self.board)
        self.scenes = {}
        self.tell("SYST:COMM:SER:BAUD 1000000")
        self.board.run(20_000)
        self.board.serial.baud = 1_000_000
        self.board.serial.write(b"COMP:LOAD " + as_block(BLOCK.read_bytes()) + b"\n")
        for n in range(1, 7):
            self.tell(f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON")
        self.fine()

    def tell(self, text):
        self.board.serial.write(text + "\n")

    def fine(self):
        answer = ask(self.board, "SYST:ERR:ALL?")
        if answer != NO_ERROR:
            raise SystemExit(f"the firmware answers {answer}")

    def arrive(self):
        if ask(self.board, "*OPC?", 20_000_000) != "1":
            raise SystemExit("the move did not end")
        self.fine()

    def go(self, pose):
        self.tell("POSE " + ",".join(f"{u:.8f}" for u in pose))

    def pose_of(self, steps):
        """The pose of motor counts: they are gone to without compensation, and asked for with it."""
        self.tell("COMP:STAT OFF")
        self.go([n * step for n, step in zip(steps, STEP)])
        self.arrive()
        self.tell("COMP:STAT ON")
        pose = [float(u) for u in ask(self.board, "POSE?").split(",")]
        self.fine()
        return pose

    def window(self, scene, segments, follower=None):
        """Counts some segments."""
        scene = self.scenes.setdefault(scene, Scene())
        before = list(follower.look()) if follower else None
        self.board.stats.clear()
        self.handler.on = True
        self.board.run(segments * SEGMENT_US)
        self.handler.on = False
        stats = self.board.stats
        scene.segments += stats.entries[TIM2_EXCEPTION]
        scene.instructions += stats.instructions[TIM2_EXCEPTION]
        scene.longest = max(scene.longest, stats.longest[TIM2_EXCEPTION])
        if follower:
            ways = [abs(b - a) for a, b in zip(before, follower.look())]
            scene.steps += sum(ways)
            return ways
        return None

    def limits(self, ways, half, rate):
        """Every motor turns at `rate` on a way of `half` steps to each side; axes may accelerate as motors may."""
        for n, way in enumerate(ways, 1):
            along = abs(way) / (2 * half)
            for header, wanted in (("VEL", rate), ("ACC", ACCELERATION), ("JERK", JERK)):
                most = float(ask(self.board, f"AXIS{n}:{header}? MAX"))
                wanted *= along
                self.tell(f"AXIS{n}:{header} " + (f"{wanted:.6f}" if wanted < most else "MAX"))
            # the least reserve leaves the most for the move; where there is room, the play is taken up before the window
            self.tell(f"AXIS{n}:BACK:VEL {'MIN' if rate > 400_000 else 'DEF'}")
        self.fine()

    def fast(self):
        """Axes as fast as they may be."""
        for n in range(1, 7):
            self.tell(f"AXIS{n}:VEL MAX;ACC MAX;JERK MAX")
        self.fine()

    def idle(self):
        self.board.run(20_000)
        self.window("idle", 500)
        self.scenes["idle"].addresses = self.handler.take()

    def course(self, name):
        """A straight move through home, counted in the window around it."""
        rate, near, half = COURSES[name]
        self.fast()
        end = self.pose_of([sign * half for sign in SIGNS])
        start = self.pose_of([-sign * half for sign in SIGNS])
        self.limits([b - a for a, b in zip(start, end)], half, rate)
        follower = Follower(self.board)
        follower.counts[0] = -SIGNS[0] * half
        self.go(end)
        inside = lambda: abs(follower.look()[0]) < near
        self.board.run_until(inside, 5_000_000, "the window around home", step_us=SEGMENT_US)
        sums, segments = [0] * 6, 0
        while inside():
            ways = self.window(name, SLICE, follower)
            sums = [a + b for a, b in zip(sums, ways)]
            segments += SLICE
        self.scenes[name].addresses = self.handler.take()
        self.scenes[name].rate = round(min(sums) * 1e6 / (segments * SEGMENT_US))
        self.arrive()

    def reversal(self):
        """All motors turn and take up their play, from the first step on."""
        follower = Follower(self.board)
        self.go([0] * 6)
        self.board.run_until(lambda: any(follower.look()), 1_000_000, "the first step", step_us=SEGMENT_US)
        for _ in range(REVERSAL // SLICE):
            self.window("reversal", SLICE, follower)
        self.scenes["reversal"].addresses = self.handler.take()
        self.arrive()

    def run(self):
        self.idle()
        # flanks are known afterwards, so that turning takes up play
        for n in range(1, 7):
            self.tell(f"AXIS{n}:BACK:PREL POS")
            self.arrive()
        self.course("6 x 100 k")
        self.reversal()
        self.course("6 x 490 k")
        if self.board.bus.warnings or self.board.merged_requests:
            raise SystemExit(f"what the chip does not take: {self.board.bus.warnings}")
        return self


def figures(bench):
    """The figures by name."""
    found = {}
    for name, scene in bench.scenes.items():
        cycles = modelled(bench.image, scene.addresses)
        each = cycles / scene.instructions
        found[name] = {
            "segments": scene.segments,
            "steps": scene.steps,
            "slowest motor, steps/s": scene.rate,
            "instructions per segment": round(scene.instructions / scene.segments, 1),
            "instructions per step": round(scene.instructions / scene.steps, 2) if scene.steps else None,
            "cycles per segment": round(cycles / scene.segments, 1),
            "worst segment, instructions": scene.longest,
            # at the scene's mean cycles an instruction
            "worst segment, share of the deadline": round(scene.longest * each / DEADLINE, 4),
        }
    return found


def show(bench, found, top):
    for name, f in found.items():
        step = f"{f['instructions per step']} instructions per step, " if f["steps"] else ""
        rate = f" at {f['slowest motor, steps/s']} steps/s and more" if f["slowest motor, steps/s"] else ""
        figure(f"refill interrupt, {name}{rate}: {step}{f['instructions per segment']} instructions and "
               f"{f['cycles per segment']} cycles per segment; worst segment {f['worst segment, instructions']} instructions, "
               f"{f['worst segment, share of the deadline']:.1%} of {SEGMENT_US} us")
        by_function = collections.Counter()
        for address, times in bench.scenes[name].addresses.items():
            by_function[bench.image.at(address)] += times
        for function, times in by_function.most_common(top):
            print(f"  {times / f['segments']:10.1f}  {function}")


def missed(found):
    """Targets that are missed."""
    for name, limit in TARGETS.items():
        if found[name]["instructions per step"] > limit:
            yield f"target missed: {name}: {found[name]['instructions per step']} instructions per step, at most {limit} wanted"


def complaints(found):
    """Targets that were met, and what costs more than what is kept."""
    kept = json.loads(KEPT.read_text())
    for name, limit in TARGETS.items():
        if found[name]["instructions per step"] > limit >= kept[name]["instructions per step"]:
            yield f"{name}: {found[name]['instructions per step']} instructions per step, at most {limit} wanted"
    for name, now in found.items():
        for key in ("instructions per segment", "worst segment, instructions"):
            if now[key] > kept[name][key] * SLACK:
                yield f"{name}: {key} {now[key]}, was {kept[name][key]}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("elf")
    parser.add_argument("--top", type=int, default=0, help="functions to print")
    parser.add_argument("--check", action="store_true", help="fail if something costs more than wanted or kept")
    parser.add_argument("--keep", action="store_true", help="keep these figures")
    args = parser.parse_args()
    bench = Bench(args.elf).run()
    found = figures(bench)
    show(bench, found, args.top)
    if args.keep:
        KEPT.write_text(json.dumps(found, indent=2) + "\n")
    bad = list(complaints(found)) if args.check else []
    print("\n".join([*missed(found), *bad]))
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
