"""Settings that are saved are there after a restart of the server."""
import pytest

from stagetools import all_errors, errors, moving, wait_until


@pytest.fixture
def restart(start, connect, tmp_path):
    """Starts a server with one settings file, again and again; hands out a link to it."""
    servers = []

    def start_again(*args, transport="tcp"):
        for server in servers:
            server.process.terminate()
            server.process.wait()
        servers.append(start("--speed", "max", "--settings", str(tmp_path / "settings.bin"), *args))
        return connect(servers[-1], transport)

    yield start_again
    # the older ones were ended on purpose: only the last one must still be there
    assert servers[-1].process.poll() is None


@pytest.fixture
def start(host_sim):
    """As in every test, but servers may end before it."""
    from conftest import Server

    servers = []

    def start_server(*args):
        servers.append(Server(host_sim, *args))
        return servers[-1]

    yield start_server
    for server in servers:
        server.stop()


@pytest.mark.parametrize("transport", ["tcp", "pty"])
def test_what_was_saved_is_there_after_a_restart(restart, transport):
    stage = restart(transport=transport)
    stage.write("AXIS1:VEL 750;:AXIS4:BACK:MARG 33;:SYST:COMM:SER:BAUD 460800;*SAV")
    stage.write("AXIS1:VEL 50")
    assert errors(stage) == []
    stage = restart(transport=transport)
    assert stage.query("AXIS1:VEL?;:AXIS4:BACK:MARG?;:SYST:COMM:SER:BAUD?") == "750.000;33;460800"
    assert errors(stage) == []


def test_what_was_not_saved_is_not_there(restart):
    default = restart().query("AXIS1:VEL?")
    stage = restart()
    stage.write("AXIS1:VEL 750")
    assert stage.query("AXIS1:VEL?") == "750.000"
    assert restart().query("AXIS1:VEL?") == default


def test_recall_brings_the_saved_settings_back_and_moves_nothing(restart):
    stage = restart()
    stage.write("AXIS1:VEL 750;*SAV")
    assert stage.query("AXIS1:VEL 20;:POSE 100,0,0,0.1,0,0;*OPC?") == "1"
    before = [stage.query(f"AXIS{n}:POS:MOT?") for n in range(1, 7)]
    assert stage.query("*RCL;:AXIS1:VEL?") == "750.000"
    assert [stage.query(f"AXIS{n}:POS:MOT?") for n in range(1, 7)] == before
    assert errors(stage) == []


def test_a_parked_stage_knows_its_counts_and_wants_homing(restart):
    stage = restart()
    assert stage.query("POSE 100,-50,20,0.1,0,-0.2;*OPC?;:SYST:PARK;*OPC?") == "1;1"
    counts = [stage.query(f"AXIS{n}:POS:MOT?") for n in range(1, 7)]
    stage = restart("--cold")
    assert [stage.query(f"AXIS{n}:POS:MOT?") for n in range(1, 7)] == counts
    stage.write("AXIS1:ENAB ON;MOVE 0")
    assert errors(stage) == [101]


def test_a_settings_file_of_random_bytes_ends_in_defaults_that_say_so(restart, tmp_path):
    (tmp_path / "settings.bin").write_bytes(bytes(range(256)) * 128)
    stage = restart()
    assert all_errors(stage)[0].startswith('106,"Settings lost, defaults in use')
    assert int(stage.query("STAT:QUES:COND?")) & 256
    stage.write("*SAV")
    assert int(stage.query("STAT:QUES:COND?")) & 256 == 0
    assert errors(restart()) == []


def test_saving_is_refused_while_it_moves(paced, connect):
    stage = connect(paced, "tcp")
    stage.write("AXIS1:VEL 100;MOVE 100")
    assert wait_until(lambda: moving(stage))
    for command in ("*SAV", "*RCL", "SYST:PARK"):
        stage.write(command)
        assert errors(stage) == [104]
    stage.query("STOP;*OPC?")


def test_a_baud_rate_out_of_range_is_refused(stage):
    for baud in ("9599", "1000001"):
        stage.write(f"SYST:COMM:SER:BAUD {baud}")
    assert errors(stage) == [-222, -222]
    assert stage.query("SYST:COMM:SER:BAUD?;BAUD? MAX") == "115200;1000000"
