"""What the client tests ask of a link."""
import time


def pose(link):
    """The six logical coordinates, um and deg."""
    return [float(number) for number in link.query("POSE?").split(",")]


def errors(link):
    """Numbers of the queued errors; takes them."""
    return [int(text.split(",")[0]) for text in all_errors(link) if text]


def all_errors(link):
    """The queued errors as text, oldest first; takes them."""
    found = []
    while not (text := link.query("SYST:ERR?")).startswith("0,"):
        found.append(text)
    return found


def moving(link):
    """Bit 8 of the operation conditions."""
    return int(link.query("STAT:OPER:COND?")) & 256 != 0


def wait_until(condition, seconds=5.0):
    """Polls a condition; says whether it came true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return False


def as_block(data):
    """An IEEE 488.2 definite block."""
    length = str(len(data)).encode()
    return b"#" + str(len(length)).encode() + length + data
