"""Homing, limit switches and the emergency stop as an alignment program meets them."""
from stagetools import all_errors, errors, moving, pose, wait_until


def test_a_cold_stage_is_homed_and_knows_where_it_stands(start, connect):
    stage = connect(start("--cold", "--speed", "max"), "tcp")
    stage.write("AXIS2:MOVE 0")
    assert errors(stage) == [101]
    # with the coupling on a long way of Y steps other motors too
    for axis in range(1, 7):
        stage.write(f"AXIS{axis}:ENAB ON")
    stage.write("AXIS2:LIM:HARD:STAT ON")
    assert stage.query("AXIS2:HOME;*OPC?;:AXIS2:HOME:STAT?") == "1;1"
    assert abs(float(stage.query("AXIS2:POS?")) - float(stage.query("AXIS2:HOME:OFFS?"))) < 5
    assert stage.query("AXIS2:MOVE 0;*OPC?") == "1"
    assert all_errors(stage) == []


def test_a_limit_switch_is_named_and_only_the_way_back_is_free(start, connect):
    stage = connect(start("--cold", "--speed", "max"), "pty")
    stage.write("AXIS3:ENAB ON;LIM:HARD:STAT ON")
    stage.query("AXIS3:MOVE:REL 9000;*OPC?")
    assert all_errors(stage) == ['102,"Limit switch active;AXIS3 upper limit switch"']
    stage.write("AXIS3:MOVE:REL 10")
    assert errors(stage) == [102]
    assert stage.query("AXIS3:MOVE:REL -1000;*OPC?;:AXIS3:LIM:HARD?") == "1;0,0"
    assert all_errors(stage) == []


def test_the_emergency_stop_is_told_to_every_link_and_latched(start, connect):
    server = start("--speed", "1", "--console")
    link, other = connect(server, "tcp"), connect(server, "pty")
    other.query("*IDN?")
    link.write("POSE 3000,2000,1000,1,1,1")
    assert wait_until(lambda: moving(link))
    server.hand("stop open")
    assert wait_until(lambda: link.query("SYST:EST:STAT?") == "1,1")
    assert wait_until(lambda: not moving(link))
    assert errors(link) == errors(other) == [103]
    stood = pose(link)
    link.write("SYST:EST:CLE;:POSE 0,0,0,0,0,0")
    assert errors(link) == [103, 103]
    server.hand("stop closed")
    assert wait_until(lambda: link.query("SYST:EST:STAT?") == "1,0")
    assert pose(link) == stood
    link.query("SYST:EST:CLE;:POSE 10,20,30,0,0,0;*OPC?")
    assert all_errors(link) == []


def test_a_driver_in_fault_is_disabled(start, connect):
    server = start("--speed", "max", "--console")
    link = connect(server, "tcp")
    server.hand("fault 5 on")
    assert wait_until(lambda: link.query("AXIS5:ENAB?") == "0")
    assert errors(link) == [112]
    server.hand("fault 5 off")
    assert wait_until(lambda: int(link.query("STAT:AXIS5?")) & 512 == 0)
    assert link.query("AXIS5:ENAB ON;POS:SET 0;:AXIS5:MOVE 0.1;*OPC?") == "1"
    assert all_errors(link) == []
