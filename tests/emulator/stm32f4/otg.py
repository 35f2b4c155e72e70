"""USB OTG FS with nothing plugged in: enough for a driver to start and to wait."""

from .bus import Peripheral

_GRSTCTL, _GINTSTS, _GCCFG, _CID = 0x10, 0x14, 0x38, 0x3C


class OtgFs(Peripheral):
    """Resets and flushes end at once; no interrupt ever comes."""

    clock = (0x34, 7)
    size = 0x4_0000

    def __init__(self, board):
        super().__init__(board, "OTG_FS", 0x5000_0000)

    def read(self, offset):
        if offset == _GRSTCTL:
            return 1 << 31
        if offset == _GINTSTS:
            return 0x0400_0020  # device mode, non-periodic FIFO empty
        if offset == _CID:
            return 0x0000_1200
        if 0x900 <= offset < 0xA00 and offset & 0x1F == 0x18:
            return 0x10  # DTXFSTS: room in the FIFO
        return self.regs.get(offset, 0)

    def write(self, offset, value):
        # EPENA and EPDIS of an endpoint that nobody serves fall back at once.
        if 0x900 <= offset < 0xD00 and offset & 0x1F == 0:
            value &= ~(3 << 30)
        self.regs[offset] = value
