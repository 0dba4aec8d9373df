"""A NetFT sensor whose web server or TCP channel is broken, hostile or gone: what the driver makes of it."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.errors import ConnectionFailed, DeviceError, ProtocolError
from crtk_drivers.state import OperatingState
from crtk_sim_backends.netft import SIM, RunningSim
from crtk_sim_backends.netft.hostile import ANSWERS
from rigs.netft_bench import (
    FREE_PORTS,
    LONG,
    NetFtBench,
    configuration,
    driver_at,
    eventually,
    netft_bench,
)

LOAD = [1.0, -2.0, 3.0, 0.1, -0.2, 0.3]
LOAD_TEXT = "constant:1,-2,3,0.1,-0.2,0.3"
SCALE = {"counts_per_force": 1e6, "counts_per_torque": 1e6}

REFUSED = {
    "entity_bomb": "EntitiesForbidden|DTDForbidden",
    "external_entity": "EntitiesForbidden|DTDForbidden",
    "duplicate_tags": "cfgcpf is there twice",
    "missing_tags": "cfgcpf is missing",
    "unknown_unit": "furlong",
    "no_number": "'many', no number",
    "cut_off": "closed after",
    "no_http": "not HTTP",
    "server_error": "500",
    "endless": "longer than",
    "huge": "longer than",
    "slow": "no complete answer in time",
    "silent": "no complete answer in time",
}
"""What the driver says of each answer."""


@pytest.fixture(scope="module")
def box() -> Iterator[RunningSim]:
    """A Net Box with a load at rest; one for all tests."""
    with SIM.spawn(load=LOAD_TEXT, **FREE_PORTS) as sim:
        yield sim


@pytest.fixture(autouse=True)
def _clear(box: RunningSim) -> Iterator[None]:
    yield
    box.control.clear()


def test_every_hostile_answer_is_expected() -> None:
    assert set(REFUSED) == set(ANSWERS)


@pytest.mark.parametrize("answer", ANSWERS)
def test_a_hostile_page_is_refused_with_its_reason_in_time(box, answer) -> None:
    box.control.inject("web_answer", answer=answer)
    never = REFUSED[answer] == "no complete answer in time"
    pages = WebPages(box.host, box.ports["http"], timeout=0.5 if never else LONG)
    begun = time.monotonic()
    with pytest.raises(DeviceError, match=REFUSED[answer]) as caught:
        pages.read()
    assert time.monotonic() - begun < LONG
    assert isinstance(caught.value, ConnectionFailed | ProtocolError)
    assert box.host in str(caught.value)


@pytest.mark.parametrize("answer", ["entity_bomb", "duplicate_tags", "unknown_unit"])
def test_a_scale_that_is_not_sure_is_never_used(box, answer) -> None:
    """The driver does not measure with it, tries again, and takes the page once it is good."""
    box.control.inject("web_answer", answer=answer)
    bench = NetFtBench(box, configuration(box))
    bench.session.start()
    try:
        eventually(lambda: bench.session.engine.status.detail, "told")
        status = bench.session.engine.status
        assert status.state is not OperatingState.ENABLED
        assert not bench.session.engine.connected
        box.control.clear()
        bench.connected()
        bench.until_load(LOAD)
    finally:
        bench.front.close()


@pytest.mark.parametrize("answer", ["entity_bomb", "silent"])
def test_a_scale_of_the_configuration_stands_in_for_a_bad_page(box, answer) -> None:
    box.control.inject("web_answer", answer=answer)
    with driver_at(box, {"scale": SCALE, "http_timeout": 0.2}) as bench:
        bench.until_load(LOAD)
        assert bench.note("web page")


def test_without_its_web_server_the_scale_comes_over_tcp(box) -> None:
    box.control.inject("closed", port="http")
    with driver_at(box) as bench:
        bench.until_load(LOAD)
        assert bench.note("web page")
        assert bench.counter("lost") == 0.0  # over UDP


def test_a_family_that_was_known_is_not_forgotten_with_the_web_page() -> None:
    with netft_bench({"sample_timeout": 1.0}, profile="axia", load=LOAD_TEXT) as bench:
        assert bench.note("web page") is None
        bench.sim.control.inject("closed", port="http")
        bench.sim.control.inject("stall")
        bench.was(OperatingState.FAULT)
        bench.sim.control.clear("stall")
        eventually(lambda: bench.front.health().reconnects >= 1, "reconnected")
        bench.connected()
        assert bench.device.profile.name == "axia"
        bench.sim.control.inject("status", bits=0x00000008)
        eventually(lambda: bench.note("notice"), "told")
        assert "busy" in bench.note("notice")[1]


def test_a_family_that_is_not_known_is_told() -> None:
    with netft_bench(preset="hex_e", load=LOAD_TEXT) as bench:
        bench.until_load(LOAD, tolerance=1e-4)
        notes = [note.text for note in bench.front.health().notes if note.key == "web page"]
        assert any("counts as netbox: give `profile`" in text for text in notes)


def test_a_page_in_single_bytes_is_read(box) -> None:
    box.control.inject("split", port="http", size=500)
    with driver_at(box) as bench:
        bench.until_load(LOAD)
        assert bench.device.info.serial == "SIM00001"


def test_settings_that_the_box_does_not_keep_are_an_error(box) -> None:
    box.control.inject("settings_ignored")
    config = {"sensor": {"rdt_rate": 500}}
    bench = NetFtBench(box, configuration(box, **config))
    bench.session.start()
    try:
        eventually(lambda: "rdt_rate" in bench.session.engine.status.detail, "told")
        assert not bench.session.engine.connected
        box.control.clear()
        bench.connected()
        assert box.control.status()["rdt_rate"] == 500
    finally:
        bench.front.close()


def test_a_stream_that_is_switched_off_in_the_sensor_is_told(box) -> None:
    WebPages(box.host, box.ports["http"]).write("comm.cgi", {"comrdte": 0})
    bench = NetFtBench(box, configuration(box, transport="udp"))
    bench.session.start()
    try:
        eventually(
            lambda: "switched off in the sensor" in bench.session.engine.status.detail, "told"
        )
        assert not bench.session.engine.connected
        with driver_at(box) as other:  # which may use TCP
            other.until_load(LOAD, tolerance=0.02)
        WebPages(box.host, box.ports["http"]).write("comm.cgi", {"comrdte": 1})
        bench.connected()
        bench.until_load(LOAD)
    finally:
        WebPages(box.host, box.ports["http"]).write("comm.cgi", {"comrdte": 1})
        bench.front.close()


# TCP instead of UDP.


def test_where_udp_is_blocked_it_measures_over_tcp(box) -> None:
    box.control.inject("deaf")
    with driver_at(box, {"open_timeout": 2.0}) as bench:
        bench.until_load(LOAD, tolerance=0.02)


@pytest.mark.parametrize("kind", ["silence", "no_answer", "disconnect", "closed"])
def test_a_tcp_channel_that_fails_is_a_fault_and_comes_back(box, kind) -> None:
    with driver_at(box, {"transport": "tcp"}) as bench:
        bench.until_load(LOAD, tolerance=0.02)
        bench.front.enable()
        box.control.inject(kind, port="tcp")
        if kind == "no_answer":  # concerns new connections only
            box.control.inject("disconnect", port="tcp", duration=0.1)
        bench.was(OperatingState.FAULT)
        box.control.clear()
        eventually(lambda: bench.front.health().reconnects >= 1, "reconnected")
        bench.connected()
        bench.until_load(LOAD, tolerance=0.02)
        bench.front.enable()


def test_tcp_answers_in_single_bytes_are_read(box) -> None:
    box.control.inject("split", port="tcp", size=1)
    with driver_at(box, {"transport": "tcp"}) as bench:
        bench.until_load(LOAD, tolerance=0.02)


def test_saturation_is_seen_over_tcp(box) -> None:
    with driver_at(box, {"transport": "tcp"}) as bench:
        box.control.inject("saturation", axis=0)
        eventually(lambda: bench.note("saturation"), "told")
