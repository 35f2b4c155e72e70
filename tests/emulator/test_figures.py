"""What the firmware costs, measured on the ELF that is flashed."""

import json
from pathlib import Path

import pytest

from lab import (NO_ERROR, SEGMENT, Follower, as_block, ask, calibrate, enable_all, errors, figure, power_up, start_moving)

ROOT = Path(__file__).resolve().parents[2]
KB = 1024
STACK = 64 * KB
WANTED_LATENCY_US = 1000
REFILL = 16 + 28
# Before a segment plays it is no longer begun: MARGIN in src/words/refill/stream.rs.
MARGIN_US = 112
# Golden poses that are tried: every so many of the forty.
EVERY = 4


def calibrated(firmware, host_sim, machine, path):
    board = power_up(firmware)
    block = calibrate(host_sim, ROOT / "host-sim" / "machines" / f"{machine}.toml", path / "block.cal")
    board.serial.write(b"COMP:LOAD " + as_block(block) + b"\n")
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    enable_all(board)
    return board


def begin_of_profile(board, since):
    """Index of the first word of the segment in which the profile's time begins, and how well the steps fit it (ticks).

    At first jerk is constant: step n is due when (t - t0)^3 is proportional to n - 1/2. A line through the times over
    the cube roots, for the motor with the most steps, has t0 where it begins."""
    steps = [[] for _ in range(6)]
    for index, motor, _ in board.words.steps(since):
        steps[motor].append(index)
    times = max(steps, key=len)[:40]
    assert len(times) == 40, "it moves"
    roots = [(n + 0.5) ** (1 / 3) for n in range(len(times))]
    mean_root, mean_time = sum(roots) / len(roots), sum(times) / len(times)
    slope = sum((r - mean_root) * (t - mean_time) for r, t in zip(roots, times)) / sum((r - mean_root) ** 2 for r in roots)
    exact = mean_time - slope * mean_root
    begin = round(exact / SEGMENT) * SEGMENT
    return begin, exact - begin


def latency_of(board, pose):
    """Microseconds from the last byte of a POSE to the first word of the segment in which its profile begins, and the
    longest refill on the way."""
    since = board.played()
    board.stats.clear()
    board.serial.write("POSE " + ",".join(pose) + "\n")
    last_byte = board.usart2.wire_free / 672
    follower = Follower(board)
    board.run_until(lambda: max(map(abs, follower.look())) >= 45, 2_000_000, "45 steps", step_us=1000)
    begin, misfit = begin_of_profile(board, since)
    assert abs(misfit) < SEGMENT / 3, f"the first steps do not tell the segment: {misfit:.0f} ticks off"
    return board.words.time_us(begin) - last_byte, board.stats.longest_us[REFILL]


def as_text(pose):
    """Coordinates in nm and nrad as the language takes them."""
    return [f"{value} {'NM' if n < 3 else 'NRAD'}" for n, value in enumerate(pose)]


@pytest.mark.parametrize("machine", ["paper", "long-lever"])
def test_a_pose_begins_within_a_millisecond_of_its_last_byte(firmware, host_sim, tmp_path, machine):
    poses = json.loads((ROOT / "tests" / "golden" / f"{machine}.json").read_text())["poses"][::EVERY]
    found = []
    for pose in poses:
        board = calibrated(firmware, host_sim, machine, tmp_path)
        found.append(latency_of(board, as_text(pose["pose_nm_nrad"])))
        board.serial.write("ABOR\n")
        board.run(5000)
        assert errors(board) == []
    latencies, refills = zip(*found)
    worst = max(latencies)
    figure(f"{machine}: last byte of POSE to the profile's begin: {min(latencies):.0f} to {worst:.0f} us over {len(poses)} golden poses")
    figure(f"{machine}: dearest refill that takes an order and makes two segments: {max(refills):.0f} us")
    assert worst <= WANTED_LATENCY_US
    assert max(refills) < MARGIN_US / 2, "the first of them is ready in time even with wait states"


def test_the_refill_leaves_time_for_everything_else(firmware, host_sim, tmp_path):
    board = calibrated(firmware, host_sim, "paper", tmp_path)
    start_moving(board, "POSE 1500,-1400,1300,1.2,-1.1,1.3", steps=2000)
    board.stats.clear()
    before = Follower(board)
    board.run(100_000)
    stats = board.stats
    entries, mean = stats.entries[REFILL], stats.instructions[REFILL] / stats.entries[REFILL]
    steps = sum(map(abs, before.look()))
    assert entries >= 100_000 // SEGMENT - 1 and steps > 1000
    share = stats.longest_us[REFILL] / SEGMENT
    figure(f"refill in a six-axis move, {steps * 10 / 1e3:.0f} k steps/s in all: {mean:.0f} instructions on average, {stats.longest[REFILL]} at most; "
           f"{stats.longest_us[REFILL]:.0f} us at most, {100 * share:.0f} % of a segment (1.5 cycles an instruction, no flash wait states)")
    assert errors(board) == []
    assert share < 0.5, "worst segment within half of its deadline"


def test_the_stack_is_large_enough_for_the_dearest_command(firmware, host_sim, tmp_path):
    board = calibrated(firmware, host_sim, "paper", tmp_path)
    start_moving(board, "POSE 300,200,-100,0.3,0.2,-0.1", steps=50)
    ask(board, "POSE:CHEC? 1000,1000,1000,1,1,1")
    board.serial.write("POSE 100,0,0,0,0,0\n")
    board.run(30_000)
    assert ask(board, "ABOR;*OPC?") == "1"
    assert ask(board, "*SAV;*OPC?") == "1" and ask(board, "*RCL;*OPC?") == "1"
    used = board.stack_used()
    figure(f"stack: {used} of {STACK} bytes")
    assert used < STACK
