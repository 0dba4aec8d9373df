"""`crtk-driver list NAME`: the units that apply to its joints, and what it has beyond CRTK."""

import re

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli import main
from crtk_drivers.cli.name_lists import numbered
from crtk_drivers.cli.terminal import OUT
from crtk_drivers.commands import Command, find, units_for

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        (
            "ur",
            [
                r"move_jp +rad  ",
                r"measured_js +rad, rad/s, N·m  ",
                r"joints: shoulder_pan_joint, .*wrist_3_joint \(rad\)",
                r"crtk-driver call NAMESPACE SERVICE",
                r"unlock_protective_stop +leave a protective stop",
                r"tcp +pose \(m, unit quaternion\) +tool centre point",
                r"digital_out_0…7 +flag +standard digital output 0",
                r"state/analog_in_0…1_voltage +number +voltage of analog in 0, V",
                r"crtk-driver echo NAMESPACE READING",
            ],
        ),
        (
            "robotiq",
            [r"move_jp +m  ", r"joints: opening \(m\)", r"activate +reset it and", "force"],
        ),
        ("robotiq-epick", [r"servo_jp +Pa  ", r"joints: vacuum \(Pa\)"]),
        ("loopback", [r"servo_jp +rad or m  ", r"joints: x, y, z \(m\); yaw \(rad\)"]),
        ("dynamixel", [r"joints: waist, .* \(rad\); gripper/gripper \(m\)"]),
        ("ros2-control", [r"joints: joint_1 \(rad or m, as configured\)"]),
        ("ati-netft", [r"set_bias +wrench \(N, N·m\) +software bias"]),
    ],
)
def test_list_of_one_shows_units_services_and_readings(
    name: str, lines: list[str], capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(plugins.ONLY, raising=False)
    monkeypatch.setattr(OUT, "width", 160)
    assert main(["list", name]) == 0
    out = capsys.readouterr().out
    for line in lines:
        assert re.search(line, out), line


def test_numbered_names_are_shown_as_one() -> None:
    names = ("in_0", "mode", "in_1", "v_0_low", "in_2", "v_1_low", "v_0_high")
    assert numbered(names) == {
        "in_0…2": "in_0",
        "mode": "mode",
        "v_0…1_low": "v_0_low",
        "v_0_high": "v_0_high",
    }


def test_a_device_without_its_required_keys_says_so(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "typical_device", lambda plugin: None)
    assert main(["list", "loopback"]) == 0
    assert "What it offers depends on its configuration." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "joints", "units"),
    [
        (find("servo_jp"), ("rad", "rad"), "rad"),
        (find("servo_jr"), ("m",), "m"),
        (find("servo_jv"), ("m",), "m/s"),
        (find("servo_jf"), ("rad",), "N·m"),
        (find("measured_js"), ("m",), "m, m/s, N"),
        (find("measured_js"), ("Pa",), "Pa, Pa/s"),
        (find("servo_jp"), ("rad", "m"), "rad or m"),
        (find("servo_jp"), ("rad", ""), "rad or m"),
        (find("servo_jp"), (), "rad or m"),
        (find("servo_cp"), ("rad",), "m, unit quaternion"),
    ],
)
def test_units_are_those_of_the_joints(
    command: Command, joints: tuple[str, ...], units: str
) -> None:
    assert units_for(command, joints) == units
