"""What the tests of the firmware share: a board that is powered up, its pins by their names, its words."""

import hashlib
import subprocess
from array import array

from stm32f4 import Board
from stm32f4.events import UNITS_PER_US
from stm32f4.words import DIR_PINS, STEP_PINS

# As in src/board/pins.rs.
STOP = ("A", 0)
LOWER = [("D", 1), ("D", 3), ("D", 7), ("D", 9), ("D", 11), ("B", 14)]
UPPER = [("D", 2), ("D", 6), ("D", 8), ("D", 10), ("B", 13), ("B", 15)]
FAULT = [("B", 4), ("B", 5), ("B", 7), ("B", 8), ("B", 11), ("B", 12)]
ENABLE = [("C", 1), ("C", 2), ("C", 5), ("C", 6), ("C", 8), ("C", 9)]

SEGMENT = 256
RING = 4
STEP_MASK = sum(1 << pin for pin in STEP_PINS)
QUIET = STEP_MASK << 16
NO_ERROR = '0,"No error"'
# 0.05 um a step: the machine without a calibration, and that of the paper.
STEPS_PER_UM = 20
# A board that has not begun to listen by then never will; one that finds settings in its flash takes longer.
BOOT_US = 500_000


# Boards of the running test, for what is summed up over all tests.
BOARDS = []


def figure(text):
    """A measured figure, for the test runner to show."""
    print(f"figure: {text}")


def boot(board):
    """Runs until the serial port listens; answers how long that took, us."""
    usart, stream = board.usart2, board.dma1.streams[5]
    listening = lambda: stream.enabled and usart.regs[12] & 4 and usart.regs[20] & 0x40
    taken = board.run_until(listening, BOOT_US, "the serial port")
    # supervision and the first turn
    board.run(2000)
    return taken


def power_up(firmware, stop_closed=True, **options):
    """The emergency stop's contact closed, limit switches closed to ground; booted."""
    board = Board(firmware, **options)
    BOARDS.append(board)
    board.pin(*STOP, int(stop_closed))
    for pin in LOWER + UPPER:
        board.pin(*pin, 0)
    boot(board)
    return board


def ask(board, text, timeout_us=3_000_000):
    return board.serial.query(text, timeout_us)


def errors(board):
    """The numbers of the queued errors; takes them."""
    text = ask(board, "SYST:ERR:ALL?")
    return [number for number in map(int, _numbers(text)) if number]


def errors_of(link):
    """The numbers of the queued errors of a link over USB; takes them."""
    found = []
    while (text := link.ask("SYST:ERR?")) != NO_ERROR:
        found.append(int(text.split(",")[0]))
    return found


def stop_by_exclamation_mark(board, link, message):
    """A message over USB moves axis 1 by 800 um; `!` on the same link stops it on the way, and it stays there."""
    enable_all(board)
    follower = Follower(board)
    link.write(message)
    board.run_until(lambda: follower.look()[0] >= 100, 2_000_000, "100 steps", step_us=500)
    link.write("!\n")
    board.run(5000)
    stopped = list(follower.look())
    board.run(50_000)
    assert follower.look() == stopped == counts(board)
    assert 0 < stopped[0] < 800 * 20


def _numbers(text):
    # 103,"latched; close",105,"…": the numbers stand outside of the strings
    return [part.strip(",") for part in text.split('"')[::2] if part.strip(",")]


def enable_all(board, *more):
    """All axes homed at 0 and enabled; `more`: further lines."""
    for n in range(1, 7):
        board.serial.write(f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON\n")
    for line in more:
        board.serial.write(line + "\n")
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR


class Follower:
    """Counts steps as they play; cheap to ask again and again."""

    def __init__(self, board):
        self.board, self.at, self.counts = board, board.played(), [0] * 6
        self.odr = board.ports["E"].read(0x14)
        self.last = None

    def look(self):
        """The counts up to now, from those at the begin; `last` is the index of the last word with a rising edge."""
        end = self.board.played()
        words, base = self.board.words.slice(self.at, end), self.at
        self.at, odr = end, self.odr
        for i, word in enumerate(words):
            after = odr & ~(word >> 16) | word & 0xFFFF
            rising = after & ~odr & STEP_MASK
            odr = after
            if rising:
                self.last = base + i
                for n, step in enumerate(STEP_PINS):
                    if rising >> step & 1:
                        self.counts[n] += 1 if odr >> DIR_PINS[n] & 1 else -1
        self.odr = odr
        return self.counts


def start_moving(board, text="AXIS1:MOVE 2000", steps=100):
    """Gives the order of a move and lets it come some way; follows the steps from its begin."""
    follower = Follower(board)
    board.serial.write(text + "\n")
    board.run_until(lambda: sum(map(abs, follower.look())) >= steps, 2_000_000, f"{steps} steps of {text!r}", step_us=500)
    return follower


def counts(board):
    """Motor counts as the firmware reports them."""
    return [int(ask(board, f"AXIS{n}:POS:MOT?")) for n in range(1, 7)]


def calibrate(host_sim, machine, path):
    """The calibration block of a machine file, or `paper`."""
    subprocess.run([host_sim, "calibrate", str(machine), "-o", str(path)], check=True, capture_output=True)
    return path.read_bytes()


def as_block(data):
    """An IEEE 488.2 definite block."""
    length = str(len(data)).encode()
    return b"#" + str(len(length)).encode() + length + data


# ---- words ----

def segments(words):
    """Segments that set a bit, as lists of words; silence as the number of segments between them."""
    out = []
    for at in range(0, len(words) - SEGMENT + 1, SEGMENT):
        part = words[at:at + SEGMENT]
        out.append(part if any(word & 0xFFFF for word in part) else None)
    return out


def moves(words, pause_segments):
    """The stretches between pauses of at least so many silent segments, each from its first to its last segment with a
    set bit, silence inside included."""
    quiet = array("I", [QUIET] * SEGMENT)
    found, current, silent = [], None, 0
    for part in segments(words):
        if part is None:
            silent += 1
            continue
        if current is None or silent >= pause_segments:
            current = array("I")
            found.append(current)
        else:
            current.extend(quiet * silent)
        current.extend(part)
        silent = 0
    return found


def stream_words(board, start=0):
    """What the pins were given from word `start` on. Where the stream began anew its segments begin anew: what was played
    of a segment before a stop is filled up with silence."""
    board.sync_stream()
    words, out = board.words, array("I")
    starts = [first for first, _, _ in words.runs if first > start] + [len(words)]
    for end in starts:
        out.extend(words.slice(start, end))
        out.extend(array("I", [QUIET] * (-len(out) % SEGMENT)))
        start = end
    return out


def digest(words):
    return hashlib.sha256(words.tobytes()).hexdigest()[:16]


def first_difference(ours, theirs):
    """Where two stretches part, as text for a person; None when they are equal."""
    for i, (a, b) in enumerate(zip(ours, theirs)):
        if a != b:
            return f"word {i % SEGMENT} of segment {i // SEGMENT}: firmware {a:#010x}, host-sim {b:#010x}"
    if len(ours) != len(theirs):
        return f"firmware plays {len(ours) // SEGMENT} segments, host-sim {len(theirs) // SEGMENT}"
    return None


def steps_of(words):
    """Signed steps of each motor in words, all DIR lines taken as low before."""
    odr, out = 0, [0] * 6
    for word in words:
        after = odr & ~(word >> 16) | word & 0xFFFF
        rising = after & ~odr & STEP_MASK
        odr = after
        if rising:
            for n, (step, direction) in enumerate(zip(STEP_PINS, DIR_PINS)):
                if rising >> step & 1:
                    out[n] += 1 if odr >> direction & 1 else -1
    return out


def reference_words(host_sim, machine, script, path):
    """What host-sim plays for a script on a board that is as cold as the emulated one: its words and its answers."""
    source, target = path / "script.txt", path / "words.bin"
    source.write_text(script)
    done = subprocess.run([host_sim, "trace", "--machine", str(machine), "--cold", "--script", str(source), "--words", str(target)],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout
    words = array("I")
    words.frombytes(target.read_bytes())
    return words, done.stdout.splitlines()


class Switch:
    """A limit switch on a motor, driven from its steps: closed to ground until the motor's count comes to `at`; opens
    again `hysteresis` steps back."""

    LOOK_US = 50

    def __init__(self, board, motor, at, upper=True, hysteresis=0, scatter=None, bounces=False):
        self.board, self.motor, self.at, self.sign = board, motor, at, 1 if upper else -1
        self.pin, self.hysteresis, self.scatter, self.bounces = (UPPER if upper else LOWER)[motor], hysteresis, scatter, bounces
        self.follower, self.tripped, self.trips, self.on = Follower(board), False, [], True
        self._look()

    def _look(self):
        if not self.on:
            return
        count = self.follower.look()[self.motor]
        at = self.at + (self.scatter() if self.scatter and not self.tripped else 0)
        way = self.sign * (count - at)
        if not self.tripped and way >= 0:
            self._turn(True)
            self.trips.append(count)
        elif self.tripped and way < -self.hysteresis:
            self._turn(False)
        self.board.at(self.LOOK_US, self._look)

    def _turn(self, tripped):
        self.tripped = tripped
        self.board.pin(*self.pin, int(tripped))
        if self.bounces:
            # the contact is open and closed some more times within a millisecond
            for n, at in enumerate((150, 220, 600, 640)):
                self.board.at(at, lambda level=int(tripped) ^ (n + 1) % 2: self.board.pin(*self.pin, level))
