"""What an instrument on a bus owes its controller: the same tests over every link."""
import re
import socket
import struct
import subprocess
import sys
import time
from collections import namedtuple

import pytest
import pyvisa

from buslinks import ERRORS, ESB, MAV, RQS, BusLink, HislipLink, StreamLink, wait_for_service
from conftest import ROOT
from stagetools import all_errors, as_block, errors, pose

MACHINES = ROOT / "host-sim" / "machines"
Lab = namedtuple("Lab", "source array meter server")
LINKS = ["gpib", "hislip", "tcp", "pty"]


@pytest.fixture
def manager():
    manager = pyvisa.ResourceManager("@py")
    yield manager
    manager.close()


def gateway_of(manager, server):
    host, port = server.gpib
    return manager.open_resource(f"PRLGX-TCPIP::{host}::{port}::INTFC")


def gpib(manager, server, timeout):
    gateway = gateway_of(manager, server)
    return [BusLink(manager, f"GPIB0::{address}::INSTR", gateway, timeout) for address in (5, 6, 7)]


@pytest.fixture(params=LINKS)
def lab(request, start, manager):
    """Opens both boards and the meter of a bench, over each link. The meter has no serial port."""

    def open_lab(*args, speed="max", timeout=10_000):
        own = ["--hislip" if request.param == "hislip" else "--gpib", "0"]
        server = start("--bench", "4", *own, "--speed", speed, *args, boards=3, terminals=2)
        if request.param == "gpib":
            return Lab(*gpib(manager, server, timeout), server)
        if request.param == "hislip":
            host, port = server.hislip
            names = [f"TCPIP::{host}::hislip{place},{port}::INSTR" for place in range(3)]
            return Lab(*(HislipLink(manager, name, timeout) for name in names), server)
        names = [server.resource(request.param, board) for board in (0, 1)] + [server.resource("tcp", 2)]
        return Lab(*(StreamLink(manager, name, timeout) for name in names), server)

    return open_lab


def test_every_instrument_says_who_it_is(lab):
    source, array, meter, _ = lab()
    for link, name in (source, "SC6"), (array, "SC6"), (meter, "Power meter and switch"):
        assert link.query("*IDN?").split(",")[:2] == ["Stage Controller", name]
        assert link.query("*TST?") == "0"
        assert errors(link) == []


def test_settings_are_those_of_their_instrument(lab):
    source, array, meter, _ = lab()
    source.write("AXIS1:VEL 321;*ESE 5")
    array.write("AXIS1:VEL 123.5;*ESE 6")
    assert [float(link.query("AXIS1:VEL?")) for link in (source, array)] == [321, 123.5]
    assert [link.query("*ESE?") for link in (source, array, meter)] == ["5", "6", "0"]
    meter.write("ROUT:CLOS 1,DET")
    assert meter.query("ROUT:CLOS? 1") == "DET"
    # every character that a gateway treats in a way of its own
    source.write("AXIS2:MOVE +1.5e+1;*WAI")
    assert source.query_slow("*OPC?;:AXIS2:POS:COMM?") == "1;15.000"
    assert [errors(link) for link in (source, array, meter)] == [[], [], []]


def test_a_long_answer_comes_whole(lab):
    source, *_ = lab()
    headers = source.block("SYST:HELP:HEAD?")
    assert len(headers) > 3000 and b":AXIS#:MOVE[:ABSolute]" in headers and headers.endswith(b"\n")
    assert source.query(";:".join(["AXIS1:VEL?"] * 30)) == ";".join([source.query("AXIS1:VEL?")] * 30)
    assert errors(source) == []


def test_a_long_wait_is_answered(lab):
    source, *_ = lab(speed="1")
    begin = time.monotonic()
    assert source.query_slow("AXIS1:VEL 200;MOVE 100;*OPC?") == "1"
    assert time.monotonic() - begin > 0.3
    assert pose(source)[0] == pytest.approx(100, abs=0.05)
    assert errors(source) == []


def test_a_calibration_goes_down_and_comes_up(lab, block_of):
    source, *_ = lab()
    block = block_of(MACHINES / "long-lever.toml")
    assert any(byte in block for byte in b"+\n\r\x1b"), "bytes that a gateway must have escaped"
    source.write_raw(b"COMP:LOAD " + as_block(block) + b"\n")
    assert source.query("COMP:NAME?") == '"long-lever"'
    assert source.block("COMP:DATA?") == block
    assert errors(source) == []


def test_a_trace_begins_with_a_trigger_and_comes_up_as_a_block(lab):
    source, *_ = lab(speed="1")
    source.write("FORM PACK;:TRIG:SOUR BUS;:TRAC:CONF SAMP,1;ARM")
    assert int(source.query("STAT:OPER:COND?")) & 32
    time.sleep(0.05)
    assert source.query("TRAC:POIN?") == "0"
    source.trigger()
    source.write("AXIS1:MOVE 5;*WAI")
    assert source.query_slow("*OPC?") == "1"
    assert int(source.query("STAT:OPER:COND?")) & 32 == 0
    points = int(source.query("TRAC:POIN?"))
    assert points > 100
    records = list(struct.iter_unpack("<Q6i2H", source.block("TRAC:DATA? 0,100")))
    assert len(records) == 100
    assert {after[0] - before[0] for before, after in zip(records, records[1:])} == {256}
    source.trigger()
    assert errors(source) == [-211]


def test_the_status_byte_tells_what_is_the_matter(lab):
    source, _, meter, _ = lab()
    for link in (source, meter):
        link.write("*CLS;*SRE 0;*ESE 32")
        assert link.status() == 0
        link.write("NO:SUCH")
        assert link.status() == ERRORS | ESB
        assert (errors(link), link.query("*ESR?"), link.status()) == ([-113], "32", 0)
        if link.has_bus:
            link.write("*ESE?")
            assert link.status() == MAV
            assert (link.read(), link.status()) == ("32", 0)
        assert errors(link) == []


def test_service_is_requested_when_an_operation_has_ended(lab):
    source, array, _, _ = lab(speed="1")
    for link in (source, array):
        link.write("*CLS;*ESE 1;*SRE 32")
    source.write("AXIS1:VEL 500;MOVE 100;*OPC")
    assert source.status() & (RQS | ESB) == 0
    assert wait_for_service(source) == RQS | ESB
    # a serial poll takes the request; a stream has none, and tells the summary
    assert source.status() == (ESB if source.has_bus else RQS | ESB)
    assert array.status() == 0
    assert (source.query("*ESR?"), source.status(), errors(source)) == ("1", 0, [])


def test_service_is_requested_when_something_is_wrong(lab):
    source, _, meter, _ = lab()
    for link in (source, meter):
        link.write("*CLS;*SRE 4")
        link.write("NO:SUCH")
        assert wait_for_service(link) & (RQS | ERRORS) == RQS | ERRORS
        assert errors(link) == [-113]
        assert link.status() & (RQS | ERRORS) == 0
        link.write("NO:SUCH")
        assert wait_for_service(link) & RQS, "again, once it was served"
        link.write("*CLS")


def test_a_clear_in_the_middle_of_an_answer_leaves_nothing_of_it(lab):
    source, _, meter, _ = lab(speed="1")
    for ask, read in ("COMP:DATA?", 20), ("POSE?", 3), ("SYST:HELP:HEAD?", 3000), ("*IDN?;", 0):
        source.write(ask)
        if read:
            source.visa.read_bytes(read)
        source.clear()
        assert source.query("*ESE?") == "0", ask
    source.write("AXIS1:VEL 100;MOVE 300;*OPC?")
    # on a stream a clear drops what stands in front of it and has not begun
    time.sleep(0.1)
    source.clear()
    assert source.query("*ESE 3;*ESE?") == "3"
    assert int(source.query("STAT:OPER:COND?")) & 256, "a clear stops no motion"
    meter.write("READ:POW?")
    meter.clear()
    assert meter.query("ROUT:CLOS? 1") != ""
    assert (errors(source), errors(meter)) == ([], [])


def test_two_stages_move_at_once_while_the_meter_is_read(lab):
    source, array, meter, _ = lab(speed="1")
    for link, target in (source, -20), (array, 20):
        link.write(f"*CLS;*ESE 1;*SRE 32;:AXIS1:VEL 20;MOVE {target};*OPC")
    read, both = [], 0
    while not all(done := [link.status() & ESB for link in (source, array)]):
        read.append(float(meter.query("READ:POW? (@1)")))
        both += not any(done)
    assert len(read) > 5 and both > 5, (len(read), both)
    assert all(-70 < level < 3 for level in read)
    assert pose(source)[0] == pytest.approx(-20, abs=0.05) and pose(array)[0] == pytest.approx(20, abs=0.05)
    assert [errors(link) for link in (source, array, meter)] == [[], [], []]


def test_a_time_out_is_recovered_from(lab):
    source, array, _, _ = lab(speed="1", timeout=300)
    source.write("AXIS1:VEL 50;MOVE 100;*OPC?")
    with pytest.raises(pyvisa.VisaIOError) as raised:
        source.read()
    assert raised.value.error_code == pyvisa.constants.StatusCode.error_timeout
    assert array.query("*IDN?").startswith("Stage Controller"), "the others are not held up"
    source.clear()
    assert source.query("*ESE 9;*ESE?") == "9"
    assert int(source.query("STAT:OPER:COND?")) & 256
    source.write("!")
    assert errors(source) == []


def test_what_breaks_the_rules_of_the_bus_is_told(start, manager):
    server = start("--bench", "4", "--gpib", "0", "--speed", "max", "--no-pty", boards=3, terminals=0)
    for link in gpib(manager, server, 300):
        link.write("*CLS")
        with pytest.raises(pyvisa.VisaIOError):
            link.read()
        assert all_errors(link)[0].startswith('-420,"Query UNTERMINATED'), link.name
        link.write("*ESE 4")
        link.write("*ESE?")
        assert link.query("*SRE?") == "0"
        assert errors(link) == [-410]
        assert link.query("*IDN?;*ESE?").startswith("Stage Controller")
        assert errors(link) == [-440]
        assert link.query("*ESR?") == "4", "query error"


def test_a_new_query_may_be_sent_before_the_answer_is_read_on_a_stream(fast, connect):
    for transport in ("tcp", "pty"):
        link = connect(fast, transport)
        link.write("*ESE?")
        link.write("*SRE 3;*SRE?")
        assert (link.read(), link.read(), errors(link)) == ("0", "3", [])


def test_a_gateway_serves_boards_without_a_bench_and_clients_that_vanish(start, manager):
    server = start("--boards", "2", "--gpib", "0", "--speed", "1", boards=2)
    for begun in (b"*IDN?\n", b"AXIS1:MOVE 1", b"*IDN?\n++read 44\n", b"SYST:JOG:TIM 3600;:AXIS1:MOVE:JOG 100\n"):
        with socket.create_connection(server.gpib, timeout=5) as client:
            client.sendall(b"++eos 3\n++addr 6\n" + begun)
            time.sleep(0.1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    time.sleep(0.2)
    gateway = gateway_of(manager, server)
    one, two = (BusLink(manager, f"GPIB0::{address}::INSTR", gateway, 2000) for address in (5, 6))
    assert two.query("*OPC?") == "1"
    assert errors(one) == []
    # the one answer of four clients that was asked for and never read, and the one that was read in part
    assert errors(two) == [-410, -410]
    assert int(two.query("STAT:OPER:COND?")) & 256 == 0, "the jog has ended"


@pytest.mark.parametrize(("example", "most"), [("align.py", 10), ("gpib.py", 10.6)])
def test_the_examples_align_over_gpib_addresses(start, example, most):
    server = start("--bench", "4", "--gpib", "0", "--speed", "max", "--no-pty", boards=3, terminals=0)
    host, port = server.gpib
    names = [f"PRLGX-TCPIP::{host}::{port}::INTFC", *(f"GPIB0::{address}::INSTR" for address in (5, 6, 7))]
    command = [sys.executable, str(ROOT / "examples" / example), *names]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    losses = [float(loss) for loss in re.findall(r"^CH\d\s.*loss\s+([\d.]+) dB$", done.stdout, re.M)]
    print(done.stdout)
    # 9.03 dB of a splitter into eight, and 0.6 dB excess
    assert len(losses) == 8 and 9 < min(losses) and max(losses) < most, losses


def test_throughput_is_told(lab, request):
    source, *_ = lab()
    count, begin = 500, time.monotonic()
    for _ in range(count):
        assert source.query("SYST:ERR:COUN?") == "0"
    queries = count / (time.monotonic() - begin)
    size, begin = 0, time.monotonic()
    while time.monotonic() - begin < 1:
        size += len(source.block("SYST:HELP:HEAD?"))
    up = size / (time.monotonic() - begin)
    block, size, begin = source.block("COMP:DATA?"), 0, time.monotonic()
    while time.monotonic() - begin < 1:
        source.write_raw(b"COMP:LOAD " + as_block(block) + b"\n")
        assert source.query("SYST:ERR:COUN?") == "0"
        size += len(block)
    down = size / (time.monotonic() - begin)
    told = f"{queries:.0f} queries/s, blocks up {up / 1e3:.0f} kB/s, down {down / 1e3:.0f} kB/s"
    print(f"{request.node.callspec.id}: {told}")
    assert queries > 20
