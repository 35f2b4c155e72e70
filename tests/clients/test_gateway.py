"""The gateway's connections: who vanishes, who says nothing, who jogs, who shares an instrument."""
import socket
import struct
import subprocess
import time

import pytest
import pyvisa

from stagetools import wait_until

SLOTS = 8
LINKS = 18
STUCK = b"AXIS1:VEL 5;MOVE 100;*WAI\n" + b"*SRE 0;*SRE 0;*SRE 0;*SRE 0;*SRE 0\n" * 40


class Wire:
    """A socket and what comes back on it."""

    def __init__(self, address):
        self.socket = socket.create_connection(address, timeout=5)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data):
        self.socket.sendall(data)

    def line(self, seconds=5):
        """The next line; what came of it until the time is over or the other side has gone."""
        self.socket.settimeout(seconds)
        got = b""
        try:
            while not got.endswith(b"\n") and (byte := self.socket.recv(1)):
                got += byte
        except (TimeoutError, ConnectionResetError):
            pass
        return got

    def ask(self, data, seconds=5):
        self.send(data)
        return self.line(seconds)

    def vanish(self, reset):
        if reset:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.socket.close()


def moving(wire):
    return int(wire.ask(b"STAT:OPER:COND?\n")) & 256 != 0


@pytest.fixture
def server(start):
    return start("--gpib", "0", "--no-pty", terminals=0)


def test_a_jog_ends_without_bytes_though_a_read_waits(server):
    watch, client = Wire(server.tcp[0]), Wire(server.gpib)
    client.send(b"++read_tmo_ms 3000\nSYST:JOG:TIM 300 MS\nAXIS1:MOVE:JOG 50\n*OPC?\n++read\n")
    assert wait_until(lambda: moving(watch), 1)
    began = time.monotonic()
    assert wait_until(lambda: not moving(watch), 2.5)
    assert time.monotonic() - began < 2
    # bytes keep it
    client.send(b"++clr\nAXIS1:MOVE:JOG 50\n")
    for _ in range(10):
        time.sleep(0.1)
        client.send(b"*ESE 0\n")
    assert moving(watch)


@pytest.mark.parametrize("reset", [False, True])
@pytest.mark.parametrize("link", ["gpib", "tcp"])
def test_who_vanishes_behind_much_that_waits_leaves_no_jog_and_no_link(server, link, reset):
    watch = Wire(server.tcp[0])
    client = Wire(getattr(server, link) if link == "gpib" else server.tcp[0])
    # 66 KB behind what waits for the end of a jog that would not end
    client.send(b"SYST:JOG:TIM 3600\nAXIS1:MOVE:JOG -5\n*WAI\n")
    assert wait_until(lambda: moving(watch), 1)
    client.socket.settimeout(0.5)
    try:
        client.socket.sendall(b"*SRE 1;*SRE 2;*SRE 3\n" * 3000)
    except TimeoutError:
        pass
    assert moving(watch)
    client.vanish(reset)
    assert wait_until(lambda: not moving(watch), 3), "the jog has ended"
    if link == "gpib":
        clients = [Wire(server.gpib) for _ in range(SLOTS)]
        assert wait_until(lambda: all(one.ask(b"++ver\n", 0.5) for one in clients), 5), "its place is free"
    else:
        links = [watch]
        # all links of the board but the gateway's
        assert wait_until(lambda: links.append(Wire(server.tcp[0])) or len(links) == LINKS - 1, 3)
        assert wait_until(lambda: all(one.ask(b"*ESE?\n", 0.5) for one in links), 5), "its link is free"


def test_a_vanished_client_whose_line_is_held_makes_way(server):
    client = Wire(server.gpib)
    client.send(b"++read_tmo_ms 200\n" + STUCK)
    time.sleep(0.1)
    client.vanish(reset=False)
    began = time.monotonic()
    assert Wire(server.gpib).ask(b"*ESE 5;*ESE?\n++read\n") == b"5\n"
    assert time.monotonic() - began < 2


def test_connections_that_never_say_anything_make_way_for_one_that_does(server):
    working = Wire(server.gpib)
    assert working.ask(b"++addr\n") == b"5\r\n"
    silent = [Wire(server.gpib) for _ in range(SLOTS)]
    time.sleep(0.2)
    for _ in range(3):
        assert Wire(server.gpib).ask(b"++addr\n") == b"5\r\n"
    assert working.ask(b"++addr\n") == b"5\r\n"
    del silent


def test_the_place_of_a_client_that_has_gone_is_free_for_the_next(server):
    for _ in range(20):
        clients = [Wire(server.gpib) for _ in range(SLOTS)]
        assert all(client.ask(b"++addr\n") == b"5\r\n" for client in clients)
        for client in clients:
            client.vanish(reset=False)


def test_a_serial_poll_behind_a_read_that_has_timed_out_brings_the_status(server):
    manager = pyvisa.ResourceManager("@py")
    host, port = server.gpib
    gateway = manager.open_resource(f"PRLGX-TCPIP::{host}::{port}::INTFC")
    stage = manager.open_resource("GPIB0::5::INSTR", write_termination="\n", timeout=3000)
    stage.write("AXIS1:VEL 20;MOVE 5;*OPC?")
    assert stage.read_stb() == 0
    time.sleep(1)
    assert [stage.read_stb(), stage.read_stb()] == [16, 16]
    # pyvisa-py sends one ++read a write
    gateway.write("++addr 5")
    assert stage.read_raw() == b"1\n"
    assert stage.query("SYST:ERR?").startswith("0,")
    manager.close()


def test_a_clear_of_one_board_sends_nothing_to_another_that_is_stuck(start):
    server = start("--boards", "2", "--gpib", "0", "--no-pty", boards=2, terminals=0)
    one, two = map(Wire, server.tcp)
    client = Wire(server.gpib)
    client.send(STUCK + b"++addr 6\n++clr\nAXIS1:VEL 66;MOVE 7;*WAI\n")
    time.sleep(1)
    assert two.ask(b"AXIS1:POS:COMM?\n") == b"0.000\n", "it waits behind what is held"
    one.send(b"!\n")
    assert wait_until(lambda: two.ask(b"AXIS1:POS:COMM?\n") == b"7.000\n")
    assert one.ask(b"AXIS1:POS:COMM?\n") != b"7.000\n"


@pytest.mark.parametrize("option", ["--gpib", "--hislip", "--port"])
def test_a_port_that_is_taken_is_told_with_the_option_that_takes_another(host_sim, option):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        ports = {"--port": "0", option: str(taken.getsockname()[1])}
        command = [host_sim, "serve", "--no-pty", *(word for pair in ports.items() for word in pair)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert ended.returncode != 0 and f"({option} takes another)" in ended.stderr
