"""Where the tests find the firmware and the virtual controller."""

import os
import sys
from pathlib import Path

import pytest

CORE_HZ = 168_000_000

sys.path.insert(0, str(Path(__file__).parent))


def _program(variable, how):
    path = os.environ.get(variable)
    if not path:
        pytest.skip(f"{variable} names no file: build it with `{how}` and set it")
    assert Path(path).is_file(), f"{variable}={path}: there is no such file"
    return path


@pytest.fixture(scope="session")
def firmware():
    """The ELF that is flashed: FIRMWARE_ELF, as tests/run.sh sets it."""
    return _program("FIRMWARE_ELF", "cargo fw")


@pytest.fixture(scope="session")
def host_sim():
    """The virtual controller: HOST_SIM, as tests/run.sh sets it."""
    return _program("HOST_SIM", "cargo build --release -p host-sim")


@pytest.fixture
def board(firmware):
    """A board whose program runs; afterwards, what the program did must have been what the chip takes."""
    import lab

    board = lab.power_up(firmware)
    yield board
    assert board.bus.warnings == [], "the program did what the chip does not take"


@pytest.fixture
def host(board):
    """A PC at its USB that has just enumerated it."""
    from stm32f4.usb_host import UsbHost

    host = UsbHost(board)
    host.plug()
    return host.enumerate()


_worst = {"stack": 0, "critical": (0, 0, "")}


@pytest.fixture(autouse=True)
def _sum_up():
    """What is the worst over all tests: stack, critical sections, the refill's latency."""
    yield
    import lab

    for board in lab.BOARDS:
        _worst["stack"] = max(_worst["stack"], board.stack_used())
        if board.rcc.system_hz == CORE_HZ:  # they are counted in instructions
            _worst["critical"] = max(_worst["critical"], *board.longest_masked(), (0, 0, ""))
    lab.BOARDS.clear()


def pytest_sessionfinish(session):
    """One of several processes tells the one that sums up."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["worst"] = _worst


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    worst = getattr(node, "workeroutput", {}).get("worst", _worst)
    _worst["stack"] = max(_worst["stack"], worst["stack"])
    _worst["critical"] = max(_worst["critical"], tuple(worst["critical"]))


def pytest_terminal_summary(terminalreporter):
    if _worst["stack"]:
        us, _, where = _worst["critical"]
        name = where.split("17h")[0].strip("_")
        terminalreporter.write_line(f"figure: stack, the most in all tests: {_worst['stack']} of 65536 bytes")
        terminalreporter.write_line(f"figure: longest critical section in all tests: {us:.1f} us in {name[-60:]}")
