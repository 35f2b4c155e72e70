"""USB: what a PC finds at the micro-AB socket, and the serial port there; at speed, full, abandoned, with the motors on."""

import struct

import pytest

from cdc import GET_LINE_CODING, CdcPort
from lab import (NO_ERROR, SEGMENT, Follower, as_block, ask, calibrate, enable_all, errors, errors_of, figure, first_difference, moves,
                 power_up, reference_words, start_moving, stop_by_exclamation_mark, stream_words)
from stm32f4 import Timeout
from stm32f4.usb_host import (CLASS, CLEAR_FEATURE, CONFIGURATION_DESCRIPTOR, DEVICE, DEVICE_DESCRIPTOR, ENDPOINT, ENDPOINT_HALT,
                              GET_CONFIGURATION, GET_STATUS, IN, INTERFACE, SET_CONFIGURATION, SET_FEATURE, STANDARD,
                              STRING_DESCRIPTOR, NoAnswer, Stall, UsbHost, descriptors)

PACKET = 64
# What the emulated chip has for a unique id: 0x30 to 0x3B (board.py), in hexadecimal.
UNIQUE_ID = "303132333435363738393A3B"
IDENTITY = "Stage Controller"


@pytest.fixture
def port(host):
    return CdcPort(host).open()


def replug(host):
    """Out for 50 ms and in again; answers the port, opened."""
    host.unplug()
    host.board.run(50_000)
    host.plug()
    return CdcPort(host.enumerate()).open()


# ---- enumeration ----

def device_descriptor():
    """USB 2.0, table 9-8."""
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        18, 1,  # bLength, bDescriptorType
        0x0210,  # bcdUSB: 2.1 has a BOS
        0xEF, 2, 1,  # bDeviceClass, SubClass, Protocol: functions are told by interface associations
        64,  # bMaxPacketSize0
        0x1209, 0x0001,  # idVendor, idProduct
        0x0010,  # bcdDevice
        1, 2, 3,  # iManufacturer, iProduct, iSerialNumber
        1)  # bNumConfigurations


def endpoint_descriptor(address, attributes, packet, interval):
    """USB 2.0, table 9-13."""
    return struct.pack("<BBBBHB", 7, 5, address, attributes, packet, interval)


def interface_descriptor(number, endpoints, *kind):
    """USB 2.0, table 9-12: bAlternateSetting and iInterface are 0."""
    return struct.pack("<BBBBBBBBB", 9, 4, number, 0, endpoints, *kind, 0)


def instrument(output, answers, notices):
    """The function of the instrument, its endpoints at these addresses: an interface association (ECN) of one interface, then
    application specific, test and measurement, USB488 (USBTMC, table 43; USB488, tables 10 and 11)."""
    return (
        bytes([8, 11, 0, 1, 0xFE, 3, 1, 0])
        + interface_descriptor(0, 3, 0xFE, 3, 1)
        + endpoint_descriptor(output, 2, 64, 0)
        + endpoint_descriptor(answers, 2, 64, 0)
        + endpoint_descriptor(notices, 3, 2, 1))


def serial_port(notices, output, answers):
    """The function of the serial port, its endpoints at these addresses. It begins with an interface association (ECN): first
    interface, two of them, class, subclass, protocol, iFunction."""
    return (
        bytes([8, 11, 1, 2, 0x02, 0x02, 0, 0])
        + interface_descriptor(1, 1, 0x02, 0x02, 0)
        + bytes([5, 0x24, 0x00, 0x10, 0x01])  # header functional descriptor: bcdCDC 1.10 (CDC 1.2, 5.2.3.1)
        + bytes([4, 0x24, 0x02, 0x02])  # abstract control: line coding and line state (PSTN 1.2, 5.3.2)
        + bytes([5, 0x24, 0x06, 1, 2])  # union: control interface 1, data interface 2 (CDC 1.2, 5.2.3.2)
        + endpoint_descriptor(notices, 3, 8, 255)
        + interface_descriptor(2, 2, 0x0A, 0, 0)
        + endpoint_descriptor(output, 2, 64, 0)
        + endpoint_descriptor(answers, 2, 64, 0))


def test_the_device_descriptor_is_that_of_a_composite_device(host):
    assert host.device == device_descriptor()


def test_the_configuration_is_an_instrument_and_a_serial_port_and_its_counts_are_true(host):
    whole = host.configuration
    kind, total, interfaces, value, name, attributes, power = struct.unpack_from("<xBHBBBBB", whole)
    assert (kind, total, value, name) == (2, len(whole), 1, 0)
    assert attributes == 0x80 and power == 50, "fed by the bus: 100 mA"
    ends = [host.interfaces()[n][3] for n in (0, 1, 2)]
    assert [[bool(end & IN) for end in of] for of in ends] == [[False, True, True], [True], [False, True]]
    # the instrument first: pyvisa-py detaches the driver of Linux from interface 0
    assert whole[9:] == instrument(*ends[0]) + serial_port(*ends[1], *ends[2])
    parts = descriptors(whole)
    assert interfaces == sum(part[1] == 4 for part in parts) == len(host.interfaces())
    ends = [part[2] for part in parts if part[1] == 5]
    assert sum(part[4] for part in parts if part[1] == 4) == len(ends) == len(set(ends))
    associated = [n for part in parts if part[1] == 11 for n in range(part[2], part[2] + part[3])]
    assert associated == sorted(host.interfaces()), "every interface belongs to one function"


def test_a_descriptor_asked_for_in_part_is_cut_and_an_exact_multiple_of_64_is_not_waited_for(host):
    whole = host.configuration
    for length in (1, 8, 9, 63, 64, 65, len(whole)):
        assert host.descriptor(CONFIGURATION_DESCRIPTOR, length=length) == whole[:length]
    assert host.descriptor(CONFIGURATION_DESCRIPTOR, length=len(whole) + 200) == whole


def test_the_serial_number_is_the_unique_id_of_the_chip(host):
    assert host.strings == {"manufacturer": "Stage Controller", "product": "SC6", "serial": UNIQUE_ID}
    assert host.descriptor(STRING_DESCRIPTOR, 0) == bytes([4, 3, 0x09, 0x04]), "English alone"


def test_a_request_that_it_does_not_know_is_refused_and_the_next_one_served(host):
    refused = [
        lambda: host.descriptor(STRING_DESCRIPTOR, 77, 0x0409),
        lambda: host.descriptor(0x22),
        lambda: host.control_in(0xC0, 0x77, 0, 0, 8),
        lambda: host.control_out(0x40, 0x77, 0, 0, b"abc"),
        lambda: host.control_out(CLASS | INTERFACE, 0x77, 0, 0),
        lambda: host.control_out(STANDARD | DEVICE, SET_CONFIGURATION, 9, 0),
    ]
    for request in refused:
        with pytest.raises(Stall):
            request()
        assert host.descriptor(DEVICE_DESCRIPTOR, length=18) == host.device
    assert host.control_in(STANDARD | DEVICE, GET_STATUS, 0, 0, 2) == b"\0\0"
    assert host.control_in(STANDARD | DEVICE, GET_CONFIGURATION, 0, 0, 1) == b"\1"


def test_without_the_crystal_there_is_no_device_and_the_serial_port_works(firmware):
    board = power_up(firmware, crystal="dead")
    host = UsbHost(board)
    host.plug()
    with pytest.raises(Timeout, match="a device at the plug"):
        host.enumerate()
    assert ask(board, "*IDN?").startswith(IDENTITY)
    assert board.bus.warnings == []


def test_a_crystal_that_dies_takes_the_device_away(board, host, port):
    assert port.ask("*IDN?").startswith(IDENTITY)
    board.kill_crystal()
    board.run(500_000)
    assert not host.attached
    assert ask(board, "*IDN?").startswith(IDENTITY)


# ---- the serial port ----

def test_the_port_keeps_the_line_coding_that_it_is_given(host, port):
    coding = host.control_in(CLASS | INTERFACE, GET_LINE_CODING, 0, port.control, 7)
    assert coding == struct.pack("<IBBB", 115_200, 0, 0, 8)


def test_the_controller_answers_over_usb_as_over_the_serial_port(board, port):
    for question in ("*IDN?", "POSE?", "SYST:ERR?", "AXIS1:POS?;VEL?"):
        assert port.ask(question) == ask(board, question)


def test_a_program_that_never_opens_the_port_is_heard_all_the_same(host):
    port = CdcPort(host)
    host.bulk_out(port.output, b"*IDN?\n")
    assert host.bulk_in(port.input, 1000).decode().startswith(IDENTITY)


@pytest.mark.parametrize("size", [63, 64, 65, 127, 128, 129, 192, 512])
def test_a_message_of_any_number_of_packets_is_one_message(port, size):
    text = "*IDN?"
    assert port.ask(text.rjust(size - 1)).startswith(IDENTITY)
    assert errors_of(port) == []


def test_no_answer_ends_with_a_full_packet_however_long_it_is(host, port):
    ended_empty = 0
    for count in range(1, 70):
        port.packets.clear()
        answer = port.ask("*ESE?" + ";*ESE?" * (count - 1))
        port.board.run(2000)
        assert answer == ";".join(["0"] * count)
        assert sum(port.packets) == 2 * count
        assert port.packets[-1] < PACKET, f"{2 * count} bytes came as {port.packets}: the PC waits for more"
        ended_empty += port.packets[-1] == 0
    assert ended_empty, "no answer filled its last packet"


def test_a_flood_is_held_back_and_loses_nothing(host):
    port = CdcPort(host).open(read=False)
    text = "".join(f"*ESE {n % 256};*ESE?\n" for n in range(600)).encode()
    sent = host.start_out(port.output, text)
    host.board.run(200_000)
    assert not sent.done and host.pipes[port.output].naks, "nobody reads: the device takes no more"
    stuck = len(sent.packets)
    host.board.run(100_000)
    assert len(sent.packets) == stuck
    answers = bytearray()
    host.start_in(port.input, on_packet=answers.extend, forever=True)
    host.board.run_until(lambda: answers.count(b"\n") == 600, 2_000_000, "all answers")
    assert sent.done
    assert [int(line) for line in answers.split()] == [n % 256 for n in range(600)]
    assert host.retransmitted == 0


def test_what_is_sent_while_flash_is_written_waits_at_the_pc(board, host, port):
    # a hundred words and more: a tenth of a second
    board.flash.program_us = 1000
    port.write("*SAV\n")
    board.run(3000)
    sent = host.start_out(port.output, "".join(f"*ESE {n};*ESE?\n" for n in range(200)).encode())
    board.run(30_000)
    stuck = len(sent.packets)
    board.run(20_000)
    assert not sent.done and len(sent.packets) == stuck, "the processor stands: the device says NAK"
    board.run_until(lambda: port.came.count(b"\n") == 200, 2_000_000, "all answers")
    assert [int(line) for line in port.came.split()] == list(range(200))
    port.came.clear()
    assert errors_of(port) == []


def test_a_calibration_goes_over_usb_there_and_back(board, port, host_sim, tmp_path):
    block = calibrate(host_sim, "paper", tmp_path / "paper.cal")
    assert len(block) > 2 * PACKET
    port.write(b"COMP:LOAD " + as_block(block) + b"\n")
    assert port.ask("COMP:STAT?;:SYST:ERR?") == "1;" + NO_ERROR
    port.write("COMP:DATA?\n")
    whole = as_block(block)
    board.run_until(lambda: len(port.came) > len(whole), 1_000_000, "the block")
    assert bytes(port.came) == whole + b"\n"


def test_two_links_have_answers_and_errors_of_their_own(board, port):
    port.write("".join(f"*ESE {n};*ESE?\n" for n in range(100)))
    board.serial.write("".join(f"*SRE {n};*SRE?\n" for n in range(60)))
    board.run(200_000)
    assert [int(line) for line in port.came.split()] == list(range(100))
    assert [int(line) for line in board.serial.read().split()] == list(range(60))
    port.came.clear()
    port.write("NONSENSE\n")
    assert ask(board, "*IDN?").startswith(IDENTITY) and errors(board) == []
    assert errors_of(port) == [-113]


# ---- closed, unplugged, reset, asleep ----

def test_closing_in_mid_line_leaves_nothing_behind(board, port):
    port.write("AXIS1:MO")
    board.run(3000)
    port.close()
    board.run(3000)
    port.open()
    assert port.ask("*IDN?").startswith(IDENTITY)
    assert errors_of(port) == []


def test_unplugged_while_nothing_is_said_it_works_when_plugged_in_again(host, port):
    for _ in range(3):
        assert port.ask("*IDN?").startswith(IDENTITY)
        port = replug(host)
    assert port.ask("*IDN?").startswith(IDENTITY)
    assert errors_of(port) == []


def test_a_bus_reset_in_mid_line_costs_that_line_only(board, host, port):
    port.write("AXIS1:MO")
    board.run(3000)
    host.reset()
    port = CdcPort(host.enumerate()).open()
    assert port.ask("*IDN?").startswith(IDENTITY)
    assert errors_of(port) == []


def test_a_suspended_bus_goes_on_where_it_was(board, host, port):
    port.write("*ID")
    host.suspend()
    assert board.otg.suspended
    board.run(50_000)
    host.resume()
    assert port.ask("N?").startswith(IDENTITY)


def test_a_reset_of_the_chip_takes_the_device_from_the_bus_and_brings_it_back(board, host, port):
    assert port.ask("*IDN?").startswith(IDENTITY)
    board.reset()
    assert not host.attached
    with pytest.raises(NoAnswer):
        host.descriptor(DEVICE_DESCRIPTOR)
    board.run_until(lambda: host.attached, 500_000, "the device again")
    assert CdcPort(host.enumerate()).open().ask("*IDN?").startswith(IDENTITY)


# ---- motors ----

def test_moves_over_usb_play_the_words_that_host_sim_plays(board, port, host_sim, tmp_path):
    homed = [f"AXIS{n}:POS:SET 0;:AXIS{n}:ENAB ON" for n in range(1, 7)]
    path = ["AXIS1:MOVE 12", "POSE 8,-6,4,0.02,-0.015,0.01", "AXIS1:MOVE 3"]
    port.write(b"COMP:LOAD " + as_block(calibrate(host_sim, "paper", tmp_path / "paper.cal")) + b"\n")
    for line in homed:
        port.write(line + "\n")
    assert port.ask("SYST:ERR:ALL?") == NO_ERROR
    start = board.played() // SEGMENT * SEGMENT
    for line in path:
        assert port.ask(line + ";*OPC?", 10_000_000) == "1"
        board.run(40_000)
    script = "\n".join(homed + [f"{line};*OPC?\n@40" for line in path])
    theirs, _ = reference_words(host_sim, "paper", script, tmp_path)
    ours, theirs = moves(stream_words(board, start), 100), moves(theirs, 100)
    assert len(ours) == len(theirs) == len(path)
    for n, (a, b) in enumerate(zip(ours, theirs)):
        assert first_difference(a, b) is None, f"move {n + 1}"


def test_six_axes_move_undisturbed_while_usb_is_asked_a_thousand_times_a_second(board, port):
    enable_all(board)
    follower = start_moving(board, "POSE 1500,-1400,1300,1.2,-1.1,1.3", steps=100)
    before, start, longest = list(follower.counts), board.now_us, 0
    for n in range(200):
        asked = board.now_us
        port.write(f"AXIS{n % 6 + 1}:POS?\n")
        board.run_until(lambda: b"\n" in port.came, 50_000, f"answer {n}", step_us=20)
        float(port.read_line())
        longest = max(longest, board.now_us - asked)
    rate = 200e6 / (board.now_us - start)
    follower.look()
    assert all(steps != old for steps, old in zip(follower.counts, before)), "six motors moved meanwhile"
    assert len(board.words.runs) == 1, "the stream of words had no gap"
    assert errors_of(port) == []
    figure(f"queries one after the other over USB while six axes move: {rate:.0f} a second, the slowest took {longest:.0f} us")
    assert rate >= 1000


def test_an_exclamation_mark_stops_a_move_even_while_the_link_waits(board, port):
    stop_by_exclamation_mark(board, port, "AXIS1:MOVE 800;*WAI;:AXIS1:MOVE 0\n")
    assert errors_of(port) == []


@pytest.mark.parametrize("what", ["unplug", "reset", "suspend"])
def test_a_move_goes_on_whatever_happens_to_the_bus(board, host, port, what):
    enable_all(board)
    follower = Follower(board)
    port.write("AXIS1:VEL 100;MOVE 20\n")
    board.run_until(lambda: follower.look()[0] >= 20, 2_000_000, "20 steps", step_us=500)
    getattr(host, what)()
    assert ask(board, "*OPC?", 5_000_000) == "1"
    assert follower.look()[0] == 400
    assert len(board.words.runs) == 1, "the stream of words had no gap"


# ---- what a host may do at any time, USB 2.0 says ----


def test_unplugged_in_the_middle_of_an_answer_the_next_one_hears_his_own(board, host):
    port = CdcPort(host).open(read=False)
    port.write("*IDN?;" * 40 + "\n")
    assert host.bulk_in(port.input, PACKET).startswith(IDENTITY.encode())
    port = replug(host)
    assert port.ask("*ESE 17;*ESE?") == "17"
    assert errors_of(port) == []


def test_closed_in_the_middle_of_an_answer_the_next_one_hears_his_own(board, host):
    port = CdcPort(host).open(read=False)
    port.write("*IDN?;" * 40 + "\n")
    assert host.bulk_in(port.input, PACKET).startswith(IDENTITY.encode())
    port.close()
    board.run(20_000)
    port.open()
    assert port.ask("*ESE 17;*ESE?") == "17"
    assert errors_of(port) == []


@pytest.mark.parametrize("how", ["close", "reset"])
def test_what_the_device_had_no_room_for_is_not_heard_as_the_next_ones(board, host, how):
    port = CdcPort(host).open(read=False)
    sent = host.start_out(port.output, b"*IDN?;NONSENSE\n" * 200)
    board.run(200_000)
    assert not sent.done, "nobody reads: packets wait at the endpoint"
    host.cancel(sent)
    if how == "close":
        port.close()
    else:
        host.reset()
        port = CdcPort(host.enumerate())
    port.open()
    assert port.ask("*ESE 17;*ESE?") == "17"
    assert errors_of(port) == []


def test_a_packet_in_the_moment_of_a_reset_is_not_kept_for_the_next_one(host, port):
    port.write("NONSENSE")
    host.reset()
    port = CdcPort(host.enumerate()).open()
    assert port.ask("*IDN?").startswith(IDENTITY)
    assert errors_of(port) == []


@pytest.mark.parametrize("packets", [1, 2])
def test_configured_again_both_sides_begin_with_data0(host, port, packets):
    for _ in range(packets):
        assert port.ask("*IDN?").startswith(IDENTITY)
    host.cancel(port.reader)
    host.configure()
    assert CdcPort(host).open().ask("*IDN?").startswith(IDENTITY)
    assert host.retransmitted == 0


@pytest.mark.parametrize("packets", [1, 2])
@pytest.mark.parametrize("end", ["output", "input"])
def test_a_halt_is_cleared_and_both_sides_begin_with_data0(host, port, packets, end):
    for _ in range(packets):
        assert port.ask("*IDN?").startswith(IDENTITY)
    host.cancel(port.reader)
    address = getattr(port, end)
    host.control_out(STANDARD | ENDPOINT, SET_FEATURE, ENDPOINT_HALT, address)
    assert host.halted(address)
    with pytest.raises(Stall):
        host.bulk_in(address, PACKET) if address & IN else host.bulk_out(address, b"*IDN?\n")
    host.clear_halt(address)
    assert not host.halted(address)
    assert port.open().ask("*IDN?").startswith(IDENTITY)
    assert host.retransmitted == 0


@pytest.mark.parametrize("end", [0x05, 0x85, 0x0F, 0x8F])
def test_a_request_that_names_an_endpoint_which_is_not_there_does_no_harm(board, host, port, end):
    requests = [
        lambda: host.halted(end),
        lambda: host.control_out(STANDARD | ENDPOINT, SET_FEATURE, ENDPOINT_HALT, end),
        lambda: host.control_out(STANDARD | ENDPOINT, CLEAR_FEATURE, ENDPOINT_HALT, end),
    ]
    for request in requests:
        try:
            request()
        except Stall:
            pass
    assert port.ask("*IDN?").startswith(IDENTITY)
    assert len(board.resets) == 1, "power on"


def begin_of_a_control_read(kind, length):
    """SETUP of a GET_DESCRIPTOR and the first packet; the host loses interest then."""
    yield "SETUP", 0, struct.pack("<BBHHH", 0x80, 6, kind << 8, 0, length)
    return (yield "IN", 1, b"")


def test_a_control_read_given_up_by_the_host_gives_way_to_the_next_request(host):
    host.wait(host.submit(0, begin_of_a_control_read(CONFIGURATION_DESCRIPTOR, 255)))
    assert host.descriptor(DEVICE_DESCRIPTOR, length=18, timeout_us=600_000) == host.device


def test_unplugged_in_the_middle_of_a_control_read_it_is_there_when_plugged_in_again(host):
    host.wait(host.submit(0, begin_of_a_control_read(CONFIGURATION_DESCRIPTOR, 255)))
    assert replug(host).ask("*IDN?").startswith(IDENTITY)


def test_deconfigured_and_configured_again_it_answers(host, port):
    assert port.ask("*IDN?").startswith(IDENTITY)
    host.cancel(port.reader)
    host.control_out(STANDARD | DEVICE, SET_CONFIGURATION, 0, 0)
    with pytest.raises(NoAnswer):
        host.bulk_in(port.input, PACKET)
    host.configure()
    assert CdcPort(host).open().ask("*IDN?").startswith(IDENTITY)
