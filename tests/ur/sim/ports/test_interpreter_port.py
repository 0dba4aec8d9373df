"""TCP port 30020 of a simulated UR controller: interpreter mode over a real socket."""

import re
import socket

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import DashboardClient, InterpreterClient, PrimaryClient, TcpClient
from rigs.waiting import LONG, eventually

PROGRAM = "def waits():\n  global a = 1\n  interpreter_mode(clearQueueOnEnter=False)\nend\n"
REPLY = re.compile(r"(\w+):\W+(\d+)?")
"""With this UR's own examples ("interpreter mode" article) read the replies."""


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn() as running:
        yield running


@pytest.fixture
def program(sim):
    """A program in interpreter mode, or about to be."""
    with TcpClient(sim.host, "primary") as script:
        script.send(b"stop program\n" + PROGRAM.encode())
        eventually(lambda: status(sim)["program"] == "waits" and playing(sim))
        yield
        script.send(b"stop program\n")
        eventually(lambda: not playing(sim))
    sim.control.clear()


def status(sim):
    return sim.control.status()


def playing(sim):
    return status(sim)["runtime_state"] == "PLAYING"


def number(reply):
    return int(REPLY.match(reply)[2])


def test_a_client_sends_statements_follows_them_and_ends_the_mode(sim, program):
    with InterpreterClient(sim.host) as client:
        first = number(client.ask("def twice(x): sync() return 2 * x end"))
        client.ask("a = twice(21)")
        last = number(client.ask("set_standard_digital_out(3, a == 42)"))
        assert (first, last) == (1, 3)
        eventually(lambda: number(client.ask("statelastexecuted")) == last)
        out = "actual_digital_output_bits"
        eventually(lambda: sim.control.outputs(out)[out] & 8)
        assert client.ask("x = = 1") == "discard: Syntax error: x = = 1"
        assert client.ask("end_interpreter()") == "ack: 4: end_interpreter()"
        eventually(lambda: not playing(sim))
        assert client.ask("a = 1") == "discard: Program is in an invalid state: a = 1"


def test_a_line_on_the_script_port_is_enough_to_enter_the_mode(sim):
    with TcpClient(sim.host, "secondary") as script, InterpreterClient(sim.host) as client:
        script.send(b"interpreter_mode()\n")
        eventually(lambda: client.ask("statelastinterpreted") and playing(sim))
        eventually(lambda: client.ask("x = 1").startswith("ack: "))
        client.ask("end_interpreter()")
        eventually(lambda: not playing(sim))


def test_lines_that_come_at_once_are_answered_in_their_order(sim, program):
    count = 200
    with InterpreterClient(sim.host) as client:
        client.send(b"a = 1\n" * count)
        assert [number(client.line()) for _ in range(count)] == list(range(1, count + 1))


def test_a_connection_for_each_line_does_as_well(sim, program):
    for count in range(1, 30):
        with InterpreterClient(sim.host) as client:
            assert client.ask("a = 1") == f"ack: {count}: a = 1"


def test_what_a_client_sent_is_executed_after_it_has_gone(sim, program):
    with InterpreterClient(sim.host) as client:
        client.ask("sleep(0.2)")
        client.ask("end_interpreter()")
    eventually(lambda: not playing(sim))


def test_a_half_open_client_gets_its_answers(sim, program):
    with InterpreterClient(sim.host) as client:
        client.send(b"a = 1\n")
        client.socket.shutdown(socket.SHUT_WR)
        assert client.line() == "ack: 1: a = 1"
        assert client.closed_by_peer()


def test_a_runtime_error_reaches_primary_clients_and_the_script_ports_go_on(sim, program):
    with PrimaryClient(sim.host) as primary, InterpreterClient(sim.host) as client:
        client.ask("textmsg([1][3])")
        assert b"Index out of range" in primary.message(10, LONG)
        eventually(lambda: not playing(sim))
        with DashboardClient(sim.host) as dashboard:
            assert dashboard.ask("running") == "Program running: false"


def test_megabytes_without_a_newline_stop_nothing(sim, program):
    with InterpreterClient(sim.host, LONG) as client:
        client.send(b"x" * (1 << 22) + b"\na = 1\n")
        assert client.line().startswith("discard: Line too long: xxx")
        assert client.line() == "ack: 1: a = 1"


def test_a_client_that_does_not_read_loses_its_connection_and_others_do_not_notice(sim, program):
    with InterpreterClient(sim.host) as greedy, InterpreterClient(sim.host) as client:
        line = b"#" + b"x" * 30_000 + b"\n"
        with pytest.raises(ConnectionError):
            greedy.send(line * 10_000)
        assert number(client.ask("statelastinterpreted")) >= 0
        eventually(lambda: len(status(sim)["connections"]["interpreter"]) == 1)
    assert status(sim)["statistics"]["defects"] == 0


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("split", {"size": 1}),
        ("delay", {"seconds": 0.05}),
        ("coalesce", {"seconds": 0.05}),
    ],
)
def test_faults_that_lose_nothing_change_no_answer(sim, program, kind, parameters):
    sim.control.inject(kind, port="interpreter", direction="both", **parameters)
    with InterpreterClient(sim.host, LONG) as client:
        assert client.ask("a = 1") == "ack: 1: a = 1"
        assert client.ask("statelastinterpreted") == "state: 1: statelastinterpreted"


def test_disconnect_closes_and_silence_withholds_the_answers(sim, program):
    with InterpreterClient(sim.host, LONG) as client:
        assert client.ask("a = 1") == "ack: 1: a = 1"
        sim.control.inject("disconnect", port="interpreter")
        assert client.closed_by_peer()
    with InterpreterClient(sim.host, LONG) as client:
        sim.control.inject("silence", port="interpreter")
        client.send(b"a = 2\n")
        assert client.silent_for(0.2)
        sim.control.clear("silence")
        assert client.line() == "ack: 2: a = 2"


def test_no_answer_is_none(sim, program):
    sim.control.inject("no_answer", port="interpreter")
    with InterpreterClient(sim.host) as client:
        client.send(b"a = 1\n")
        assert client.silent_for(0.2)


def test_dropped_data_takes_lines_away(sim, program):
    sim.control.inject("drop", port="interpreter", direction="in", every=1)
    with InterpreterClient(sim.host) as client:
        client.send(b"a = 1\n")
        clients = lambda: status(sim)["connections"]["interpreter"]  # noqa: E731
        eventually(lambda: any(client["bytes_in"] for client in clients()))
        sim.control.clear("drop")
        assert client.ask("a = 2") == "ack: 1: a = 2"


@pytest.mark.parametrize(
    "options", [{"model": "ur5"}, {"version": "5.9.4"}], ids=["cb3", "before 5.10"]
)
def test_older_software_has_no_such_port(options):
    with SIM.spawn(**options) as sim:
        assert "interpreter" not in sim.ports
        with pytest.raises(ConnectionRefusedError):
            InterpreterClient(sim.host)
