"""The simulator as a plug-in and a process: options, ttys, timing, control socket."""

from __future__ import annotations

import dataclasses
import fcntl
import os
import re
import select
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from crtk_drivers.plugins import SimPlugin
from crtk_sim_backends.control import ControlError
from crtk_sim_backends.dynamixel import SIM, ConfigError, SimConfig, SimStartError
from crtk_sim_backends.dynamixel.config import PRESETS, parse_servos
from crtk_sim_backends.dynamixel.injection import KINDS
from rigs.dynamixel_clients import (
    EVERYONE,
    POSITION,
    Wire,
    instruction,
    read,
    running,
    statuses,
    sync_read,
    vendor_at,
    write,
)
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.usefixtures("cold_start")

TIOCGEXCL = 0x80045440
GUIDE = Path(__file__, "../../../../docs/dynamixel_simulator.md").resolve().read_text()
PING_1, ANSWER_1 = instruction(1, 0x01), 14

# Options


def test_is_a_plugin_as_the_core_wants_it() -> None:
    assert isinstance(SIM, SimPlugin)
    assert SIM.Config is SimConfig


@pytest.mark.parametrize("name", PRESETS)
def test_presets(name: str) -> None:
    (bus,) = SimConfig(servos=name).buses
    assert len(bus) >= 5
    assert len({spec.number for spec in bus}) == len(bus)


def test_servos_as_text() -> None:
    one, two = SimConfig(servos="1:XM430-W350@46~1.5, 2:xm430-w350&1 ; 1:xl330-m288").buses
    assert [(s.number, s.model.name, s.firmware, s.gravity, s.partner) for s in one] == [
        (1, "xm430-w350", 46, 1.5, None),
        (2, "xm430-w350", 52, 0.0, 1),
    ]
    assert [s.model.number for s in two] == [1200]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"servos": "arm7"}, "did you mean 'arm6'"),
        ({"servos": "1:xm430-w35"}, "did you mean 'xm430-w350'"),
        ({"servos": "1:xm430-w350,1:xl330-m288"}, "used twice"),
        ({"servos": "253:xm430-w350"}, r"ids lie in \[0, 252\]"),
        ({"servos": "1:xm430-w350&2"}, "needs servo 2 before it"),
        ({"servos": "1:xm430-w350,2:ax-12a&1"}, "cannot be a shadow"),
        ({"servos": ""}, "ID:MODEL"),
        ({"timing": "wires"}, "did you mean 'wire'"),
        ({"baud": 300}, "baud must lie in"),
        ({"speed": float("nan")}, "speed must lie in"),
        ({"host": "192.168.0.1"}, "loopback"),
        ({"faults": "nowhere.yaml"}, "there is no file"),
        ({"servo": "arm6"}, "did you mean 'servos'"),
    ],
)
def test_wrong_options(options: dict[str, object], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        SIM.spawn(**options)


def test_parse_names_what_it_cannot_read() -> None:
    with pytest.raises(ConfigError, match="'2;xm' is not ID:MODEL"):
        parse_servos("1:xm430-w350,2;xm")


# Ttys


def test_a_link_of_ones_own(tmp_path: Path) -> None:
    link = tmp_path / "u2d2"
    with running(link=str(link), servos="1:xm430-w350;2:xm430-w350") as sim:
        assert sim.ttys == {"bus1": str(link), "bus2": f"{link}-2"}
        for number, path in enumerate(sim.ttys.values(), start=1):
            with Wire(path) as wire:
                (answer,) = wire.ask(instruction(EVERYONE, 0x01), ANSWER_1)
                assert answer.number == number
        with pytest.raises(SimStartError, match="cannot make the link"):
            SIM.spawn(link=str(link), timing="none")
    assert not link.is_symlink()
    link.symlink_to("/dev/pts/does-not-exist")  # left behind by one that was killed
    with running(link=str(link)) as sim, Wire(str(link)) as wire:
        assert len(wire.ask(PING_1, ANSWER_1)) == 1


def test_nothing_is_left_behind() -> None:
    with running() as sim:
        folder = Path(sim.ttys["bus1"]).parent
        assert folder.is_dir()
    assert not folder.exists()


def test_two_simulators_beside_each_other() -> None:
    with (
        running(servos="1:xm430-w350") as one,
        running(servos="1:xl330-m288") as two,
        vendor_at(one) as first,
        vendor_at(two) as second,
    ):
        assert (first.ping(1)[0], second.ping(1)[0]) == (1020, 1200)


def test_a_client_comes_after_another_and_finds_nothing_of_it() -> None:
    with running() as sim:
        with Wire(sim.ttys["bus1"]) as wire:
            wire.send(PING_1)
            select.select([wire], [], [], 2.0)
        eventually(lambda: sim.control.status()["buses"]["bus1"]["clients"] == 0)
        fd = os.open(sim.ttys["bus1"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            assert select.select([fd], [], [], 0.05)[0] == []
        finally:
            os.close(fd)


def test_an_exclusive_port_can_be_opened_again() -> None:
    with running() as sim:
        with Wire(sim.ttys["bus1"]) as wire:
            fcntl.ioctl(wire, termios.TIOCEXCL)
            assert fcntl.ioctl(wire, TIOCGEXCL, bytes(4)) != bytes(4)
        eventually(lambda: sim.control.status()["buses"]["bus1"]["clients"] == 0)
        with Wire(sim.ttys["bus1"]) as wire:
            assert fcntl.ioctl(wire, TIOCGEXCL, bytes(4)) == bytes(4)


def test_a_client_that_does_not_read_loses_bytes_and_nothing_else() -> None:
    with running() as sim, Wire(sim.ttys["bus1"]) as wire:
        for _ in range(300):
            wire.send(read(1, 0, 600))
        eventually(lambda: sim.control.status()["buses"]["bus1"]["overruns"] > 0)
        wire.rest()
        assert len(wire.ask(PING_1, ANSWER_1)) == 1


# Time


@pytest.mark.parametrize(("speed", "baud"), [(termios.B57600, 57600), (termios.B115200, 115200)])
def test_bytes_take_their_time(speed: int, baud: int) -> None:
    request = sync_read(POSITION, 4, 1, 2, 3)
    with (
        running(baud=baud, timing="wire", return_delay=250) as sim,
        Wire(sim.ttys["bus1"], speed) as wire,
    ):
        start = time.monotonic()
        answers = wire.ask(request, 45)
        taken = time.monotonic() - start
    assert len(answers) == 3
    assert taken > (len(request) + 45) * 10 / baud + 3 * 500e-6 - 0.4e-3


def test_talking_while_a_servo_talks_loses_both() -> None:
    with running(baud=9600, timing="wire") as sim, Wire(sim.ttys["bus1"], termios.B9600) as wire:
        wire.send(sync_read(0, 140, *range(1, 8)))  # more than a second
        eventually(lambda: sim.control.status()["instructions"] == 1)
        wire.send(PING_1)
        assert len(wire.rest(1.0, 4.0)) < 7 * 151
        assert sim.control.status()["buses"]["bus1"]["collisions"] == 1
        assert len(wire.ask(PING_1, ANSWER_1)) == 1


def test_an_unfinished_packet_is_forgotten_after_a_while() -> None:
    with running() as sim, Wire(sim.ttys["bus1"]) as wire:
        wire.send(read(1, 0, 2)[:-3])
        clock = lambda: sim.control.status()["time"]  # noqa: E731
        forgotten = clock() + 0.15
        eventually(lambda: clock() > forgotten)
        (answer,) = wire.ask(PING_1, ANSWER_1)
        assert (answer.number, answer.error) == (1, 0)


# Control


def test_the_control_socket() -> None:
    with running(servos="1:xm430-w350,2:xl330-m288") as sim, Wire(sim.ttys["bus1"]) as wire:
        wire.ask(read(2, POSITION, 4), 15)
        (entry,) = sim.control.trace()
        assert (entry["bus"], entry["id"], entry["code"]) == ("bus1", 2, 2)
        assert entry["parameters"] == "84000400"
        assert abs(entry["time_ns"] - time.monotonic_ns()) < 10e9
        assert sim.control.trace(after=1) == []
        sim.control.call("place", id=2, angle=-0.5)
        outputs = sim.control.outputs("bus1/2")
        assert outputs["bus1/2"]["angle"] == pytest.approx(-0.5)
        sim.control.inject("stuck", id=1)
        status = sim.control.status()
        assert status["faults"] == [{"kind": "stuck", "bus": 1, "id": 1}]
        assert status["buses"]["bus1"]["baud"] == 1_000_000
        with pytest.raises(ControlError, match="did you mean 'bus1/1'"):
            sim.control.outputs("bus1/11")
        with pytest.raises(ControlError, match="no servo has the id 3"):
            sim.control.call("place", id=3, angle=0.0)


def test_only_instructions_are_counted() -> None:
    looks_like_protocol_1 = b"\xff\xff\x05\x02\x01\xf7"
    with running() as sim, Wire(sim.ttys["bus1"]) as wire:
        wire.send(write(1, 116, looks_like_protocol_1))
        wire.rest()
        assert [entry["code"] for entry in sim.control.trace()] == [3]


def test_the_banner_tells_the_tty(tmp_path: Path) -> None:
    link = tmp_path / "bus"
    command = [sys.executable, "-m", "crtk_sim_backends.dynamixel", f"--link={link}"]
    process = subprocess.Popen([*command, "--timing=none"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert str(link) in process.stdout.readline()
        with Wire(str(link)) as wire:
            assert len(wire.ask(PING_1, ANSWER_1)) == 1
    finally:
        process.terminate()
        process.communicate(timeout=LONG)
    assert process.returncode == 0
    assert not os.path.lexists(link)


def test_the_guide_names_every_fault_preset_and_option() -> None:
    options = [entry.name for entry in dataclasses.fields(SimConfig)]
    for name in (*KINDS, *PRESETS, *options):
        assert f"`{name}`" in GUIDE, name


def test_the_example_of_the_guide() -> None:
    (program,) = re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)
    exec(compile(program, "docs/dynamixel_simulator.md", "exec"), {})


def test_answers_of_status_are_whole_packets() -> None:
    with running() as sim, Wire(sim.ttys["bus1"]) as wire:
        wire.send(*[instruction(number, 0x01) for number in range(1, 8)])
        assert [s.number for s in statuses(wire.receive(7 * ANSWER_1))] == list(range(1, 8))
