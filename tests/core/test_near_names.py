"""What is proposed for a name that does not exist: what was probably meant, and no far name."""

import time

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli.own_commands import OWN_COMMANDS
from crtk_drivers.commands import COMMANDS
from crtk_drivers.config.keys import all_keys
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.labs.lab_file import LabSettings

DEVICES = [*plugins.devices(), *plugins.pages()]
LAB_KEYS = [str(key[-1]) for key in all_keys(LabSettings)]

NEAR = [
    ("lopback", DEVICES, "loopback"),
    ("canopn", DEVICES, "canopen"),
    ("UR", DEVICES, "ur"),
    ("ut", DEVICES, "ur"),
    ("ur5e", DEVICES, "ur"),
    ("netft", DEVICES, "ati-netft"),
    ("ati_netft", DEVICES, "ati-netft"),
    ("epick", DEVICES, "robotiq-epick"),
    ("wsg", DEVICES, "weiss-wsg"),
    ("robotik", DEVICES, "robotiq"),
    ("dynamixle", DEVICES, "dynamixel"),
    ("enabel", OWN_COMMANDS, "enable"),
    ("stat", OWN_COMMANDS, "state"),
    ("mesured_js", COMMANDS, "measured_js"),
    ("mov_jp", COMMANDS, "move_jp"),
    ("servo_pj", COMMANDS, "servo_jp"),
    ("scal", LAB_KEYS, "scale"),
    ("pluggin", ["name", "plugin", "host"], "plugin"),
    ("hots", ["host", "port"], "host"),
    ("prot", ["host", "port"], "port"),
    ("sinus", ["sine", "step"], "sine"),
    ("ampl", ["amplitude", "period"], "amplitude"),
    ("csq", ["csp", "csv", "pp"], "csv"),
    ("ppp", ["csv", "pp"], "pp"),
    ("shit", ["shift", "sign"], "shift"),
    ("lowpass", ["low_pass", "rate"], "low_pass"),
    ("axis", ["axia", "netbox"], "axia"),
    ("motion.lag.lga", ["motion.lag.lag", "motion.lag.far"], "motion.lag.lag"),
]
FAR = [
    ("nope", DEVICES),
    ("foo", DEVICES),
    ("robot", ["onrobot2", "probe"]),
    ("ft", ["ur", "can"]),
    ("a", ["b", "c"]),
    ("", ["b", "ur"]),
    ("driver", LAB_KEYS),
    ("speed", ["seed_of_noise", "peer"]),
    ("motion.lag.foo", ["motion.lag.lag"]),
    ("enable", ["disable"]),
    ("position", ["proportion"]),
    ("j7", ["j1", "j6"]),
    ("joint_7", ["joint_1", "joint_6", "joint_70"]),
    ("force", ["free"]),
]


@pytest.mark.parametrize(("name", "names", "meant"), NEAR, ids=[row[0] for row in NEAR])
def test_what_was_probably_meant_comes_first(name: str, names: list[str], meant: str) -> None:
    assert near_names(name, names) == [meant]


@pytest.mark.parametrize(("name", "names"), FAR, ids=[row[0] or "nothing" for row in FAR])
def test_a_far_name_is_not_proposed(name: str, names: list[str]) -> None:
    assert near_names(name, names) == []


def test_several_names_come_nearest_first() -> None:
    assert near_names("movel", COMMANDS, most=3)[0].startswith("move_")
    assert len(near_names("movel", COMMANDS, most=3)) == 3
    models = ["xm540-w270", "xm430-w350", "xm430-w210"]
    assert near_names("xm430-w35", models, most=2) == ["xm430-w350", "xm430-w210"]


def test_long_names_take_no_time() -> None:
    began = time.process_time()
    assert near_names("a" * 3000, ["a" * 2999 + "b", "b" * 3000]) == ["a" * 2999 + "b"]
    assert time.process_time() - began < 1.0  # 0.01 s; all of their letters take 9 s


def test_many_names_take_seconds_at_most() -> None:
    began = time.process_time()
    many = [f"measured_position_of_{number:04}_joint" for number in range(8000)]
    assert near_names("measured_position_of_1234_jiont", many) == [many[1234]]
    assert time.process_time() - began < 5.0  # 1.6 s
