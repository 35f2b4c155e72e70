"""What must stop the motors does, in time; what must stay stopped does."""

import random

import pytest

from lab import (BOARDS, ENABLE, FAULT, LOWER, NO_ERROR, SEGMENT, STOP, UPPER, Switch, ask, boot, counts, enable_all, errors, figure,
                 power_up, start_moving)

# The longest way from a contact to the last word (tests measure it, host-sim and homing rely on it), us.
LIMIT_US, GATE_US = 20, 2
REFILL = 16 + 28
# wfi; b .-2
ASLEEP = bytes.fromhex("30bffde7")
SPARE_FLASH = 0x080F_0000
DISABLED = [1] * 6


@pytest.fixture
def board(firmware):
    board = power_up(firmware)
    enable_all(board, "AXIS1:LIM:HARD:POL HIGH;STAT ON;:AXIS1:VEL MAX")
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"


def levels(board, pins):
    return [board.level(*pin) for pin in pins]


def jog(board, sign=1, steps=60):
    return start_moving(board, f"AXIS1:MOVE:JOG {1500 * sign}", steps)


def in_a_critical_section(board):
    """Runs on to a moment in which a library keeps interrupts below the refill away."""
    board.run_until(lambda: board.core.masks()[1], 30_000, "a critical section", step_us=0.4)


def in_the_refill(board):
    board.run_until(lambda: REFILL in board.nvic.active, 1000, "a refill", step_us=1)


# (where the processor is when the contact changes, further us)
MOMENTS = ([(in_a_critical_section, 0)] * 6 + [(in_the_refill, after) for after in (0, 2, 5, 10, 20, 40)]
           + [(None, after) for after in range(0, SEGMENT, 13)])


def stopped_stream(board, before):
    """Words from `before` on until the stream stopped."""
    return next((first for first, _, _ in board.words.runs if first >= before), len(board.words)) - before


def test_a_limit_switch_stops_all_motors_within_twenty_microseconds_whatever_the_processor_does(board):
    worst, edge, sections = 0, 0, 0
    for n, (where, after) in enumerate(MOMENTS):
        jog(board)
        if where:
            where(board)
        board.run(after)
        sections += bool(board.core.masks()[1])
        before = board.played()
        board.pin(*UPPER[0], 1)
        board.run(1500)
        assert errors(board) == [102], f"moment {n}"
        words = stopped_stream(board, before)
        edges = [index - before for index, _, _ in board.words.steps(before, before + words)]
        worst, edge = max(worst, words), max([edge, *edges])
        assert counts(board)[0] == sum(sign for _, _, sign in board.words.steps()), "the count is exact"
        board.pin(*UPPER[0], 0)
        board.run(1000)
    assert sections >= 6, "some of the edges came in critical sections"
    figure(f"limit switch to the last word: {worst} us at most, to the last STEP edge {edge} us, {len(MOMENTS)} moments; "
           f"longest critical section {max(board.longest_masked())[0]:.1f} us")
    assert worst <= LIMIT_US


def test_each_of_the_twelve_switches_stops_its_own_motor_on_its_own_way_and_is_told_by_name(board):
    for n in range(1, 7):
        board.serial.write(f"AXIS{n}:LIM:HARD:POL HIGH;STAT ON\n")
    assert errors(board) == []
    worst = slowest = 0
    for n in range(6):
        for side, sign, pin, behind in (("lower", -1, LOWER[n], UPPER[n]), ("upper", 1, UPPER[n], LOWER[n])):
            follower = start_moving(board, f"AXIS{n + 1}:MOVE:JOG {sign * (1000 if n < 3 else 1)}", steps=20)
            before = board.played()
            board.pin(*behind, 1)
            board.run(400)
            assert board.played() - before == 400, "a switch that is left behind stops nothing"
            before = board.played()
            board.pin(*pin, 1)
            board.run(1500)
            words = stopped_stream(board, before)
            edges = [index - before for index, motor, _ in board.words.steps(before, before + words) if motor == n]
            worst, slowest = max([worst, *edges]), max(slowest, words)
            text = ask(board, "SYST:ERR?")
            assert text.startswith("102,") and f"AXIS{n + 1} {side} limit switch" in text and errors(board) == []
            assert ask(board, f"AXIS{n + 1}:LIM:HARD?") == "1,1"
            assert sign * follower.look()[n] > 0
            board.pin(*pin, 0)
            board.pin(*behind, 0)
            board.run(1000)
    # a motor without a step in the words that wait is not on its way: its next step is what stops all
    figure(f"twelve limit switches: last STEP edge of the motor after {worst} us at most; to the last word {slowest} us, when "
           f"the motor's next step was farther away than the ring reaches")
    assert worst <= LIMIT_US


def test_the_emergency_stop_lets_no_edge_through_after_two_microseconds_whatever_the_processor_does(board):
    worst = 0
    for n, (where, after) in enumerate(MOMENTS[::2]):
        jog(board)
        if where:
            where(board)
        board.run(after + 0.37 * n % 1)
        before = board.played()
        board.pin(*STOP, 0)
        board.run(2500)
        worst = max(worst, board.played() - before)
        assert errors(board) == [103]
        assert counts(board)[0] == sum(sign for _, _, sign in board.words.steps()), "the count is exact"
        board.pin(*STOP, 1)
        board.run(2500)
        assert ask(board, "SYST:EST:CLE;*OPC?") == "1"
    figure(f"emergency stop: {worst} words after the contact has opened, at most")
    assert worst <= GATE_US


def test_an_emergency_stop_is_latched_and_only_cleared_by_command_with_the_contact_closed(board):
    jog(board)
    board.pin(*STOP, 0)
    board.run(3000)
    assert errors(board) == [103] and ask(board, "SYST:EST:STAT?") == "1,1"
    assert int(ask(board, "STAT:QUES:COND?")) & 1 << 10
    played = board.played()
    board.serial.write("SYST:EST:CLE\n")
    assert errors(board) == [103]
    # a contact that closes again arms nothing, nor does anything else
    board.pin(*STOP, 1)
    for text in ("AXIS1:MOVE 5", "AXIS1:MOVE:JOG 100", "AXIS1:MOVE:REL 1", "POSE 1,1,1,0,0,0"):
        board.serial.write(text + "\n")
        assert errors(board) == [103], text
    board.serial.write("*RST;*CLS;:ABOR;:STOP\n")
    assert ask(board, "SYST:EST:STAT?") == "1,0"
    assert board.played() == played, "not a word"
    # it outlives the watchdog's patience
    board.run(2_200_000)
    assert len(board.resets) == 1 and board.played() == played
    assert ask(board, "SYST:EST:CLE;*OPC?") == "1"
    assert ask(board, "SYST:EST:STAT?") == "0,0"
    assert ask(board, "AXIS1:MOVE 0;*OPC?") == "1"
    assert errors(board) == [] and counts(board)[0] == 0


def test_a_board_that_starts_with_an_open_contact_stands_until_it_is_cleared(firmware):
    board = power_up(firmware, stop_closed=False)
    assert board.played() == 0
    assert errors(board) == [103]
    board.pin(*STOP, 1)
    board.run(5000)
    assert ask(board, "SYST:EST:CLE;*OPC?") == "1"
    enable_all(board)
    assert ask(board, "AXIS1:MOVE 1;*OPC?") == "1"
    assert counts(board) == board.words.position() == [20, 0, 0, 0, 0, 0]


def test_a_driver_in_fault_stops_all_motors_and_is_disabled(board):
    follower = jog(board)
    assert levels(board, ENABLE) == [0] * 6
    before = board.played()
    board.pin(*FAULT[1], 0)
    board.run(5000)
    words = stopped_stream(board, before)
    text = ask(board, "SYST:ERR?")
    assert text.startswith("112,") and "AXIS2" in text and errors(board) == []
    assert levels(board, ENABLE) == [0, 1, 0, 0, 0, 0]
    assert counts(board) == follower.look()
    board.serial.write("AXIS2:ENAB ON\n")
    assert errors(board) == [112]
    board.pin(*FAULT[1], 1)
    board.run(2000)
    board.serial.write("AXIS2:ENAB ON\n")
    assert errors(board) == [] and levels(board, ENABLE) == [0] * 6
    figure(f"driver fault to the last word: {words} us, driver disabled")
    assert words <= SEGMENT + LIMIT_US, "faults are looked at once a segment"


def restarts_by_the_watchdog(board):
    """Runs until the watchdog bites, checks that it says so; answers how long it took, us."""
    taken = board.run_until(lambda: len(board.resets) > 1, 3_500_000, "the watchdog", step_us=5000)
    assert board.resets[-1][1] == "watchdog"
    boot(board)
    assert levels(board, ENABLE) == DISABLED
    assert errors(board) == [111]
    assert ask(board, "AXIS1:HOME:STAT?") == "0"
    return taken


def test_the_watchdog_bites_when_the_refill_stops(board):
    jog(board)
    board.nvic.enabled &= ~(1 << REFILL - 16)
    figure(f"watchdog after the refill has stopped: {restarts_by_the_watchdog(board) / 1e6:.2f} s")


def test_the_watchdog_bites_when_the_controllers_thread_stops(board):
    jog(board)
    board.run_until(lambda: not board.nvic.active, 1000, "the thread", step_us=0.5)
    board.core.flash[SPARE_FLASH - 0x0800_0000:][:len(ASLEEP)] = ASLEEP
    board.machine.asleep, board.machine.pc = None, SPARE_FLASH
    figure(f"watchdog after the controller's thread has stopped: {restarts_by_the_watchdog(board) / 1e6:.2f} s")


def test_a_panic_disables_the_drivers_and_the_watchdog_starts_the_board_anew(board):
    jog(board)
    board.run_until(lambda: not board.nvic.active, 1000, "the thread", step_us=0.5)
    (panic,) = [address for name, address in board.image.symbols.items() if "rust_begin_unwind" in name]
    before = board.played()
    # its argument is not that of a panic: what it makes of it, on the stack too, does not count
    BOARDS.remove(board)
    board.machine.asleep, board.machine.pc = None, panic & ~1
    board.run(3000)
    assert board.played() - before <= 10
    assert levels(board, ENABLE) == DISABLED
    figure(f"panic: {board.played() - before} words more, drivers disabled")
    restarts_by_the_watchdog(board)


def test_only_the_watchdog_is_told_as_a_restart(board):
    board.reset()
    taken = board.run_until(lambda: levels(board, ENABLE) == DISABLED, 20_000, "disabled drivers", step_us=1)
    figure(f"drivers disabled {taken:.0f} us after a reset, at most; before, the lines float")
    boot(board)
    assert levels(board, ENABLE) == DISABLED
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    assert ask(board, "AXIS1:HOME:STAT?") == "1", "a reset at rest knows where it was"
    board.power_cycle()
    boot(board)
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    assert ask(board, "AXIS1:HOME:STAT?") == "0"


def test_a_reset_in_mid_move_leaves_the_axes_uncertain(board):
    jog(board)
    board.reset()
    boot(board)
    assert ask(board, "AXIS1:HOME:STAT?") == "0"
    assert int(ask(board, "STAT:AXIS1:COND?")) & 1 << 10
    board.serial.write("AXIS1:ENAB ON;MOVE 0\n")
    assert errors(board)[0] in (101, 109)


def test_homing_on_a_switch_that_jitters_and_bounces_ends_at_the_same_place(board):
    chance = random.Random(1)
    switch = Switch(board, 0, 300, hysteresis=40, scatter=lambda: chance.choice((-1, 0, 0, 1)), bounces=True)
    board.serial.write("AXIS1:HOME:TYPE UPP;VEL 2000;OFFS 0\n")
    ends = []
    for start in (0, 90, -40):
        board.serial.write(f"AXIS1:MOVE:REL {start} STEP\n")
        assert ask(board, "*OPC?") == "1"
        assert ask(board, "AXIS1:HOME;*OPC?", 5_000_000) == "1"
        assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
        assert ask(board, "AXIS1:HOME:STAT?") == "1" and ask(board, "AXIS1:POS?") == "0.000"
        ends.append(switch.follower.look()[0])
    switch.on = False
    figure(f"homing on a jittering, bouncing switch: ends at motor counts {ends}, {len(switch.trips)} trips")
    assert max(ends) - min(ends) <= 2, "within one step of each other's middle"
    assert switch.follower.look()[1:] == [0] * 5, "nothing else has moved"
