"""Configuration of a simulated UR controller."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.defects import read_defects
from crtk_sim_backends.options import (
    ConfigError,
    Options,
    check_choice,
    check_file,
    check_port,
    check_range,
    option,
)
from crtk_sim_backends.process import AUTO
from crtk_sim_backends.ur.defects import ArmDefects
from crtk_sim_backends.ur.models import MODELS, RobotModel
from crtk_sim_backends.ur.motion.calibration import calibrated
from crtk_sim_backends.ur.motion.contact import Surface, parse
from crtk_sim_backends.ur.motion.limits import SafetyLimits
from crtk_sim_backends.ur.safety.modes import POWER_SECONDS, PROTECTIVE_STOP_LOCK_SECONDS
from crtk_sim_backends.ur.signals.recording import USUAL, RecordingError, chosen_variables
from crtk_sim_backends.ur.signals.tool_device import parse_device
from crtk_sim_backends.ur.signals.variables import Variable
from crtk_sim_backends.ur.signals.wiring import Wire, WiringError, parse_wires
from crtk_sim_backends.ur.urscript.manual import SINCE
from crtk_sim_backends.ur.versions import Version

PORTS: Final = {
    "rtde": 30004,
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "primary_read_only": 30011,
    "secondary_read_only": 30012,
    "realtime_read_only": 30013,
    "modbus": 502,
    "interpreter": 30020,
    "tool": 54321,
    "robot_api": 80,
}
"""TCP ports of the controller by name.

PolyScope X (10.x) has the Robot API in place of the dashboard server, CB3 no serial line to the
tool, and software before 5.10 no interpreter mode; Modbus server and Robot API are options.
"""

LARGEST_POSITION: Final = 363.0
"""Degrees, of the widest safety configuration."""

SLOWEST: Final = 0.1
FASTEST: Final = 100.0
"""Times real time that can be asked for; what the machine cannot do, it says."""

_DEFAULT_VERSIONS: Final = {True: "3.15.8", False: "5.12.4"}  # by "is a CB3 arm"


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """Options of a simulated UR controller; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Controller and arm": (
            "model",
            "version",
            "serial_number",
            "calibration",
            "boot_seconds",
            "powered_on",
            "power_seconds",
            "lock_seconds",
            "remote",
            "remote_enforced",
            "programs",
            "speed",
            "contact",
            "defects",
        ),
        "Further servers": (
            "modbus",
            "modbus_port",
            "robot_api",
            "robot_api_port",
            "fieldbus",
            "web",
            "web_port",
        ),
        "Tool": ("tool_communication", "tool_device", "wiring"),
        "Recordings": (
            "record",
            "record_variables",
            "record_rate",
            "replay",
            "replay_loop",
            "trace_size",
        ),
        "Safety limits": (
            "tool_speed_limit",
            "tool_force_limit",
            "power_limit",
            "momentum_limit",
            "position_limit",
        ),
    }

    model: str = option("ur5e", "arm to simulate", tuple(MODELS))
    version: str = option(
        AUTO, "controller software, such as 5.12.4; 'auto': 5.12.4, or 3.15.8 for a CB3 arm"
    )
    calibration: float = option(
        0.0,
        "have an arm of its own, each link up to so many mm and mrad off the model's; another one for "
        "each serial number; 0: as the model",
    )
    boot_seconds: float = option(0.0, "time that the controller boots at its start, s")
    programs: str = option(
        "", "folder of programs (.urp with its .script beside it, or .script) that 'load' finds"
    )
    powered_on: bool = option(True, "start with the arm powered and the brakes released")
    power_seconds: float = option(
        POWER_SECONDS, "time from an arm without power to one with released brakes, s"
    )
    lock_seconds: float = option(
        PROTECTIVE_STOP_LOCK_SECONDS, "time for which a protective stop cannot be unlocked, s"
    )
    remote: bool = option(True, "start in remote control (e-Series)")
    remote_enforced: bool = option(
        True,
        "refuse remote clients in local control, as a robot does; URSim tells that it is not in remote "
        "control, and obeys",
    )
    serial_number: str = option("20235500001", "serial number that the dashboard reports")
    modbus: bool = option(False, "have the Modbus server (needs crtk-drivers[ur-sim])")
    modbus_port: int = option(
        PORTS["modbus"],
        "its port; most systems permit 502 to root only; 0: any free one",
    )
    robot_api: bool = option(False, "PolyScope X from 10.11: have the Robot API (JSON over HTTP)")
    robot_api_port: int = option(
        PORTS["robot_api"],
        "its port; most systems permit 80 to root only; 0: any free one",
    )
    fieldbus: bool = option(
        False,
        "EtherNet/IP or PROFINET is enabled: it has the lower general purpose input registers, which no "
        "RTDE client gets",
    )
    tool_communication: bool = option(
        False, "start with the serial line to the tool on, at 115200 8N1, and 24 V for the tool"
    )
    tool_device: str = option(
        "",
        "what is attached to it: path of a tty (needs crtk-drivers[ur-sim]), tcp://host:port or "
        "unix:///path; nothing when empty",
    )
    wiring: str = option(
        "",
        "outputs that are connected to inputs, such as "
        "digital_out_0=digital_in_3,analog_out_1=tool_analog_in_0",
    )
    speed: float = option(1.0, "how many times as fast as real time the controller's time passes")
    record: str = option(
        "", "file to record RTDE outputs in, as record.py of UR does; .gz: compressed"
    )
    record_variables: str = option(USUAL, "outputs to record, beside timestamp")
    record_rate: float = option(0.0, "rows a second of the controller; 0: every control period")
    replay: str = option("", "recording to publish instead, for clients that only listen")
    replay_loop: bool = option(False, "begin the recording anew at its end")
    trace_size: int = option(5000, "how many received input packages the trace keeps")
    contact: str = option(
        "",
        "surfaces for the tool to touch, as point/normal[/stiffness[/damping[/friction]]] in m, N/m "
        "and N.s/m, such as '0,0,0.1/0,0,1/20000'; several with ';' between them",
    )
    defects: str = option(
        "",
        "what is wrong with joints (1 to 6, from the base), such as 'position_noise=1e-3,joints=2+3; "
        "velocity_scale=1.1,joints=5'",
    )
    tool_speed_limit: float = option(5.0, "speed of the tool that stops the arm protectively, m/s")
    tool_force_limit: float = option(250.0, "force on the tool that stops it, N")
    power_limit: float = option(6000.0, "power of the joints that stops it, W")
    momentum_limit: float = option(100.0, "momentum of the arm that stops it, kg m/s")
    position_limit: float = option(
        LARGEST_POSITION, "position of joints that stops it, degrees to both sides"
    )

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS, "arm")
        if not re.fullmatch(r"\d{4,20}", self.serial_number):
            raise ConfigError(f"serial_number must be 4 to 20 digits, not {self.serial_number!r}")
        check_range("calibration", self.calibration, 0.0, 10.0)
        for name in ("boot_seconds", "power_seconds", "lock_seconds"):
            check_range(name, getattr(self, name), 0.0, 3600.0)
        if self.programs and not Path(self.programs).is_dir():
            raise ConfigError(f"programs: there is no folder {self.programs}")
        check_range("speed", self.speed, SLOWEST, FASTEST)
        if self.trace_size < 1:
            raise ConfigError(f"trace_size must be at least 1, not {self.trace_size}")
        try:
            self.surfaces  # noqa: B018
        except ValueError as error:
            raise ConfigError(f"contact: {error}") from error
        for name in ("tool_speed", "tool_force", "power", "momentum"):
            check_range(f"{name}_limit", getattr(self, f"{name}_limit"), 0.001, 1e6)
        major = self.software[0]
        if self.robot.is_cb3 != (major == 3) or major not in (3, 5, 10):
            needed = "3.x" if self.robot.is_cb3 else "5.x or 10.x"
            raise ConfigError(f"version: a {self.robot.title} has software {needed}, not {major}.x")
        if self.robot.is_cb3 and not self.remote:
            raise ConfigError("remote: a CB3 controller has no local control")
        check_range("position_limit", self.position_limit, 100.0, LARGEST_POSITION)
        check_port("modbus_port", self.modbus_port)
        check_port("robot_api_port", self.robot_api_port)
        if self.robot_api and self.software[:2] < (10, 11):
            raise ConfigError("robot_api: software before 10.11 has none; give a version")
        if self.tool_device:
            parse_device(self.tool_device)
        if self.robot.is_cb3 and (self.tool_device or self.tool_communication):
            raise ConfigError("tool_device: a CB3 arm has no serial line to the tool")
        _ = self.wires
        _ = self.wrong
        check_file("replay", self.replay)
        if self.replay and (self.modbus or self.tool_communication or self.tool_device):
            raise ConfigError(
                "replay: a recording has neither Modbus nor a serial line to the tool"
            )
        check_range("record_rate", self.record_rate, 0.0, self.robot.frequency)
        try:
            _ = self.recorded
        except RecordingError as error:
            raise ConfigError(f"record_variables: {error}") from error

    @property
    def robot(self) -> RobotModel:
        """The arm."""
        model = MODELS[self.model]
        if self.position_limit < LARGEST_POSITION:
            model = model.limited_to(radians(self.position_limit))
        if not self.calibration:
            return model
        return calibrated(model, self.calibration, int(self.serial_number))

    @property
    def surfaces(self) -> list[Surface]:
        """What the tool can touch."""
        return parse(self.contact)

    @property
    def limits(self) -> SafetyLimits:
        """Of the safety configuration."""
        return SafetyLimits(
            tool_speed=self.tool_speed_limit,
            tool_force=self.tool_force_limit,
            power=self.power_limit,
            momentum=self.momentum_limit,
        )

    @property
    def software(self) -> Version:
        """Software version (major, minor, bugfix, build)."""
        text = _DEFAULT_VERSIONS[self.robot.is_cb3] if self.version == AUTO else self.version
        match = re.fullmatch(r"(\d{1,2})\.(\d{1,2})(?:\.(\d{1,2}))?(?:\.(\d{1,9}))?", text)
        if not match:
            raise ConfigError(f"version must look like 5.12.4, not {self.version!r}")
        major, minor, bugfix, build = (int(part or 0) for part in match.groups())
        return major, minor, bugfix, build

    @property
    def wires(self) -> tuple[Wire, ...]:
        """What `wiring` says."""
        try:
            return parse_wires(self.wiring)
        except WiringError as error:
            raise ConfigError(f"wiring: {error}") from error

    @property
    def wrong(self) -> tuple[ArmDefects, ...]:
        """What `defects` says."""
        return read_defects(ArmDefects, self.defects)

    @property
    def recorded(self) -> list[Variable]:
        """The variables to record."""
        return chosen_variables(self.record_variables.replace(",", " ").split(), self.software)

    @property
    def ports(self) -> dict[str, int]:
        """The TCP ports that this controller has, by name, without the control port."""
        ports = {**PORTS, "modbus": self.modbus_port, "robot_api": self.robot_api_port}
        if self.software[0] >= 10:
            del ports["dashboard"]
        if self.robot.is_cb3:
            del ports["tool"]
        if not SINCE["interpreter_mode"].reached_by(self.software):
            del ports["interpreter"]
        if not self.modbus:
            del ports["modbus"]
        if not self.robot_api:
            del ports["robot_api"]
        return ports
