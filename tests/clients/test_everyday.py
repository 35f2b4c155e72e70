"""What an alignment program does all day, over a socket and over a serial port."""
import math
import subprocess

import pytest

from conftest import ROOT
from stagetools import all_errors, as_block, errors, moving, pose, wait_until

MACHINES = ROOT / "host-sim" / "machines"


def test_the_stage_says_who_it_is(stage):
    maker, model, _serial, version = stage.query("*IDN?").split(",")
    assert (maker, model) == ("Stage Controller", "SC6")
    assert version.count(".") == 2
    assert stage.query("*TST?") == "0"
    assert stage.query("SYST:VERS?") == "1999.0"


def test_the_help_lists_every_header(stage):
    text = bytes(stage.query_binary_values("SYST:HELP:HEAD?", datatype="B", container=bytes)).decode()
    assert ":AXIS#:MOVE[:ABSolute]/nquery/" in text.splitlines()
    assert "*IDN/qonly/" in text.splitlines()


@pytest.mark.parametrize(
    ("setting", "value", "answer"),
    [
        ("AXIS1:VEL", "1.5 MM/S", 1500),
        ("AXIS1:VEL", "250", 250),
        ("AXIS4:VEL", "10 MRAD/S", math.degrees(0.01)),
        ("AXIS2:ACC", "5 MM/S2", 5000),
        ("AXIS3:JERK", "100 MM/S3", 100_000),
        ("AXIS1:LIM:SOFT:UPP", "1.25 MM", 1250),
        ("AXIS5:LIM:SOFT:LOW", "-500 MDEG", -0.5),
        ("AXIS1:BACK:DIST", "2500 NM", 2.5),
        ("AXIS1:BACK:MARG", "25", 25),
        ("SYST:JOG:TIM", "250 MS", 0.25),
        ("VEL", "50", 50),
    ],
)
def test_a_setting_takes_suffixes_and_answers_in_its_unit(stage, setting, value, answer):
    stage.write(f"{setting} {value}")
    assert float(stage.query(f"{setting}?")) == pytest.approx(answer, rel=1e-7, abs=1e-8)
    assert errors(stage) == []


@pytest.mark.parametrize("setting", ["AXIS1:VEL", "AXIS4:ACC", "AXIS6:JERK", "AXIS2:BACK:VEL", "SYST:JOG:TIM", "VEL"])
def test_a_setting_knows_its_least_most_and_default(stage, setting):
    least, most, default = (float(stage.query(f"{setting}? {which}")) for which in ("MIN", "MAX", "DEF"))
    assert least <= default <= most
    for which, value in (("MIN", least), ("MAX", most), ("DEFault", default)):
        stage.write(f"{setting} {which}")
        assert float(stage.query(f"{setting}?")) == value
    assert errors(stage) == []


def test_reset_brings_the_defaults_back_and_moves_nothing(stage):
    stage.query("AXIS1:VEL 100;:VEL 10;:POSE 10,0,0,0,0,0;*OPC?")
    stage.write("*RST")
    assert float(stage.query("VEL?")) == 100
    assert stage.query("AXIS1:VEL?") == stage.query("AXIS1:VEL? DEF")
    assert pose(stage)[0] == pytest.approx(10, abs=0.05)
    assert errors(stage) == []


def test_a_calibration_goes_in_and_comes_back(stage, block_of):
    block = block_of(MACHINES / "long-lever.toml")
    stage.write_binary_values("COMP:LOAD ", block, datatype="B")
    assert stage.query("COMP:NAME?") == '"long-lever"'
    assert stage.query_binary_values("COMP:DATA?", datatype="B", container=bytes) == block
    assert int(stage.query("COMP:CRC?")) == int.from_bytes(block[-4:], "little")
    assert errors(stage) == []


def test_a_calibration_moves_no_motor(stage, block_of):
    stage.query("POSE 100,50,-20,0.1,0.2,-0.3;*OPC?")
    ask = ";".join(f":AXIS{n}:POS:MOT?" for n in range(1, 7))
    before = stage.query(ask)
    stage.write_raw(b"COMP:LOAD " + as_block(block_of(MACHINES / "bench.toml")) + b"\n")
    assert stage.query(ask) == before
    assert errors(stage) == []


@pytest.mark.parametrize(
    ("change", "number"), [(lambda b: b[:-1] + bytes([b[-1] ^ 1]), -230), (lambda b: b"NONE" + b[4:], -221)]
)
def test_a_bad_calibration_is_refused_and_the_old_one_stays(stage, block_of, change, number):
    before = stage.query("COMP:CRC?")
    stage.write_raw(b"COMP:LOAD " + as_block(change(block_of("paper"))) + b"\n")
    assert errors(stage) == [number]
    assert stage.query("COMP:CRC?") == before


def test_the_loader_of_the_tool_loads(fast, connect, host_sim, block_of, tmp_path):
    path = tmp_path / "mine.cal"
    path.write_bytes(block_of(MACHINES / "long-lever.toml"))
    host, port = fast.tcp[0]
    done = subprocess.run([host_sim, "load", str(path), "--to", f"tcp://{host}:{port}"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("in force until power-off.")
    assert connect(fast, "tcp").query("COMP:NAME?") == '"long-lever"'


def test_a_coordinated_move_ends_where_it_was_told_to(stage):
    target = [1000, -500, 250, 0.5, -1, 0.2]
    assert stage.query("POSE " + ",".join(map(str, target)) + ";*OPC?") == "1"
    # whole motor steps: 50 nm and 4 urad, the latter on a lever
    # half a step of each motor, and what half a step of the rotary ones does at F
    here = pose(stage)
    assert here[:3] == pytest.approx(target[:3], abs=0.05)
    assert here[3:] == pytest.approx(target[3:], abs=0.0002)
    commanded = [float(stage.query(f"AXIS{n}:POS:COMM?")) for n in range(1, 7)]
    assert commanded == pytest.approx(target, abs=1e-7)
    assert errors(stage) == []


def test_a_coordinated_move_is_a_straight_line(slow_stage):
    target = [400, -200, 100, 0.1, -0.1, 0.05]
    slow_stage.write("VEL 50;:POSE " + ",".join(map(str, target)))
    seen = []
    while moving(slow_stage):
        seen.append(pose(slow_stage))
    share = [now[0] / target[0] for now in seen]
    # a step of another axis may move this one by a few nanometres
    assert all(b > a - 1e-3 for a, b in zip(share, share[1:]))
    assert len([s for s in share if 0.05 < s < 0.95]) > 3
    for now, s in zip(seen, share):
        assert now[:3] == pytest.approx([s * t for t in target[:3]], abs=0.5)
        assert now[3:] == pytest.approx([s * t for t in target[3:]], abs=0.002)


def test_position_and_status_are_polled_while_it_moves(slow_stage):
    slow_stage.write("AXIS1:VEL 1000;MOVE 500")
    assert moving(slow_stage)
    assert int(slow_stage.query("STAT:AXIS1?")) & 1
    assert int(slow_stage.query("STAT:OPER:INST:COND?")) == 1 << 1
    assert float(slow_stage.query("AXIS1:POS:COMM?")) == 500
    assert wait_until(lambda: not moving(slow_stage))
    assert float(slow_stage.query("AXIS1:POS?")) == pytest.approx(500, abs=0.05)


def test_operation_complete_is_asked_for(slow_stage):
    slow_stage.write("AXIS1:MOVE 500;*OPC?")
    assert slow_stage.read() == "1"
    assert not moving(slow_stage)
    assert float(slow_stage.query("AXIS1:MOVE 0;*WAI;:AXIS1:POS?")) == pytest.approx(0, abs=0.05)


def test_operation_complete_raises_a_service_request(slow_stage):
    slow_stage.write("*CLS;*ESE 1;*SRE 32")
    slow_stage.write("AXIS1:MOVE 500;*OPC")
    assert int(slow_stage.query("*STB?")) & 64 == 0
    assert wait_until(lambda: int(slow_stage.query("*STB?")) & 64)
    assert not moving(slow_stage)
    assert int(slow_stage.query("*ESR?")) == 1
    assert int(slow_stage.query("*STB?")) & 96 == 0


def test_an_error_raises_a_service_request(stage):
    stage.write("*CLS;*ESE 60;*SRE 36")
    assert stage.query("*STB?") == "0"
    stage.write("NO:SUCH")
    assert int(stage.query("*STB?")) & (64 | 32 | 4) == 64 | 32 | 4
    assert int(stage.query("*ESR?")) == 32
    assert errors(stage) == [-113]


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("AXIS2:MOVE 6200", '-222,"Data out of range;AXIS2 6200.000 um above 5000.000 um"'),
        ("AXIS5:MOVE:REL -4", '-222,"Data out of range;AXIS5 -4.00000000 deg below -3.00000003 deg"'),
        ("POSE 100,100,-7 MM,0,0,0", '-222,"Data out of range;AXIS3 -7000.000 um below -5000.000 um"'),
        ("AXIS1:ENAB OFF;MOVE 1", '108,"Axis disabled;AXIS1"'),
    ],
)
def test_a_refused_move_names_the_axis_and_the_value(stage, command, text):
    before = pose(stage)
    stage.write(command)
    assert stage.query("*OPC?") == "1"
    assert all_errors(stage) == [text]
    assert pose(stage) == before


def test_a_dry_run_gives_the_verdict_of_the_move(stage):
    good = stage.query("POSE:CHEC? 100,0,0,0,0,0.5").split(",")
    assert good[0] == "0" and len(good) == 14 and float(good[1]) > 0
    bad = stage.query("POSE:CHEC? 9000,0,0,0,0,0").split(",")
    assert bad[0] == "-222"
    assert pose(stage) == pytest.approx([0] * 6, abs=1e-6)


def test_a_rotation_centre_is_defined_and_selected(stage):
    stage.write("PIV:DEF 1,0,0,2 MM;SEL 1")
    assert stage.query("PIV?") == "1,0.000,0.000,2000.000"
    stage.write("PIV:DEF 2,0,0,80 MM")
    assert errors(stage) == [-222]
    stage.write("PIV:SEL 0")
    assert stage.query("PIV?").startswith("0,")


def test_an_answer_sent_back_gives_the_same_integer(stage):
    stage.query("POSE 123.456,-78.9,1,0.12345678,-1.5,0.3;*OPC?")
    answer = stage.query("POSE?")
    stage.query(f"POSE {answer};*OPC?")
    assert [stage.query(f"AXIS{n}:POS:COMM?") for n in range(1, 7)] == answer.split(",")
