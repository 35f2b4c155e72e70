"""Whatever a client sends: the number of the manual, nothing moves, the next command works."""
import random
import time

import pytest

from stagetools import errors, pose

#: bytes of a line, and the error that they make
BAD = [
    (b"", None),
    (b"   \t ", None),
    (b";;; ;", None),
    (b"\r", None),
    (b"\xff\xfe\x80\x90\xa0\xb1", -101),
    ("AXIS1:M\u00d6VE 5".encode(), -101),
    (b"AXIS1:MOVE\xa05", -101),
    (b"AXIS1::MOVE 5", -102),
    (b"AXIS1:MOVE ,5", -102),
    (b"AXIS1:MOVE 5,,", -102),
    (b"AXIS1:MOVE 5)", -102),
    (b"AXIS1:MOVE (5", -102),
    (b"AXIS1-MOVE 5", -102),
    (b"@", -102),
    (b"AXIS1:MOVE NAN", -104),
    (b"AXIS1:MOVE INF", -104),
    (b"AXIS1:MOVE five", -104),
    (b'AXIS1:MOVE "5"', -104),
    (b"AXIS1:MOVE --5", -104),
    (b"AXIS1:MOVE -", -104),
    (b"AXIS1:ENAB MAYBE", -104),
    (b"AXIS1:BACK:MODE REVE", -104),
    (b"AXIS1:VEL? 5", -104),
    (b"AXIS1:MOVE 5,6", -108),
    (b"POSE 1,2,3,0,0,0,0", -108),
    (b"*RST 1", -108),
    (b"*IDN? 1", -108),
    (b"AXIS1:MOVE", -109),
    (b"POSE 1,2,3", -109),
    (b"AXIS1:STEP:TIM 1 US", -109),
    (b"FOO:BAR 5", -113),
    (b"MOVE 5", -113),
    (b"AXIS1:MOV 5", -113),
    (b"AXIS1:MOVE? 5", -113),
    (b"*IDN", -113),
    (b"AXIS1:HOM", -113),
    (b"AXIS1:HOME", -221),
    (b"SCAN:STAR 1", -221),
    (b"AXIS0:MOVE 5", -114),
    (b"AXIS7:MOVE 5", -114),
    (b"AXIS99999999999999999999:MOVE 5", -114),
    (b"AXIS1:MOVE 1E40000", -123),
    (b"AXIS1:MOVE 1E-99999999999", -123),
    (b"AXIS1:MOVE 5 DEG", -131),
    (b"AXIS4:MOVE 5 UM", -131),
    (b"AXIS1:MOVE 5 STEP", -131),
    (b"AXIS1:MOVE 5 furlongs", -131),
    (b"AXIS1:VEL 5 MM", -131),
    (b"AXIS1:MOVE 5 \xc2\xb5m", -131),
    (b'AXIS1:MOVE "5', -151),
    (b"AXIS1:MOVE '5", -151),
    (b"COMP:LOAD abc", -161),
    (b"COMP:LOAD #0abc", -161),
    (b"COMP:LOAD #13ab,", -221),
    (b"COMP:LOAD #13abcd", -161),
    (b"AXIS1:MOVE 1E400", -222),
    (b"AXIS1:MOVE -1E400", -222),
    (b"AXIS1:MOVE 99999999999999999999999999", -222),
    (b"POSE 5,5,5,0,0,1E300", -222),
    (b"AXIS1:VEL 0", -222),
    (b"AXIS1:VEL -5", -222),
    (b"VEL 101", -222),
    (b"*ESE 256", -222),
    (b"PIV:SEL 8", -222),
    (b"AXIS1:LIM:SOFT:LOW 6 MM", -222),
    (b"PIV:SEL 3", -221),
    (b"X" * 10_000, -363),
    (b"AXIS1:MOVE 5" + b" " * 10_000, -363),
    (b"AXIS1:MOVE " + b"0" * 600 + b"5", -363),
]


@pytest.mark.parametrize(("line", "number"), BAD, ids=[repr(line[:40]) for line, _ in BAD])
def test_bad_input_is_named_and_harmless(stage, line, number):
    before = pose(stage)
    stage.write_raw(line + b"\n")
    assert errors(stage) == ([] if number is None else [number])
    assert stage.query("*OPC?") == "1"
    assert pose(stage) == before
    assert stage.query("AXIS1:MOVE 10;*OPC?") == "1"
    assert float(stage.query("AXIS1:POS?")) == pytest.approx(10, abs=0.05)


def test_after_a_command_error_the_rest_of_the_message_is_dropped(stage):
    stage.write("AXIS1:VEL 100;NONSENSE 1;:AXIS1:MOVE 5")
    assert errors(stage) == [-113]
    assert float(stage.query("AXIS1:VEL?")) == 100
    assert pose(stage)[0] == 0


def test_after_another_error_the_message_goes_on(stage):
    stage.write("AXIS1:MOVE 9999;:AXIS1:MOVE 5;*WAI")
    assert stage.query("*OPC?") == "1"
    assert errors(stage) == [-222]
    assert pose(stage)[0] == pytest.approx(5, abs=0.05)


def test_a_six_axis_move_that_breaks_one_limit_moves_no_axis(stage):
    stage.write("POSE 10,10,10,0.1,0.1,4")
    assert stage.query("*OPC?") == "1"
    assert errors(stage) == [-222]
    assert pose(stage) == pytest.approx([0] * 6, abs=1e-6)


def test_the_error_queue_keeps_the_oldest_and_tells_of_the_loss(stage):
    for _ in range(30):
        stage.write("AXIS9:MOVE 1")
    assert int(stage.query("SYST:ERR:COUN?")) == 16
    assert errors(stage) == [-114] * 15 + [-350]


def test_a_block_that_pauses_is_given_up(stage):
    before = stage.query("COMP:CRC?")
    stage.write_raw(b"COMP:LOAD #3400only this")
    # it waits for the rest; two seconds later the link is free again
    time.sleep(2.5)
    assert stage.query("*IDN?").startswith("Stage Controller")
    assert errors(stage) == [-161]
    assert stage.query("COMP:CRC?") == before


def test_a_device_clear_byte_drops_what_was_begun(stage):
    stage.write_raw(b"AXIS1:MOVE 5\x18*IDN?\n")
    assert stage.read().startswith("Stage Controller")
    assert pose(stage)[0] == 0


@pytest.mark.parametrize("seed", range(5))
def test_binary_garbage_is_survived(stage, seed):
    choose = random.Random(seed)
    # neither a block nor a string, which would rightly take what follows as theirs
    usable = [b for b in range(256) if b not in b"#"]
    stage.write_raw(bytes(choose.choices(usable, k=4000)) + b"\n")
    stage.write("*CLS")
    assert stage.query("*IDN?").startswith("Stage Controller")
    assert errors(stage) == []
    assert pose(stage) == pytest.approx([0] * 6, abs=1e-6)
