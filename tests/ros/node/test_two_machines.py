"""A lab on two machines, each a network namespace with a cable to the other one."""

import os
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from rigs.lab_observer import observer
from rigs.lab_up import Up
from rigs.two_machines import Machine, two_machines

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

DOMAIN = int(os.environ["ROS_DOMAIN_ID"])
OTHER_DOMAIN = DOMAIN % 101 + 1
SHIFT = 0.25

LAB = """
environment = {{ ROS_DOMAIN_ID = {domain}, ROS_AUTOMATIC_DISCOVERY_RANGE = "SUBNET" }}
machine = "control"

[devices.arm]
plugin = "loopback"

[devices.camera]
plugin = "loopback"
namespace = "{camera}"
machine = "tracking"
"""
PROGRAM = """
[programs.work]
command = ["sh", "-c", "echo began; exec sleep 1000"]
machine = "tracking"
after = ["arm"]
"""


@dataclass
class TwoUp:
    """Two machines, and what `crtk-driver up` of one lab file has logged on each."""

    control: Machine
    tracking: Machine
    on_control: Up
    on_tracking: Up
    lab: Path


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The lab is up on tracking first, then on control."""
    with two_machines() as machines:
        folders = [tmp_path_factory.mktemp(machine.name) for machine in machines]
        for folder in folders:
            text = LAB.format(domain=DOMAIN, camera="/camera") + PROGRAM
            (folder / "lab.toml").write_text(text)
        control, tracking = machines
        here, there = (folder / "lab.toml" for folder in folders)
        with tracking.up(there) as second:
            second.until("camera: measures")
            with control.up(here) as first:
                yield TwoUp(control, tracking, first, second, here)


def test_a_program_waits_for_the_arm_of_the_other_machine(lab):
    lab.on_tracking.until("work: started")
    lines = "".join(lab.on_tracking.lines)
    assert lines.index("camera: measures") < lines.index("arm on control: DISABLED")
    assert lines.index("arm on control: DISABLED") < lines.index("work: started")
    lab.on_control.until("arm: measures")


def test_each_machine_shows_the_devices_of_the_other(lab):
    lab.on_control.until("camera on tracking: DISABLED")
    lab.on_tracking.until("arm on control: DISABLED")
    assert os.uname().nodename not in ("control", "tracking"), "this machine keeps its name"


def test_the_clock_of_the_other_machine_is_measured(lab):
    with observer({"camera": "/camera"}, lab.control.python(), in_domain(lab.control)) as watching:
        found = watching.until("its clock", offset=lambda it: it is not None)
    assert found.host == "tracking"
    assert abs(found.offset) < 0.005


def in_domain(machine):
    return machine.environment(ROS_DOMAIN_ID=str(DOMAIN))


def test_a_lab_in_order_passes_its_check(lab):
    code, told = lab.control.run("lab", "check", str(lab.lab))
    assert code == 0, told
    assert "tracking  tracking  DISABLED" in told
    assert "wrong" not in told


def test_a_cable_that_is_pulled_out_is_told(lab):
    others = (lab.on_control, "camera on tracking"), (lab.on_tracking, "arm on control")
    for up, device in others:
        up.until(rf"{device}: DISABLED$")
    lab.control.set_link(up=False)
    began = time.monotonic()
    for up, device in others:
        up.until(rf"{device}: not seen$")
    assert time.monotonic() - began < 10.0
    shown = [len(up.matching(rf"{device}: DISABLED$")) for up, device in others]
    lab.control.set_link(up=True)
    for (up, device), count in zip(others, shown, strict=True):
        up.until(rf"{device}: DISABLED$", count + 1)


def check_of(lab, folder, domain, camera):
    path = folder / "lab.toml"
    path.write_text(LAB.format(domain=domain, camera=camera))
    return lab.control.run("lab", "check", str(path))


def test_a_clock_that_is_off_is_told_with_the_figure(lab, tmp_path):
    with lab.tracking.device("/shifted", SHIFT, ROS_DOMAIN_ID=str(DOMAIN)):
        code, told = check_of(lab, tmp_path, DOMAIN, "/shifted")
    assert code == 1, told
    assert "the clock of tracking is off by +250." in told or "off by +249." in told
    assert "chrony or PTP" in told


def test_a_device_in_another_domain_is_told(lab, tmp_path):
    with lab.tracking.device("/lost", ROS_DOMAIN_ID=str(OTHER_DOMAIN)):
        code, told = check_of(lab, tmp_path, DOMAIN, "/lost")
    assert code == 1, told
    assert (
        f"but in domain {OTHER_DOMAIN} on tracking: there ROS_DOMAIN_ID is {OTHER_DOMAIN}" in told
    )


def test_a_device_on_the_wrong_machine_is_told(lab, tmp_path):
    with lab.control.device("/moved", ROS_DOMAIN_ID=str(DOMAIN)):
        code, told = check_of(lab, tmp_path, DOMAIN, "/moved")
    assert code == 1, told
    assert "camera runs on control, and the lab file gives it to tracking" in told


def test_a_machine_that_is_not_up_yet_is_no_error(lab, tmp_path):
    code, told = check_of(lab, tmp_path, DOMAIN, "/not_up")
    assert code == 0, told
    assert f"nothing of tracking is seen in domain {DOMAIN}: camera" in told
    assert f"{lab.tracking.address} (Fast DDS) announces itself" in told, "it is in this domain"


def test_nothing_is_looked_for_where_that_is_left_out(lab):
    code, told = lab.control.run("lab", "check", str(lab.lab), "--no-ros")
    assert code == 0
    assert "seen on ROS" not in told
