"""An STM32F407VG in which the unmodified firmware runs, for tests: no board, exact and repeatable time."""

from .board import Board, Timeout
from .flash import PowerCut
from .image import Image

__all__ = ["Board", "Image", "PowerCut", "Timeout"]
