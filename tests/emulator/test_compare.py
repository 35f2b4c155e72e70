"""Position compare: the pulses at the pin are those of host-sim's words, and lie where the axis passes."""

import pytest

from lab import SEGMENT, ask, calibrate, as_block, counts, enable_all, errors, figure, power_up, reference_words, start_moving, stream_words
from stm32f4.words import TRIGGER_PIN

PULSE, END = 1 << TRIGGER_PIN, 1 << TRIGGER_PIN + 16
HOMED = [f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON" for n in range(1, 7)]
SCRIPT = ["OUTP:PCOM 1,2,0.5,60", "AXIS1:MOVE 40", "AXIS1:MOVE -5", "OUTP:PCOM 2,1,-0.25,9", "POSE 10,3,5,0,0,0.01", "POSE 0,-4,0,0,0,0"]


@pytest.fixture
def board(firmware):
    board = power_up(firmware)
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"


def pulses(words):
    """(index, width) of every pulse at the pin."""
    out, since = [], None
    for i, word in enumerate(words):
        if word & PULSE and since is None:
            since = i
        elif since is not None and word & END and not word & PULSE:
            out.append((since, i - since))
            since = None
    assert since is None, "the line is low in the end"
    return out


def test_pulses_of_moves_from_standstill_are_those_of_host_sim(board, host_sim, tmp_path):
    block = calibrate(host_sim, "paper", tmp_path / "paper.cal")
    board.serial.write(b"COMP:LOAD " + as_block(block) + b"\n")
    for line in HOMED:
        board.serial.write(line + "\n")
    for line in SCRIPT:
        assert ask(board, line + ";*OPC?", 10_000_000) == "1"
        board.run(20_000)
    assert errors(board) == []
    words, _ = reference_words(host_sim, "paper", "\n".join(HOMED + [f"{line};*OPC?\n@20" for line in SCRIPT]), tmp_path)
    ours, theirs = pulses(stream_words(board)), pulses(words)
    assert len(ours) == len(theirs) == 69 and ask(board, "OUTP:PCOM:COUN?") == "9"
    # counted from the first pulse of each move: between moves the serial port takes its time
    apart = lambda found: [b - a for (a, _), (b, _) in zip(found, found[1:])]
    assert [d for d in apart(ours) if d < 5000] == [d for d in apart(theirs) if d < 5000]
    assert [at % SEGMENT for at, _ in ours] == [at % SEGMENT for at, _ in theirs]
    assert {width for _, width in ours} == {1}
    figure(f"position compare: {len(ours)} pulses of the firmware lie where host-sim's do")


def test_a_comb_over_an_aborted_way_has_every_pulse_once(board):
    enable_all(board, "OUTP:PCOM 1,1,0.1,300")
    for _ in range(6):
        start_moving(board, "AXIS1:MOVE 60", 40)
        board.serial.write("!\n")
        board.run(20_000)
    assert ask(board, "AXIS1:MOVE 60;*OPC?", 10_000_000) == "1"
    assert errors(board) == []
    found = pulses(stream_words(board))
    assert len(found) == 300 and ask(board, "OUTP:PCOM:COUN?") == "300"
    assert len(board.words.runs) > 6 and counts(board)[0] == 1200
