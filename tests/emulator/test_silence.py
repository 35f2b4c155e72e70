"""No word plays twice: whatever stops the processor, the pins fall silent."""

import pytest

from lab import BOARDS, ENABLE, RING, SEGMENT, ask, boot, counts, enable_all, errors, figure, power_up, start_moving

# Fast enough for several steps a segment.
FAST = "AXIS1:MOVE 3000"
REFILL = 16 + 28
# The lowest address of the stack (memory.x).
STACK_END = 0x1000_0000
TEN_SEGMENTS_US = 10 * SEGMENT


@pytest.fixture
def moving(firmware):
    """Axis 1 at speed in a long move."""
    board = power_up(firmware)
    enable_all(board, "AXIS1:VEL MAX")
    board.follower = start_moving(board, FAST, steps=400)
    return board


def last_edge(board, since):
    """Words from `since` to the last rising edge after it, 0 when there is none."""
    steps = [index for index, _, _ in board.words.steps(since)]
    return max(steps, default=since) - since


def check_no_repetition(board, since):
    """Behind the last edge there is silence for longer than the ring: what was played is gone."""
    edge = last_edge(board, since)
    assert edge <= RING * SEGMENT, f"a step {edge} us after the processor stopped: the ring holds {RING * SEGMENT} words"
    assert board.played() - since >= RING * SEGMENT + edge, "the stream went on long enough to play something twice"
    return edge


def test_masked_interrupts_end_in_silence_105_is_told_and_counts_and_the_next_move_are_exact(moving):
    before, follower = moving.played(), moving.follower
    moving.mask_interrupts(TEN_SEGMENTS_US)
    moving.run(TEN_SEGMENTS_US)
    edge = check_no_repetition(moving, before)
    assert moving.words.steps(before) != [], "it was at speed"
    moving.run(30_000)
    assert errors(moving) == [105]
    assert counts(moving) == follower.look()
    assert int(ask(moving, "STAT:QUES:COND?")) & 1 << 9, "until the next move begins"
    at = float(ask(moving, "AXIS1:POS?"))
    assert at == pytest.approx(follower.counts[0] / 20, abs=0.0005)
    assert ask(moving, f"AXIS1:MOVE {at - 7};*OPC?") == "1"
    assert errors(moving) == []
    assert counts(moving) == follower.look() == [round((at - 7) * 20), 0, 0, 0, 0, 0]
    figure(f"interrupts masked for {TEN_SEGMENTS_US} us in mid-move: last STEP edge after {edge} us, then silence")


@pytest.mark.parametrize("offset_us", range(0, SEGMENT, 37))
def test_a_refill_that_is_late_by_less_than_the_ring_loses_no_step(moving, offset_us):
    moving.run(offset_us)
    moving.mask_interrupts(100)
    moving.run(40_000)
    assert errors(moving) == []
    assert moving.follower.look()[0] > 500, "it goes on"


@pytest.mark.parametrize("inside", ["the thread", "the refill"])
def test_a_hard_fault_in_mid_move_silences_the_pins_at_once_and_disables_the_drivers(moving, inside):
    refill = inside == "the refill"
    moving.run_until(lambda: (REFILL in moving.nvic.active) == refill, 1000, inside, step_us=1)
    before = moving.played()
    moving.hard_fault()
    moving.run(5000)
    edge = last_edge(moving, before)
    assert edge <= 5, f"a step {edge} us after the fault"
    assert [moving.level(*pin) for pin in ENABLE] == [1] * 6
    figure(f"hard fault in mid-move, in {inside}: last STEP edge after {edge} us, drivers disabled")


def test_a_stack_that_overflows_ends_in_silence_and_a_restart_and_overwrites_nothing(moving):
    moving.run_until(lambda: not moving.nvic.active and not moving.machine.asleep, 20_000, "the thread", step_us=1)
    before = moving.played()
    BOARDS.remove(moving)  # its stack does not count
    moving.core.sp = STACK_END + 16
    moving.run(20_000)
    assert moving.stats.faults, "nothing lies below the stack"
    edge = check_no_repetition(moving, before) if moving.played() - before > RING * SEGMENT else last_edge(moving, before)
    moving.run_until(lambda: len(moving.resets) > 1, 3_000_000, "the watchdog", step_us=10_000)
    boot(moving)
    assert errors(moving) == [111]
    figure(f"stack overflow in mid-move: last STEP edge after {edge} us, then the watchdog")


def test_a_debugger_that_halts_the_core_halts_the_steps(moving):
    before = moving.played()
    moving.halt_core(20_000)
    moving.run(19_000)
    assert moving.dbgmcu.freezes("TIM8")
    assert moving.played() - before <= 1, "TIM8 stands with the core"
    # let go, it goes on where it was
    moving.run(1500)
    moving.run_until(lambda: moving.follower.look()[0] > 600, 200_000, "the move to go on", step_us=1000)
    assert errors(moving) == []


@pytest.mark.parametrize("offset_us", range(0, SEGMENT, 32))
def test_a_core_that_is_halted_while_the_timer_runs_ends_in_silence_and_says_what_it_knows(moving, offset_us):
    moving.run(offset_us)
    # what a debugger without the freeze bits does
    moving.dbgmcu.regs[12] = 0
    before = moving.played()
    moving.halt_core(20_000)
    moving.run(19_000)
    edge = check_no_repetition(moving, before)
    moving.run(40_000)
    told = ask(moving, "SYST:ERR?")
    assert told.startswith("105,") and errors(moving) == []
    at = float(ask(moving, "AXIS1:POS?"))
    if "exact" in told:
        assert counts(moving) == moving.follower.look()
        assert ask(moving, f"AXIS1:MOVE {at + 3};*OPC?") == "1"
        assert counts(moving) == moving.follower.look() == [round((at + 3) * 20), 0, 0, 0, 0, 0]
    else:
        # held up while it wrote a segment: nobody knows which of its words were in time
        assert int(ask(moving, "STAT:AXIS1:COND?")) & 1 << 10, "uncertain"
        assert ask(moving, "AXIS1:MOVE 0;:SYST:ERR?").startswith("109,")
    figure(f"core halted for 20 ms with TIM8 running: last STEP edge after {edge} us, then silence; {told}")


def test_a_locked_up_core_ends_in_silence_and_the_watchdog_starts_it_anew(moving):
    before = moving.played()
    moving.machine.locked_up = True
    moving.run(20_000)
    edge = check_no_repetition(moving, before)
    moving.run_until(lambda: len(moving.resets) > 1, 3_000_000, "the watchdog", step_us=10_000)
    assert moving.resets[-1][1] == "watchdog"
    boot(moving)
    assert errors(moving) == [111]
    figure(f"core locked up in mid-move: last STEP edge after {edge} us, watchdog after {(moving.resets[-1][0]) / 1e6:.2f} s of life")
