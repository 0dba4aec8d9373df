"""Starting the hub: options, places that are taken, and a hub inside another program."""

import errno
import os
import socket
import threading
import time

import can
import pytest

from crtk_sim_backends.can import SIM, ConfigError, SimConfig, frames
from crtk_sim_backends.can.hub import Hub
from crtk_sim_backends.can.port import State
from crtk_sim_backends.can.server import HubServer
from crtk_sim_backends.faults import FaultKind
from crtk_sim_backends.process import SimStartError
from rigs.can_hub_doors import frame, ids, receive
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.usefixtures("cold_start")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"bitrate": 10}, "bitrate must be 0 or lie in"),
        ({"stuffing": "exakt"}, "did you mean 'exact'"),
        ({"host": "10.0.0.1"}, "loopback"),
        ({"channel": "a b"}, "channel must be"),
        ({"terminals": 99}, "terminals must lie in"),
        ({"terminals": 0, "link": "/tmp/x"}, "there is no slcan terminal"),
        ({"queue": 0}, "queue must lie in"),
        ({"replay_speed": -1.0}, "replay_speed must be"),
        ({"socketcand_port": 70000}, "socketcand_port must lie in"),
        ({"faults": "/no/such/file"}, "there is no file"),
        ({"socket": ""}, "socket must be"),
        ({"bitrat": 1}, "did you mean 'bitrate'"),
    ],
)
def test_a_wrong_option_is_refused_with_what_can_be_given(options, complaint):
    with pytest.raises(ConfigError, match=complaint):
        SIM.spawn(**options)


def test_two_hubs_do_not_share_a_socket(tmp_path):
    path = str(tmp_path / "bus.sock")
    with (
        SIM.spawn(socket=path, socketcand_port=0, terminals=0),
        pytest.raises(SimStartError, match="another hub is there"),
    ):
        SIM.spawn(socket=path, socketcand_port=0, terminals=0)
    assert not os.path.exists(path)


def test_the_socket_of_a_hub_that_was_killed_is_taken_over(tmp_path):
    path = str(tmp_path / "bus.sock")
    SIM.spawn(socket=path, socketcand_port=0, terminals=0).kill()
    assert os.path.exists(path)
    with SIM.spawn(socket=path, socketcand_port=0, terminals=0):
        can.Bus(interface="crtk", channel=path).shutdown()


def test_a_file_is_not_removed(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("precious")
    with pytest.raises(SimStartError, match="there is a file"):
        SIM.spawn(socket=str(path), socketcand_port=0)
    assert path.read_text() == "precious"


def test_a_port_that_is_taken_is_named():
    with SIM.spawn(socketcand_port=0, terminals=0) as sim, pytest.raises(SimStartError) as caught:
        SIM.spawn(host=sim.host, socketcand_port=sim.ports["socketcand"])
    assert f"socketcand port {sim.host}:{sim.ports['socketcand']}" in str(caught.value)


def test_an_interface_that_the_kernel_does_not_have_is_refused():
    with pytest.raises(SimStartError, match="cannot join vcan99"):
        SIM.spawn(socketcand_port=0, interface="vcan99")


def test_terminals_can_have_links(tmp_path):
    link = tmp_path / "ttyCAN"
    with SIM.spawn(socketcand_port=0, terminals=2, link=str(link)) as sim:
        assert os.path.realpath(link) == sim.ttys["slcan"]
        assert os.path.realpath(f"{link}-2") == sim.ttys["slcan-2"]
    assert not os.path.lexists(link)


def test_the_hints_connect(tmp_path):
    with SIM.spawn(socketcand_port=0) as sim:
        lines = [line.partition(":")[2].split(", or ")[0].strip() for line in sim.hints]
        assert len(lines) == 3
        for line in lines:
            eval(line, {"can": can}).shutdown()


# In the process of another program


@pytest.fixture
def hub():
    with Hub(bitrate=1_000_000) as made:
        yield made


def steps(hub, condition):
    deadline = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        hub.step(time.monotonic() + 0.01)


def test_nodes_of_one_process_hear_each_other_but_not_themselves(hub):
    got = {"a": [], "b": [], "c": []}
    nodes = {name: hub.attach(lambda *f, n=name: got[n].append(f), name) for name in got}
    assert nodes["a"].send(0x123, b"xyz") == 0
    assert nodes["b"].send(0x1 | frames.EXTENDED) == 0
    steps(hub, lambda: len(got["c"]) == 2)
    x, y = (0x123, b"xyz"), (0x1 | frames.EXTENDED, b"")
    assert (got["a"], got["b"], got["c"]) == ([y], [x], [y, x])
    nodes["a"].detach()
    nodes["b"].send(0x5)
    steps(hub, lambda: len(got["c"]) == 3)
    assert got["a"] == [y]


@pytest.mark.parametrize("bitrate", [0, 1_000_000])
def test_every_frame_is_counted_once_for_everybody_who_hears_it(bitrate):
    with Hub(bitrate=bitrate) as hub:
        first, second = hub.attach(lambda *_: None, "a"), hub.attach(lambda *_: None, "b")

        def send_and_count():
            before = hub.frame_count
            assert first.send(0x123) == 0
            steps(hub, lambda: hub.frame_count > before)
            nodes = hub.status()["nodes"].values()
            return [(node["sent"], node["received"]) for node in nodes]

        assert send_and_count() == [(1, 0), (0, 1)]
        second.interests = {0x7}  # is not given the frame, and hears it
        assert send_and_count() == [(2, 0), (0, 2)]
        first.echo = True
        assert send_and_count() == [(3, 1), (0, 3)]
        hub.attach(lambda *_: None, "c")
        assert first.send(0x123) == 0
        steps(hub, lambda: hub.frame_count == 4)
        hub.attach(lambda *_: None, "d")  # which has not heard it
        assert send_and_count() == [(5, 3), (0, 5), (0, 2), (0, 1)]


@pytest.mark.parametrize("bitrate", [0, 1_000_000])
def test_an_answer_comes_after_the_question_for_everybody(bitrate):
    with Hub(bitrate=bitrate) as hub:
        seen = []
        hub.attach(lambda can_id, data: answering.send(0x581) if can_id == 0x601 else 0, "first")
        answering = hub.attach(lambda *_: None, "answering")
        hub.attach(lambda can_id, data: seen.append(can_id), "last")
        hub.attach(lambda *_: None, "asking").send(0x601)
        steps(hub, lambda: len(seen) == 2)
        assert seen == [0x601, 0x581]


def test_a_full_queue_and_an_interface_that_is_down_are_told_to_the_sender():
    with Hub(bitrate=10_000, queue=3) as hub:
        node = hub.attach(lambda *_: None, "drive")
        assert [node.send(0x1, bytes(8)) for _ in range(4)] == [0, 0, 0, errno.ENOBUFS]
        hub.set_state(node, State.DOWN)
        assert node.send(0x1) == errno.ENETDOWN
        assert hub.waiting(node) == 0
        hub.set_state(node, State.LISTEN_ONLY)
        assert node.send(0x1) == 0
        assert node.counters.lost == 6


@pytest.mark.parametrize(
    ("can_id", "data", "complaint"),
    [(0x123, bytes(9), "at most 8"), (0x800, b"", "extended"), (frames.ERROR, b"", "error frame")],
)
def test_what_can_does_not_have_is_refused(hub, can_id, data, complaint):
    with pytest.raises(ValueError, match=complaint):
        hub.attach(lambda *_: None).send(can_id, data)


def test_timers_are_called_in_order_unless_cancelled(hub):
    called = []
    now = time.monotonic()
    for name, after in (("late", 0.02), ("never", 0.01), ("early", 0.005), ("past", -1.0)):
        timer = hub.call_at(now + after, lambda name=name: called.append(name))
        if name == "never":
            timer.cancel()
    steps(hub, lambda: "late" in called)
    assert called == ["past", "early", "late"]
    assert time.monotonic() >= now + 0.02


def test_two_nodes_that_answer_each_other_do_not_keep_others_out():
    """At no bit rate an endless exchange takes no time at all; sockets still have their turn."""
    with Hub() as hub:
        ping = hub.attach(lambda can_id, data: pong.send(0x2) if can_id == 0x1 else 0, "ping")
        pong = hub.attach(lambda can_id, data: ping.send(0x1) if can_id == 0x2 else 0, "pong")
        door = hub.open_socketcand("127.0.0.1", 0)
        ping.send(0x2)
        with socket.create_connection(("127.0.0.1", door.port), LONG) as client:
            client.setblocking(False)
            greeting = []

            def greeted():
                try:
                    greeting.append(client.recv(100))
                except BlockingIOError:
                    return False
                return True

            steps(hub, greeted)
            assert greeting == [b"< hi >"]


class Lamp:
    """A device on the bus, with a fault of its own."""

    def __init__(self, hub):
        self.kinds = {"broken": FaultKind("broken", "it says nothing", lasting=True)}
        self.events = ("switched_on",)
        self.places = ()
        self.broken = False
        self.node = hub.attach(self._take, "lamp")
        self.handlers = {"glow": lambda: "bright"}

    def _take(self, can_id, data):
        if not self.broken:
            self.node.send(can_id + 1, data)

    def begin(self, fault):
        self.broken = True

    def end(self, fault):
        self.broken = False

    def status(self):
        return {"broken": self.broken}


def test_devices_share_the_faults_and_the_control_socket_of_their_hub(tmp_path):
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {when: switched_on, kind: broken}\n- {at: 1000, kind: drop}\n")
    config = SimConfig(socketcand_port=0, terminals=0, faults=str(faults))
    server = HubServer(config, devices=Lamp)
    try:
        server._faults.handlers["inject"]("broken", {})
        assert server.status()["broken"]
        server._faults.handlers["inject"]("drop", {"id": 5})
        server._faults.handlers["clear"]("broken")
        assert [fault["kind"] for fault in server.status()["faults"]] == ["drop"]
        assert not server.status()["broken"]
    finally:
        server.close()


def test_a_hub_can_run_in_a_thread_beside_its_client(tmp_path):
    path = str(tmp_path / "bus.sock")
    with Hub() as hub:
        hub.open_socket(path)
        node = hub.attach(lambda can_id, data: node.send(can_id + 1, data), "echo")
        thread = threading.Thread(target=hub.run)
        thread.start()
        try:
            with can.Bus(interface="crtk", channel=path) as bus:
                bus.send(frame(0x10))
                assert ids(receive(bus)) == [0x11]
            eventually(lambda: len(hub.nodes) == 1)
        finally:
            hub.stop()
            thread.join()
