"""The firmware that is flashed, unmodified, on the emulated board."""

import pytest

from lab import RING, SEGMENT
from stm32f4 import Board, PowerCut

BOOT_US = 100_000
STOP = ("A", 0)
ENABLE = [("C", 1), ("C", 2), ("C", 5), ("C", 6), ("C", 8), ("C", 9)]
# 0.05 um a step: the machine without a calibration.
STEPS_PER_UM = 20


def power_up(firmware, **options):
    """The emergency stop's contact closed, everything else open; booted."""
    board = Board(firmware, **options)
    board.pin(*STOP, 1)
    board.run(BOOT_US)
    assert board.resets == [(0.0, "power")] and not board.stats.faults, board.describe()
    return board


@pytest.fixture
def board(firmware):
    board = power_up(firmware)
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"
    assert board.merged_requests == 0


@pytest.fixture
def moving(board):
    """Axis 1 on a move of 2 mm, some way along it."""
    for n in range(1, 7):
        board.serial.write(f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON\n")
    assert board.serial.query("SYST:ERR?") == '0,"No error"'
    board.serial.write("AXIS1:MOVE 2000\n")
    board.run_until(lambda: board.words.position()[0] > 100, 500_000, "a hundred steps", step_us=5000)
    return board


def test_it_starts_from_the_crystal_and_says_who_it_is(board):
    assert board.rcc.system_hz == 168_000_000 and board.rcc.pll_from_hse
    assert board.serial.query("*IDN?").startswith("Stage Controller,SC6,")
    assert board.serial.query("SYST:ERR?") == '0,"No error"'


def test_it_starts_without_a_crystal_and_says_who_it_is(firmware):
    board = power_up(firmware, crystal="dead")
    assert board.rcc.system_hz == 168_000_000 and not board.rcc.pll_from_hse
    assert board.serial.query("*IDN?").startswith("Stage Controller,SC6,")


def test_the_stream_runs_silently_from_the_start_without_a_gap(board):
    before = board.played()
    board.run(50_000)
    assert board.played() - before == 50_000
    assert len(board.words.runs) == 1 and board.words.steps() == []


def test_the_stack_never_reaches_its_end(board):
    for text in ("*IDN?", "SYST:ERR?", "AXIS1:POS?", "POSE?"):
        board.serial.query(text)
    assert board.stack_used() < 0x1_0000


def test_a_move_plays_its_steps_and_ends_where_it_should(board):
    for n in range(1, 7):
        board.serial.write(f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON\n")
    board.serial.write("AXIS1:MOVE 10\n")
    assert board.serial.query("*OPC?") == "1"
    assert board.serial.query("AXIS1:POS?") == "10.000"
    assert board.serial.query("SYST:ERR?") == '0,"No error"'
    assert board.words.position() == [10 * STEPS_PER_UM, 0, 0, 0, 0, 0]


def test_an_opened_contact_stops_the_words_by_itself_and_the_position_is_exact(moving):
    moving.pin(*STOP, 0)
    opened = moving.played()
    moving.run(2000)
    assert moving.played() - opened <= 2
    steps = moving.words.position()[0]
    assert float(moving.serial.query("AXIS1:POS?")) == pytest.approx(steps / STEPS_PER_UM, abs=0.0005)
    # closed again, it stays stopped
    moving.pin(*STOP, 1)
    moving.run(20_000)
    assert moving.words.position()[0] == steps


def test_masked_interrupts_end_in_silence_and_no_word_plays_twice(moving):
    before = moving.played()
    moving.mask_interrupts(10 * SEGMENT)
    moving.run(10 * SEGMENT)
    # four segments are in the ring at most; what has played is cleared behind
    late = [step for step in moving.words.steps(before) if step[0] >= before + RING * SEGMENT]
    assert late == []
    moving.run(20_000)
    assert moving.serial.query("SYST:ERR?").startswith("105,")


def test_a_hard_fault_ends_in_silence_with_drivers_disabled_and_a_new_start(moving):
    moving.hard_fault()
    before = moving.played()
    moving.run(10_000)
    assert [step for step in moving.words.steps(before) if step[0] >= before + 10] == []
    assert [moving.level(*pin) for pin in ENABLE] == [1] * 6
    moving.run_until(lambda: len(moving.resets) > 1, 5_000_000, "the watchdog", step_us=10_000)
    assert moving.resets[-1][1] == "watchdog"


def test_a_transfer_error_ends_in_silence_and_says_so(moving):
    moving.dma_error(1)
    before = moving.played()
    moving.run(20_000)
    assert moving.words.steps(before) == []
    assert moving.serial.query("SYST:ERR?").startswith("105,")


def saved(board):
    """A velocity that is not the default, in flash."""
    board.serial.write("AXIS1:VEL 500\n*SAV\n")
    assert board.serial.query("*OPC?", 3_000_000) == "1"
    assert board.flash.operations > 0
    return board


def test_saved_settings_are_there_after_a_reset_and_after_a_power_cut(board):
    saved(board)
    for restart in (board.reset, board.power_cycle):
        restart()
        board.run(BOOT_US)
        board.serial.read()
        assert board.serial.query("AXIS1:VEL?") == "500.000"
        assert board.serial.query("SYST:ERR?") == '0,"No error"'


@pytest.mark.parametrize("operation", [0, 1, 20])
def test_a_power_cut_while_saving_leaves_the_old_value(board, operation):
    saved(board)
    board.flash.cut_at = board.flash.operations + operation
    board.serial.write("AXIS1:VEL 700\n*SAV\n")
    with pytest.raises(PowerCut):
        board.run(3_000_000)
    board.power_cycle()
    board.run(BOOT_US)
    assert board.serial.query("AXIS1:VEL?") == "500.000"


def test_a_crystal_that_dies_ends_in_a_new_start_without_it(board):
    board.kill_crystal()
    board.run(2 * BOOT_US)
    assert board.resets[-1][1] == "software"
    assert board.rcc.system_hz == 168_000_000 and not board.rcc.pll_from_hse
    assert board.serial.query("*IDN?").startswith("Stage Controller,SC6,")


def test_the_refill_comes_at_every_border_again_after_the_stream_has_paused(board):
    saved(board)
    board.run(1000)
    before = board.stats.irq_entries(28)
    board.run(100 * SEGMENT)
    assert board.stats.irq_entries(28) - before >= 99


def test_a_break_in_mid_line_costs_that_line_only(board):
    board.serial.write("AXIS1:VE")
    board.serial.send_break(3000)
    board.run(20_000)
    board.serial.read()
    assert board.serial.query("*IDN?").startswith("Stage Controller,SC6,")


def test_a_thousand_queries_a_second_at_full_speed_while_six_axes_move(board):
    board.serial.write("SYST:COMM:SER:BAUD 1000000\n")
    board.run(20_000)
    board.serial.baud = 1_000_000
    for n in range(1, 7):
        board.serial.write(f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON\n")
    board.run(50_000)
    board.serial.write("POSE 500,500,500,0.1,0.1,0.1\n")
    board.run_until(lambda: board.words.first_set() is not None, 200_000, "the first step")
    board.serial.read()
    for i in range(100):
        board.at(1000 * i, lambda: board.serial.write("AXIS1:POS?\n"))
    board.run(110_000)
    answers = board.serial.read().split()
    assert len(answers) == 100 and board.usart2.lost == 0
    positions = [float(answer) for answer in answers]
    assert positions == sorted(positions) and positions[-1] > positions[0]
    assert board.serial.query("SYST:ERR?") == '0,"No error"' and len(board.words.runs) == 1
