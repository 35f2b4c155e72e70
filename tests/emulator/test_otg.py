"""The model of the USB core by its registers: a bare device made by hand, and what the core could not do is refused."""

import struct

import pytest

from stm32f4.usb_host import NoAnswer, Stall, UsbHost
from test_emulator import board as bare_board
from test_emulator import full_speed

GPIOA = 0x4002_0000
GAHBCFG, GRSTCTL, GINTSTS, GINTMSK, GRXSTSP, GRXFSIZ, DIEPTXF0, DIEPTXF1, GCCFG = 8, 0x10, 0x14, 0x18, 0x20, 0x24, 0x28, 0x104, 0x38
DCFG, DCTL, DIEPMSK, DOEPMSK, DAINT, DAINTMSK, DIEPEMPMSK = 0x800, 0x804, 0x810, 0x814, 0x818, 0x81C, 0x834
DIEPCTL1, DIEPINT1, DIEPTSIZ1, DTXFSTS1, DOEPCTL0, DOEPCTL1, DOEPINT0, DOEPTSIZ0, DOEPTSIZ1 = (
    0x920, 0x928, 0x930, 0x938, 0xB00, 0xB20, 0xB08, 0xB10, 0xB30)
USBAEP, BULK, STALL, CNAK, SNAK, SD0PID, EPDIS, EPENA = 1 << 15, 2 << 18, 1 << 21, 1 << 26, 1 << 27, 1 << 28, 1 << 30, 1 << 31
RXFLVL, USBSUSP, USBRST, ENUMDNE, IEPINT = 1 << 4, 1 << 11, 1 << 12, 1 << 13, 1 << 18
FIFO0, FIFO1 = 0x1000, 0x2000
IRQ = 67


@pytest.fixture
def host():
    """A device with one bulk endpoint of 64 bytes each way, set up by hand: no program serves it."""
    board = bare_board()
    full_speed(board)
    board.bus.store(GPIOA, 0xA800_0000 | 0b1010 << 22)
    board.bus.store(GPIOA + 0x24, 0xAA << 12)
    write = board.otg.write
    write(GCCFG, 1 << 16 | 1 << 21)
    write(DCTL, 0)
    write(GAHBCFG, 1)
    host = UsbHost(board)
    host.plug()
    host.reset()
    write(GRXFSIZ, 64)
    write(DIEPTXF0, 16 << 16 | 64)
    write(DIEPTXF1, 16 << 16 | 80)
    write(GRSTCTL, 0x10 << 6 | 3 << 4)
    write(DIEPCTL1, USBAEP | BULK | SD0PID | SNAK | 1 << 22 | 64)
    write(DOEPCTL1, USBAEP | BULK | SD0PID | SNAK | 64)
    return host


@pytest.fixture
def otg(host):
    return host.otg


def load(otg, data, packets=1):
    """What a driver does to send."""
    otg.write(DIEPTSIZ1, packets << 19 | len(data))
    otg.write(DIEPCTL1, otg.read(DIEPCTL1) | CNAK | EPENA)
    for at in range(0, len(data), 4):
        otg.write(FIFO1, int.from_bytes(data[at:at + 4], "little"))


def receive(otg, packets=1):
    """What a driver does to be sent something."""
    otg.write(DOEPTSIZ1, packets << 19 | 64 * packets)
    otg.write(DOEPCTL1, otg.read(DOEPCTL1) | CNAK | EPENA)


def take(otg):
    """One packet from the receive FIFO: (PKTSTS, endpoint, bytes)."""
    status = otg.read(GRXSTSP)
    count = status >> 4 & 0x7FF
    data = b"".join(otg.read(FIFO0).to_bytes(4, "little") for _ in range(-(-count // 4)))
    return status >> 17 & 15, status & 15, data[:count]


def test_a_packet_goes_to_the_host_and_one_comes(host, otg):
    load(otg, b"hello")
    assert host.bulk_in(0x81, 64) == b"hello"
    assert otg.read(DIEPINT1) & 1, "transfer completed"
    assert not otg.read(DIEPCTL1) & EPENA
    receive(otg)
    host.bulk_out(0x01, b"world!")
    assert otg.read(GINTSTS) & RXFLVL
    assert take(otg) == (2, 1, b"world!")
    assert take(otg) == (3, 1, b""), "transfer completed"
    assert not otg.read(GINTSTS) & RXFLVL


def test_without_a_driver_every_token_is_answered_with_nak(host, otg):
    sent, wanted = host.start_out(0x01, b"x"), host.start_in(0x81, 64)
    host.board.run(1000)
    assert not sent.done and not wanted.done
    receive(otg)
    load(otg, b"y")
    assert (host.wait(sent, 1000), host.wait(wanted, 1000)) == (None, b"y")
    assert host.pipes[0x01].naks and host.pipes[0x81].naks


def test_a_full_receive_fifo_answers_nak_until_it_is_read(host, otg):
    receive(otg, packets=6)
    sent = host.start_out(0x01, bytes(range(256)) + bytes(128))
    host.board.run(5000)
    assert len(sent.packets) == 3, "17 words each leave no room for a fourth in 64"
    assert take(otg)[2] == bytes(range(64))
    host.board.run(1000)
    assert len(sent.packets) == 4


def test_the_receive_fifo_gives_no_more_than_came(host, otg):
    with pytest.raises(AssertionError, match="receive FIFO is empty"):
        otg.read(GRXSTSP)
    receive(otg)
    host.bulk_out(0x01, b"12345678")
    otg.read(GRXSTSP)
    with pytest.raises(AssertionError, match="2 words of the last packet left"):
        otg.read(GRXSTSP)
    otg.read(FIFO0), otg.read(FIFO0)
    with pytest.raises(AssertionError, match="beyond the packet"):
        otg.read(FIFO0)


def test_a_transmit_fifo_takes_no_more_than_its_transfer_and_its_room(otg):
    with pytest.raises(AssertionError, match="before its endpoint was enabled"):
        otg.write(FIFO1, 0)
    with pytest.raises(AssertionError, match="beyond the 5 bytes"):
        load(otg, b"hello")
        otg.write(FIFO1, 0)
    otg.write(DIEPCTL1, otg.read(DIEPCTL1) | SNAK | EPDIS)
    otg.write(GRSTCTL, 1 << 6 | 1 << 5)
    assert otg.read(DTXFSTS1) == 16
    with pytest.raises(AssertionError, match="FIFO 1 of 16 words was written beyond its room"):
        load(otg, bytes(128), packets=2)


def test_a_packet_is_no_larger_than_its_endpoint_takes(otg):
    with pytest.raises(AssertionError, match="65 bytes in 1 packets of 64"):
        load(otg, bytes(65))
    with pytest.raises(AssertionError, match="PKTCNT 0"):
        load(otg, b"x", packets=0)
    with pytest.raises(AssertionError, match="packets of 128 bytes"):
        otg.write(DIEPCTL1, 0)
        otg.write(DIEPCTL1, USBAEP | BULK | 1 << 22 | 128)


@pytest.mark.parametrize("receive_words, at, words, why", [
    (64, 60, 16, "overlap"), (64, 80, 8, "16 at least"), (250, 310, 16, "FIFOs of 326 words in a RAM of 320"), (8, 80, 16, "16 to 256")])
def test_fifos_lie_beside_each_other_in_their_ram(otg, receive_words, at, words, why):
    otg.write(DIEPCTL1, 0)
    otg.write(GRXFSIZ, receive_words)
    otg.write(DIEPTXF0, 16 << 16 | receive_words)
    otg.write(DIEPTXF1, words << 16 | at)
    with pytest.raises(AssertionError, match=why):
        otg.write(DIEPCTL1, USBAEP | BULK | 1 << 22 | 64)


def test_there_is_no_endpoint_4(host, otg):
    with pytest.raises(NoAnswer):
        host.bulk_in(0x84, 64)
    for offset in (0x980, 0xB80):
        with pytest.raises(AssertionError, match="endpoint 4"):
            otg.read(offset)
    with pytest.raises(AssertionError, match="FIFO 4"):
        otg.write(0x5000, 0)


def test_data0_and_data1_take_turns_and_a_repeated_packet_is_dropped(host, otg):
    receive(otg, packets=2)
    host.bulk_out(0x01, b"one")
    take(otg), take(otg)
    host.pipes[0x01].toggle = 0
    receive(otg)
    host.bulk_out(0x01, b"one again")
    assert not otg.read(GINTSTS) & RXFLVL, "acknowledged, and dropped"
    otg.write(DOEPCTL1, otg.read(DOEPCTL1) | SD0PID)
    host.pipes[0x01].toggle = 0
    host.bulk_out(0x01, b"two")
    assert take(otg)[2] == b"two"


def test_a_stalled_endpoint_answers_stall_until_the_driver_relents(host, otg):
    load(otg, b"x")
    otg.write(DIEPCTL1, otg.read(DIEPCTL1) | STALL)
    with pytest.raises(Stall):
        host.bulk_in(0x81, 64)
    otg.write(DIEPCTL1, otg.read(DIEPCTL1) & ~STALL)
    assert host.bulk_in(0x81, 64) == b"x"


def test_a_setup_packet_is_taken_in_spite_of_stall_and_nak_and_sets_both_right(host, otg):
    otg.write(DOEPTSIZ0, 3 << 29)
    otg.write(DOEPCTL0, STALL | SNAK)
    request = struct.pack("<BBHHH", 0x80, 6, 0x100, 0, 18)
    asked = host.submit(0, host._control(request, 18, None))
    host.board.run(1000)
    assert not asked.done, "NAK in the data stage"
    assert take(otg) == (6, 0, request)
    assert take(otg) == (4, 0, b""), "the stage of SETUP ended with the first IN token"
    assert otg.read(DOEPINT0) & 8 and otg.read(DOEPTSIZ0) >> 29 == 2
    assert not otg.read(DOEPCTL0) & STALL


def test_a_bus_reset_makes_endpoints_inactive_and_leaves_a_waiting_packet_enabled(host, otg):
    load(otg, b"x")
    host.reset()
    assert otg.read(GINTSTS) & (USBRST | ENUMDNE) == USBRST | ENUMDNE
    assert otg.read(DIEPCTL1) & (USBAEP | EPENA) == EPENA
    with pytest.raises(NoAnswer):
        host.bulk_in(0x81, 64)


def test_an_address_counts_from_the_end_of_the_status_stage_on(host, otg):
    def no_data_stage():
        yield "SETUP", 0, struct.pack("<BBHHH", 0, 5, 7, 0, 0)
        return (yield "IN", 1, b"")
    asked = host.submit(0, no_data_stage())
    host.board.run(1000)
    take(otg), take(otg)
    otg.write(DCFG, 7 << 4)
    otg.write(0x910, 1 << 19)
    otg.write(0x900, otg.read(0x900) | CNAK | EPENA)
    assert host.wait(asked, 1000) == b"", "the status stage still goes to address 0"
    load(otg, b"x")
    with pytest.raises(NoAnswer):
        host.bulk_in(0x81, 64)
    host.address = 7
    assert host.bulk_in(0x81, 64) == b"x"


def test_an_idle_bus_is_suspended_after_3_ms_and_wakes_up_again(host, otg):
    host.suspend(2900)
    assert not otg.read(GINTSTS) & USBSUSP
    host.board.run(200)
    assert otg.read(GINTSTS) & USBSUSP
    host.resume()
    assert otg.read(GINTSTS) >> 31


def test_the_interrupt_line_follows_the_masks_of_core_and_endpoints(host, otg):
    line = lambda: bool(host.board.nvic.lines >> IRQ & 1)
    load(otg, b"x")
    host.bulk_in(0x81, 64)
    assert not line()
    otg.write(DIEPMSK, 1)
    assert otg.read(DAINT) == 2 and not line()
    otg.write(DAINTMSK, 2)
    assert otg.read(GINTSTS) & IEPINT and not line()
    otg.write(GINTMSK, IEPINT)
    assert line()
    otg.write(DIEPINT1, 1)
    assert not line()
    # an empty FIFO, where it is asked for
    otg.write(DIEPEMPMSK, 2)
    assert line()


def test_without_48_mhz_there_is_no_device(host):
    board = host.board
    assert host.attached
    board.kill_crystal()
    board.run(100)
    assert not host.attached
    with pytest.raises(NoAnswer):
        host.bulk_in(0x81, 64)
