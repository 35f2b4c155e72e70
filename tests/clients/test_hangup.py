"""Clients that hang up at each byte of what they say and of what they are told, over every link that can be hung up."""
import os
import socket
import struct
import time

import pytest

from test_hislip import Client, frame, receive

#: A question, a setting that all links share, and half a message.
TALK = b"*ESE 5;*ESE?\nAXIS1:VEL 17\nAXIS1:MOVE 1"
SETTING = TALK.index(b"17\n") + len(b"17\n")
ANSWER = b"5\n"


def hang_up(link, at):
    """Every other one with a reset."""
    if at % 2:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    link.close()


class Line:
    """Lines over a socket."""

    def __init__(self, address):
        self.link = socket.create_connection(address, timeout=3)
        self.file = self.link.makefile("rb")

    def query(self, text):
        self.link.sendall(text.encode() + b"\n")
        return self.file.readline().decode().strip()

    def close(self):
        self.file.close()
        self.link.close()


def until(ask, expected):
    """What was sent before a hang-up is executed soon, not at once."""
    end = time.monotonic() + 3
    while (told := ask()) != expected:
        assert time.monotonic() < end, (told, expected)
    return told


def test_a_socket_is_hung_up_at_each_byte(start):
    server = start("--speed", "max", "--no-pty", terminals=0)
    other = Line(server.tcp[0])
    for at in range(len(TALK) + 1):
        assert other.query("AXIS1:VEL 3;VEL?;*ESE?") == "3.000;0"
        stage = socket.create_connection(server.tcp[0], timeout=3)
        stage.sendall(TALK[:at])
        # with what it was told, or a part of that
        if at > TALK.index(b"\n"):
            read = at % (len(ANSWER) + 1)
            assert stage.recv(read, socket.MSG_WAITALL) == ANSWER[:read] if read else True
        # an end behind the bytes: a reset may overtake them
        stage.shutdown(socket.SHUT_WR)
        stage.close()
        until(lambda: other.query("AXIS1:VEL?"), "17.000" if at >= SETTING else "3.000")
        told = Line(server.tcp[0])
        assert told.query("*ESE?;:SYST:ERR?;:AXIS1:POS:COMM?") == '0;0,"No error";0.000', at
        told.close()
    assert other.query("SYST:ERR:ALL?") == '0,"No error"'


def test_a_socket_is_reset_at_each_byte(start):
    server = start("--speed", "max", "--no-pty", terminals=0)
    for at in range(len(TALK) + 1):
        stage = socket.create_connection(server.tcp[0], timeout=3)
        stage.sendall(TALK[:at])
        hang_up(stage, 1)
        told = Line(server.tcp[0])
        assert told.query("*ESE?;:SYST:ERR?;:AXIS1:POS:COMM?") == '0;0,"No error";0.000', at
        told.close()


def test_a_serial_port_is_hung_up_at_each_byte(start):
    server = start("--speed", "max")
    other = Line(server.tcp[0])
    for at in range(len(TALK) + 1):
        assert other.query("AXIS1:VEL 3;VEL?") == "3.000"
        port = os.open(server.pty[0], os.O_RDWR | os.O_NOCTTY)
        os.write(port, TALK[:at])
        os.close(port)
        until(lambda: other.query("AXIS1:VEL?"), "17.000" if at >= SETTING else "3.000")
    port = os.open(server.pty[0], os.O_RDWR | os.O_NOCTTY)
    os.write(port, b"*ESE 6;*ESE?;:SYST:ERR?;:AXIS1:POS:COMM?\n")
    with os.fdopen(port, "rb") as lines:
        assert lines.readline() == b'6;0,"No error";0.000\n'


def test_a_gateway_is_hung_up_at_each_byte(start):
    server = start("--bench", "4", "--gpib", "0", "--speed", "max", "--no-pty", boards=3, terminals=0)
    talk = b"++addr 6\n*ESE 5;*ESE?\n++read eoi\n++spoll\nAXIS1:VEL 17\nAXIS1:MOVE 1"
    asked, read = talk.index(b"?\n") + 2, talk.index(b"eoi\n") + 4
    for at in range(len(talk) + 1):
        stage = socket.create_connection(server.gpib, timeout=3)
        stage.sendall(talk[:at])
        stage.shutdown(socket.SHUT_WR)
        # the gateway closes when all that was sent is done
        told = b""
        while part := stage.recv(100):
            told += part
        assert told == (b"" if at < read else b"5\n" + (b"0\r\n" if b"spoll\n" in talk[:at] else b"")), at
        stage.close()
        next_one = Line(server.gpib)
        next_one.link.sendall(b"++addr 6\n*IDN?\n")
        assert next_one.query("++read eoi").startswith("Stage Controller"), at
        errors = []
        while not (answer := next_one.query("SYST:ERR?\n++read eoi")).startswith("0,"):
            errors.append(int(answer.split(",")[0]))
        assert errors == ([-410] if asked <= at < read else []), at
        assert next_one.query("*CLS;:AXIS1:POS:COMM?\n++read eoi") == "0.000", at
        next_one.close()


def test_a_gateway_is_reset_at_each_byte(start):
    server = start("--bench", "4", "--gpib", "0", "--speed", "max", "--no-pty", boards=3, terminals=0)
    talk = b"++addr 6\n*ESE 5;*ESE?\n++read eoi\n++spoll\n*IDN?\n++auto 1\nPOSE?\nAXIS1:MOVE 1"
    for at in range(len(talk) + 1):
        stage = socket.create_connection(server.gpib, timeout=3)
        stage.sendall(talk[:at])
        hang_up(stage, 1)
        for address in 5, 6, 7:
            next_one = Line(server.gpib)
            next_one.link.sendall(b"++addr %d\n++clr\n*IDN?\n" % address)
            assert next_one.query("++read eoi").startswith("Stage Controller"), (at, address)
            next_one.close()


@pytest.mark.parametrize("channel", ["synchronous", "asynchronous", "both"])
def test_a_hislip_client_hangs_up_at_each_byte_of_either_channel(start, channel):
    server = start("--bench", "4", "--hislip", "0", "--speed", "max", "--no-pty", boards=3, terminals=0)
    talk = {
        "synchronous": frame("DataEnd", 0, 0xFFFF_FF00, b"*ESE 5;*ESE?\n")
        + frame("Data", 1, 0xFFFF_FF02, b"AXIS1:MOVE 1"),
        "asynchronous": frame("AsyncStatusQuery") + frame("AsyncLock", 1, 0, b"team") + frame("AsyncDeviceClear"),
    }
    talk["both"] = talk["synchronous"]
    for at in range(len(talk[channel]) + 1):
        stage = Client(server)
        first, second = stage.sync, stage.aside
        if channel == "asynchronous":
            first, second = second, first
        first.sendall(talk[channel][:at])
        hang_up(first, at)
        if channel == "both":
            second.close()
        else:
            # a client has two channels or none: the other one is closed with it
            with pytest.raises(ConnectionError):
                while True:
                    receive(second)
            second.close()
        told = Client(server)
        assert told.query("*ESE?;:AXIS1:POS:COMM?") == "0;0.000", at
        assert told.errors() == [], at
        assert told.ask("AsyncLockInfo")[:3] == ("AsyncLockInfoResponse", 0, 0), "its locks went with it"
        told.close()


def test_a_hislip_client_hangs_up_at_each_byte_of_an_answer(start):
    server = start("--bench", "4", "--hislip", "0", "--speed", "max", "--no-pty", boards=3, terminals=0)
    answer = len(frame("DataEnd", 0, 0, b"0.000;0\n"))
    for at in range(answer + 1):
        stage = Client(server)
        stage.write("AXIS1:POS:COMM?;*ESE?")
        if at:
            assert len(stage.sync.recv(at, socket.MSG_WAITALL)) == at
        hang_up(stage.sync, at)
        stage.aside.close()
        told = Client(server)
        assert (told.query("*ESE?"), told.errors()) == ("0", []), at
        told.close()
