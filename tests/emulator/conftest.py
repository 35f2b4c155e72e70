"""Where the tests find the firmware and the virtual controller."""

import os
import sys
from pathlib import Path

import pytest

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
