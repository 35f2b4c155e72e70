"""Servers and links for the client tests.

HOST_SIM names the program; without it the release build is made and used.
"""
import json
import os
import re
import subprocess
import tempfile
from pathlib import Path

import pytest
import pyvisa

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT_MS = 10_000
TRANSPORTS = ["tcp", "pty"]


def program():
    """Path of host-sim."""
    if "HOST_SIM" in os.environ:
        return os.environ["HOST_SIM"]
    subprocess.run(["cargo", "build", "--release", "-q", "-p", "host-sim"], cwd=ROOT, check=True)
    metadata = ["cargo", "metadata", "--format-version", "1", "--no-deps"]
    told = subprocess.run(metadata, cwd=ROOT, check=True, capture_output=True)
    return str(Path(json.loads(told.stdout)["target_directory"]) / "release" / "host-sim")


class Server:
    """A running `host-sim serve` with so many boards (or other sockets), and terminals: one a board. With --gpib a
    gateway too, with --hislip a HiSLIP server."""

    def __init__(self, path, *args, boards=1, terminals=None):
        command = [path, "serve", "--port", "0", *args]
        pipe, self.errors = subprocess.PIPE, tempfile.TemporaryFile("w+")
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self.errors, text=True)
        self.tcp, self.pty, self.gpib, self.hislip = [], [], None, None
        terminals = boards if terminals is None else terminals
        while (
            len(self.tcp) < boards
            or len(self.pty) < terminals
            or ("--gpib" in args and not self.gpib)
            or ("--hislip" in args and not self.hislip)
        ):
            line = self.process.stdout.readline()
            assert line, f"{command} ended with {self.process.wait()}"
            if found := re.match(r"\s*TCP\s+(\S+):(\d+)", line):
                self.tcp.append((found[1], int(found[2])))
            elif found := re.match(r"\s*PTY\s+(\S+)", line):
                self.pty.append(found[1])
            elif found := re.match(r"\s*GPIB\s+(\S+):(\d+)", line):
                self.gpib = (found[1], int(found[2]))
            elif found := re.match(r"\s*HiSLIP\s+(\S+):(\d+)", line):
                self.hislip = (found[1], int(found[2]))

    def resource(self, transport, board=0):
        """The VISA name of a board."""
        if transport == "tcp":
            host, port = self.tcp[board]
            return f"TCPIP::{host}::{port}::SOCKET"
        return f"ASRL{self.pty[board]}::INSTR"

    def hand(self, words):
        """What a hand does at the stage; the server was started with --console."""
        self.process.stdin.write(words + "\n")
        self.process.stdin.flush()

    def said(self):
        """What is on its standard error so far."""
        self.errors.seek(0)
        return self.errors.read()

    def stop(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()
        self.errors.close()


@pytest.fixture(scope="session")
def host_sim():
    return program()


@pytest.fixture
def start(host_sim):
    """Starts servers with options; they end with the test, and must not have ended before."""
    servers = []

    def start_server(*args, **sockets):
        servers.append(Server(host_sim, *args, **sockets))
        return servers[-1]

    yield start_server
    alive = [server.process.poll() is None for server in servers]
    for server in servers:
        server.stop()
    assert all(alive), "a server ended during the test"


@pytest.fixture
def connect():
    """Opens links to a server; they close with the test."""
    manager = pyvisa.ResourceManager("@py")

    def open_link(server, transport, board=0):
        return manager.open_resource(
            server.resource(transport, board), read_termination="\n", write_termination="\n", timeout=TIMEOUT_MS
        )

    yield open_link
    manager.close()


@pytest.fixture
def fast(start):
    """A stage in virtual time as fast as it can."""
    return start("--speed", "max")


@pytest.fixture
def paced(start):
    """A stage in real time."""
    return start("--speed", "1")


@pytest.fixture(params=TRANSPORTS)
def stage(request, fast, connect):
    """One link to a fast stage, over each transport."""
    return connect(fast, request.param)


@pytest.fixture(params=TRANSPORTS)
def slow_stage(request, paced, connect):
    """One link to a stage in real time, over each transport."""
    return connect(paced, request.param)


@pytest.fixture(params=[("tcp", "tcp"), ("tcp", "pty"), ("pty", "tcp")], ids="-".join)
def pair(request, paced, connect):
    """Two links to one stage in real time."""
    return tuple(connect(paced, transport) for transport in request.param)


@pytest.fixture
def block_of(host_sim, tmp_path):
    """The calibration block of a machine."""

    def calibrate(machine):
        path = tmp_path / "block.cal"
        subprocess.run([host_sim, "calibrate", str(machine), "-o", str(path)], check=True, capture_output=True)
        return path.read_bytes()

    return calibrate
