"""The words at the pins against those of host-sim, which plays the same script: one a microsecond, none may differ."""

import pytest

from lab import (LOWER, NO_ERROR, QUIET, SEGMENT, STOP, UPPER, as_block, ask, calibrate, counts, digest, errors, figure,
                 first_difference, moves, power_up, reference_words, start_moving, steps_of, stream_words)

# Between moves both are silent for at least this long; inside a move neither is.
PAUSE_MS, PAUSE_SEGMENTS = 40, 100
SEGMENT_MS = SEGMENT / 1000
HOMED = [f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON" for n in range(1, 7)]
# Motors on a known flank: two moves, the second planned when the first has ended.
PRELOADED = [f"AXIS{n}:BACK:PREL POS" for n in (1, 4)]


@pytest.fixture(scope="module")
def block(host_sim, tmp_path_factory):
    return calibrate(host_sim, "paper", tmp_path_factory.mktemp("calibration") / "paper.cal")


@pytest.fixture
def board(firmware, block):
    """With the calibration of the paper's stage, homed at 0, enabled."""
    board = power_up(firmware)
    board.serial.write(b"COMP:LOAD " + as_block(block) + b"\n")
    for line in HOMED:
        board.serial.write(line + "\n")
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"


def play(board, before, lines):
    """Gives moves one after the other, each from standstill; answers the words from before the first of `lines`."""
    for line in before + lines:
        if line is lines[0]:
            start = board.played() // SEGMENT * SEGMENT
        assert ask(board, line + ";*OPC?", 10_000_000) == "1", line
        board.run(PAUSE_MS * 1000)
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    return stream_words(board, start)


def script(lines):
    """The same for host-sim."""
    return "\n".join(HOMED + [f"{line};*OPC?\n@{PAUSE_MS}" for line in lines])


def compare(ours, theirs, what):
    for n, (a, b) in enumerate(zip(ours, theirs)):
        assert digest(a) == digest(b), f"{what}, move {n + 1} from standstill: {first_difference(a, b)}"
    assert len(ours) == len(theirs), f"{what}: firmware makes {len(ours)} moves, host-sim {len(theirs)}"


MOVES = {
    "one axis up and down": ([], ["AXIS1:MOVE 12", "AXIS1:MOVE 3", "AXIS1:MOVE 3.05"]),
    "poses with calibration and reversals": (PRELOADED, ["POSE 8,-6,4,0.02,-0.015,0.01", "POSE 2,5,-3,-0.01,0.01,0.02", "POSE 0,0,0,0,0,0"]),
    "axes one after the other": ([], [f"AXIS{n}:MOVE:REL {0.02 if n > 3 else 6}" for n in range(1, 7)]),
}


@pytest.mark.parametrize("before, lines", MOVES.values(), ids=MOVES.keys())
def test_every_move_from_standstill_plays_the_words_of_host_sim(board, host_sim, tmp_path, before, lines):
    ours = moves(play(board, before, lines), PAUSE_SEGMENTS)
    words, _ = reference_words(host_sim, "paper", script(before + lines), tmp_path)
    theirs = moves(words, PAUSE_SEGMENTS)
    assert len(ours) >= len(lines), "each of them moves something"
    compare(ours, theirs[-len(ours):] if before else theirs, "words")
    assert steps_of(stream_words(board)) == steps_of(words) == counts(board)
    figure(f"words equal to host-sim's: {len(ours)} moves, {sum(map(len, ours))} words, "
           f"{sum(sum(map(abs, steps_of(move))) for move in ours)} net steps, last hash {digest(ours[-1])}")


INTERVENTIONS = {
    "a jog that is stopped": ("AXIS2:MOVE:JOG 300", "AXIS2:STOP"),
    "a move that is stopped": ("AXIS1:MOVE 400", "STOP"),
    "a move with a new target on the way": ("AXIS1:MOVE 200", "AXIS1:MOVE 90"),
}
GIVEN_MS = 30


def intervene(board, first, then):
    """The words of a move with an order on its way, from the first to the last segment with a set bit."""
    start = board.played() // SEGMENT * SEGMENT
    board.serial.write(first + "\n")
    board.run(GIVEN_MS * 1000)
    assert ask(board, then + ";*OPC?", 10_000_000) == "1"
    board.run(PAUSE_MS * 1000)
    assert ask(board, "SYST:ERR:ALL?") == NO_ERROR
    (ours,) = moves(stream_words(board, start), PAUSE_SEGMENTS)
    return ours


class Candidates:
    """What host-sim plays when it is given the order in one segment or another: on the board, that is a matter of the serial
    port and of how long planning takes."""

    NEVER = 1000

    def __init__(self, host_sim, path, first, then):
        def play(at):
            lines = HOMED + [first, f"@{at * SEGMENT_MS}", then + ";*OPC?", f"@{PAUSE_MS}"]
            found = moves(reference_words(host_sim, "paper", "\n".join(lines), path)[0], PAUSE_SEGMENTS)
            # stopped before the first step
            return found[0] if found else []
        self.play = play

    def nearest(self, ours):
        """The segment whose words are the same for longest, those words, and where the order shows first."""
        undisturbed, at = self.play(self.NEVER), round(GIVEN_MS / SEGMENT_MS)
        shows = alike(ours, undisturbed)
        for _ in range(5):
            at = max(at + (shows - alike(self.play(at), undisturbed)) // SEGMENT, 1)
        around = sorted(range(max(at - 25, 1), at + 26), key=lambda n: abs(n - at))
        best, most = at, -1
        for at in around:
            same = alike(ours, self.play(at))
            if same > most:
                best, most = at, same
            if same == len(ours):
                break
        return best, self.play(best), shows


def alike(a, b):
    """Words until two stretches part."""
    return next((i for i, (x, y) in enumerate(zip(a, b)) if x != y), min(len(a), len(b)))


@pytest.mark.parametrize("first, then", INTERVENTIONS.values(), ids=INTERVENTIONS.keys())
def test_an_order_on_the_way_plays_the_words_of_host_sim_once_it_falls_into_the_same_segment(board, host_sim, tmp_path, first, then):
    ours = intervene(board, first, then)
    at, theirs, _ = Candidates(host_sim, tmp_path, first, then).nearest(ours)
    assert first_difference(ours, theirs) is None
    figure(f"{then} {GIVEN_MS} ms after {first}: equal to host-sim's when that gets it after {at * SEGMENT_MS:.0f} ms, {len(ours)} words, hash {digest(ours)}")


def test_a_new_pose_on_the_way_plays_the_words_of_host_sim_until_its_second_order_and_ends_where_host_sim_does(board, host_sim, tmp_path):
    # the old path is slowed down by one order, the new one begins with another: each falls into a segment of its own
    first, then = "POSE 150,100,50,0.1,0.1,-0.1", "POSE 60,40,20,0.1,0.05,-0.05"
    ours = intervene(board, first, then)
    at, theirs, shows = Candidates(host_sim, tmp_path, first, then).nearest(ours)
    same = alike(ours, theirs)
    assert same == len(ours) or same - shows > 25 * SEGMENT, first_difference(ours, theirs)
    assert steps_of(ours) == steps_of(theirs) == counts(board)
    figure(f"a new pose on the way: shows in word {shows}, equal to host-sim's for {same} of {len(ours)} words, same end")


def abort(board):
    board.serial.write("ABOR\n")


def open_the_contact(board):
    board.pin(*STOP, 0)


def hit_the_switch(board):
    board.pin(*UPPER[0], 1)


def arm_again(board):
    board.run(5000)
    board.pin(*STOP, 1)
    for pin in LOWER + UPPER:
        board.pin(*pin, 0)
    board.run(5000)
    board.serial.write("SYST:EST:CLE\n")


STOPS = {"ABORt": (abort, []), "emergency stop": (open_the_contact, [103]), "limit switch": (hit_the_switch, [102])}


@pytest.mark.parametrize("stop, told", STOPS.values(), ids=STOPS.keys())
def test_up_to_an_immediate_stop_the_words_are_host_sims_and_count_position_and_next_move_are_exact(board, host_sim, tmp_path, stop, told):
    move, back = "AXIS1:MOVE 40", "POSE 0,0,0,0,0,0"
    board.serial.write("AXIS1:LIM:HARD:POL HIGH;STAT ON;:AXIS1:BACK:PREL POS\n")
    assert ask(board, "*OPC?") == "1"
    board.run(PAUSE_MS * 1000)
    start = board.played() // SEGMENT * SEGMENT
    start_moving(board, move, steps=150)
    stop(board)
    board.run(PAUSE_MS * 1000)
    assert errors(board) == told
    stopped = stream_words(board, start)
    (ours,) = moves(stopped, PAUSE_SEGMENTS)
    while ours[-1] == QUIET:
        ours.pop()
    lines = HOMED + ["AXIS1:LIM:HARD:POL HIGH;STAT ON;:AXIS1:BACK:PREL POS;*OPC?", f"@{PAUSE_MS}", move + ";*OPC?", f"@{PAUSE_MS}", back + ";*OPC?"]
    played, _ = reference_words(host_sim, "paper", "\n".join(lines), tmp_path)
    theirs = moves(played, PAUSE_SEGMENTS)
    # a preload steps only if something has to be taken up
    theirs = theirs[-2]
    assert 0 < len(ours) < len(theirs), "it was stopped on the way"
    assert first_difference(ours, theirs[:len(ours)]) is None
    # counts
    at = counts(board)
    whole = steps_of(stream_words(board))
    assert at == whole and at[0] < 40 * 20
    # the next move ends where host-sim's does
    arm_again(board)
    assert ask(board, back + ";*OPC?", 10_000_000) == "1"
    assert errors(board) == []
    assert counts(board) == steps_of(stream_words(board)) == steps_of(played)
    assert [float(x) for x in ask(board, "POSE?").split(",")] == pytest.approx([0] * 6, abs=0.06)
    figure(f"{stop.__name__.replace('_', ' ')}: {len(ours)} words up to the stop are host-sim's, counts {at} exact, next move exact")
