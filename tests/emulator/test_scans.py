"""Scans in the light: the same script in the firmware and in host-sim, with the same light to the last bit.

What must be equal is every answer, every record, and every word from the first step of a way to its last. What need not be
is how long the stage rests between two ways: the thread gives the next one when it has heard that the stage rests, and on
the chip it hears of that, fits the peak, and plans, within some segments. So silence of `REST` segments and more may differ
by `SLACK`; in the midst of a way nothing may."""

import struct
import subprocess
from array import array
from pathlib import Path

import pytest

from lab import (FAULT, LOWER, NO_ERROR, QUIET, SEGMENT, UPPER, Follower, Switch, as_block, ask, calibrate, counts, figure,
                 power_up, segments, steps_of, stream_words)
from light import Light, Spot

MACHINES = Path(__file__).resolve().parents[2] / "host-sim" / "machines"
BAUD = 1_000_000
PAUSE_MS = 40
# Silent segments: ways begin and end slower than a step in so many; by how many rests may differ, which is 4 ms; what is a
# pause of the script.
REST, SLACK, PAUSE = 30, 16, 100
HOMED = [f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON" for n in range(1, 7)]
PRELOADED = [line for n in (1, 2, 4) for line in (f"AXIS{n}:BACK:PREL POS;*OPC?", f"@{PAUSE_MS}")]
METERS = ["SENS1:INP LOG,20,-60;AVER 1;:SENS2:INP LIN,0.001;AVER 1"]
# The logarithmic meter of 20 dB/V sees a Gaussian beam, 4.3 dB down at 5 um; the linear one sees something with a maximum.
SPOTS = [Spot(30_000, [37, -23, 11, 4, -3, 2], [226_000, 180_000, 3_000, 40_000, 0, 0]),
         Spot(20_000, [-31, 15, 0, 0, 0, 0], [900_000, 1_500_000, 1_000, 0, 0, 0])]
DARK = [Spot(0, [0] * 6, [0] * 6)] * 2
BRIGHT = [Spot(34_000, [20, 0, 0, 0, 0, 0], [226_000, 180_000, 0, 0, 0, 0])] * 2
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
    """The shipped ELF with a calibration, in the light."""

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

    def query(self, text, timeout_us=10_000_000):
        """An answer as it is, block or text."""
        serial = self.board.serial
        serial.read()
        serial.write(text + "\n")
        self.board.run_until(lambda: serial.usart.sent[-1:] == b"\n" and cut(serial.peek()), timeout_us, f"an answer to {text!r}")
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
        assert self.board.bus.warnings == [], "the program did what the chip does not take"
        return answers


@pytest.fixture(scope="module")
def block(host_sim, tmp_path_factory):
    return calibrate(host_sim, "paper", tmp_path_factory.mktemp("calibration") / "paper.cal")


# ---- what is compared ----

def close(ours, theirs):
    """Silence of so many segments may stand for the other."""
    least = min(ours, theirs)
    return ours == theirs or least >= PAUSE or least >= REST and abs(ours - theirs) <= SLACK


def parts(words):
    """Segments that set a bit, each with the number of silent ones before it."""
    out, silent = [], 0
    for part in segments(words):
        if part is None:
            silent += 1
        else:
            out.append((silent, part))
            silent = 0
    return out


def alike(ours, theirs):
    """How many parts are the same, the first silence left out, and by how much the rests between them differ."""
    rests = []
    for n, ((silent, a), (still, b)) in enumerate(zip(ours, theirs)):
        if a != b or n and not close(silent, still):
            return n, rests
        if n and silent != still and min(silent, still) < PAUSE:
            rests.append(abs(silent - still))
    return min(len(ours), len(theirs)), rests


def records(answer):
    """Rows of a recording: (tick, counts and light)."""
    if answer[:1] == b"#":
        rows = list(RECORD.iter_unpack(answer[2 + int(answer[1:2]):]))
    else:
        values = answer.decode().split(",")
        rows = [(int(values[n]), *values[n + 1:n + 9]) for n in range(0, len(values), 9)]
    return [(row[0], row[1:]) for row in rows]


def compare_records(ours, theirs, what):
    ours, theirs = records(ours), records(theirs)
    assert [row for _, row in ours] == [row for _, row in theirs], what
    assert all(tick % SEGMENT == 0 for tick, _ in ours + theirs)
    for n in range(1, len(ours)):
        a, b = ((rows[n][0] - rows[n - 1][0]) // SEGMENT for rows in (ours, theirs))
        # in a way each is a segment behind the other, or two
        assert a == b or min(a, b) > 2 and abs(a - b) <= SLACK, f"{what}, record {n}: {a} segments after the one before, host-sim: {b}"
    return len(ours)


def compare_answers(script, ours, theirs):
    """Every answer is the same; ticks count from the first one of a recording. The number of records."""
    assert len(ours) == len(theirs) == sum("?" in line for line in script)
    kept, running, answers = 0, "", iter(zip(ours, theirs))
    for line in script:
        running = line if "SCAN:DEF" in line else running
        if "?" in line:
            a, b = next(answers)
            if "TRAC:DATA?" in line:
                kept += compare_records(a, b, f"{line} behind {running}")
            else:
                assert a == b, f"{line} behind {running}"
    return kept


# ---- every kind of scan ----

def scan(definition, before=(), skip=1):
    """A scan with its recording, by its parameters behind the number, and what it says of itself."""
    kind, parameters = definition.split(" ")
    return [*before, f"@{PAUSE_MS}", f"SCAN:DEF:{kind} 0,{parameters};:TRAC:CONF SCAN,{skip};ARM;:SCAN:STAR 0;*OPC?", f"@{PAUSE_MS}",
            "SCAN:RES? 0;:SYST:ERR:ALL?;:SCAN:STAT?;:STAT:OPER:COND?;:STAT:QUES:COND?;:TRAC:POIN?",
            "AXIS1:POS:MOT?;:AXIS2:POS:MOT?;:AXIS3:POS:MOT?;:AXIS4:POS:MOT?;:AXIS5:POS:MOT?;:AXIS6:POS:MOT?", "SENS1:POW?;:SENS2:POW?"]


SCRIPT = HOMED + PRELOADED + METERS + [
    *scan("LINE 1,1,20,0.05,-40,PEAK"),
    "FORM ASC;:TRAC:DATA? 100,20", "FORM PACK;:TRAC:DATA? 0,113", "TRAC:DATA? 113,113", "TRAC:DATA? 226,113",
    *scan("LINE 2,2,10,0.2,-40,STAR,NEG", ["SENS2:AVER 4;SCAL LIN"]), "TRAC:DATA? 0,113", "TRAC:DATA? 113,80",
    *scan("RAST 1,1,2,8,6,0.1,3,-40,PEAK", ["POSE -1,-1,0,0,0,0;*OPC?"], skip=2), "TRAC:DATA? 0,113",
    *scan("SPIR 1,1,2,12,0.3,3,-5,PEAK", ["SENS1:AVER 3", "POSE 3,-4,0,0,0,0;*OPC?"]), "TRAC:DATA? 0,113", "TRAC:DATA? 300,113",
    *scan("HILL 1,(@1,2),10,1.5,0.5,1,-40,PEAK", ["SENS1:AVER 4", "POSE 0.5,-2.5,0,0,0,0;*OPC?"]), "TRAC:DATA? 0,60",
    *scan("PAR 1,1,8,5,-40,PEAK,NEG"), "TRAC:DATA? 0,20",
    *scan("PAR 1,4,0.02,5,-40,PEAK"), "TRAC:DATA? 0,12",
]
FIRST_LIGHT = ["SENS1:AVER 1", *scan("SPIR 1,1,2,8,0.2,2,-5,FIRS", ["POSE 6,4,0,0,0,0;*OPC?"]), "TRAC:DATA? 0,113", "TRAC:DATA? 113,113"]


def test_every_kind_of_scan_gives_the_answers_the_records_and_the_words_of_host_sim(firmware, host_sim, block, tmp_path):
    virtual, emulated = Virtual(host_sim, tmp_path), Emulated(firmware, block)
    script = SCRIPT + FIRST_LIGHT
    theirs, their_words = virtual.run(script)
    results = [answer.split(b",")[0] for line, answer in zip([line for line in script if "?" in line], theirs) if "SCAN:RES?" in line]
    assert results == [b"7"] * 7 + [b"5"], "each of them finds its peak, and the last one its light"
    board = emulated.board
    started = board.stack_used()
    board.machine.paint_stack(board.core.sp)
    ours = emulated.run(script)
    kept = compare_answers(script, ours, theirs)
    assert kept > 1000
    our_words = stream_words(board)
    a, b = parts(our_words), parts(their_words)
    same, rests = alike(a, b)
    # a stop for first light takes effect when the thread gets to it: behind the light the words may differ, their end may not
    before = len(parts(virtual.run(SCRIPT)[1]))
    assert same > before + 20, f"part {same} of {before}"
    assert steps_of(our_words) == steps_of(their_words) == counts(board)
    # their memory is static, and not of the stack's
    (address,) = [address for name, address in board.image.symbols.items() if "firmware5LIGHT" in name]
    assert 0x2000_0000 <= address < 0x2002_0000 and board.stack_used() < started, "the start takes more than all scans"
    figure(f"stack: {board.stack_used()} bytes in scans, {started} to the start; longest critical section in scans "
           f"{max(board.longest_masked())[0]:.1f} us")
    figure(f"scans: 8 scans, {len(ours)} answers and {kept} records equal to host-sim's; of {len(b)} segments with edges {same} are equal, "
           f"{before} before the scan for first light; {len(rests)} rests between ways differ, by {max(rests, default=0)} segments at most")


# ---- what goes wrong ----

STATE = ["SYST:ERR:ALL?;:SCAN:STAT?;:SCAN:RES? 0", "AXIS1:POS:MOT?;:AXIS2:POS:MOT?", "STAT:QUES:COND?;:STAT:OPER:COND?", "SENS1:POW?"]
AWAY = "POSE 1.3,-0.7,0,0,0,0;*OPC?"
KINDS = ["LINE 0,1,1,8,0.1,-40", "PAR 0,1,1,8,5,-40,STAY", "RAST 0,1,1,2,4,4,0.1,2,-40"]


@pytest.mark.parametrize("spots, why, power", ((DARK, b"no light above the threshold", b"-9.9E37"), (BRIGHT, b"power saturated", b"9.9E37")),
                         ids=("no light", "saturated"))
def test_without_light_and_with_too_much_of_it_a_scan_fails_as_in_host_sim_and_goes_back(firmware, host_sim, block, tmp_path, spots, why, power):
    script = HOMED + METERS + [AWAY]
    for definition in KINDS:
        kind, parameters = definition.split(" ", 1)
        script += [f"@{PAUSE_MS}", f"SCAN:DEF:{kind} {parameters};:SCAN:STAR 0;*OPC?", *STATE, "POSE?"]
    theirs, their_words = Virtual(host_sim, tmp_path, spots).run(script)
    emulated = Emulated(firmware, block, spots)
    ours = emulated.run(script)
    compare_answers(script, ours, theirs)
    for n in range(len(KINDS)):
        _, state, _, conditions, level, pose = ours[1 + 6 * n:][:6]
        assert state.startswith(b'113,"Scan without result;' + why + b'";IDLE,0;'), state
        assert int(state.split(b";")[-1].split(b",")[0]) & 0x303 == 256
        assert int(conditions.split(b";")[0]) & 8 and level == power
        assert pose.startswith(b"1.300,-0.700,"), "back where it began"
    a, b = parts(stream_words(emulated.board)), parts(their_words)
    assert alike(a, b)[0] == len(a) == len(b)


def abort(emulated):
    emulated.board.serial.write("ABOR\n")


def fault(emulated):
    emulated.run(["@fault 1 on"])


def nothing(_):
    """The switch of the machine comes by itself."""


LINE = "SCAN:DEF:LINE 0,1,1,20,0.05,-40,PEAK"
WATCHED = "AXIS1:LIM:HARD:POL HIGH;STAT ON"
# Where the switch is, um and counts.
SWITCH_UM, SWITCH = 4.0, 80
# What host-sim does 300 ms after the start, when it is in the midst of the line as well.
STOPS = {"abort at a word": (abort, ["@300", "ABOR"], b'0,"No error"', 128),
         "driver fault": (fault, ["@300", "@fault 1 on"], b'112,', 256),
         "limit switch": (nothing, ["@500"], b'102,', 256)}


@pytest.fixture
def switched(tmp_path):
    """The paper's stage with its upper switch of X in the midst of the line."""
    text, line = (MACHINES / "paper.toml").read_text(), "[axes.X]\n"
    assert line in text
    path = tmp_path / "paper.toml"
    path.write_text(text.replace(line, f"{line}switches_um = [-4900.0, {SWITCH_UM}]\n"))
    return path


@pytest.mark.parametrize("stop, virtually, told, flag", STOPS.values(), ids=STOPS.keys())
def test_what_stops_the_motors_in_mid_scan_ends_it_as_in_host_sim(firmware, host_sim, block, tmp_path, switched, stop, virtually, told, flag):
    script = HOMED + METERS + [WATCHED, LINE, "SYST:ERR:ALL?", f"@{PAUSE_MS}"]
    state = [f"@{PAUSE_MS}", "SYST:ERR:ALL?", "SCAN:STAT?", "SCAN:RES? 0", "STAT:OPER:COND?;:AXIS1:ENAB?;:AXIS2:ENAB?;:AXIS1:LIM:HARD?",
             "SCAN:CONT;:SYST:ERR?", "SCAN:STAT?"]
    machine = switched if stop is nothing else "paper"
    virtual = Virtual(host_sim, tmp_path, machine=machine)
    theirs, _ = virtual.run(script + ["SCAN:STAR 0"] + virtually + state)
    emulated = Emulated(firmware, block)
    board = emulated.board
    assert emulated.run(script) == [NO_ERROR.encode()]
    if stop is nothing:
        Switch(board, 0, SWITCH)
    follower, lowest = Follower(board), 0

    def on_the_line():
        nonlocal lowest
        at = follower.look()[0]
        lowest = min(lowest, at)
        return lowest < -220 and at > -50

    board.serial.write("SCAN:STAR 0\n")
    board.run_until(on_the_line, 2_000_000, "the midst of the line")
    board.run(137)
    stop(emulated)
    board.run(300_000 if stop is nothing else PAUSE_MS * 1000)
    ours = emulated.run(state)
    # where it was stopped, and how many samples there were until then, is a matter of the moment
    assert len(ours) == len(theirs[1:]) == 6
    for line, a, b in zip([line for line in state if "?" in line], ours, theirs[1:]):
        if "RES?" in line:
            a, b = (answer.split(b",")[0] for answer in (a, b))
            assert int(a) & 0x383 == flag
        assert a == b, line
    assert ours[0].startswith(told) and ours[1] == b"IDLE,0"
    at = counts(board)
    words = stream_words(board)
    assert at == steps_of(words), "counts are exact"
    assert SWITCH <= at[0] <= SWITCH + 1 if stop is nothing else -60 < at[0] < 60
    # up to the stop the words are those of a scan that nobody stops
    _, whole = Virtual(host_sim, tmp_path).run(script + ["SCAN:STAR 0;*OPC?", "SYST:ERR:ALL?"])
    a, b = parts(words), parts(whole)
    same, _ = alike(a, b)
    assert same >= len(a) - 1 and len(a) > 500
    if same < len(a):
        last = a[-1][1]
        while last[-1] == QUIET:
            last.pop()
        assert last == b[same][1][:len(last)], "the segment that was cut short"
    # and the next scan is right
    for pin in LOWER + UPPER:
        board.pin(*pin, 0)
    again = ["@fault 1 off", "AXIS1:LIM:HARD:STAT OFF;:AXIS1:POS:SET 0;:AXIS1:ENAB ON;*CLS", LINE + ";:SCAN:STAR 0;*OPC?", "SCAN:RES? 0;:SYST:ERR:ALL?"]
    result = emulated.run(again)[-1]
    assert result.startswith(b"7,") and result.endswith(b'0,"No error"'), result
    figure(f"{flag} {told.decode()} in mid-scan: state as host-sim's, counts {at[:2]} exact, {same} segments with edges before it equal")


def test_a_link_that_falls_silent_or_is_cleared_in_mid_scan_changes_nothing(firmware, host_sim, block, tmp_path):
    script = HOMED + METERS + [LINE + ";:SYST:JOG:TIM 0.1;:SYST:ERR:ALL?", f"@{PAUSE_MS}"]
    result = ["SCAN:RES? 0;:SYST:ERR:ALL?;:SCAN:STAT?", "AXIS1:POS:MOT?"]
    theirs, their_words = Virtual(host_sim, tmp_path).run(script + ["SCAN:STAR 0;*OPC?"] + result)
    emulated = Emulated(firmware, block)
    board = emulated.board
    emulated.run(script)
    # the answer to *OPC? is never asked for again: the link is cut in the midst of a line, and cleared
    board.serial.write("SCAN:STAR 0;*OPC?\n")
    board.run(250_000)
    board.serial.write("SCAN:ST")
    board.run(200_000)
    board.serial.write("\x18")
    board.run(500_000)
    ours = emulated.run(result)
    assert ours == theirs[-2:] and ours[0].startswith(b"7,")
    a, b = parts(stream_words(board)), parts(their_words)
    assert alike(a, b)[0] == len(a) == len(b)
