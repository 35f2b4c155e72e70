"""One script for both: the firmware over the emulated serial port, and `host-sim serve` over a socket."""

import re
import socket
import subprocess
import time
from pathlib import Path

import pytest

from lab import LOWER, NO_ERROR, STOP, Switch, as_block, ask, boot, calibrate, figure, power_up

MACHINES = Path(__file__).resolve().parents[2] / "host-sim" / "machines"
# Where the upper switch of X is in this test, um; and how far back it opens again.
SWITCH_UM, OPENS_UM, STEP_UM = 8.0, 50.0, 0.05


class Emulated:
    """The shipped ELF, its serial port, a hand at its pins."""

    def __init__(self, firmware):
        self.board = power_up(firmware)
        self.switch = Switch(self.board, 0, round(SWITCH_UM / STEP_UM), hysteresis=round(OPENS_UM / STEP_UM))
        for pin in LOWER:
            self.board.pin(*pin, 0)

    def write(self, data):
        self.board.serial.write(data)

    def query(self, text):
        return ask(self.board, text)

    def wait(self, ms):
        self.board.run(ms * 1000)

    def stop_contact(self, is_open):
        self.board.pin(*STOP, 0 if is_open else 1)
        self.board.run(2000)

    def restart(self):
        self.board.reset()
        boot(self.board)

    def power_cycle(self):
        self.board.power_cycle()
        boot(self.board)

    def close(self):
        assert self.board.bus.warnings == [], "the program did what the chip does not take"


class Virtual:
    """host-sim behind a socket; its standard input is the hand at the stage."""

    def __init__(self, host_sim, machine, settings):
        self.command = [host_sim, "serve", "--machine", str(machine), "--settings", str(settings), "--port", "0", "--cold",
                        "--no-pty", "--console"]
        self._start()

    def _start(self):
        self.process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        while not (found := re.match(r"\s*TCP\s+(\S+):(\d+)", self.process.stdout.readline())):
            assert self.process.poll() is None, f"{self.command} ended"
        self.socket = socket.create_connection((found[1], int(found[2])), timeout=30)
        self.lines = self.socket.makefile("rb")

    def write(self, data):
        self.socket.sendall(data.encode() if isinstance(data, str) else data)

    def query(self, text):
        self.write(text + "\n")
        return self.lines.readline().decode().rstrip("\n")

    def wait(self, ms):
        time.sleep(ms / 1000)

    def stop_contact(self, is_open):
        self.process.stdin.write(f"stop {'open' if is_open else 'closed'}\n")
        self.process.stdin.flush()
        time.sleep(0.3)

    def restart(self):
        self.close()
        self._start()

    power_cycle = restart

    def close(self):
        self.socket.close()
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self.process.stdin.close()


def numbers(text):
    return [float(part) for part in text.split(",")]


def error(stage):
    """The oldest error's number."""
    return int(stage.query("SYST:ERR?").split(",")[0])


def script(stage, block):
    """What every stage controller does, link and machine whatever they are. Answers what a client would read."""
    heard = []

    def tell(text, expected=0):
        stage.write(text + "\n")
        number = error(stage)
        assert number == expected, f"{text!r} raised {number}, not {expected}"

    def hear(text):
        heard.append((text, stage.query(text)))
        return heard[-1][1]

    # it says who it is, and does not move before it knows where it is
    assert hear("*IDN?").startswith("Stage Controller,SC6,")
    assert hear("SYST:ERR:ALL?") == NO_ERROR
    tell("AXIS1:MOVE 10", 101)
    tell("AXIS1:MOVE:REL 10", 108)
    tell("POSE 1,1,1,0,0,0", 101)

    # a calibration, damaged and whole
    stage.write(b"COMP:LOAD " + as_block(block[:-1] + bytes([block[-1] ^ 1])) + b"\n")
    assert error(stage) == -230
    stage.write(b"COMP:LOAD " + as_block(block) + b"\n")
    assert error(stage) == 0
    hear("COMP:CRC?;:COMP:NAME?")
    assert hear("COMP:STAT?") == "1"

    # a coordinated move
    for n in range(1, 7):
        tell(f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON")
    target = [5, -4, 3, 0.01, -0.01, 0.005]
    stage.write("POSE " + ",".join(map(str, target)) + "\n")
    assert stage.query("*OPC?") == "1"
    at = numbers(hear("POSE?"))
    assert all(abs(a - b) < (0.05 if n < 3 else 3e-4) for n, (a, b) in enumerate(zip(at, target))), at
    for n in range(1, 7):
        hear(f"AXIS{n}:POS:MOT?")
    assert hear("SYST:ERR:ALL?") == NO_ERROR

    # what a message does wrong, it is told; what it did right before has happened
    for text, number in [
        ("FOO:BAR 1", -113), ("AXIS7:MOVE 1", -114), ("AXIS1:VEL fast", -104), ("AXIS1:VEL 1,2", -108), ("AXIS1:VEL", -109),
        ("AXIS1:VEL 1 DEG", -131), ("AXIS1::VEL 1", -102), ("AXIS1:MOVE 1e9", -222), ("AXIS1:MOVE 1e99999", -123),
        ("*ESE 'x", -151), ("POSE 1000000,0,0,0,0,0", -222), ("X" * 600, -363),
    ]:
        tell(text, number)
    tell("AXIS3:VEL 500;:NONSENSE;:AXIS3:VEL 700", -113)
    assert hear("AXIS3:VEL?") == "500.000"
    assert numbers(hear("POSE?")) == at, "nothing of that has moved anything"

    # a limit switch
    tell("AXIS1:VEL 100")
    tell("AXIS1:LIM:HARD:POL HIGH;STAT ON")
    stage.write("AXIS1:MOVE 100\n")
    assert stage.query("*OPC?") == "1"
    told = hear("SYST:ERR?")
    assert told.startswith("102,") and "AXIS1" in told and "upper" in told
    assert hear("AXIS1:LIM:HARD?") == "0,1"
    on = numbers(stage.query("AXIS1:POS?"))[0]
    assert abs(on - SWITCH_UM) < 0.5, on
    tell("AXIS1:MOVE 20", 102)
    tell("AXIS1:VEL MAX")
    away = SWITCH_UM - OPENS_UM - 10
    tell(f"AXIS1:MOVE {away}")
    assert stage.query("*OPC?") == "1"
    assert abs(numbers(stage.query("AXIS1:POS?"))[0] - away) < 0.05
    assert hear("AXIS1:LIM:HARD?") == "0,0"

    # the emergency stop in mid-move
    tell("AXIS2:VEL 200")
    stage.write("AXIS2:MOVE 1000\n")
    stage.wait(80)
    stage.stop_contact(True)
    assert hear("SYST:ERR?").startswith("103,")
    assert hear("SYST:EST:STAT?") == "1,1"
    stopped = numbers(stage.query("AXIS2:POS?"))[0]
    assert -3.9 < stopped < 990, stopped
    stage.wait(20)
    assert numbers(stage.query("AXIS2:POS?"))[0] == stopped
    tell("SYST:EST:CLE", 103)
    tell("AXIS2:MOVE 0", 103)
    stage.stop_contact(False)
    assert hear("SYST:EST:STAT?") == "1,0", "latched until it is cleared"
    tell("AXIS2:MOVE 0", 103)
    stage.write("SYST:EST:CLE\n")
    assert stage.query("*OPC?") == "1"
    assert hear("SYST:EST:STAT?") == "0,0"
    stage.write(f"AXIS2:MOVE {stopped - 4}\n")
    assert stage.query("*OPC?") == "1"
    assert abs(numbers(stage.query("AXIS2:POS?"))[0] - (stopped - 4)) < 0.05
    assert hear("SYST:ERR:ALL?") == NO_ERROR

    # settings outlive a reset and a power cut
    tell("AXIS3:VEL 123;:AXIS3:BACK:DIST 0.4;:SYST:JOG:TIM 2")
    stage.write("*SAV\n")
    assert stage.query("*OPC?") == "1"
    tell("AXIS3:VEL 77")
    for again in (stage.restart, stage.power_cycle):
        again()
        assert hear("SYST:ERR:ALL?") == NO_ERROR
        assert hear("AXIS3:VEL?;:AXIS3:BACK:DIST?") == "123.000;0.400"
        assert hear("AXIS1:LIM:HARD:STAT?;:SYST:JOG:TIM?").startswith("1;2")
        hear("COMP:CRC?;:COMP:NAME?")
        tell("AXIS1:MOVE:REL 1", 108)
    tell("AXIS1:MOVE 1", 101)
    tell("*RCL")
    return heard


@pytest.fixture(scope="module")
def block(host_sim, tmp_path_factory):
    return calibrate(host_sim, "paper", tmp_path_factory.mktemp("calibration") / "paper.cal")


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """The paper's stage with its upper switch of X close by."""
    text = (MACHINES / "paper.toml").read_text()
    line = "[axes.X]\n"
    assert line in text
    path = tmp_path_factory.mktemp("machine") / "paper.toml"
    path.write_text(text.replace(line, f"{line}switches_um = [-4900.0, {SWITCH_UM}]\n"))
    return path


@pytest.fixture(scope="module")
def virtual(host_sim, machine, tmp_path_factory, block):
    stage = Virtual(host_sim, machine, tmp_path_factory.mktemp("settings") / "settings")
    try:
        return script(stage, block)
    finally:
        stage.close()


def test_the_script_passes_on_the_virtual_controller(virtual):
    assert len(virtual) > 20


def test_the_same_script_passes_on_the_firmware_and_hears_the_same(firmware, block, virtual):
    stage = Emulated(firmware)
    heard = script(stage, block)
    stage.close()
    assert heard == virtual
    figure(f"one script for firmware and host-sim: {len(heard)} answers, all the same")
