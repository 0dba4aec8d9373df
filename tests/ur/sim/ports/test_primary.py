"""Primary, secondary and real-time ports: packets, messages, script text, read-only ports."""

import itertools
import math
import struct

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import PrimaryClient, TcpClient, subpackages
from rigs.waiting import eventually

SIZES = {0: 42, 1: 246, 2: 32, 4: 96, 5: 220, 6: 440, 7: 56, 8: 4}
"""Bodies of the robot state's sub-packages in bytes, from the interface description."""


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn() as running:
        yield running


@pytest.mark.parametrize("port", ["primary", "secondary", "primary_read_only"])
def test_the_version_comes_first_and_the_full_state_next(sim, port):
    with PrimaryClient(sim.host, port) as client:
        kind, body = client.frame()
        assert (kind, body[9]) == (20, 3)
        length = body[10]
        assert body[11 : 11 + length] == b"URControl"
        numbers = struct.unpack_from(">BBii", body, 11 + length)
        assert numbers == (5, 12, 4, 0)
        kind, body = client.frame()
        assert kind == 16
        parts = subpackages(body)
        assert {number: len(parts[number]) for number in SIZES} == SIZES
        assert len(parts[3]) == 2 * 4 + 2 * 18 + 4 * 4 + 3 + 4 + 3


def test_the_hardware_is_told_once_on_the_primary_port_alone():
    with SIM.spawn(version="5.26") as newer:
        with PrimaryClient(newer.host) as client:
            kinds = [(kind, body[9] if kind == 20 else None) for kind, body in frames(client, 4)]
            assert kinds == [(20, 3), (20, 18), (16, None), (16, None)]
        with PrimaryClient(newer.host, "secondary") as client:
            assert [kind for kind, _ in frames(client, 3)] == [20, 16, 16]


def frames(client, count):
    return [client.frame() for _ in range(count)]


def test_the_state_says_what_rtde_says(sim):
    with PrimaryClient(sim.host) as client:
        parts = client.state()
    outputs = sim.control.outputs("actual_q", "actual_TCP_pose", "robot_mode")
    mode = struct.unpack(">Q7?bBdddB", parts[0])
    assert mode[8] == outputs["robot_mode"] == 7
    joints = [struct.unpack_from(">3d4fB", parts[1], 41 * n) for n in range(6)]
    assert [joint[0] for joint in joints] == pytest.approx(outputs["actual_q"])
    assert {joint[-1] for joint in joints} == {253}
    assert struct.unpack_from(">6d", parts[4]) == pytest.approx(outputs["actual_TCP_pose"])
    kinematics = struct.unpack(">6I24dI", parts[5])
    assert kinematics[6 + 6 : 6 + 12] == (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
    assert kinematics[6 + 12 : 6 + 18] == (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
    assert kinematics[6 + 18] == pytest.approx(math.pi / 2)
    configuration = struct.unpack(">12d12d5d24d4i", parts[6])
    assert configuration[-2] == 1  # UR5


def test_the_state_tells_how_the_line_to_the_tool_is_set(sim):
    with PrimaryClient(sim.host) as client:
        client.send(b"set_tool_communication(True, 9600, 2, 1, 2.0, 4.0)\n")
        eventually(lambda: struct.unpack(">?3I2f", client.state()[11]) == (1, 9600, 2, 1, 2.0, 4.0))
        client.send(b"set_tool_communication(False, 115200, 0, 1, 1.5, 3.5)\n")
        eventually(lambda: not client.state()[11][0])


def test_states_come_ten_times_a_second(sim):
    with PrimaryClient(sim.host) as client:
        client.state()
        times = [struct.unpack_from(">Q", client.state()[0])[0] for _ in range(5)]
    steps = [b - a for a, b in itertools.pairwise(times)]
    assert steps == pytest.approx([100_000] * 4, abs=2)


@pytest.mark.parametrize("port", ["primary", "secondary", "realtime"])
def test_script_text_runs_and_its_messages_reach_primary_clients(sim, port):
    with (
        PrimaryClient(sim.host, "primary_read_only") as watcher,
        TcpClient(sim.host, port) as client,
    ):
        client.send(b'def hello():\n  textmsg("from ", "' + port.encode() + b'")\nend\n')
        assert watcher.message(7)[8:] == bytes([19]) + b"PROGRAM_XXX_STARTEDhello"
        assert watcher.message(0) == b"from " + port.encode()
        assert watcher.message(7)[8:] == bytes([19]) + b"PROGRAM_XXX_STOPPEDhello"


def test_a_script_that_does_not_compile_is_reported_with_its_place(sim):
    with PrimaryClient(sim.host) as client:
        client.send(b"def broken():\n  calldoesntexist()\nend\n")
        body = client.message(10)
    assert struct.unpack_from(">ii", body) == (2, 3)
    assert body[8:] == b"compile_error_name_not_found:calldoesntexist:"


def test_a_script_on_a_read_only_port_is_refused_with_error_210(sim):
    for port in ("primary_read_only", "secondary_read_only", "realtime_read_only"):
        with PrimaryClient(sim.host, "primary") as watcher, TcpClient(sim.host, port) as client:
            client.send(b'textmsg("never")\n')
            code, argument, level = struct.unpack_from(">iii", watcher.message(6))
            assert (code, argument, level) == (210, 0, 2)
    assert sim.control.status()["scripts"] == [] or all(
        "never" not in script["text"] for script in sim.control.status()["scripts"]
    )


def test_switching_to_local_control_drops_the_script_clients():
    with SIM.spawn() as own, PrimaryClient(own.host) as client:
        client.state()
        own.control.inject("local_control")
        assert client.closed_by_peer()
        with PrimaryClient(own.host) as again:
            again.send(b'textmsg("never")\n')
            assert struct.unpack_from(">i", again.message(6)) == (210,)
            own.control.clear("local_control")
            eventually(lambda: own.control.status()["remote"])
            again.send(b'textmsg("never")\n')  # opened in local control, it stays read-only
            assert struct.unpack_from(">i", again.message(6)) == (210,)
            with PrimaryClient(own.host) as anew:
                anew.send(b'textmsg("now")\n')
                assert again.message(0) == b"now"


def test_plain_commands_on_a_script_port():
    with SIM.spawn(powered_on=False) as own, TcpClient(own.host, "secondary") as client:

        def mode():
            return own.control.status()["robot_mode"]

        client.send(b"power on\n")
        eventually(lambda: mode() == "IDLE")
        client.send(b"set robotmode run\n")
        eventually(lambda: mode() == "RUNNING")
        client.send(b"power off\n")
        eventually(lambda: mode() == "POWER_OFF")


@pytest.mark.parametrize(
    ("model", "version", "length"),
    [
        ("ur5e", "5.12.4", 1220),
        ("ur5e", "5.9.0", 1140),
        ("ur5e", "5.4.0", 1116),
        ("ur5e", "5.2", 1108),
        ("ur5", "3.15", 1220),
        ("ur5", "3.4", 1060),
        ("ur5e", "10.9", 1220),
    ],
)
def test_the_realtime_packet_has_the_length_of_its_version(model, version, length):
    with SIM.spawn(model=model, version=version) as own, TcpClient(own.host, "realtime") as client:
        first, second = client.read(length), client.read(length)
        assert struct.unpack_from(">I", first) == struct.unpack_from(">I", second) == (length,)
        times = [struct.unpack_from(">d", packet, 4)[0] for packet in (first, second)]
        period = 1 / 125 if model == "ur5" else 1 / 500
        assert times[1] - times[0] == pytest.approx(period, abs=1e-9)
        values = struct.unpack_from(">130d", second, 4)
        outputs = own.control.outputs("actual_q", "robot_mode", "safety_mode")
        assert list(values[31:37]) == pytest.approx(outputs["actual_q"])
        assert values[94] == outputs["robot_mode"]
        assert values[101] == outputs["safety_mode"]


def test_clients_that_never_read_do_not_stop_the_controller(sim):
    """ur_rtde uploads its script on 30003 and never reads what comes back."""
    with TcpClient(sim.host, "realtime") as lazy, PrimaryClient(sim.host) as reader:
        clients = lambda: sim.control.status()["connections"]["realtime"]  # noqa: E731
        eventually(lambda: any(client["dropped"] > 10 for client in clients()))
        reader.state()
        lazy.send(b'def late():\n  textmsg("alive")\nend\n')
        assert reader.message(0, 30) == b"alive"


@pytest.mark.parametrize(("model", "version"), [("ur5", "3.15"), ("ur20", "10.9")])
def test_a_motion_sent_as_text_moves_the_arm(model, version):
    with SIM.spawn(model=model, version=version) as own, TcpClient(own.host, "secondary") as client:
        start = own.control.outputs("actual_q")["actual_q"]
        goal = [start[0] + 0.1, *start[1:]]
        client.send(f"movej({goal}, a=5, v=2)\n".encode())
        eventually(
            lambda: own.control.outputs("actual_q")["actual_q"] == pytest.approx(goal, abs=1e-3)
        )


def test_a_long_title_of_a_popup_is_cut(sim):
    with PrimaryClient(sim.host) as primary:
        primary.send(b'def ask():\n  popup("text", title="' + b"t" * 400 + b'")\nend\n')
        body = primary.message(2)
        assert body[8:] == b"\xff" + b"t" * 255 + b"text"


def test_a_program_can_shut_the_robot_down():
    with SIM.spawn() as sim, TcpClient(sim.host, "primary") as script:
        script.send(b"powerdown()\n")
        eventually(lambda: not sim.running)
        assert sim.stop() == 0
