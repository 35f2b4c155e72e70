"""The instrument at the micro-AB socket: USBTMC with USB488, beside the serial port of the same device."""

import struct

import pytest

from cdc import CdcPort
from lab import (NO_ERROR, Follower, as_block, ask, calibrate, counts, enable_all, errors_of, figure, start_moving,
                 stop_by_exclamation_mark)
from stm32f4 import Timeout
from stm32f4.usb_host import CLASS, IN, INTERFACE, Stall, descriptors
from usbtmc import (CODES, DEV_DEP_MSG_IN, DEV_DEP_MSG_OUT, EOM, FAILED, NOT_IN_PROGRESS, READ_STATUS_BYTE, TERM_CHAR, TRIGGER,
                    Refused, Usbtmc, header)

PACKET = 64
IDENTITY = "Stage Controller"
# The status byte (IEEE 488.2, 11.2): errors, message available, event status, request for service.
ERRORS, MAV, ESB, RQS = 4, 16, 32, 64


@pytest.fixture
def instrument(host):
    return Usbtmc(host)


# ---- what it says of itself ----

def test_the_interface_is_a_test_instrument_of_usb488_with_three_endpoints(host, instrument):
    parts = descriptors(host.configuration)
    at = next(n for n, part in enumerate(parts) if part[1] == 4 and tuple(part[5:8]) == CODES)
    own, *ends = parts[at:at + 4]
    assert own[:2] + own[3:8] == bytes([9, 4, 0, 3, 0xFE, 0x03, 0x01]), "alternate 0, three endpoints, USB488"
    assert sorted(end[3:6] for end in ends) == [bytes([2, 64, 0])] * 2 + [bytes([3, 2, 0])], "two bulk ones, one for notifications"
    assert len({end[2] for end in ends}) == 3
    assert instrument.interrupt is not None


def test_the_capabilities_are_those_of_a_scpi_instrument_with_all_that_488_has(instrument):
    # USBTMC, table 37; USB488, table 8
    expected = struct.pack("<BxHBB6xHBB8x", 1, 0x0100, 0x00, 0x01, 0x0100, 0x07, 0x0F)
    assert instrument.capabilities() == expected


# ---- messages ----

def test_it_answers_as_over_the_serial_port(board, instrument):
    for question in ("*IDN?", "POSE?", "SYST:ERR?", "AXIS1:VEL?"):
        assert instrument.ask(question) == ask(board, question)


@pytest.mark.parametrize("zlp", [True, False])
def test_messages_of_every_length_around_a_packet_arrive_whole(host, zlp):
    instrument = Usbtmc(host, zlp)
    for size in [*range(44, 58), 116, 180, 500]:
        text = "*ESE?".rjust(size - 1)
        assert instrument.ask(text) == "0", size
    assert errors_of(instrument) == []


def test_answers_of_every_length_around_a_packet_arrive_whole(instrument):
    for count in [1, *range(20, 32), 52, 58, 84]:
        assert instrument.ask("*ESE?" + ";*ESE?" * (count - 1)) == ";".join(["0"] * count)


def test_a_message_in_three_transfers_is_one_message(instrument):
    for part, end in (("*ES", False), ("E 5;*E", False), ("SE?\n", True)):
        instrument.write(part, end)
    assert instrument.read() == b"5\n"


def test_the_end_of_the_transfer_ends_a_message_without_a_line_feed(instrument):
    instrument.write("*ESE 6;*ESE?")
    assert instrument.read() == b"6\n"


def test_an_answer_is_read_in_pieces_and_only_the_last_has_eom(instrument):
    instrument.write("*IDN?\n")
    whole, seen = b"", []
    while not seen or not seen[-1] & EOM:
        part, attributes = instrument.read_transfer(7)
        whole += part
        seen.append(attributes)
    assert whole.startswith(IDENTITY.encode()) and whole.endswith(b"\n")
    assert len(seen) == -(-len(whole) // 7) and not any(attributes & EOM for attributes in seen[:-1])


def test_a_read_ends_at_the_character_that_was_asked_for(instrument):
    instrument.write("POSE?\n")
    part, attributes = instrument.read_transfer(1000, term=ord(","))
    assert part == b"0.000," and attributes == TERM_CHAR
    assert instrument.read().count(b",") == 4


def test_a_calibration_goes_there_and_back(instrument, host_sim, tmp_path):
    block = as_block(calibrate(host_sim, "paper", tmp_path / "paper.cal"))
    instrument.write(b"COMP:LOAD " + block + b"\n")
    assert instrument.ask("COMP:STAT?") == "1"
    instrument.write("COMP:DATA?\n")
    assert instrument.read(1_000_000) == block + b"\n"
    assert errors_of(instrument) == []


def test_queries_are_answered_fast_enough_while_six_axes_move(board, instrument):
    enable_all(board)
    follower = start_moving(board, "POSE 1500,-1400,1300,1.2,-1.1,1.3", steps=100)
    before, start = list(follower.counts), board.now_us
    for n in range(100):
        float(instrument.ask(f"AXIS{n % 6 + 1}:POS?"))
    rate = 100e6 / (board.now_us - start)
    follower.look()
    assert all(steps != old for steps, old in zip(follower.counts, before)), "six motors moved meanwhile"
    assert len(board.words.runs) == 1, "the stream of words had no gap"
    figure(f"queries one after the other over USB488 while six axes move: {rate:.0f} a second")
    assert rate >= 250


# ---- the rules of the exchange ----

def test_what_breaks_the_rules_of_the_exchange_is_told(instrument):
    instrument.write("*ESE 4;*ESE?\n")
    assert instrument.ask("*SRE?") == "0"
    assert errors_of(instrument) == [-410], "the first answer was interrupted"
    instrument.request(100)
    with pytest.raises(Timeout):
        instrument.host.bulk_in(instrument.input, PACKET, 20_000)
    assert errors_of(instrument) == [-420], "nothing was asked"


# ---- status ----

def test_the_status_byte_tells_what_is_the_matter(instrument):
    instrument.write("*CLS;*SRE 0;*ESE 32\n")
    assert instrument.read_stb() == 0
    instrument.write("NO:SUCH\n")
    assert instrument.read_stb() == ERRORS | ESB
    assert errors_of(instrument) == [-113] and instrument.ask("*ESR?") == "32"
    assert instrument.read_stb() == 0
    instrument.write("*ESE?\n")
    assert instrument.read_stb() == MAV
    assert instrument.read() == b"32\n" and instrument.read_stb() == 0


def test_a_status_byte_is_asked_for_under_a_tag_from_2_on(instrument):
    for tag in (0, 1, 128):
        status, came, _ = instrument._in(READ_STATUS_BYTE, tag, 3)
        assert (status, came) == (FAILED, tag)
    assert instrument.read_stb() == 0


def test_service_is_requested_when_an_operation_has_ended(board, instrument):
    enable_all(board)
    instrument.write("*CLS;*ESE 1;*SRE 32\n")
    instrument.write("AXIS1:VEL 500;MOVE 2;*OPC\n")
    assert instrument.read_stb() & (RQS | ESB) == 0
    assert instrument.wait_request(3_000_000) == RQS | ESB
    assert instrument.read_stb() & (RQS | ESB) == ESB, "the notification was the poll"
    assert instrument.requests == [], "requested once"
    assert instrument.ask("*ESR?") == "1" and instrument.read_stb() == 0


# ---- clear, abort, trigger ----

@pytest.mark.parametrize("read", [0, 1, 2])
def test_a_clear_in_the_middle_of_an_answer_leaves_nothing_of_it(host, instrument, read):
    instrument.write("*ESE?;" * 60 + "*ESE?\n")
    if read:
        instrument.request()
        host.bulk_in(instrument.input, read * PACKET)
    instrument.clear()
    assert instrument.ask("*ESE 9;*ESE?") == "9"
    assert errors_of(instrument) == []


def test_a_clear_in_the_middle_of_a_message_leaves_nothing_of_it(host, instrument):
    host.bulk_out(instrument.output, header(DEV_DEP_MSG_OUT, 1, 1000, EOM) + b"NONSENSE" * 6 + b"XXXX")
    instrument.tag = 1
    instrument.clear()
    assert instrument.ask("*ESE 9;*ESE?") == "9"
    assert errors_of(instrument) == []


def test_a_clear_ends_a_wait_and_stops_no_motion(board, instrument):
    enable_all(board)
    follower = start_moving(board, "AXIS1:VEL 100;MOVE 20", steps=20)
    instrument.write("*OPC?\n")
    instrument.clear()
    assert instrument.ask("*ESE 3;*ESE?") == "3"
    assert ask(board, "*OPC?", 5_000_000) == "1" and follower.look()[0] == 400


def test_an_answer_can_be_aborted_at_every_packet_and_the_next_one_is_whole(host, instrument):
    for read in range(3):
        instrument.write("*ESE?;" * 80 + "*ESE?\n")
        tag = instrument.request()
        host.board.run(60_000)
        host.bulk_in(instrument.input, read * PACKET)
        sent = instrument.abort_in(tag)
        assert max(read * PACKET - 12, 0) <= sent <= 162
        instrument.clear()
        assert instrument.ask("*IDN?").startswith(IDENTITY)
    assert errors_of(instrument) == []


def test_a_message_can_be_aborted_and_is_dropped(host, instrument):
    host.bulk_out(instrument.output, header(DEV_DEP_MSG_OUT, 7, 1000, EOM) + b"NONSENSE" * 6 + b"XXXX")
    instrument.tag = 7
    host.board.run(3000)
    with pytest.raises(Refused) as refused:
        instrument.abort_out(8)
    assert refused.value.status == NOT_IN_PROGRESS
    assert instrument.abort_out(7) == 52
    assert instrument.ask("*IDN?").startswith(IDENTITY)
    assert errors_of(instrument) == []


def test_an_abort_of_what_is_not_under_way_is_refused(instrument):
    for abort in (instrument.abort_in, instrument.abort_out):
        with pytest.raises(Refused) as refused:
            abort(200)
        assert refused.value.status == FAILED
    assert instrument.ask("*IDN?").startswith(IDENTITY)


def test_a_trigger_is_trg(instrument):
    instrument.write("FORM PACK;:TRIG:SOUR BUS;:TRAC:CONF SAMP,1;ARM\n")
    assert int(instrument.ask("STAT:OPER:COND?")) & 32
    instrument.trigger()
    assert not int(instrument.ask("STAT:OPER:COND?")) & 32
    instrument.trigger()
    assert errors_of(instrument) == [-211], "nothing waits for it any more"


# ---- malformed, and recovered from ----

MALFORMED = {
    "unknown MsgID": header(77, 1, 4, EOM) + b"*RST",
    "bTag 0": header(DEV_DEP_MSG_OUT, 0, 4, EOM) + b"*RST",
    "bTagInverse": bytes([DEV_DEP_MSG_OUT, 1, 1, 0]) + header(DEV_DEP_MSG_OUT, 1, 4, EOM)[4:] + b"*RST",
    "half a header": header(DEV_DEP_MSG_OUT, 1, 4, EOM)[:8],
    "more than announced": header(DEV_DEP_MSG_OUT, 1, 4, EOM) + b"*RST" * 4,
    "less than announced": header(DEV_DEP_MSG_OUT, 1, 40, EOM) + b"*RST",
    "a request with data": header(DEV_DEP_MSG_IN, 1, 4) + b"*RST",
    "a trigger with data": header(TRIGGER, 1, 0) + b"*RST",
}


@pytest.mark.parametrize("transfer", MALFORMED.values(), ids=MALFORMED.keys())
def test_a_malformed_transfer_halts_the_endpoint_and_the_host_recovers(host, instrument, transfer):
    assert instrument.ask("*ESE 5;*ESE?") == "5"
    host.bulk_out(instrument.output, transfer)
    host.board.run(3000)
    assert host.halted(instrument.output)
    with pytest.raises(Stall):
        instrument.write("*IDN?\n")
    host.clear_halt(instrument.output)
    assert instrument.ask("*ESE?") == "5", "nothing of it was executed"
    # and once more, so that DATA0 and DATA1 are right either way
    assert instrument.ask("*IDN?").startswith(IDENTITY)


def test_requests_that_it_does_not_know_are_refused(host, instrument):
    for request in (0, 8, 63, 64, 127, 129, 163, 255):
        with pytest.raises(Stall):
            host.control_in(CLASS | INTERFACE, request, 0, instrument.interface, 1)
    assert instrument.ask("*IDN?").startswith(IDENTITY)


def test_requests_of_remote_and_local_succeed_in_any_order_and_change_nothing_of_the_link(instrument):
    # the board has no panel: what they do is tested with the exchange
    steps = (lambda: instrument.remote(True), instrument.local_lockout, instrument.go_to_local, lambda: instrument.remote(False))
    instrument.write("*ESE 3\n")
    for step in steps + steps[::-1]:
        step()
        assert instrument.ask("*ESE?") == "3"
    assert errors_of(instrument) == []


# ---- both functions, and the motors ----

def test_instrument_and_serial_ports_have_answers_and_errors_of_their_own(board, host, instrument):
    port = CdcPort(host).open()
    port.write("".join(f"*ESE {n};*ESE?\n" for n in range(60)))
    board.serial.write("".join(f"*SRE {n};*SRE?\n" for n in range(60)))
    for n in range(20):
        assert instrument.ask(f"*ESE {100 + n};*ESE?") == str(100 + n)
    board.run(100_000)
    assert [int(line) for line in port.came.split()] == list(range(60))
    assert [int(line) for line in board.serial.read().split()] == list(range(60))
    port.came.clear()
    instrument.write("NONSENSE\n")
    assert port.ask("SYST:ERR?") == NO_ERROR
    assert errors_of(instrument) == [-113]


def test_an_exclamation_mark_stops_a_move(board, instrument):
    stop_by_exclamation_mark(board, instrument, "AXIS1:MOVE 800\n")


def test_an_exclamation_mark_behind_a_clear_is_heard_before_the_host_has_checked(board, host, instrument):
    enable_all(board)
    follower = Follower(board)
    instrument.write("AXIS1:VEL 50;MOVE 800;*WAI\n")
    board.run_until(lambda: follower.look()[0] >= 100, 2_000_000, "100 steps", step_us=500)
    assert list(host.control_in(CLASS | INTERFACE, 5, 0, instrument.interface, 1)) == [1], "INITIATE_CLEAR"
    instrument.write("!\n", timeout_us=20_000)
    board.run(30_000)
    assert list(host.control_in(CLASS | INTERFACE, 6, 0, instrument.interface, 2)) in ([1, 0], [0x82, 0]), "CHECK_CLEAR_STATUS"
    host.clear_halt(instrument.output)
    board.run(10_000)
    stopped = list(follower.look())
    board.run(50_000)
    assert follower.look() == stopped == counts(board)
    assert errors_of(instrument) == []


def stops_at_once(board, instrument, follower):
    """`!` reaches a motion that is under way, behind whatever was done to the link."""
    assert follower.look()[0] < 400, "it would go on to 800 for 16 seconds"
    instrument.write("!\n", timeout_us=20_000)
    board.run(30_000)
    stopped = list(follower.look())
    board.run(50_000)
    assert follower.look() == stopped == counts(board)
    assert stopped[0] < 800
    assert errors_of(instrument) == []


@pytest.mark.parametrize("size", (52, 308, 692))
def test_an_exclamation_mark_is_heard_behind_an_abort_while_a_message_waits(board, host, instrument, size):
    enable_all(board)
    follower = Follower(board)
    instrument.write("AXIS1:VEL 50;MOVE 800;*WAI\n")
    board.run_until(lambda: follower.look()[0] >= 100, 2_000_000, "100 steps", step_us=500)
    instrument.tag = 7
    message = b"NONSENSE;" * 5 + b"NONSENS" + b"X" * (size - 52)
    transfer = host.start_out(instrument.output, header(DEV_DEP_MSG_OUT, 7, 1000, EOM) + message)
    board.run(5000)
    assert transfer.done == (size < 500), "512 bytes find room"
    if not transfer.done:
        host.cancel(transfer)
    assert instrument.abort_out(7) >= min(size, 500)
    stops_at_once(board, instrument, follower)


def test_an_exclamation_mark_is_heard_behind_a_halt_while_a_message_waits(board, host, instrument):
    enable_all(board)
    follower = Follower(board)
    instrument.write("AXIS1:VEL 50;MOVE 800;*WAI\n")
    board.run_until(lambda: follower.look()[0] >= 100, 2_000_000, "100 steps", step_us=500)
    host.bulk_out(instrument.output, header(DEV_DEP_MSG_OUT, 1, 1000, EOM) + b"NONSENSE;" * 7)
    board.run(3000)
    assert host.halted(instrument.output), "a short packet, and it has not all that was announced"
    host.clear_halt(instrument.output)
    stops_at_once(board, instrument, follower)


def test_a_request_without_a_question_is_an_error_whatever_follows_at_once(board, host, instrument):
    host.start_out(instrument.output, header(DEV_DEP_MSG_IN, 1, 100))
    host.bulk_out(instrument.output, header(DEV_DEP_MSG_OUT, 2, 8, EOM) + b"*ESE 3\n ")
    instrument.tag = 2
    assert errors_of(instrument) == [-420]


def set_interface(host, number):
    """SET_INTERFACE, alternate 0: its endpoints begin with DATA0 on both sides (USB 2.0, 9.1.1.5)."""
    host.control_out(INTERFACE, 11, 0, number)
    _, _, _, ends = host.interfaces()[number]
    for end in ends:
        host._pipe(end).toggle = 0


@pytest.mark.parametrize("packets", (1, 2))
def test_an_alternate_setting_that_is_set_begins_with_data0_and_leaves_nothing_behind(host, instrument, packets):
    for _ in range(packets):
        instrument.write("*ESE 4\n")
        assert instrument.read_stb() == 0
    instrument.write("*ESE?;" * 60 + "*ESE?\n")
    instrument.request()
    host.bulk_in(instrument.input, packets * PACKET)
    set_interface(host, instrument.interface)
    assert instrument.ask("*ESE?") == "0", "a link as after power-up"
    assert instrument.read_stb() == 0
    assert errors_of(instrument) == []
    # bulk OUT may be halted before
    host.bulk_out(instrument.output, MALFORMED["bTag 0"])
    host.board.run(3000)
    set_interface(host, instrument.interface)
    assert instrument.ask("*IDN?").startswith(IDENTITY)


@pytest.mark.parametrize("packets", (1, 2))
def test_an_alternate_setting_of_the_serial_port_leaves_the_instrument_alone(host, instrument, packets):
    port = CdcPort(host).open()
    instrument.write("*ESE 6\n")
    for _ in range(packets):
        assert port.ask("*ESE 5;*ESE?") == "5"
    for number in (1, 2):
        set_interface(host, number)
    assert port.ask("*ESE?") == "0"
    assert instrument.ask("*ESE?") == "6"


@pytest.mark.parametrize("way", ("instrument", "port"))
@pytest.mark.parametrize("out", (True, False), ids=("unplugged", "suspended"))
def test_a_jog_ends_when_its_host_is_gone_or_asleep(board, host, instrument, way, out):
    enable_all(board)
    follower = Follower(board)
    port = CdcPort(host).open()
    link = {"instrument": instrument, "port": port}[way]
    link.write("*ESE 5;:SYST:JOG:TIM 60\n")
    link.write("AXIS1:MOVE:JOG 10\n")
    board.run_until(lambda: follower.look()[0] >= 100, 2_000_000, "100 steps", step_us=500)
    if out:
        host.unplug()
        board.run(100_000)
    else:
        host.suspend(100_000)
    stopped = list(follower.look())
    board.run(100_000)
    assert follower.look() == stopped
    if not out:
        host.resume()
        assert link.ask("*ESE?") == "5", "what sleeps wakes up to what it had"


def test_unplugged_in_the_middle_of_an_answer_the_next_one_hears_his_own(board, host):
    instrument = Usbtmc(host)
    instrument.write("*ESE?;" * 60 + "*ESE?\n")
    instrument.request()
    host.bulk_in(instrument.input, PACKET)
    host.unplug()
    board.run(50_000)
    host.plug()
    instrument = Usbtmc(host.enumerate())
    assert instrument.ask("*ESE 9;*ESE?") == "9"
    assert errors_of(instrument) == []
