"""The simulated sensor box without sockets, in a time of its own: what it measures and sends."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.kit.loads import LOADS
from crtk_sim_backends.netft.config import ConfigError, SimConfig
from crtk_sim_backends.netft.hostile import ANSWERS
from crtk_sim_backends.netft.injection import EVENTS, KINDS
from crtk_sim_backends.netft.rdt import decode
from rigs.netft_clients import VirtualBox, records, request

LOAD = "constant:1,-2,3,0.1,-0.2,0.3"
COUNTS = (1_000_000, -2_000_000, 3_000_000, 100_000, -200_000, 300_000)


def sequences(found):
    return [record.rdt for record in found]


# The stream.


def test_a_request_is_the_one_of_the_manual():
    assert decode(bytes.fromhex("1234000200000000")).command == 2
    extended = decode(bytes.fromhex("1234800200000000E00005806E5A"))
    assert (extended.command, extended.count, extended.to) == (2, 0, ("224.0.5.128", 28250))


@given(st.binary(max_size=40))
def test_anything_else_is_ignored(data):
    found = decode(data)
    if found is not None:
        assert data[:2] == b"\x12\x34"
        assert len(data) in (8, 14)


def test_records_begin_with_one_and_count_up():
    box = VirtualBox(load=LOAD, rdt_rate=0)
    box.run(0.5)
    box.ask(2)
    found = box.run(0.1)
    assert sequences(found) == list(range(1, 701))
    assert [r.ft for r in found] == list(range(3501, 4201))
    assert {r.counts for r in found} == {COUNTS}
    assert {r.status for r in found} == {0}


def test_a_start_begins_anew_and_a_stop_ends():
    box = VirtualBox()
    box.ask(2)
    assert sequences(box.run(0.01))[0] == 1
    box.ask(2)
    assert sequences(box.run(0.01))[0] == 1
    box.ask(0)
    assert box.run(0.1) == []


def test_a_count_ends_by_itself():
    box = VirtualBox()
    box.ask(2, 5)
    assert sequences(box.run(1.0)) == [1, 2, 3, 4, 5]
    assert box.box.stream is None


def test_the_last_one_to_ask_has_the_stream():
    box = VirtualBox()
    box.ask(2, client=1)
    box.run(0.1)
    box.ask(2, client=2)
    assert box.box.stream.to == ("127.0.0.1", 2)
    assert sequences(box.run(0.01))[0] == 1
    assert box.box.counters.takeovers == 1


@pytest.mark.parametrize(
    ("profile", "wanted", "step"),
    [
        ("netbox", 7000, 1),
        ("netbox", 150, 46),
        ("netbox", 1000, 7),
        ("netbox", 1, 7000),
        ("axia", 7912, 1),
        ("axia", 500, 15),
        ("onrobot", 500, 2),
    ],
)
def test_a_rate_is_a_fraction_of_the_internal_one(profile, wanted, step):
    box = VirtualBox(profile=profile, rdt_rate=wanted)
    box.ask(2)
    found = box.run(3.0)
    assert set(np.diff([r.ft for r in found])) == {step}
    assert box.box.settings.rdt_rate >= min(wanted, box.box.settings.internal_rate)
    assert abs(len(found) - 3.0 * box.box.settings.internal_rate / step) <= 1.0


def test_buffered_datagrams_hold_so_many_records():
    box = VirtualBox(rdt_rate=0, buffer_size=40)
    box.ask(3)
    found = box.datagrams(0.1)
    assert {len(data) for data in found} == {1440}
    assert len(found) == 700 // 40
    assert sequences(records(b"".join(found))) == list(range(1, 681))


def test_the_last_datagram_of_a_count_may_be_smaller():
    box = VirtualBox(rdt_rate=0, buffer_size=4)
    box.ask(3, 10)
    assert [len(data) // 36 for data in box.datagrams(0.1)] == [4, 4, 2]


@given(st.lists(st.floats(1e-5, 0.05), min_size=1, max_size=30), st.integers(1, 40))
def test_whatever_the_wake_ups_every_record_comes_once(pauses, size):
    box = VirtualBox(rdt_rate=3500, buffer_size=size)
    box.ask(3)
    found = [record for pause in pauses for record in box.run(pause)]
    assert sequences(found) == list(range(1, len(found) + 1))
    assert [r.ft for r in found] == [1 + 2 * i for i in range(len(found))]
    assert abs(len(found) - sum(pauses) * 3500) <= size + 1


def test_both_numbers_wrap():
    box = VirtualBox(rdt_rate=0, ft_sequence=2**32 - 10)
    box.ask(2)
    box.box.restart_stream(2**32 - 5)
    found = box.run(0.01)
    assert sequences(found[:8]) == [*range(2**32 - 5, 2**32), 0, 1, 2]
    fts = [r.ft for r in found]
    assert 2**32 - 1 in fts
    assert fts[fts.index(2**32 - 1) + 1] == 0


def test_an_extended_request_sends_elsewhere():
    box = VirtualBox()
    elsewhere = struct.pack(">HHI4BH", 0x1234, 0x8002, 0, 127, 0, 0, 9, 5000)
    box.box.request(elsewhere, ("127.0.0.1", 1), box.now)
    assert box.box.stream.to == ("127.0.0.9", 5000)


def test_nothing_is_ever_sent_beyond_this_machine():
    box = VirtualBox()
    box.box.request(bytes.fromhex("1234800200000000E00005806E5A"), ("127.0.0.1", 1), box.now)
    assert box.box.stream is None
    assert box.box.counters.bad_requests == 1


COMMANDS = {
    "netbox": {2, 3, 4},
    "axia": {1, 2, 3},
    "schunk": {1, 2, 3},
    "onrobot": {2},
}


@pytest.mark.parametrize("profile", COMMANDS)
def test_each_family_knows_its_commands(profile):
    for command in range(1, 0x90):
        box = VirtualBox(profile=profile)
        box.ask(command)
        assert (box.box.stream is not None) == (command in COMMANDS[profile]), hex(command)


def test_an_rdt_that_is_off_does_nothing():
    box = VirtualBox()
    box.write("comm.cgi", comrdte=0)
    box.ask(2)
    assert box.box.stream is None


# Bias.


@pytest.mark.parametrize("profile", ["netbox", "axia", "schunk"])
@pytest.mark.parametrize("bias", ["continues", "stops"])
def test_a_bias_makes_the_load_zero_and_the_stream_go_on_or_not(profile, bias):
    box = VirtualBox(profile=profile, load=LOAD, bias=bias)
    box.ask(2)
    box.run(0.1)
    box.ask(0x42)
    assert (box.box.stream is None) == (bias == "stops")
    box.ask(2)
    assert {r.counts for r in box.run(0.1)} == {(0,) * 6}
    box.write("setting.cgi", **{f"setbias{i}": 0 for i in range(6)})
    assert box.run(0.1)[-1].counts == COUNTS


def test_an_onrobot_bias_is_set_and_cleared_by_its_count():
    box = VirtualBox(profile="onrobot", load=LOAD)
    box.ask(0x42, 255)
    assert box.counts == (0,) * 6
    box.ask(0x42, 0)
    assert box.counts == (10_000, -20_000, 30_000, 10_000, -20_000, 30_000)


def test_an_onrobot_sensor_takes_filter_and_period():
    box = VirtualBox(profile="onrobot")
    box.ask(0x81, 4)
    box.ask(0x82, 5)
    assert box.box.settings.filter_code == 4
    assert box.box.settings.rdt_rate == 200
    box.ask(2)
    assert set(np.diff([r.ft for r in box.run(0.5)])) == {5}


# Status.

SATURATED = {
    "netbox": 0x80020000,
    "axia": 0xC0000000,
    "schunk": 0xC0000000,
    "onrobot": 0x80,
}


@pytest.mark.parametrize("profile", SATURATED)
def test_a_load_beyond_the_range_is_cut_and_told(profile):
    box = VirtualBox(profile=profile, load="constant:fz=5000")
    box.run(0.1)
    assert box.status == SATURATED[profile]
    assert box.counts[2] == pytest.approx(
        1.1 * box.box.settings.rated[2] * box.box.settings.counts_per_si[2]
    )
    box.run(0.1)


@pytest.mark.parametrize(("profile", "held"), [("netbox", 0), ("axia", 32)])
def test_how_long_saturation_stays(profile, held):
    rate = {"netbox": 7000, "axia": 7912}[profile]
    box = VirtualBox(profile=profile, rdt_rate=0, load="sine:axis=2,amplitude=2000,frequency=5")
    box.ask(2)
    found = box.run(0.2)
    limit = 1.1 * box.box.settings.rated[2]
    beyond = [abs(2000.0 * np.sin(2 * np.pi * 5 * r.ft / rate)) > limit for r in found]
    for i in range(40, len(found)):
        assert bool(found[i].status) == any(beyond[i - held : i + 1]), i


@pytest.mark.parametrize(("profile", "word"), [("netbox", 0x80010000), ("axia", 0x00010000)])
def test_a_monitor_condition_latches_until_it_is_cleared(profile, word):
    box = VirtualBox(profile=profile, load="sine:axis=2,amplitude=10,frequency=1")
    box.write("moncon.cgi", setmce=1, mce3=1, mcx3=2, mcc3=1, mcv3=9_000_000, mco3=4)
    box.run(0.15)
    assert box.status == 0
    box.run(0.2)
    assert box.status == word
    assert box.box.sensor.measurement(box.now).latched == 8
    box.box.sensor.clear_latch(box.now)
    assert box.status == 0
    assert box.run(0.5) == []
    box.run(0.5)
    assert box.status == word


def test_a_net_box_clears_the_latch_over_rdt_and_an_axia_does_not():
    for profile, cleared in (("netbox", True), ("axia", False)):
        box = VirtualBox(profile=profile, load="constant:fz=10")
        box.write("moncon.cgi", setmce=1, mce0=1, mcx0=2, mcc0=1, mcv0=1)
        box.run(0.1)
        box.write("moncon.cgi", mce0=0)
        box.run(0.1)
        assert box.status != 0
        box.ask(0x41)
        assert (box.status == 0) == cleared


# What the settings do.


def test_units_and_counts():
    box = VirtualBox(preset="nano17", load="constant:fz=1,tz=0.001")
    assert box.counts == (0, 0, 1_000_000, 0, 0, 1_000_000)
    box.write("config.cgi", cfgid=0, cfgfu=1, cfgtu=1)
    assert box.counts[2] == round(1e6 / 4.4482216152605)
    assert box.counts[5] == round(1e3 / 0.1129848290276167)


def test_counts_fit_in_any_unit():
    box = VirtualBox(preset="gamma", load="constant:tz=30")
    box.write("config.cgi", cfgid=0, cfgtu=4)
    per_force, per_torque = box.box.settings.counts_per_unit(box.box.settings.configuration)
    assert (per_force, per_torque) == (1_000_000, 10_000)
    assert box.counts[5] == 30_000 * 10_000


def test_a_tool_transform_moves_and_turns():
    box = VirtualBox(load="constant:fx=10,fy=5")
    box.write("config.cgi", cfgid=0, cfgtdu=3, cfgtau=1, cfgtfx2=100)
    # At a point 0.1 m up, T' = T - d x F.
    assert box.counts == (10_000_000, 5_000_000, 0, 500_000, -1_000_000, 0)
    box.write("config.cgi", cfgid=0, cfgtfx2=0, cfgtfx5=90)
    assert box.counts == (5_000_000, -10_000_000, 0, 0, 0, 0)


def test_a_low_pass_has_no_gain_at_rest_and_its_cut_off():
    for frequency, gain in ((0.2, 1.0), (8.0, 0.7071), (80.0, 0.0995)):
        box = VirtualBox(rdt_rate=0, load=f"sine:axis=2,amplitude=100,frequency={frequency}")
        box.write("setting.cgi", setuserfilter=7)
        box.ask(2)
        box.run(1.0)
        highest = max(r.counts[2] for r in box.run(2.0 if frequency < 1.0 else 0.5))
        assert highest / 1e8 == pytest.approx(gain, rel=0.02), frequency


def test_an_internal_rate_changes_the_pace():
    box = VirtualBox(profile="axia", rdt_rate=0)
    box.write("setting.cgi", setadcrate=1953)
    assert box.box.settings.internal_rate == 1978
    box.ask(2)
    assert len(box.run(1.0)) == pytest.approx(1978, abs=2)


def test_peaks_are_kept():
    box = VirtualBox(load="sine:axis=0,amplitude=10,frequency=2")
    box.write("setting.cgi", setpke=1)
    box.run(1.0)
    assert box.box.sensor.peaks[:, 0].tolist() == pytest.approx([10_000_000, -10_000_000], rel=1e-3)


def test_noise_is_as_large_as_wanted():
    box = VirtualBox(rdt_rate=0, load="noise:force=0.5,torque=0.01")
    box.ask(2)
    counts = np.array([r.counts for r in box.run(1.0)])
    np.testing.assert_allclose(counts.std(axis=0), [5e5] * 3 + [1e4] * 3, rtol=0.05)


# Changes while it streams.


def test_a_change_loses_and_repeats_no_record():
    box = VirtualBox(rdt_rate=0, load=LOAD)
    box.ask(2)
    found = []
    for i in range(200):
        found += box.run(0.0013)
        box.write("setting.cgi", setuserfilter=i % 3)
        if i % 5 == 0:
            box.ask(0x42)
    assert sequences(found) == list(range(1, len(found) + 1))
    assert set(np.diff([r.ft for r in found])) == {1}


def test_a_frozen_transducer_repeats_itself_and_thaws():
    box = VirtualBox(load="sine:2,5,1")
    box.ask(2)
    box.run(0.1)
    box.box.sensor.freeze(box.now)
    box.box.sensor.change(box.now)
    found = box.run(0.1)
    assert len({(r.ft, r.counts) for r in found}) == 1
    assert len(set(sequences(found))) == len(found) > 50
    box.box.sensor.thaw()
    box.box.sensor.change(box.now)
    assert len({r.ft for r in box.run(0.1)}) > 50


def test_power_up_begins_anew():
    box = VirtualBox(load=LOAD, rdt_rate=0)
    box.ask(2)
    box.run(0.5)
    box.ask(0x42)
    box.box.power_up(box.now, scale=0.5)
    assert box.box.stream is None
    box.ask(2)
    found = box.run(0.01)
    assert [found[0].rdt, found[0].ft] == [1, 1]
    assert found[0].counts == tuple(count // 2 for count in COUNTS)


def test_a_drifting_clock_is_faster():
    box = VirtualBox(rdt_rate=0)
    box.ask(2)
    box.run(1.0)
    box.box.sensor.trouble.drift = 0.01
    box.box.changed()
    box.box.settle(box.now)
    assert len(box.run(1.0)) == pytest.approx(7070, abs=2)


# Options.


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"profile": "netbux"}, "did you mean 'netbox'"),
        ({"preset": "nano"}, "nano17"),
        ({"host": "10.0.0.1"}, "loopback"),
        ({"load": "sinus:1"}, "load: unknown load 'sinus'"),
        ({"rdt_rate": 9000}, "rdt_rate must lie in"),
        ({"internal_rate": 1000}, "internal_rate: netbox has 7000"),
        ({"buffer_size": 41}, "buffer_size"),
        ({"bias": "never"}, "bias"),
        ({"faults": "/nowhere.yaml"}, "no file"),
    ],
)
def test_wrong_options_are_refused_with_their_reason(options, told):
    with pytest.raises(ConfigError, match=told):
        SimConfig(**options)


def test_what_comes_before_a_request_is_complete_is_no_request():
    assert decode(request(2)[:-1]) is None


def test_every_fault_and_load_is_documented():
    page = Path(__file__).parents[3].joinpath("docs", "ati_netft.md").read_text()
    for name in (*KINDS, *LOADS, *ANSWERS, *EVENTS):
        assert f"`{name}`" in page or name == "none", name
