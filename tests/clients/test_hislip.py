"""HiSLIP with a client of our own: what pyvisa-py does not show, and what no client should do."""
import os
import socket
import struct
import time

import pytest

HEADER = struct.Struct("!2sBBIQ")
KINDS = dict(
    Initialize=0, InitializeResponse=1, FatalError=2, Error=3, AsyncLock=4, AsyncLockResponse=5, Data=6, DataEnd=7,
    DeviceClearComplete=8, DeviceClearAcknowledge=9, AsyncRemoteLocalControl=10, AsyncRemoteLocalResponse=11,
    Trigger=12, Interrupted=13, AsyncInterrupted=14, AsyncMaxMsgSize=15, AsyncMaxMsgSizeResponse=16,
    AsyncInitialize=17, AsyncInitializeResponse=18, AsyncDeviceClear=19, AsyncServiceRequest=20, AsyncStatusQuery=21,
    AsyncStatusResponse=22, AsyncDeviceClearAcknowledge=23, AsyncLockInfo=24, AsyncLockInfoResponse=25,
)  # fmt: skip
NAMES = {number: name for name, number in KINDS.items()}
READ = 1


def frame(kind, control=0, parameter=0, payload=b""):
    number = kind if isinstance(kind, int) else KINDS[kind]
    return HEADER.pack(b"HS", number, control, parameter, len(payload)) + payload


def exactly(link, count):
    data = b""
    while len(data) < count:
        part = link.recv(count - len(data))
        if not part:
            raise ConnectionError("closed")
        data += part
    return data


def receive(link):
    """Kind, control code, parameter and payload of the next message."""
    prologue, kind, control, parameter, length = HEADER.unpack(exactly(link, HEADER.size))
    assert prologue == b"HS"
    return NAMES[kind], control, parameter, exactly(link, length)


class Client:
    def __init__(self, server, name=b"hislip0"):
        self.sync = socket.create_connection(server.hislip, timeout=3)
        self.sync.sendall(frame("Initialize", 0, 0x0100 << 16 | 0x7878, name))
        kind, overlap, told, _ = receive(self.sync)
        assert (kind, overlap, told >> 16) == ("InitializeResponse", 0, 0x0100)
        self.aside = socket.create_connection(server.hislip, timeout=3)
        self.aside.sendall(frame("AsyncInitialize", 0, told & 0xFFFF))
        assert receive(self.aside)[0] == "AsyncInitializeResponse"
        self.message, self.read = 0xFFFF_FF00, 0

    def send(self, kind, payload=b""):
        sent = self.message
        self.sync.sendall(frame(kind, self.read, sent, payload))
        self.message, self.read = (sent + 2) & 0xFFFF_FFFF, 0
        return sent

    def write(self, text):
        return self.send("DataEnd", text.encode())

    def answer(self):
        """The next answer and the message that it belongs to."""
        data = b""
        while True:
            kind, _, parameter, payload = receive(self.sync)
            assert kind in ("Data", "DataEnd"), (kind, payload)
            data += payload
            if kind == "DataEnd":
                self.read = READ
                return data.decode().rstrip("\n"), parameter

    def query(self, text):
        sent = self.write(text)
        answer, parameter = self.answer()
        assert parameter == sent
        return answer

    def ask(self, kind, control=0, parameter=0, payload=b""):
        """Sends on the asynchronous channel; what comes back."""
        self.aside.sendall(frame(kind, control, parameter, payload))
        return receive(self.aside)

    def status(self):
        kind, control, _, _ = self.ask("AsyncStatusQuery", self.read, self.message)
        assert kind == "AsyncStatusResponse"
        return control

    def errors(self):
        found = []
        while not (told := self.query("SYST:ERR?")).startswith("0,"):
            found.append(int(told.split(",")[0]))
        return found

    def clear(self, feature=0):
        assert self.ask("AsyncDeviceClear")[0] == "AsyncDeviceClearAcknowledge"
        self.sync.sendall(frame("DeviceClearComplete", feature))
        while (told := receive(self.sync))[0] != "DeviceClearAcknowledge":
            pass
        self.message, self.read = 0xFFFF_FF00, 0
        return told[1]

    def close(self):
        self.sync.close()
        self.aside.close()


@pytest.fixture
def server(start):
    return start("--bench", "4", "--hislip", "0", "--speed", "1", "--no-pty", boards=3, terminals=0)


def test_service_requests_come_unasked_once_for_each_rise(server):
    stage = Client(server)
    stage.write("*CLS;*ESE 1;*SRE 32;:AXIS1:VEL 200;MOVE 40;*OPC")
    begin = time.monotonic()
    assert receive(stage.aside)[:2] == ("AsyncServiceRequest", 0x60)
    assert time.monotonic() - begin > 0.1
    assert (stage.status(), stage.status()) == (0x60, 0x20)
    assert stage.query("*ESR?") == "1"
    stage.write("*SRE 4;NO:SUCH")
    assert receive(stage.aside)[:2] == ("AsyncServiceRequest", 0x44)
    assert stage.errors() == [-113]
    stage.aside.settimeout(0.2)
    with pytest.raises(TimeoutError):
        receive(stage.aside)


def test_an_answer_is_available_until_it_is_said_to_be_read(server):
    stage = Client(server)
    stage.write("*CLS;*SRE 16")
    stage.write("*ESE?")
    assert receive(stage.aside)[:2] == ("AsyncServiceRequest", 0x50)
    assert stage.status() == 0x50
    assert stage.answer()[0] == "0"
    assert stage.status() == 0, "the query said that it was read"
    stage.read = 0
    assert stage.query("*SRE 0;*ESE?") == "0"


def test_a_trigger_is_a_message_in_its_turn(server):
    stage = Client(server)
    assert stage.query("TRIG:SOUR BUS;:TRAC:CONF SAMP,1;ARM;:STAT:OPER:COND?") == "32"
    stage.send("Trigger")
    assert stage.query("STAT:OPER:COND?") == "0"
    stage.send("Trigger")
    assert stage.errors() == [-211]


def test_a_message_before_the_answer_is_read_interrupts_it(server):
    stage = Client(server)
    stage.write("*ESE?")
    second = stage.write("*SRE?")
    told = [receive(stage.sync) for _ in range(3)]
    assert [kind for kind, *_ in told] == ["DataEnd", "Interrupted", "DataEnd"]
    assert told[1][2] == told[2][2] == second
    assert receive(stage.aside)[:3] == ("AsyncInterrupted", 0, second)
    stage.read = READ
    assert stage.errors() == [-410]
    stage.write("AXIS1:VEL 100;MOVE 50;*OPC?")
    stage.write("*ESE 3")
    assert receive(stage.sync)[0] == "Interrupted" and receive(stage.aside)[0] == "AsyncInterrupted"
    assert (stage.query("*ESE?"), stage.errors()) == ("3", [-410])


def test_in_overlap_mode_answers_come_in_turn_with_their_messages(server):
    stage = Client(server)
    assert stage.clear(1) == 1
    asked = [stage.write(f"*ESE {n};*ESE?") for n in range(20)]
    assert [stage.answer() for _ in asked] == [(str(n), sent) for n, sent in enumerate(asked)]
    assert stage.clear() == 0
    assert stage.errors() == []


def test_a_clear_at_each_message_leaves_a_working_link(server):
    stage = Client(server)
    for begun in [("Data", b"*ESE 1"), ("Data", b"COMP:LOAD #3400abc"), ("DataEnd", b"COMP:DATA?"), ("Trigger", b"")]:
        stage.send(*begun)
        stage.clear()
        assert stage.query("*ESE?") == "0"
    stage.write("AXIS1:VEL 100;MOVE 50;*OPC?")
    stage.clear()
    assert int(stage.query("STAT:OPER:COND?")) & 256, "motion goes on"
    assert [error for error in stage.errors() if error != -211] == []


def test_long_messages_come_in_parts_that_the_client_can_take(server):
    stage = Client(server)
    kind, _, _, payload = stage.ask("AsyncMaxMsgSize", payload=struct.pack("!Q", 116))
    assert kind == "AsyncMaxMsgSizeResponse" and struct.unpack("!Q", payload)[0] > 4096 + 512
    stage.write("SYST:HELP:HEAD?")
    data = b""
    while (told := receive(stage.sync))[0] == "Data":
        assert len(told[3]) <= 100
        data += told[3]
    assert told[0] == "DataEnd" and len(data + told[3]) > 3000
    stage.read = READ
    # and a block goes down in parts
    stage.send("Data", b"COMP:LO")
    stage.send("Data", b"AD #15ab")
    stage.send("DataEnd", b"\n!\n")
    assert stage.errors() == [-221]
    stage.send("Data", b"x" * 70_000)
    assert receive(stage.sync)[:2] == ("Error", 4)
    stage.send("DataEnd", b"\n*ESE 77\n")
    assert stage.query("*ESE?") == "0", "the rest of a message that was refused"
    assert stage.query("*OPC?") == "1"


def test_a_lock_keeps_others_out_until_it_is_given_back_or_its_owner_goes(server):
    one, two, other = Client(server), Client(server), Client(server, b"hislip1")
    assert one.ask("AsyncLock", 1, 0)[:2] == ("AsyncLockResponse", 1)
    assert two.ask("AsyncLock", 1, 100)[:2] == ("AsyncLockResponse", 0)
    assert two.ask("AsyncLockInfo")[:3] == ("AsyncLockInfoResponse", 1, 1)
    assert other.ask("AsyncLock", 1, 0)[:2] == ("AsyncLockResponse", 1), "another instrument"
    two.write("*IDN?")
    two.sync.settimeout(0.2)
    with pytest.raises(TimeoutError):
        two.answer()
    two.sync.settimeout(3)
    assert one.query("*ESE?") == "0"
    assert one.ask("AsyncLock", 0)[:2] == ("AsyncLockResponse", 1)
    assert two.answer()[0].startswith("Stage Controller")
    assert [link.ask("AsyncLock", 1, 0, b"team")[1] for link in (one, two)] == [1, 1]
    assert two.ask("AsyncLock", 1, 0)[1] == 1
    two.close()
    assert one.query("*ESE?") == "0", "its locks went with it"
    assert one.ask("AsyncLock", 0)[1] == 2 and one.ask("AsyncLock", 0)[1] == 3


def test_remote_and_local_are_taken_and_unknown_messages_refused(server):
    stage = Client(server)
    for control in range(7):
        assert stage.ask("AsyncRemoteLocalControl", control)[0] == "AsyncRemoteLocalResponse"
        assert stage.query("*ESE?") == "0"
    assert stage.ask("AsyncRemoteLocalControl", 7)[:2] == ("Error", 2)
    assert stage.ask(77)[:2] == ("Error", 1)
    assert stage.ask(200, payload=b"abc")[:2] == ("Error", 3)
    stage.sync.sendall(frame(77, payload=b"abc"))
    assert receive(stage.sync)[:2] == ("Error", 1)
    assert stage.query("*ESE?") == "0"


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", 1),
        (frame("DataEnd", 0, 0, b"*IDN?"), 3),
        (frame("AsyncInitialize", 0, 12345), 3),
        (frame("Initialize", 0, 0x01000000, b"hislip9"), 3),
        (frame("Initialize", 0, 0x01000000, b"nothing"), 3),
        (frame("Initialize", 0, 0x01000000) + frame("DataEnd", 0, 0, b"*IDN?"), 2),
    ],
)
def test_a_client_that_begins_wrongly_is_told_and_closed(server, sent, code):
    with socket.create_connection(server.hislip, timeout=3) as link:
        link.sendall(sent)
        told = receive(link)
        if told[0] == "InitializeResponse":
            told = receive(link)
        assert told[:2] == ("FatalError", code), told
        with pytest.raises((ConnectionError, TimeoutError)):
            receive(link)
    assert Client(server).query("*IDN?").startswith("Stage Controller")


def leave(link, reset):
    """Closes a socket, or resets it."""
    if reset:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    link.close()


def test_a_client_that_hangs_up_at_each_byte_leaves_nothing_behind(server):
    watch = Client(server)
    watch.query("*CLS;*ESE 7;*ESE?")
    assert watch.ask("AsyncLock", 1, 0, b"team")[1] == 1
    # every client takes the lock, jogs, asks, and is in the middle of a message
    talk = frame("DataEnd", 0, 0xFFFF_FF00, b"SYST:JOG:TIM 3600;:AXIS1:MOVE:JOG 100\n")
    jogs_from = len(talk)
    talk += frame("DataEnd", 0, 0xFFFF_FF02, b"*ESE 5;*ESE?") + frame("Data", 1, 0xFFFF_FF04, b"AXIS2:MOVE 1")
    jogged = 0
    for at in range(len(talk) + 1):
        stage = Client(server)
        assert stage.ask("AsyncLock", 1, 0, b"team")[1] == 1
        assert watch.ask("AsyncLockInfo")[1:3] == (0, 2)
        stage.sync.sendall(talk[:at])
        if at >= jogs_from:
            stage.status()  # it has come
            jogged += is_moving(watch)
        leave(stage.sync, at % 2)
        leave(stage.aside, at % 4 > 1)
        # neither a slot, nor a lock, nor motion; and the other client is as it was
        end = time.monotonic() + 3
        while watch.ask("AsyncLockInfo")[1:3] != (0, 1):
            assert time.monotonic() < end, at
        assert watch.query("*OPC?;*ESE?") == "1;7", "a jog would never end"
    assert jogged == len(talk) + 1 - jogs_from
    assert watch.errors() == []
    assert float(watch.query("AXIS2:POS:COMM?")) == 0, "half a message"
    # every place is free: sixteen at a time
    assert watch.ask("AsyncLock", 0, watch.message - 2)[1] == 2
    others = [Client(server) for _ in range(15)]
    assert [link.query("*ESE?") for link in others] == ["0"] * 15


def test_a_connection_that_hangs_up_before_it_is_a_client_leaves_nothing_behind(server):
    talk = frame("Initialize", 0, 0x0100 << 16, b"hislip0")
    for at in range(2 * len(talk)):
        link = socket.create_connection(server.hislip, timeout=3)
        link.sendall(talk[: at // 2])
        leave(link, at % 2)
    clients = [Client(server) for _ in range(16)]
    assert [link.query("*ESE?") for link in clients] == ["0"] * 16


def is_moving(link):
    return bool(int(link.query("STAT:OPER:COND?")) & 256)


def wait_for_rest(link, seconds):
    end = time.monotonic() + seconds
    while is_moving(link):
        assert time.monotonic() < end, "it moves on"


def test_a_jog_ends_when_nothing_is_sent_for_its_time_out(server):
    stage, other = Client(server), Client(server)
    stage.write("SYST:JOG:TIM 500 MS;:AXIS1:MOVE:JOG 20")
    begin = time.monotonic()
    while time.monotonic() < begin + 1.2:
        stage.write("*ESE 1")
        time.sleep(0.1)
    assert is_moving(other), "bytes keep it going"
    wait_for_rest(other, 2)
    assert 10 < float(other.query("AXIS1:POS?")) < 60


@pytest.mark.parametrize("mode", [0, 1])
def test_an_emergency_stop_does_not_wait(server, mode):
    stage, other = Client(server), Client(server)
    stage.clear(mode)
    stage.write("AXIS1:VEL 2;MOVE 100;*OPC?")
    stage.write("AXIS1:MOVE -100")
    time.sleep(0.2)
    assert is_moving(other)
    assert other.ask("AsyncLock", 1, 0)[1] == 1
    stage.write("!")
    wait_for_rest(other, 1)
    assert abs(float(other.query("AXIS1:POS:COMM?"))) < 20
    assert other.ask("AsyncLock", 0, other.message - 2)[1] == 1
    time.sleep(0.2)
    assert not is_moving(other), "what was sent before the stop"
    other.query("AXIS1:VEL 50;MOVE 30;*OPC?")
    assert float(other.query("AXIS1:POS:COMM?")) == 30, "the stop has been"


@pytest.mark.parametrize("silent", [False, True])
def test_nobody_costs_nothing(start, silent):
    """Processor time in a second in which nothing happens, at full speed."""
    server = start("--hislip", "0", "--speed", "max", "--no-pty", terminals=0)
    stat = f"/proc/{server.process.pid}/stat"
    if not os.path.exists(stat):
        pytest.skip("no /proc")

    def spent():
        with open(stat) as file:
            fields = file.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    links = [socket.create_connection(server.hislip) for _ in range(3)] if silent else [Client(server)]
    time.sleep(0.2)
    before = spent()
    time.sleep(1)
    assert spent() - before < 0.15
    assert links


def test_a_jog_ends_when_its_client_goes(server):
    stage, other = Client(server), Client(server)
    stage.write("SYST:JOG:TIM 3600;:AXIS1:MOVE:JOG 100")
    assert stage.query("*ESE?") == "0"
    assert int(other.query("STAT:OPER:COND?")) & 256
    stage.close()
    assert other.query("*OPC?") == "1"
    assert abs(float(other.query("AXIS1:POS?"))) < 50
