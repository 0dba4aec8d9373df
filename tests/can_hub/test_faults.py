"""Faults of the bus and of interfaces, as clients at its doors meet them."""

import errno
import time

import can
import pytest

from crtk_sim_backends.can import SIM
from crtk_sim_backends.control import ControlError
from crtk_sim_backends.process import SimStartError
from rigs.can_hub_doors import drain, frame, ids, open_bus, receive
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(socketcand_port=0, bitrate=1_000_000) as running:
        yield running


@pytest.fixture
def pair(sim):
    with open_bus(sim, "crtk", name="native-a") as a, open_bus(sim, "crtk", name="native-b") as b:
        yield a, b
        sim.control.clear()
    eventually(lambda: not any(name.startswith("native") for name in nodes(sim)))


def nodes(sim):
    return sim.control.status()["nodes"]


def sent_through(pair, messages, marker=0x7EF):
    """What the second bus gets of `messages` from the first one."""
    one, other = pair
    for message in [*messages, frame(marker, b"")]:
        one.send(message, timeout=LONG)
    return drain(other, marker)


def numbered(count, can_id=0x200):
    return [frame(can_id, bytes([n])) for n in range(count)]


def test_drop_loses_every_nth_frame_that_matches(sim, pair):
    sim.control.inject("drop", id=0x200, every=3)
    got = sent_through(pair, [*numbered(9), *numbered(3, 0x201)])
    assert [(m.arbitration_id, m.data[0]) for m in got] == [
        *((0x200, n) for n in (0, 1, 3, 4, 6, 7)),
        *((0x201, n) for n in range(3)),
    ]
    sim.control.clear("drop")
    assert len(sent_through(pair, numbered(9))) == 9


def test_a_mask_selects_a_range_of_identifiers(sim, pair):
    sim.control.inject("drop", id=0x180, mask=0x780)
    got = sent_through(pair, [frame(can_id) for can_id in (0x17F, 0x180, 0x1FF, 0x200)])
    assert ids(got) == [0x17F, 0x200]


def test_a_pattern_selects_the_sender(sim, pair):
    sim.control.inject("drop", sender="native-b")
    a, b = pair
    b.send(frame(0x1))
    assert len(sent_through(pair, numbered(2))) == 2
    b.send(frame(0x2))
    eventually(lambda: nodes(sim)["native-b"]["lost"] == 2)
    sim.control.clear()
    b.send(frame(0x3))
    assert ids(receive(a)) == [0x3]


def test_duplicate_sends_twice(sim, pair):
    sim.control.inject("duplicate", id=0x200, every=2)
    assert [m.data[0] for m in sent_through(pair, numbered(4))] == [0, 1, 1, 2, 3, 3]


@pytest.mark.parametrize(
    ("effect", "data"), [("lost", [0, 2, 3]), ("doubled", [0, 1, 1, 2, 3]), ("late", [0, 2, 3, 1])]
)
def test_a_single_message_is_hit_and_no_other(sim, pair, effect, data):
    sim.control.inject("message", id=0x200, number=2, effect=effect, seconds=1.0)
    got = [m.data[0] for m in sent_through(pair, numbered(4))]
    if effect == "late":
        got += [m.data[0] for m in receive(pair[1])]
    assert got == data


def test_delay_lets_other_frames_pass(sim, pair):
    sim.control.inject("delay", id=0x200, seconds=1.0)
    assert sent_through(pair, numbered(2)) == []
    assert [m.data[0] for m in receive(pair[1], 2)] == [0, 1]


def test_corrupt_changes_one_bit_of_the_data(sim, pair):
    sim.control.inject("corrupt", id=0x200, every=2, seed=3)
    got = sent_through(pair, [frame(0x200, bytes(8))] * 6)
    assert [sum(byte.bit_count() for byte in m.data) for m in got] == [0, 1] * 3
    sim.control.inject("corrupt", id=0x200, every=2, seed=3)
    assert [m.data for m in sent_through(pair, [frame(0x200, bytes(8))] * 6)] == [
        m.data for m in got
    ]


def test_corrupt_changes_one_bit_of_the_identifier(sim, pair):
    sim.control.inject("corrupt", id=0x200, what="id")
    got = sent_through(pair, numbered(5))
    assert [(m.arbitration_id ^ 0x200).bit_count() for m in got] == [1] * 5
    assert [m.data[0] for m in got] == list(range(5))


def refused(bus):
    with pytest.raises(can.CanOperationError) as caught:
        bus.send(frame())
    return caught.value.error_code


def test_bus_off_is_an_error_frame_and_no_buffer_space_until_the_restart(sim, pair):
    a, b = pair
    sim.control.inject("bus_off", node="native-a")
    (message,) = receive(a)
    assert message.is_error_frame
    assert message.arbitration_id == 0x40
    assert a.state is can.BusState.ERROR
    assert refused(a) == errno.ENOBUFS
    b.send(frame(0x100))
    eventually(lambda: nodes(sim)["native-b"]["sent"] == 1)
    sim.control.clear("bus_off")
    b.send(frame(0x101))
    restarted, got = receive(a, 2)
    assert restarted.is_error_frame
    assert restarted.arbitration_id == 0x100
    assert got.arbitration_id == 0x101
    assert a.state is can.BusState.ACTIVE
    a.send(frame(0x102))
    assert ids(receive(b)) == [0x102]


def test_down_ends_a_wait_and_refuses_to_send_until_it_is_up(sim, pair):
    a, b = pair
    sim.control.inject("down", node="native-a")
    with pytest.raises(can.CanOperationError, match="went down") as caught:
        a.recv(LONG)
    assert caught.value.error_code == errno.ENETDOWN
    assert refused(a) == errno.ENETDOWN
    assert a.recv(0.01) is None
    sim.control.clear()
    b.send(frame(0x5))
    assert ids(receive(a)) == [0x5]
    a.send(frame(0x6))
    assert ids(receive(b)) == [0x6]


def test_full_refuses_to_send_and_lets_a_patient_sender_wait(sim, pair):
    a, b = pair
    sim.control.inject("full", node="native-a")
    assert refused(a) == errno.ENOBUFS
    b.send(frame(0x5))
    assert ids(receive(a)) == [0x5]
    sim.control.inject("full", node="native-a", duration=0.05)
    a.send(frame(0x6), timeout=LONG)
    assert ids(receive(b)) == [0x6]


def test_listen_only_loses_what_is_sent_without_a_word(sim, pair):
    a, b = pair
    sim.control.inject("listen_only", node="native-a")
    assert sent_through((b, a), numbered(2)) != []
    a.send(frame(0x6))
    eventually(lambda: nodes(sim)["native-a"]["lost"] == 1)
    sim.control.clear()
    a.send(frame(0x7))
    assert ids(receive(b)) == [0x7]


def test_error_passive_is_told_and_changes_nothing_else(sim, pair):
    a, b = pair
    sim.control.inject("error_passive", node="native-a")
    (message,) = receive(a)
    assert (message.is_error_frame, message.arbitration_id) == (True, 0x4)
    assert message.data[1] == 0x30
    assert a.state is can.BusState.PASSIVE
    a.send(frame(0x7))
    assert ids(receive(b)) == [0x7]


def test_a_babbling_node_takes_the_bus(sim, pair):
    sim.control.inject("babbling", id=0x10, rate=500, length=2)
    got = receive(pair[1], 20)
    assert set(ids(got)) == {0x10}
    assert "babbling" in nodes(sim)
    sim.control.clear()
    assert "babbling" not in nodes(sim)
    pair[0].send(frame(0x7EF, b""))
    drain(pair[1])


def test_the_highest_priority_at_full_rate_starves_the_others():
    """5000 frames/s are far above 20 kbit/s: nobody else wins an arbitration."""
    with (
        SIM.spawn(socketcand_port=0, terminals=0, bitrate=20_000, queue=100) as sim,
        open_bus(sim, "crtk", name="native-a") as a,
    ):
        sim.control.inject("babbling", id=0, rate=5000, length=8)
        eventually(lambda: nodes(sim)["babbling"]["waiting"] == 100)
        for _ in range(100):
            a.send(frame(0x1))
        eventually(lambda: nodes(sim)["native-a"]["waiting"] == 100)
        assert refused(a) == errno.ENOBUFS
        assert nodes(sim)["native-a"]["sent"] == 0
        eventually(lambda: sim.control.status()["load"] > 0.5)
        sim.control.clear()
        eventually(lambda: nodes(sim)["native-a"]["sent"] > 0)


def test_a_frame_on_its_way_into_the_queue_is_counted_once():
    """Room for two takes two, whenever the second one is sent."""
    with SIM.spawn(socketcand_port=0, terminals=0, bitrate=20_000, queue=2) as sim:
        sim.control.inject("babbling", id=0, rate=5000, length=8)
        eventually(lambda: nodes(sim)["babbling"]["waiting"] == 2)
        for turn in range(300):
            with open_bus(sim, "crtk", name=f"native-{turn}") as bus:
                bus.send(frame(0x1))
                later = time.perf_counter() + turn * 2e-6  # another moment in each turn
                while time.perf_counter() < later:
                    pass
                bus.send(frame(0x1))


@pytest.mark.parametrize(("what", "number"), [("protocol", 0x88), ("no_ack", 0xA0)])
def test_error_frames_reach_everybody(sim, pair, what, number):
    sim.control.inject("error_frames", rate=200, what=what)
    with open_bus(sim, "socketcand") as other:
        for bus in (*pair, other):
            (message,) = receive(bus)
            assert message.is_error_frame
            assert message.arbitration_id == number
    assert sim.control.status()["error_frames"] > 0


def test_an_adapter_refuses_frames_and_reports_bus_off_in_its_flags(sim):
    with open_bus(sim, "slcan") as bus:
        sim.control.inject("bus_off", node="slcan")
        bus.send(frame())
        bus._write("F")
        answers = []
        while not answers or not answers[-1].startswith("F"):
            answers.append(bus._read(LONG))
        sim.control.clear()
        assert answers[-2:] == ["\a", "F80\r"]


def test_a_client_that_comes_later_meets_the_fault_too(sim):
    sim.control.inject("down", node="native*")
    try:
        with can.Bus(interface="crtk", channel=sim.paths["crtk"]) as bus:
            assert refused(bus) == errno.ENETDOWN
    finally:
        sim.control.clear()


def test_the_status_names_the_faults_and_clearing_ends_them(sim):
    sim.control.inject("drop", id=0x200)
    sim.control.inject("drop", id=0x201)
    sim.control.inject("drop", id=0x201, every=2)
    faults = sim.control.status()["faults"]
    assert [(fault["kind"], fault["id"], fault["every"]) for fault in faults] == [
        ("drop", 0x200, 1),
        ("drop", 0x201, 2),
    ]
    sim.control.clear()
    assert sim.control.status()["faults"] == []


@pytest.mark.parametrize(
    ("kind", "parameters", "complaint"),
    [
        ("dropp", {}, "did you mean 'drop'"),
        ("drop", {"evry": 2}, "did you mean 'every'"),
        ("delay", {}, "needs the parameter 'seconds'"),
        ("corrupt", {"what": "crc"}, "unknown what 'crc'"),
        ("babbling", {"id": 0x800}, "must lie in"),
        ("bus_off", {"node": 3}, "node must be str"),
    ],
)
def test_a_wrong_fault_is_refused_with_the_reason(sim, kind, parameters, complaint):
    with pytest.raises(ControlError, match=complaint):
        sim.control.inject(kind, **parameters)
    assert sim.control.status()["faults"] == []


def test_a_fault_file_plays_at_its_time_and_at_events(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "- {when: first_frame, kind: drop, id: 0x100}\n- {at: 0, kind: duplicate, id: 0x300}\n"
    )
    with (
        SIM.spawn(socketcand_port=0, terminals=0, faults=str(path)) as sim,
        open_bus(sim, "crtk") as a,
        open_bus(sim, "crtk") as b,
    ):
        eventually(lambda: len(sim.control.status()["faults"]) == 1)
        a.send(frame(0x100))
        assert ids(receive(b)) == [0x100]
        eventually(lambda: len(sim.control.status()["faults"]) == 2)
        assert ids(sent_through((a, b), [frame(0x100), frame(0x300)])) == [0x300, 0x300]


def test_a_wrong_fault_file_is_refused_with_its_line(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("# nothing\n- {at: 0, kind: bus_of}\n")
    with pytest.raises(SimStartError, match=r"line 2: unknown kind of fault 'bus_of'"):
        SIM.spawn(socketcand_port=0, faults=str(path))
