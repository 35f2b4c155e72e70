"""Scans in the light: the same script in the firmware and in host-sim, with the same light to the last bit."""

import struct
import subprocess
from array import array

import pytest

from lab import (FAULT, LOWER, NO_ERROR, QUIET, SEGMENT, STOP, UPPER, as_block, ask, calibrate, counts, errors, figure, moves, power_up,
                 steps_of, stream_words)
from light import Light, Spot

PAUSE_MS, PAUSE_SEGMENTS = 40, 100
BAUD = 1_000_000
HOMED = [f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON" for n in range(1, 7)]
# A logarithmic meter of 20 dB/V sees a Gaussian beam, 4.3 dB down at 5 um; a linear one sees something with a maximum.
SPOTS = [Spot(30_000, [37, -23, 11, 4, -3, 2], [226_000, 180_000, 3_000, 40_000, 0, 0]),
         Spot(20_000, [-31, 15, 0, 0, 0, 0], [900_000, 1_500_000, 1_000, 0, 0, 0])]
METERS = ["SENS1:INP LOG,20,-60;AVER 1;:SENS2:INP LIN,0.001;AVER 1"]
PRELOADED = [line for n in (1, 2, 4) for line in (f"AXIS{n}:BACK:PREL POS;*OPC?", f"@{PAUSE_MS}")]
RECORD = struct.Struct("<Q6i2H")


class Virtual:
    """host-sim, which runs a script at once."""

    def __init__(self, host_sim, folder, spots=SPOTS, machine="paper"):
        self.host_sim, self.folder, self.machine, self.light = host_sim, folder, machine, folder / "light.toml"
        self.light.write_text("".join(spot.toml() for spot in spots))

    def run(self, lines):
        """Answers and words of a script on a cold board."""
        source, target = self.folder / "script.txt", self.folder / "words.bin"
        source.write_text("\n".join(lines))
        command = [self.host_sim, "trace", "--machine", str(self.machine), "--cold", "--light", str(self.light), "--script", str(source),
                   "--words", str(target)]
        done = subprocess.run(command, capture_output=True)
        assert done.returncode == 0, done.stderr.decode() + done.stdout.decode("ascii", "replace")
        words = array("I")
        words.frombytes(target.read_bytes())
        answers, rest = [], done.stdout
        while rest:
            answer, rest = cut(rest)
            answers.append(answer)
        return answers, words


def cut(data):
    """The first answer in some bytes without its end, and what follows; None when it is not complete."""
    size = 0
    if data[:1] == b"#" and len(data) > 1:
        digits = int(data[1:2])
        size = 2 + digits + int(data[2:2 + digits]) if len(data) >= 2 + digits else len(data)
    end = data.find(b"\n", size)
    return (data[:end], data[end + 1:]) if end >= 0 else None


class Emulated:
    """The shipped ELF with a calibration."""

    def __init__(self, firmware, block, spots=SPOTS):
        self.board = power_up(firmware)
        self.board.serial.write(b"COMP:LOAD " + as_block(block) + b"\n")
        assert ask(self.board, "SYST:ERR:ALL?") == NO_ERROR
        # records are long
        assert ask(self.board, f"SYST:COMM:SER:BAUD {BAUD};*OPC?") == "1"
        self.board.run(3000)
        self.board.serial.baud = BAUD
        self.board.adc.light = Light(self.board, spots)
        self.board.run(2 * SEGMENT)

    def query(self, text, timeout_us=30_000_000):
        """An answer as it is, block or text."""
        serial = self.board.serial
        serial.read()
        serial.write(text + "\n")
        self.board.run_until(lambda: serial.peek().endswith(b"\n") and cut(serial.peek()), timeout_us, f"an answer to {text!r}")
        return cut(serial.read())[0]

    def run(self, lines):
        """Answers of a script."""
        answers = []
        for line in lines:
            if line.startswith("@fault"):
                _, motor, state = line.split()
                self.board.pin(*FAULT[int(motor) - 1], int(state == "off"))
            elif line.startswith("@"):
                self.board.run(float(line[1:]) * 1000)
            elif "?" in line:
                answers.append(self.query(line))
            else:
                self.board.serial.write(line + "\n")
        return answers


@pytest.fixture(scope="module")
def block(host_sim, tmp_path_factory):
    return calibrate(host_sim, "paper", tmp_path_factory.mktemp("calibration") / "paper.cal")


def scan(definition, before=()):
    """A scan with its recording, by its parameters behind the number."""
    kind, parameters = definition.split(" ")
    return [*before, f"@{PAUSE_MS}", f"SCAN:DEF:{kind} 0,{parameters};:TRAC:CONF SCAN;ARM;:SCAN:STAR 0", "*OPC?", f"@{PAUSE_MS}",
            "SCAN:RES? 0;:SYST:ERR:ALL?;:SCAN:STAT?"] + [f"AXIS{n}:POS:MOT?" for n in range(1, 7)]


SCRIPT = HOMED + PRELOADED + METERS + [
    *scan("LINE 1,1,20,0.05,-40,PEAK"),
    "SENS1:POW?;:SENS2:POW?", "TRAC:POIN?", "FORM ASC;:TRAC:DATA? 100,20", "FORM PACK;:TRAC:DATA? 0,113", "TRAC:DATA? 113,113", "TRAC:DATA? 226,113",
    *scan("LINE 2,2,10,0.2,-40,STAR,NEG", ["SENS2:AVER 4"]),
    "SENS1:POW?;:SENS2:SCAL LIN;POW?", "TRAC:POIN?", "TRAC:DATA? 0,20",
    *scan("RAST 1,1,2,8,6,0.1,3,-40,PEAK", ["POSE -1,-1,0,0,0,0;*OPC?"]),
    "TRAC:POIN?", "TRAC:DATA? 0,100",
    *scan("SPIR 1,1,2,8,0.2,2,-5,FIRS", ["POSE 6,4,0,0,0,0;*OPC?"]),
    "TRAC:POIN?", "TRAC:DATA? 0,100",
    *scan("SPIR 1,1,2,6,0.2,3,-5,PEAK", ["POSE 3,-4,0,0,0,0;*OPC?"]),
    "TRAC:POIN?", "TRAC:DATA? 0,100",
    *scan("HILL 1,(@1,2),10,1.5,0.5,1,-40,PEAK", ["SENS1:AVER 4", "POSE 0.5,-2.5,0,0,0,0;*OPC?"]),
    "TRAC:POIN?", "TRAC:DATA? 0,20",
    *scan("PAR 1,1,8,5,-40,PEAK,NEG"), "TRAC:POIN?", "TRAC:DATA? 0,20",
    *scan("PAR 1,4,0.02,3,-40,PEAK"), "TRAC:POIN?", "TRAC:DATA? 0,12",
]


def test_try(firmware, host_sim, block, tmp_path):
    import time, pickle
    t = time.time()
    theirs, their_words = Virtual(host_sim, tmp_path).run(SCRIPT)
    print("host", time.time() - t)
    for a in theirs: print(a[:100])
    t = time.time()
    emulated = Emulated(firmware, block)
    ours = emulated.run(SCRIPT)
    print("emu", time.time() - t, emulated.board.machine.now_us)
    for a, b in zip(ours, theirs):
        if a != b: print("FIRM", a[:120], "\nHOST", b[:120])
    pickle.dump((ours, theirs, stream_words(emulated.board), their_words), open("/tmp/emu5.pickle", "wb"))
