"""Whatever a simulated sensor box is asked for, it answers, keeps its pages sound, and measures on."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_sim_backends.netft.http import HttpSession
from crtk_sim_backends.netft.pages import sensor_page
from crtk_sim_backends.netft.settings import PAGES
from crtk_sim_backends.netft.tcp import TcpSession
from rigs.examples import examples
from rigs.netft_clients import VirtualBox, tags

VARIABLES = sorted({name for page in PAGES.values() for name in page})
NUMBERS = st.one_of(
    st.integers().map(str),
    st.floats().map(str),
    st.integers(0, 2**33).map(hex),
    st.sampled_from(["", "-", "1e999", "0x", "\u0661", "Enabled"]),
)
PAIRS = st.lists(
    st.tuples(
        st.builds(
            lambda name, index: f"{name}{index}",
            st.sampled_from([*VARIABLES, "cfgid", "other"]),
            st.sampled_from(["", *range(17), -1, "9" * 30]),
        ),
        st.one_of(NUMBERS, st.text(max_size=50)),
    ),
    max_size=8,
)
PROFILES = st.sampled_from(["netbox", "axia", "schunk"])


def check(box: VirtualBox) -> None:
    """The page is sound XML with every tag once, and a stream is right."""
    page = sensor_page(box.box, None, "127.0.0.1", box.now)
    ET.fromstring(page.encode())
    found = tags(page)
    assert 1 <= int(found["comrdtrate"]) <= int(found["runrate"])
    assert 1 <= int(found["comrdtbsiz"]) <= 40
    assert len(found["cfgtfx"].split(";")) == 6
    box.write("comm.cgi", comrdte=1)
    box.ask(2, 3)
    seconds = 3.1 * box.box.settings.divisor / box.box.settings.internal_rate
    assert [r.rdt for r in box.run(seconds)] == [1, 2, 3]


@given(PROFILES, st.lists(st.tuples(st.sampled_from(sorted(PAGES)), PAIRS), max_size=4))
def test_any_setting(profile, requests):
    box = VirtualBox(profile=profile, load="sine:2,500,3")
    for page, pairs in requests:
        assert box.box.write_page(page, pairs)
        box.box.settle(box.now)
        box.run(0.05)
    check(box)


@given(st.lists(st.binary(min_size=1, max_size=60), max_size=20))
def test_any_tcp_bytes(pieces):
    box = VirtualBox()
    session = TcpSession(box.box, "client", lambda: box.now)
    for piece in pieces:
        session.receive(piece)
        box.box.settle(box.now)
        box.run(0.01)
    check(box)


@given(st.integers(0, 4), st.binary(min_size=19, max_size=19))
def test_any_tcp_request(command, rest):
    box = VirtualBox(load="constant:fz=10")
    session = TcpSession(box.box, "client", lambda: box.now)
    answer = session.receive(bytes([command]) + rest)
    assert len(answer) == {0: 16, 1: 24}.get(command, 4)
    box.box.settle(box.now)
    box.run(0.05)
    check(box)


@given(st.one_of(st.binary(max_size=200), st.text(max_size=100).map(str.encode)))
def test_any_http_bytes(data):
    box = VirtualBox()
    for before in (
        b"",
        b"GET /",
        b"GET /setting.cgi?",
        b"GET /config.cgi?cfgid=0&cfgnam=",
        b"GET /comm.cgi?page=1&port=2&now=",
    ):
        session = HttpSession(box.box, "127.0.0.1", "client", lambda: box.now, None)
        answer = session.receive(before + data + b" HTTP/1.0\r\n\r\n")
        assert answer.startswith(b"HTTP/1.0 ")
        assert session.ended
        box.box.settle(box.now)
    check(box)


@settings(max_examples=examples(30))
@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 2**32 - 1)), max_size=10))
def test_any_rdt_requests(requests):
    box = VirtualBox(profile="onrobot")
    for command, count in requests:
        box.ask(command, count)
        box.run(0.01)
    box.ask(2, 3)
    assert len(box.run(10.0)) == 3
