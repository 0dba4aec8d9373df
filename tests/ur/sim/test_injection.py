"""Faults injected while the simulator runs, seen from its clients; nonsense on every port."""

import random
import socket
import struct
import time

import pytest

from crtk_sim_backends.control import ControlClient, ControlError
from crtk_sim_backends.kit import HOOKS
from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.injection import BEGIN, END, KINDS
from rigs.ur_clients import PORTS, DashboardClient, PrimaryClient, RtdeClient, TcpClient
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def shared():
    with SIM.spawn() as running:
        yield running


@pytest.fixture
def sim(shared):
    yield shared
    shared.control.clear()


@pytest.fixture
def stream(sim):
    """An RTDE client whose stream of timestamps runs."""
    with RtdeClient(sim.host) as client:
        client.setup_outputs("timestamp,safety_mode,robot_mode,runtime_state,actual_q")
        client.start()
        client.data()
        yield client


def drain(client):
    """Read what is under way until nothing comes for a while."""
    client.socket.settimeout(0.1)
    try:
        while client.socket.recv(65536):
            pass
    except TimeoutError:
        return
    finally:
        client.socket.settimeout(LONG)


def test_disconnect_closes_connections_and_new_ones_are_welcome(sim, stream):
    sim.control.inject("disconnect", port="rtde")
    assert stream.closed_by_peer()
    RtdeClient(sim.host).close()


def test_disconnect_with_a_duration_closes_new_connections_too(sim, stream):
    sim.control.inject("disconnect", port="all", duration=60)
    assert stream.closed_by_peer()
    with TcpClient(sim.host, "rtde") as refused:
        assert refused.closed_by_peer()
    sim.control.clear("disconnect")
    DashboardClient(sim.host).close()


def test_every_connection_can_be_cut_at_once_again_and_again(sim):
    for _ in range(5):
        clients = [TcpClient(sim.host, port) for port in (*PORTS.values(), *PORTS.values())]
        sim.control.inject("disconnect", port="all")
        for client in clients:
            assert client.closed_by_peer()
            client.close()
    connections = sim.control.status()["connections"]
    assert {name for name, clients in connections.items() if clients} == {"control"}


def test_silence_keeps_connections_open_and_sends_nothing(sim, stream):
    sim.control.inject("silence", port="rtde")
    drain(stream)
    assert stream.silent_for(0.1)
    DashboardClient(sim.host).close()  # the other ports still answer
    with TcpClient(sim.host, "rtde") as late:  # the kernel takes the connection
        late.send(struct.pack(">HBH", 5, ord("V"), 2))
        assert late.silent_for(0.1)
        sim.control.clear("silence")
        assert late.read(4) == b"\x00\x04V\x01"
    first, second = stream.data()[0], stream.data()[0]
    assert second - first == pytest.approx(0.002, abs=1e-6)


def test_no_answer_accepts_and_never_answers(sim, stream):
    sim.control.inject("no_answer", port="all")
    with TcpClient(sim.host, "dashboard") as mute:
        mute.send(b"robotmode\n")
        assert mute.silent_for(0.1)
    stream.data()  # older connections go on


def test_stall_freezes_everything_but_the_control_socket(sim, stream):
    sim.control.inject("stall")
    assert sim.control.status()["faults"] == [{"kind": "stall"}]
    before = sim.control.status()["time"]
    drain(stream)
    assert stream.silent_for(0.1)
    with TcpClient(sim.host, "dashboard") as client:
        assert client.silent_for(0.05)
        assert sim.control.status()["time"] == before
        sim.control.clear("stall")
        assert client.read(9) == b"Connected"
    stream.data()


def test_a_timed_stall_ends_by_itself_without_a_burst(sim, stream):
    ticks = sim.control.status()["ticks"]
    sim.control.inject("stall", duration=0.3)
    eventually(lambda: not sim.control.status()["faults"])
    assert sim.control.status()["ticks"] >= ticks
    times = [stream.data()[0] for _ in range(20)]
    assert times == sorted(set(times))


def test_split_data_is_the_same_data(sim):
    sim.control.inject("split", port="all", size=1)
    with DashboardClient(sim.host) as dashboard, RtdeClient(sim.host) as rtde:
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        assert rtde.setup_outputs("timestamp,actual_q", 10) == (1, ["DOUBLE", "VECTOR6D"])
        assert rtde.start()
        first, second = rtde.data()[0], rtde.data()[0]
        assert second - first == pytest.approx(0.1, abs=1e-6)
    with PrimaryClient(sim.host) as primary:
        assert 6 in primary.state()


def test_delayed_answers_come_late_and_complete(sim):
    with DashboardClient(sim.host) as dashboard:
        sim.control.inject("delay", port="dashboard", seconds=0.3, direction="out")
        asked = time.monotonic()
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        assert time.monotonic() - asked >= 0.3


def test_coalesced_packages_arrive_in_lumps(sim, stream):
    sim.control.inject("coalesce", port="rtde", seconds=0.2, direction="out")
    drain(stream)
    # A simulator that is held up leaves periods out, and has little to send.
    eventually(lambda: len(stream.socket.recv(65536)) > 20 * 80)


def test_corrupt_data_reaches_the_client(sim):
    with DashboardClient(sim.host) as dashboard:
        sim.control.inject("corrupt", port="dashboard", every=1, direction="out")
        dashboard.send(b"robotmode\n")
        answer = dashboard.read(len("Robotmode: RUNNING\n"))
        assert sum(a != b for a, b in zip(answer, b"Robotmode: RUNNING\n", strict=True)) == 1


@pytest.mark.parametrize(
    ("kind", "safety_mode"),
    [
        ("protective_stop", 3),
        ("safeguard_stop", 5),
        ("emergency_stop", 7),
        ("violation", 8),
        ("safety_fault", 9),
    ],
)
def test_the_safety_system_stops_the_program(kind, safety_mode):
    with SIM.spawn() as own, RtdeClient(own.host) as client, TcpClient(own.host, 30002) as script:
        client.setup_outputs("safety_mode,runtime_state")
        client.start()
        script.send(b"def work():\n  while True:\n    sync()\n  end\nend\n")
        client.wait_for(lambda values: values == (1, 2))
        own.control.inject(kind)
        client.wait_for(lambda values: values[0] == safety_mode and values[1] != 2)


def test_a_fault_is_in_force_when_its_injection_is_answered(sim):
    control = sim.control
    for kind, name, value in (
        ("reduced_mode", "safety_mode", 2),
        ("safeguard_stop", "safety_mode", 5),
        ("speed_slider", "target_speed_fraction", 0.5),
    ):
        before = control.outputs(name)
        control.inject(kind, **({"fraction": 0.5} if kind == "speed_slider" else {}))
        assert control.outputs(name) == {name: value}
        control.clear(kind)
        assert control.outputs(name) == before


def test_answers_of_a_megabyte_arrive_whole(sim):
    with RtdeClient(sim.host) as client:
        names = ",".join(f"input_double_register_{i}" for i in range(48))
        recipe, _ = client.setup_inputs(names)
        for number in range(1500):
            client.write_data(recipe, "48d", *([number / 7.0] * 48))
        before = sim.control.status()["input_packages"]
        eventually(lambda: sim.control.status()["input_packages"] >= max(before, 1500))
        trace = sim.control.trace()
    assert len(trace) >= 1500
    assert trace[-1]["values"]["input_double_register_47"] == 1499 / 7.0
    assert sim.control.outputs().keys() >= {"actual_q", "output_double_register_47"}


def test_a_failing_program_ends_with_a_runtime_exception(sim):
    with PrimaryClient(sim.host) as primary:
        primary.send(b"def work():\n  while True:\n    sync()\n  end\nend\n")
        assert primary.message(7).endswith(b"PROGRAM_XXX_STARTEDwork")
        sim.control.inject("script_error")
        assert primary.message(7).endswith(b"PROGRAM_XXX_STOPPEDwork")
        line, column = struct.unpack_from(">ii", primary.message(10))
        assert (line, column) == (3, 3)


def test_the_pendant_moves_the_speed_slider_and_back(sim):
    with RtdeClient(sim.host) as client:
        client.setup_outputs("target_speed_fraction")
        client.start()
        sim.control.inject("speed_slider", fraction=0.25)
        client.wait_for(lambda values: values == (0.25,))
        sim.control.clear("speed_slider")
        client.wait_for(lambda values: values == (1.0,))


def test_a_fault_file_is_played(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "- {when: rtde_connected, after: 0.05, kind: reduced_mode}\n"
        "- {when: program_started, kind: disconnect, port: rtde}\n"
    )
    with SIM.spawn(faults=str(path)) as own, RtdeClient(own.host) as client:
        client.setup_outputs("safety_mode")
        client.start()
        client.wait_for(lambda values: values == (2,))
        with TcpClient(own.host, "secondary") as script:
            script.send(b'def work():\n  textmsg("working")\nend\n')
            assert client.closed_by_peer()


@pytest.mark.parametrize(
    ("kind", "parameters", "complaint"),
    [
        ("protective_stopp", {}, "did you mean 'protective_stop'"),
        ("silence", {}, "needs the parameter 'port'"),
        ("silence", {"port": "control"}, "unknown port 'control'"),
        ("freeze_joint", {"joint": 6}, "joint must lie in [0, 5]"),
        ("external_force", {"wrench": [1, 2, 3]}, "a list of 6 numbers"),
        ("protective_stop", {"duration": 1}, "unknown parameter"),
    ],
)
def test_a_wrong_injection_is_refused_with_a_hint(sim, kind, parameters, complaint):
    with pytest.raises(ControlError) as caught:
        sim.control.inject(kind, **parameters)
    assert complaint in str(caught.value)


def test_wrong_requests_are_refused_and_the_control_socket_lives(sim):
    with pytest.raises(ControlError, match="did you mean 'status'"):
        sim.control.call("statuss")
    with pytest.raises(ControlError, match="inject"):
        sim.control.call("inject", nothing=1)
    with ControlClient(sim.host, sim.ports["control"]) as other:
        assert other.status()["model"] == "ur5e"
        wrong = (
            b'{"do": "inject", "with": {"kind": "corrupt", "parameters": {"port": "rtde", %s}}}\n'
        )
        for nonsense in (
            b"\n",
            b"{}\n",
            b"[]\n",
            b"1\n",
            b"\xff\xff\n",
            b'{"do": {}}\n',
            b"[" * 100_000 + b"\n",
            wrong % b'"seed": Infinity',
            wrong % (b'"seed": 1' + b"0" * 400),
        ):
            other._socket.sendall(nonsense)
            assert b'"ok": false' in other._lines.readline()
        assert other.status()["model"] == "ur5e"


def test_every_kind_of_fault_does_something():
    handled = {*BEGIN, *HOOKS, "stall", "silence", "disconnect", "no_answer"}
    assert set(KINDS) == handled
    assert set(END) <= set(BEGIN)


def nonsense(generator):
    """Random bytes, headers with wrong sizes, broken script and dashboard text."""
    size = generator.choice([0, 1, 2, 3, 5, 100, 5000])
    header = struct.pack(">HB", generator.randrange(65536), generator.choice(b"VvOISPUM\x00X"))
    words = [b"def ", b"end", b"\n", b'"', b"#", b"sec ", b"thread ", b"(", b"p[", b"1e999", b"if "]
    return generator.choice(
        [
            generator.randbytes(size),
            header + generator.randbytes(size),
            struct.pack(">HB", 3 + size, generator.choice(b"VvOISPUM")) + generator.randbytes(size),
            b"".join(generator.choice(words) for _ in range(20)) + b"\n",
        ]
    )


@pytest.mark.parametrize("seed", range(8))
def test_nonsense_on_every_port_disturbs_no_other_client(sim, stream, seed):
    generator = random.Random(seed)
    for port in (*PORTS, sim.ports["control"]):
        for _ in range(10):
            with TcpClient(sim.host, port) as client:
                try:
                    for _ in range(generator.randrange(1, 6)):
                        client.send(nonsense(generator))
                except ConnectionError:
                    pass  # the simulator may end such a connection
                if generator.random() < 0.5:
                    client.socket.setsockopt(
                        socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
                    )
    first = stream.data()[0]
    assert stream.wait_for(lambda values: values[0] > first + 0.1)
    with DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("robotmode").startswith("Robotmode: ")
    assert sim.control.status()["ticks"] > 0
