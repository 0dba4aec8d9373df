"""The simulated sensor box on its ports: UDP, web pages, TCP, faults, process."""

from __future__ import annotations

import os
import socket
import struct
import time
import urllib.error
from collections.abc import Iterator
from itertools import pairwise

import pytest

from crtk_sim_backends.control import ControlError
from crtk_sim_backends.netft import SIM, ConfigError, RunningSim, SimStartError
from crtk_sim_backends.netft.injection import KINDS
from rigs.netft_clients import FREE_PORTS, RdtClient, ask_tcp, page, request, tags
from rigs.waiting import LONG, eventually

LOAD = "constant:1,-2,3,0.1,-0.2,0.3"
COUNTS = (1_000_000, -2_000_000, 3_000_000, 100_000, -200_000, 300_000)


@pytest.fixture(scope="module")
def box() -> Iterator[RunningSim]:
    with SIM.spawn(load=LOAD, **FREE_PORTS) as sim:
        yield sim


@pytest.fixture(autouse=True)
def _clear(box) -> Iterator[None]:
    yield
    box.control.clear()
    page(box, "setting.cgi?setbias0=0&setbias1=0&setbias2=0&setbias3=0&setbias4=0&setbias5=0")


@pytest.fixture
def client(box) -> Iterator[RdtClient]:
    with RdtClient(box) as client:
        yield client
        client.ask(0)


# UDP.


def test_a_stream(client):
    client.ask(2)
    found = client.take(100)
    assert [r.rdt for r in found] == list(range(1, 101))
    assert {r.counts for r in found} == {COUNTS}


@pytest.mark.parametrize(
    "data", [b"", b"\x12\x34", b"\x12\x35" + request(2)[2:], request(2) + b"\0"]
)
def test_what_is_no_request_is_ignored(client, data):
    client.send(data)
    assert client.silent()
    client.ask(2, 3)
    assert len(client.take(3)) == 3


def test_another_client_steals_the_stream(box, client):
    client.ask(2)
    client.take(10)
    with RdtClient(box) as thief:
        thief.ask(2)
        assert thief.take(10)[0].rdt == 1
        client.until_silent(0.02)
        assert client.silent()
        thief.ask(0)


def test_the_fastest_stream_has_no_gap():
    with SIM.spawn(profile="axia", rdt_rate=0, **FREE_PORTS) as sim, RdtClient(sim) as client:
        client.ask(2)
        found = client.take(4000)
        assert [r.rdt for r in found] == list(range(1, 4001))
        assert found[-1].ft - found[0].ft == 3999


def test_nothing_is_made_up_for_after_a_stand_still(box, client):
    client.ask(2)
    before = client.take(10)[-1]
    box.suspend()
    time.sleep(1.3)
    box.resume()
    client.take(20)
    after = client.take(1)[0]
    assert after.rdt - before.rdt < 1000
    assert after.ft - before.ft < 7000


def test_what_was_asked_in_a_stand_still_is_done_after_it(box, client):
    client.ask(2)
    before = client.take(10)[-1]
    box.suspend()
    time.sleep(1.3)
    client.until_silent(0.02)
    client.ask(2)
    box.resume()
    found = client.take(200)
    begin = next(index for index, record in enumerate(found) if record.rdt == 1)
    series = [record.rdt for record in found[begin:]]
    assert series == list(range(1, len(series) + 1))
    assert len(series) > 100
    assert found[-1].ft - before.ft < 7000


# The web pages.


TAGS = """
runstat runft runpkmx runpkmn runsg runmcb runmco runmcl runrate setcfgsel setuserfilter setpke setbias setmce
mce mcx mcc mcv mco cfgnam cfgcalsel cfgcalsn cfgfu scfgfu cfgtu scfgtu cfgcpf cfgcpt cfgmr cfgtdu scfgtdu
cfgtau scfgtau cfgtfx cfgusra cfgusrb comnetdhcp comnetip comnetmsk comnetgw comrdte comrdtrate comrdtbsiz
comrdtmsyn comeipe nethwaddr netip mfgdigsn mfgdigver prodname
"""


def test_the_page_has_every_tag_of_the_manual_once(box):
    found = tags(page(box, "netftapi2.xml"))
    assert set(TAGS.split()) <= set(found)
    assert found["runft"] == "1000000;-2000000;3000000;100000;-200000;300000"
    assert found["cfgmr"] == "330;330;990;30;30;30"
    assert (found["cfgcpf"], found["scfgfu"], found["scfgtu"]) == ("1000000", "N", "Nm")
    assert (found["comrdte"], found["comeipe"]) == ("Enabled", "Disabled")


def test_an_axia_has_tags_of_its_own():
    with SIM.spawn(profile="axia", **FREE_PORTS) as sim:
        found = tags(page(sim, "netftapi2.xml"))
        assert (found["setrate"], found["runrate"]) == ("7812", "7912")
        assert "setiirshift" in found


def test_an_onrobot_box_has_the_one_page_that_a_client_asks_for():
    """As the ROS 2 driver net_ft_driver does at its start: the scale, and nothing else."""
    with SIM.spawn(profile="onrobot", **FREE_PORTS) as sim:
        found = tags(page(sim, "netftcalapi.xml"))
        assert (found["calcpf"], found["calcpt"]) == ("10000", "100000")
        for other in ("netftapi2.xml", "setting.cgi?setbias0=1", "comm.cgi?comrdtrate=1"):
            with pytest.raises(urllib.error.HTTPError, match="404") as caught:
                page(sim, other)
            caught.value.close()


def test_the_calibration_page(box):
    found = tags(page(box, "netftcalapi.xml?index=0"))
    assert (found["calsn"], found["calpn"], found["calcpf"]) == ("FT27462", "SI-330-30", "1000000")


@pytest.mark.parametrize(
    ("path", "tag", "value"),
    [
        ("comm.cgi?comrdtrate=150", "comrdtrate", "152"),
        ("comm.cgi?comrdtrate=99999", "comrdtrate", "7000"),
        ("comm.cgi?comrdtrate=0", "comrdtrate", "1"),
        ("comm.cgi?comrdtrate=1000", "comrdtrate", "1000"),
        ("comm.cgi?comrdtrate=fast", "comrdtrate", "1000"),
        ("comm.cgi?comrdtbsiz=99", "comrdtbsiz", "40"),
        ("comm.cgi?comrdtbsiz=10", "comrdtbsiz", "10"),
        ("comm.cgi?commrdtrate=500", "comrdtrate", "1000"),
        ("setting.cgi?setuserfilter=7", "setuserfilter", "7"),
        ("setting.cgi?setuserfilter=77", "setuserfilter", "12"),
        ("setting.cgi?setuserfilter=0", "setuserfilter", "0"),
        ("setting.cgi?setcfgsel=3", "setcfgsel", "3"),
        ("setting.cgi?setcfgsel=0", "setcfgsel", "0"),
        ("setting.cgi?setpke=1", "setpke", "Enabled"),
        ("setting.cgi?setpke=0", "setpke", "Disabled"),
        ("setting.cgi?setbias0=100", "setbias", "100;0;0;0;0;0"),
        ("config.cgi?cfgid=0&cfgnam=" + "x" * 40, "cfgnam", "x" * 32),
        ("config.cgi?cfgnam=refused", "cfgnam", "x" * 32),
        ("config.cgi?cfgid=0&cfgnam=%3Cb%3E&cfgusra=a", "cfgnam", "&lt;b&gt;"),
        ("config.cgi?cfgid=0&cfgtfx2=132.71", "cfgtfx", "0;0;132.71;0;0;0"),
        ("config.cgi?cfgid=0&cfgtfx2=0&cfgnam=Simulated", "cfgtfx", "0;0;0;0;0;0"),
        ("moncon.cgi?mcx5=2&mcv5=-7&mcc5=-1", "mcv", "0;0;0;0;0;-7;0;0;0;0;0;0;0;0;0;0"),
        ("moncon.cgi?mcx5=-1&mcv5=0&mcc5=1", "mcv", ";".join("0" * 16)),
    ],
)
def test_what_is_written_reads_back_clamped_and_rounded(box, path, tag, value):
    assert "<html>" in page(box, path)
    assert tags(page(box, "netftapi2.xml"))[tag] == value


def test_another_configuration_can_be_read(box):
    page(box, "config.cgi?cfgid=4&cfgnam=other&cfgfu=1")
    found = tags(page(box, "netftapi2.xml?index=4"))
    assert (found["cfgnam"], found["scfgfu"]) == ("other", "lbf")
    assert tags(page(box, "netftapi2.xml"))["scfgfu"] == "N"


@pytest.mark.parametrize("path", ["nothing.htm", "other.cgi?a=1"])
def test_other_pages_are_not_found(box, path):
    with pytest.raises(urllib.error.HTTPError, match="404") as caught:
        page(box, path)
    caught.value.close()


def test_anything_but_get_is_refused(box):
    with socket.create_connection((box.host, box.ports["http"]), LONG) as peer:
        peer.sendall(b"POST / HTTP/1.0\r\n\r\n")
        assert peer.recv(1000).startswith(b"HTTP/1.0 400")


# The TCP channel.


def test_a_reading_and_its_scale(box):
    scale, reading = ask_tcp(box, bytes([1]) + bytes(19), bytes(20))
    assert struct.unpack(">HBBII6H", scale) == (
        0x1234,
        2,
        3,
        10**6,
        10**6,
        *[30214] * 3,
        *[916] * 3,
    )
    header, status, *values = struct.unpack(">HH6h", reading)
    assert (header, status) == (0x1234, 0)
    steps = [30214] * 3 + [916] * 3
    for value, step, count in zip(values, steps, COUNTS, strict=True):
        assert value * step == pytest.approx(count, abs=step / 2 + 1)


def test_a_nano17_has_the_steps_of_the_manual():
    with SIM.spawn(preset="nano17", **FREE_PORTS) as sim:
        (scale,) = ask_tcp(sim, bytes([1]) + bytes(19))
        assert struct.unpack(">HBBII6H", scale)[5:] == (1069,) * 3 + (7630,) * 3


def test_a_reading_can_bias(box):
    (reading,) = ask_tcp(box, struct.pack(">B15xHH", 0, 0, 1))
    assert struct.unpack(">HH6h", reading) == (0x1234, 0, 0, 0, 0, 0, 0, 0)


def test_a_condition_over_tcp_latches_and_is_cleared(box):
    write = struct.pack(">BBBBbh13x", 3, 2, 2, 1, 1, 50)
    answer, reading, cleared = ask_tcp(
        box, write, struct.pack(">B15xHH", 0, 1 << 2, 0), struct.pack(">B15xHH", 0, 0, 2)
    )
    assert answer == struct.pack(">HBB", 0x1234, 3, 0)
    assert struct.unpack(">HH", reading[:4]) == (0x1234, 0x8001)
    page(box, "moncon.cgi?setmce=0&mce2=0")
    (cleared,) = ask_tcp(box, struct.pack(">B15xHH", 0, 0, 2))
    assert struct.unpack(">HH", cleared[:4]) == (0x1234, 0)


def test_a_transform_over_tcp(box):
    ok, wrong = ask_tcp(
        box,
        struct.pack(">BBB6h5x", 2, 3, 1, 0, 0, 1250, 0, 0, 0),
        struct.pack(">BBB6h5x", 2, 9, 1, 0, 0, 0, 0, 0, 0),
    )
    assert ok == struct.pack(">HBB", 0x1234, 2, 0)
    assert wrong == struct.pack(">HBB", 0x1234, 2, 1)
    assert tags(page(box, "netftapi2.xml"))["cfgtfx"] == "0;0;12.5;0;0;0"
    ask_tcp(box, struct.pack(">BBB6h5x", 2, 3, 1, 0, 0, 0, 0, 0, 0))


def test_an_unknown_tcp_command_is_refused(box):
    assert ask_tcp(box, bytes([9]) + bytes(19)) == [struct.pack(">HBB", 0x1234, 9, 1)]


# Faults.


def test_unknown_faults_are_refused_with_a_reason(box):
    for kind, parameters, told in (
        ("los", {}, "did you mean 'loss'"),
        ("loss", {"evry": 3}, "did you mean 'every'"),
        ("loss", {"every": 0}, r"\[1, inf\]"),
        ("status", {}, "needs the parameter 'bits'"),
        ("web_answer", {"answer": "nice"}, "known: "),
        ("reboot", {"duration": 1}, "unknown parameter"),
    ):
        with pytest.raises(ControlError, match=told):
            box.control.inject(kind, **parameters)
    with pytest.raises(ControlError, match="unknown kind"):
        box.control.clear("los")


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_begins_and_ends(box, kind):
    table = KINDS[kind]
    needed = {
        "status": {"bits": 4},
        "push": {"wrench": [1.0] * 6},
        "drift": {"ppm": 10.0},
        "web_answer": {"answer": "slow"},
        "web_tag": {"tag": "cfgfu", "text": "1"},
        "delay": {"seconds": 0.01},
        "reboot": {"seconds": 0.05},
    }
    box.control.inject(kind, **needed.get(kind, {}))
    active = [fault["kind"] for fault in box.control.status()["faults"]]
    assert active == ([kind] if table.lasting else [])
    box.control.clear(kind)
    assert box.control.status()["faults"] == []
    eventually(lambda: not box.control.status()["unreachable"], "reachable")
    with RdtClient(box) as client:
        client.ask(2)
        assert client.take(5)[-1].rdt == 5
        client.ask(0)
    assert ask_tcp(box, bytes(20))
    assert tags(page(box, "netftapi2.xml"))


STREAM_FAULTS = {
    "loss": ({"every": 4}, [1, 2, 3, 5, 6, 7, 9]),
    "duplicate": ({"every": 3}, [1, 2, 3, 3, 4, 5, 6, 6]),
    "late": ({"every": 3, "by": 2}, [1, 2, 4, 5, 3, 7, 8, 6]),
}


@pytest.mark.parametrize("kind", STREAM_FAULTS)
def test_what_the_stream_suffers(box, client, kind):
    parameters, wanted = STREAM_FAULTS[kind]
    box.control.inject(kind, **parameters)
    client.ask(2)
    assert [r.rdt for r in client.take(len(wanted))] == wanted


@pytest.mark.parametrize(
    ("kind", "parameters", "sizes"),
    [
        ("short", {"every": 2, "size": 20}, [36, 20, 36, 20]),
        ("long", {"every": 2, "size": 4}, [36, 40, 36, 40]),
        ("empty", {"every": 2}, [36, 0, 36, 36, 0]),
    ],
)
def test_the_sizes_that_arrive(box, client, kind, parameters, sizes):
    box.control.inject(kind, **parameters)
    client.ask(2)
    assert [len(client.datagram()) for _ in sizes] == sizes


def test_strangers_send_from_elsewhere(box, client):
    box.control.inject("foreign", every=1)
    client.ask(2)
    found = client.take(10)
    assert {99_000_000} in [set(r.counts) for r in found]
    assert COUNTS in [r.counts for r in found]


def test_a_reboot_loses_bias_stream_and_connections(box, client):
    client.ask(2)
    client.take(10)
    client.ask(0x42)
    eventually(lambda: box.control.outputs("bias")["bias"][2] == 3.0, "biased")
    with socket.create_connection((box.host, box.ports["tcp"]), LONG) as peer:
        eventually(lambda: box.control.status()["connections"]["tcp"] == 1, "connected")
        box.control.inject("reboot", seconds=1.0)
        assert box.control.status()["unreachable"]
        peer.settimeout(LONG)
        assert peer.recv(1) == b""
    client.until_silent(0.02)
    assert box.control.status()["stream"] is None
    eventually(lambda: not box.control.status()["unreachable"], "reachable")
    client.ask(2)
    record = client.take(1)[0]
    assert record.rdt == 1
    assert record.counts == COUNTS
    assert record.ft < 7000 * LONG


def test_an_unplugged_box_measures_on_and_hears_nothing(box, client):
    client.ask(2)
    before = client.take(10)[-1]
    box.control.inject("unplugged")
    client.until_silent()
    client.ask(0)  # is never heard
    begun = box.control.outputs("ft_sequence")["ft_sequence"]
    eventually(lambda: box.control.outputs("ft_sequence")["ft_sequence"] > begun + 1400, "measures")
    box.control.clear()
    after = client.take(1)[0]
    assert after.rdt - before.rdt > 200
    assert after.ft - before.ft == 7 * (after.rdt - before.rdt)


def test_a_stalled_box_goes_on_where_it_was(box, client):
    client.ask(2)
    found = client.take(10)
    box.control.inject("stall")
    box.control.call("load", text=LOAD)  # whatever happens to it meanwhile
    found += client.until_silent()
    box.control.clear()
    found += client.take(100)
    assert {after.rdt - before.rdt for before, after in pairwise(found)} == {1}
    assert {after.ft - before.ft for before, after in pairwise(found)} == {7}


def test_a_fault_file_is_played(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text(
        "- {when: stream_started, after: 0.2, kind: status, bits: 4, duration: 1.0}\n"
        "- {at: 0.0, kind: push, wrench: [1, 0, 0, 0, 0, 0]}\n"
    )
    with SIM.spawn(faults=str(path), **FREE_PORTS) as sim, RdtClient(sim) as client:
        client.ask(2)
        found = client.take(1)
        for status in (0, 4):
            while found[-1].status == status:  # datagrams may be lost on the way to who is held up
                found += client.receive()
        sent = [record.rdt for record in found if record.status == 4]
        assert {record.status for record in found} == {0, 4}
        assert 600 < sent[-1] - sent[0] < 1400
        assert found[-1].counts[0] == 1_000_000


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("- {at: 0, kind: los}\n", "line 1.*did you mean 'loss'"),
        ("- {when: rain, kind: loss}\n", "unknown event 'rain'"),
        ("kind: loss\n", "list of entries"),
    ],
)
def test_a_wrong_fault_file_is_refused_at_the_start(tmp_path, text, told):
    path = tmp_path / "faults.yaml"
    path.write_text(text)
    with pytest.raises(SimStartError, match=told):
        SIM.spawn(faults=str(path), **FREE_PORTS)


# The process.


def test_two_boxes_have_the_ports_of_real_ones_side_by_side():
    with SIM.spawn(http_port=0) as first, SIM.spawn(http_port=0) as second:
        assert first.host != second.host
        for sim in (first, second):
            assert (sim.ports["rdt"], sim.ports["tcp"]) == (49152, 49151)
            with RdtClient(sim) as client:
                client.ask(2, 3)
                assert len(client.take(3)) == 3


def test_a_port_in_use_is_told(box):
    with pytest.raises(SimStartError, match=f"{box.host}:{box.ports['rdt']}.*in use"):
        SIM.spawn(host=box.host, rdt_port=box.ports["rdt"], tcp_port=0, http_port=0)


def test_a_wrong_option_is_refused_before_anything_starts():
    with pytest.raises(ConfigError, match="did you mean 'preset'"):
        SIM.spawn(prset="gamma")


def test_it_ends_as_asked_and_its_ports_are_free():
    sim = SIM.spawn(**FREE_PORTS)
    ports = {f"{name}_port": number for name, number in sim.ports.items()}
    assert sim.stop() == 0
    with SIM.spawn(host=sim.host, **ports) as again:
        assert again.ports == sim.ports


def test_it_takes_a_new_load_and_keeps_requests(box, client):
    box.control.call("load", text="constant:fy=7")
    try:
        assert box.control.outputs("counts")["counts"] == [0, 7_000_000, 0, 0, 0, 0]
        with pytest.raises(ControlError, match="unknown load"):
            box.control.call("load", text="constnt")
    finally:
        box.control.call("load", text=LOAD)
    client.ask(2, 1)
    client.take(1)
    last = box.control.trace()[-1]
    assert last["recipe"] == "rdt"
    assert last["values"] == {"command": 2, "count": 1}
    assert box.control.trace(last["number"]) == []


def test_garbage_on_every_port_harms_nobody(box):
    for name in ("tcp", "http", "control"):
        for _ in range(3):
            with socket.create_connection((box.host, box.ports[name]), LONG) as peer:
                peer.sendall(os.urandom(5000))
    with RdtClient(box) as client:
        for size in range(64):
            client.send(os.urandom(size))
        client.ask(2, 3)
        assert len(client.take(3)) == 3
    assert box.running
