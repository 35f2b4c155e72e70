"""The serial link: at speed, disturbed, abandoned."""

import pytest

from lab import NO_ERROR, Follower, ask, counts, enable_all, errors, figure, power_up, start_moving, steps_of, stream_words

_ORE = 1 << 3
QUERIES = 300
WANTED_PER_S = 1000


@pytest.fixture
def board(firmware):
    board = power_up(firmware)
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"


def at_a_megabaud(board):
    assert ask(board, "SYST:COMM:SER:BAUD 1000000;*OPC?") == "1"
    board.run(3000)
    board.serial.baud = 1_000_000
    assert ask(board, "SYST:COMM:SER:BAUD?") == "1000000"


def test_the_port_speaks_115200_baud_and_a_megabaud(board):
    assert board.usart2.baud == pytest.approx(115_200, rel=0.005)
    at_a_megabaud(board)
    assert board.usart2.baud == pytest.approx(1_000_000, rel=0.005)
    assert ask(board, "*IDN?").startswith("Stage Controller")
    # and back
    assert ask(board, "SYST:COMM:SER:BAUD 115200;*OPC?") == "1"
    board.run(3000)
    board.serial.baud = 115_200
    assert errors(board) == []


def begin_six_axes(board):
    enable_all(board)
    at_a_megabaud(board)
    return start_moving(board, "POSE 1500,-1400,1300,1.2,-1.1,1.3", steps=100)


def nothing_was_lost(board, follower, before):
    follower.look()
    assert all(steps != old for steps, old in zip(follower.counts, before)), "six motors moved meanwhile"
    assert board.usart2.lost == 0
    assert errors(board) == []
    assert len(board.words.runs) == 1, "the stream of words had no gap"


def test_a_thousand_queries_a_second_one_after_the_other_while_six_axes_move(board):
    follower = begin_six_axes(board)
    before, start = list(follower.counts), board.now_us
    longest = 0
    for n in range(QUERIES):
        asked = board.now_us
        board.serial.write(f"AXIS{n % 6 + 1}:POS?\n")
        board.run_until(lambda: b"\n" in board.serial.peek(), 50_000, f"answer {n}", step_us=20)
        float(board.serial.read_line())
        longest = max(longest, board.now_us - asked)
    rate = QUERIES * 1e6 / (board.now_us - start)
    nothing_was_lost(board, follower, before)
    figure(f"queries one after the other at 1 Mbaud while six axes move: {rate:.0f} a second, the slowest took {longest:.0f} us")
    assert rate >= WANTED_PER_S


def test_a_thousand_queries_a_second_on_a_timer_while_six_axes_move(board):
    follower = begin_six_axes(board)
    before, start, sent = list(follower.counts), board.now_us, len(board.usart2.sent)
    for n in range(QUERIES):
        board.serial.write(f"AXIS{n % 6 + 1}:POS?\n")
        board.run(1e6 / WANTED_PER_S)
    board.run(5000)
    answers = bytes(board.usart2.sent[sent:]).decode().splitlines()
    nothing_was_lost(board, follower, before)
    assert len(answers) == QUERIES and all(abs(float(answer)) < 1500 for answer in answers)
    figure(f"{WANTED_PER_S} queries a second at 1 Mbaud while six axes move: {len(answers)} of {QUERIES} answered, no byte lost, no gap in the words")


def test_queries_without_a_pause_are_all_answered_in_order(board):
    follower = begin_six_axes(board)
    before, sent, start = list(follower.counts), len(board.usart2.sent), board.now_us
    text = "".join(f"*ESE {n % 256};*ESE?\n" for n in range(QUERIES))
    board.serial.write(text)
    board.run_until(lambda: bytes(board.usart2.sent[sent:]).count(b"\n") == QUERIES, 2_000_000, "all answers", step_us=1000)
    answers = [int(line) for line in bytes(board.usart2.sent[sent:]).split()]
    assert answers == [n % 256 for n in range(QUERIES)]
    board.serial.read()
    figure(f"queries without a pause at 1 Mbaud while six axes move: {QUERIES * 1e6 / (board.now_us - start):.0f} a second")
    nothing_was_lost(board, follower, before)


def test_who_goes_away_in_mid_line_leaves_nothing_behind_but_that_line(board):
    board.serial.write("AXIS1:MO")
    board.run(300_000)
    assert ask(board, "\n*IDN?").startswith("Stage Controller")
    assert errors(board) == [-113]
    # and with a break none at all
    board.serial.write("AXIS1:MO")
    board.run(20_000)
    board.serial.send_break()
    board.run(300_000)
    assert ask(board, "*IDN?").startswith("Stage Controller")
    assert errors(board) == []


def test_a_break_clears_the_input_and_a_pending_wait_and_the_move_goes_on(board):
    enable_all(board)
    follower = start_moving(board, "AXIS1:VEL 100;MOVE 20;*OPC?", steps=20)
    board.serial.write("AXIS1:VEL 3")
    board.run(2000)
    board.serial.send_break(2000)
    board.run(5000)
    board.serial.read()
    assert ask(board, "AXIS1:VEL?") == "100.000"
    assert errors(board) == []
    assert ask(board, "*OPC?") == "1" and follower.look()[0] == 400


def test_a_damaged_byte_is_told_as_362_and_the_next_message_works(board):
    board.serial.write("AXIS1:V")
    board.serial.noise()
    board.serial.write("L 17\n")
    board.run(50_000)
    assert errors(board) == [-362]
    assert ask(board, "*IDN?").startswith("Stage Controller")


def test_an_overrun_is_told_as_363_and_the_next_message_works(board):
    board.serial.write("AXIS1:VEL 1")
    board.run(3000)
    board.usart2.inject(_ORE)
    board.run(1000)
    board.serial.write("7\n")
    board.run(50_000)
    assert errors(board) == [-363]
    assert ask(board, "AXIS1:VEL?;*IDN?") != "17.000"
    assert errors(board) == []


def test_a_flood_without_an_end_is_told_as_363_and_the_next_message_works(board):
    at_a_megabaud(board)
    board.serial.write("X" * 5000)
    board.run(60_000)
    board.serial.write("\n")
    assert errors(board) == [-363]
    board.serial.write("*IDN?;" * 80 + "\n")
    board.run(60_000)
    answer = board.serial.read().decode()
    assert answer.count("Stage Controller") == 80 and answer.endswith("\n")
    assert ask(board, "*IDN?").startswith("Stage Controller")


def test_bytes_that_come_while_flash_is_erased_are_not_lost(board):
    # 115200 baud, the ring of the reception holds 178 ms
    board.flash.erase_us = 120_000
    board.serial.write("*SAV\n")
    board.run(3000)
    text = "".join(f"*ESE {n};*ESE?\n" for n in range(60))
    board.serial.write(text)
    board.run(400_000)
    assert [int(line) for line in board.serial.read().split()] == list(range(60))
    assert errors(board) == []


def test_an_exclamation_mark_aborts_even_while_the_link_waits(board):
    enable_all(board)
    follower = start_moving(board, "AXIS1:MOVE 800;*WAI;:AXIS1:MOVE 0", steps=100)
    board.serial.write("!\n")
    board.run(5000)
    stopped = list(follower.look())
    board.run(50_000)
    assert follower.look() == stopped == counts(board)
    assert 0 < stopped[0] < 800 * 20
    assert errors(board) == []
