"""The launch file of a lab, with a stand-in for ROS 2's `launch`, of which there is no wheel.

The stand-in has the names and arguments of launch 3.4 (Jazzy) that the file uses, and refuses others.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from runpy import run_path
from types import ModuleType

import pytest

from crtk_drivers.labs import device_command, load_lab

LAUNCH_FILE = Path(__file__).parents[2] / "examples" / "lab.launch.py"
LAB = """
name = "bench"
[devices.ft]
plugin = "ati-netft"
on = "arm"
settings = { host = "192.168.1.20" }
[devices.arm]
plugin = "ur"
settings = { host = "192.168.1.10", model = "ur5e" }
[programs.teleop]
command = ["python", "teleop.py"]
"""


@dataclass
class LaunchDescription:
    entities: list


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: str | None = None
    description: str = ""


@dataclass
class OpaqueFunction:
    function: object


@dataclass
class ExecuteProcess:
    cmd: list
    name: str
    cwd: str
    output: str = "log"
    respawn: bool = False
    respawn_delay: float = 0.0
    sigterm_timeout: str = "5"
    additional_env: dict = field(default_factory=dict)

    def __post_init__(self):
        assert all(isinstance(word, str) for word in self.cmd)


@dataclass
class LogInfo:
    msg: str


@dataclass
class LaunchConfiguration:
    name: str

    def perform(self, context):
        return context[self.name]


@pytest.fixture
def launch(monkeypatch):
    package = ModuleType("launch")
    package.LaunchDescription = LaunchDescription
    actions, substitutions = ModuleType("launch.actions"), ModuleType("launch.substitutions")
    for action in (DeclareLaunchArgument, OpaqueFunction, ExecuteProcess, LogInfo):
        setattr(actions, action.__name__, action)
    substitutions.LaunchConfiguration = LaunchConfiguration
    for module in (package, actions, substitutions):
        monkeypatch.setitem(sys.modules, module.__name__, module)


def started(**given):
    *arguments, function = run_path(str(LAUNCH_FILE))["generate_launch_description"]().entities
    context = {argument.name: argument.default_value for argument in arguments}
    assert not given.keys() - context.keys()
    return function.function({**context, **given})


@pytest.fixture
def lab(tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text(LAB)
    return path


def test_the_processes_are_those_of_the_lab(launch, lab):
    found = load_lab(lab)
    arm, ft, teleop = started(lab=str(lab))
    assert [process.name for process in (arm, ft, teleop)] == ["arm", "ft", "teleop"]
    for process in (arm, ft):
        settings = Path(process.cmd[process.cmd.index("--config") + 1])
        assert process.cmd == list(device_command(found.devices[process.name], settings))
        assert "192.168.1" in settings.read_text()
        assert process.respawn
    assert teleop.cmd == ["python", "teleop.py"]
    assert teleop.cwd == str(lab.parent)
    assert not teleop.respawn


def test_simulated_and_only_some(launch, lab):
    (ft,) = started(lab=str(lab), sim="true", devices="ft")
    assert ft.name == "ft"
    assert "--sim" in ft.cmd


def test_environment_and_enclaves_are_those_of_the_lab(launch, lab):
    lab.write_text("environment = { ROS_DOMAIN_ID = 42, ROS_SECURITY_ENABLE = true }\n" + LAB)
    processes = started(lab=str(lab))
    for process in processes:
        assert process.additional_env == {"ROS_DOMAIN_ID": "42", "ROS_SECURITY_ENABLE": "true"}
    assert processes[0].cmd[-3:] == ["--ros-args", "--enclave", "/arm/crtk_driver"]
    assert "--enclave" not in processes[-1].cmd, "a program says so itself"


def test_a_machine_starts_its_share(launch, lab):
    text = lab.read_text().replace(
        'plugin = "ati-netft"', 'plugin = "of-tracking"\nmachine = "tracking"'
    )
    lab.write_text('machine = "control"\n' + text)
    told, *processes = started(lab=str(lab), machine="control")
    assert told == LogInfo("left out: ft on tracking")
    assert [process.name for process in processes] == ["arm", "teleop"]


def test_it_is_read_without_launch():
    assert "launch" not in sys.modules
    run_path(str(LAUNCH_FILE))
