"""A simulator as a process: started, proven ready, refused loudly, never left behind."""

import os
import signal
import socket
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

import crtk_sim_backends
from crtk_sim_backends.process import SimStartError, loopback_addresses
from crtk_sim_backends.ur import SIM, ConfigError, SimConfig
from rigs.ur_clients import DashboardClient, last_json
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.usefixtures("cold_start")

PACKAGES = str(Path(crtk_sim_backends.__file__).parents[1])


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return not stat.exists() or stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"


def test_two_simulators_live_side_by_side_on_addresses_of_their_own():
    with SIM.spawn() as first, SIM.spawn(model="ur10e") as second:
        assert first.host != second.host
        with DashboardClient(first.host) as one, DashboardClient(second.host) as other:
            assert one.ask("get robot model") == "UR5"
            assert other.ask("get robot model") == "UR10"


def test_an_address_in_use_is_refused_with_address_and_port():
    with SIM.spawn() as sim, pytest.raises(SimStartError) as caught:
        SIM.spawn(host=sim.host)
    assert f"{sim.host}:30004" in str(caught.value)
    assert "in use" in str(caught.value)


def test_one_port_in_use_is_enough_and_leaves_nothing_bound():
    with SIM.spawn() as sim:
        host = sim.host

    with socket.create_server((host, 30012)), pytest.raises(SimStartError, match=r":30012"):
        SIM.spawn(host=host)
    SIM.spawn(host=host).stop()


def test_stop_ends_it_with_exit_code_0_and_frees_its_ports():
    sim = SIM.spawn()
    assert alive(sim.pid)
    assert sim.stop() == 0
    assert not sim.running
    assert sim.stop() == 0
    with SIM.spawn(host=sim.host) as again:
        assert again.host == sim.host


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_with_exit_code_0(number):
    with SIM.spawn() as sim:
        os.kill(sim.pid, number)
        eventually(lambda: not sim.running)
        assert sim.stop() == 0


def test_a_stalled_or_frozen_simulator_can_be_stopped():
    with SIM.spawn() as sim:
        sim.control.inject("stall")
        assert sim.stop() == 0
    with SIM.spawn() as sim:
        sim.suspend()
        assert sim.stop() == 0


def test_it_ends_when_its_parent_dies():
    program = (
        "import json, os\n"
        "from crtk_sim_backends.ur import SIM\n"
        "sim = SIM.spawn()\n"
        "print(json.dumps([sim.pid, sim.host]), flush=True)\n"
        "os._exit(1)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": PACKAGES},
        stdout=subprocess.PIPE,
        text=True,
        timeout=30,
        check=False,
    )
    pid, _ = last_json(result.stdout)
    eventually(lambda: not alive(pid))


def test_it_finds_the_packages_of_its_parent_without_pythonpath(monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    SIM.spawn().stop()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"modle": "ur5e"}, "did you mean 'model'"),
        ({"model": "ur16"}, "did you mean 'ur16e'"),
        ({"version": "5"}, "must look like 5.12.4"),
        ({"version": "3.15"}, "has software 5.x or 10.x"),
        ({"model": "ur10", "version": "5.12.4"}, "has software 3.x"),
        ({"model": "ur10", "remote": False}, "no local control"),
        ({"host": "192.168.1.10"}, "must be a loopback address"),
        ({"host": "robot"}, "must be 'auto' or an IPv4 address"),
        ({"serial_number": "abc"}, "4 to 20 digits"),
        ({"faults": "/no/such/file.yaml"}, "there is no file"),
        ({"control_port": 70000}, "control_port must lie in"),
    ],
)
def test_wrong_options_are_refused_before_anything_starts(options, complaint):
    with pytest.raises(ConfigError) as caught:
        SIM.spawn(**options)
    assert complaint in str(caught.value)


def test_a_wrong_fault_file_is_refused_with_its_line(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("- {at: 1, kind: silence, port: rtd}\n")
    with pytest.raises(SimStartError, match=r"line 1: unknown port 'rtd'; did you mean 'rtde'"):
        SIM.spawn(faults=str(path))


def test_it_runs_alone_in_the_foreground_with_a_banner():
    (host,) = loopback_addresses(os.getpid() + 1, count=1)
    process = subprocess.Popen(
        [sys.executable, "-m", "crtk_sim_backends.ur", "--host", host, "--no-powered-on"],
        env={**os.environ, "PYTHONPATH": PACKAGES},
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout.readline() == (
            f"simulated UR5e, software 5.12.4, powered off, at {host}\n"
        )
        with DashboardClient(host) as dashboard:
            assert dashboard.ask("robotmode") == "Robotmode: POWER_OFF"
        process.send_signal(signal.SIGINT)
        assert process.wait(LONG) == 0


def test_every_option_has_help_and_a_default():
    for entry in fields(SimConfig):
        assert entry.metadata["help"], entry.name
        assert getattr(SimConfig(), entry.name) == entry.default
