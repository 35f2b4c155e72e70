"""Where the tests find the firmware."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def firmware():
    """The ELF that is flashed: FIRMWARE_ELF, as tests/run.sh sets it."""
    path = os.environ.get("FIRMWARE_ELF")
    if not path:
        pytest.skip("FIRMWARE_ELF names no file: build it with `cargo fw` and set it")
    assert Path(path).is_file(), f"FIRMWARE_ELF={path}: there is no such file"
    return path
