"""What can break, broken: each fault ends in the stated safe state with its error number."""

import pytest

from lab import (ENABLE, NO_ERROR, SEGMENT, ask, boot, counts, enable_all, errors, figure, power_up, start_moving)
from stm32f4 import PowerCut

DISABLED = [1] * 6
SECTOR = 0x4000
SETTINGS = slice(SECTOR, 3 * SECTOR)
REFILL = 28
# What is saved and looked for in these tests.
OLD, NEW = "111.000", "222.000"


@pytest.fixture
def board(firmware):
    return power_up(firmware)


@pytest.fixture
def moving(board):
    enable_all(board)
    board.follower = start_moving(board)
    return board


def enables(board):
    return [board.level(*pin) for pin in ENABLE]


@pytest.mark.parametrize("stream", [1, 2])
def test_an_error_of_a_step_stream_stops_the_motors_and_leaves_the_axes_uncertain(moving, stream):
    before = moving.played()
    moving.dma_error(stream)
    moving.run(2000)
    words = next((first for first, _, _ in moving.words.runs if first >= before), moving.played()) - before
    assert ask(moving, "SYST:ERR?").startswith('105,"Step deadline missed;step output failed')
    assert errors(moving) == []
    assert int(ask(moving, "STAT:AXIS1:COND?")) & 1 << 10
    moving.serial.write("AXIS1:MOVE 0\n")
    assert errors(moving) == [109]
    # named anew it moves
    at = counts(moving)[0]
    assert ask(moving, "AXIS1:POS:SET 0;:AXIS1:MOVE 1;*OPC?") == "1"
    assert counts(moving)[0] == 20
    figure(f"DMA error on the step output's stream {stream}: {words} words more, 105, uncertain, steps again (was at {at})")
    assert words <= 20


def test_an_error_of_the_transmissions_stream_costs_an_answer_at_most(moving):
    moving.serial.write("*IDN?\n")
    moving.run(800)
    moving.dma_error(6, controller=1)
    moving.run(100_000)
    moving.serial.read()
    assert ask(moving, "*IDN?").startswith("Stage Controller")
    assert errors(moving) == [] and moving.follower.look()[0] > 200, "the move goes on"


def test_an_error_of_the_receptions_stream_is_told_as_363_and_the_next_message_works(moving):
    moving.dma_error(5, controller=1)
    moving.serial.write("AXIS1:VEL 3\n")
    moving.run(100_000)
    assert errors(moving) == [-363]
    assert ask(moving, "AXIS1:VEL?") != "3.000"
    assert moving.follower.look()[0] > 200, "the move goes on"


@pytest.mark.parametrize("late_us, told", [(SEGMENT // 2, []), (SEGMENT - 8, []), (5 * SEGMENT, [105])])
def test_a_late_refill_is_made_up_for_or_told_as_105(moving, late_us, told):
    moving.nvic.enabled &= ~(1 << REFILL)
    moving.run(late_us)
    moving.nvic.enabled |= 1 << REFILL
    moving.machine.attend()
    moving.run(20_000)
    assert errors(moving) == told
    if told:
        assert counts(moving) == moving.follower.look()
        assert ask(moving, "AXIS1:MOVE 0;*OPC?") == "1" and counts(moving)[0] == 0


# ---- flash ----

def save(board, value, timeout_us=3_000_000):
    board.serial.write(f"AXIS3:VEL {value}\n")
    return ask(board, "*SAV;*OPC?", timeout_us)


def fail_for_ever(flash):
    """Every operation of the flash from now on fails."""
    begin = flash._begin

    def fails(what, where):
        flash.fail_at = flash.operations
        return begin(what, where)
    flash._begin = fails


def test_a_flash_that_fails_is_told_as_320_and_the_old_settings_stay(board):
    save(board, OLD)
    assert errors(board) == []
    fail_for_ever(board.flash)
    save(board, NEW)
    assert errors(board) == [-320]
    assert ask(board, "AXIS3:VEL?") == NEW, "in force, not saved"
    del board.flash._begin
    board.power_cycle()
    boot(board)
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    assert ask(board, "AXIS3:VEL?") == OLD
    save(board, NEW)
    assert errors(board) == []
    board.power_cycle()
    boot(board)
    assert ask(board, "AXIS3:VEL?") == NEW


@pytest.mark.parametrize("operation", [0, 3, 40])
def test_one_word_that_cannot_be_written_costs_nothing_the_other_sector_takes_the_settings(board, operation):
    save(board, OLD)
    board.flash.fail_at = board.flash.operations + operation
    save(board, NEW)
    assert errors(board) == [] and board.flash.fail_at is None
    board.power_cycle()
    boot(board)
    assert ask(board, "SYST:ERR:ALL?;:AXIS3:VEL?") == f"{NO_ERROR};{NEW}"


def saved_until_an_erase(board):
    """Saves until a sector has to be erased; the flash before that save, the operations of the save up to the erase and
    altogether."""
    for _ in range(100):
        content, first = board.flash_content(), board.flash.operations
        save(board, OLD)
        ours = [what for number, what, _ in board.flash.log if number >= first]
        if first and "erase" in ours:
            return content, ours.index("erase"), len(ours)
    raise AssertionError("never erased")


def test_a_power_cut_while_flash_is_written_or_erased_leaves_the_old_settings_or_the_new_ones(firmware, board):
    content, erase, count = saved_until_an_erase(board)
    seen = set()
    for cut in sorted({0, 1, erase, erase + 1, count // 2, count - 2, count - 1}):
        cut_board = power_up(firmware, flash=content)
        assert ask(cut_board, "AXIS3:VEL?") == OLD
        first = cut_board.flash.operations
        cut_board.flash.cut_at = first + cut
        with pytest.raises(PowerCut):
            save(cut_board, NEW)
        cut_board.power_cycle()
        boot(cut_board)
        value = ask(cut_board, "AXIS3:VEL?")
        assert value in (OLD, NEW), f"cut in operation {cut} of {count}"
        assert errors(cut_board) == []
        seen.add(value)
    figure(f"power cut in operations of a save of {count} (the erase is number {erase}): settings old or new, found {sorted(seen)}")


def test_settings_that_cannot_be_read_are_told_as_106_and_defaults_are_in_use(firmware, board):
    save(board, OLD)
    content = bytearray(board.flash_content())
    record = [at for at in range(SETTINGS.start, SETTINGS.stop) if content[at] != 0xFF]
    # every eighth byte of it is damaged
    for at in record[::8]:
        content[at] ^= 0x3C
    broken = power_up(firmware, flash=bytes(content))
    assert errors(broken) == [106]
    assert int(ask(broken, "STAT:QUES:COND?")) & 1 << 8
    assert ask(broken, "AXIS3:VEL?") not in (OLD, NEW)
    # saved anew all is well
    save(broken, NEW)
    assert errors(broken) == [] and not int(ask(broken, "STAT:QUES:COND?")) & 1 << 8
    broken.power_cycle()
    boot(broken)
    assert ask(broken, "SYST:ERR:ALL?;:AXIS3:VEL?") == f"{NO_ERROR};{NEW}"


# ---- the crystal ----

def test_with_a_dead_crystal_it_runs_from_the_internal_oscillator_says_110_and_has_no_usb(firmware):
    board = power_up(firmware, crystal="dead")
    assert board.rcc.system_hz == 168_000_000 and not board.rcc.pll_from_hse
    assert errors(board) == [110]
    assert int(ask(board, "STAT:QUES:COND?")) & 1 << 12
    assert not board.bus.load(0x4002_3834) >> 7 & 1, "the clock of USB is off"
    enable_all(board)
    assert ask(board, "AXIS1:MOVE 2;*OPC?") == "1"
    assert counts(board) == board.words.position() == [40, 0, 0, 0, 0, 0]


def test_with_a_living_crystal_none_of_that(board):
    assert errors(board) == []
    assert not int(ask(board, "STAT:QUES:COND?")) & 1 << 12
    assert board.bus.load(0x4002_3834) >> 7 & 1, "the clock of USB is on"


def test_a_crystal_that_dies_in_mid_move_disables_the_drivers_and_restarts_on_the_internal_oscillator(moving):
    before, died = moving.played(), moving.now_us
    moving.kill_crystal()
    moving.run_until(lambda: len(moving.resets) > 1, 10_000, "the restart", step_us=20)
    restarted, words = moving.now_us - died, moving.played() - before
    assert enables(moving) == DISABLED or moving.resets[-1][1] == "software"
    boot(moving)
    assert enables(moving) == DISABLED
    assert not moving.rcc.pll_from_hse and moving.rcc.system_hz == 168_000_000
    assert 110 in errors(moving)
    assert int(ask(moving, "STAT:QUES:COND?")) & 1 << 12
    assert int(ask(moving, "STAT:AXIS1:COND?")) & 1 << 10, "it does not know where it stopped"
    figure(f"crystal dies in mid-move: {words} words more, restart after {restarted:.0f} us, 110")
    assert words <= 2
