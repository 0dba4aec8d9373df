"""Configuration of a simulated UR controller."""

from __future__ import annotations

import dataclasses
import ipaddress
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends.faults import unknown
from crtk_sim_backends.process import AUTO
from crtk_sim_backends.ur.models import MODELS, RobotModel
from crtk_sim_backends.ur.variables import Version

PORTS: Final = {
    "rtde": 30004,
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "primary_read_only": 30011,
    "secondary_read_only": 30012,
    "realtime_read_only": 30013,
}
"""TCP ports of the controller by name. PolyScope X (10.x) has no dashboard server."""

_DEFAULT_VERSIONS: Final = {True: "3.15.8", False: "5.12.4"}  # by "is a CB3 arm"


class ConfigError(ValueError):
    """A simulator option with a value that cannot be used."""


def _option(default: Any, help_text: str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=default, metadata={"help": help_text, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class SimConfig:
    """Options of a simulated UR controller; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    host: str = _option(
        AUTO, "loopback address to listen on; 'auto' finds a free one in 127.0.0.0/8"
    )
    model: str = _option("ur5e", "arm to simulate", tuple(MODELS))
    version: str = _option(
        AUTO, "controller software, such as 5.12.4; 'auto': 5.12.4, or 3.15.8 for a CB3 arm"
    )
    powered_on: bool = _option(True, "start with the arm powered and the brakes released")
    remote: bool = _option(True, "start in remote control (e-Series)")
    serial_number: str = _option("20235500001", "serial number that the dashboard reports")
    faults: str = _option("", "fault file (YAML) to play from the start")
    control_port: int = _option(0, "port of the control socket; 0: any free one")
    trace_size: int = _option(5000, "how many received input packages the trace keeps")
    realtime: bool = _option(
        False, "run with real-time priority (SCHED_FIFO) when the system permits it"
    )

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ConfigError(f"model: {unknown('arm', self.model, MODELS)}")
        if self.host != AUTO:
            _check_loopback(self.host)
        if not re.fullmatch(r"\d{4,20}", self.serial_number):
            raise ConfigError(f"serial_number must be 4 to 20 digits, not {self.serial_number!r}")
        if not 0 <= self.control_port <= 65535:
            raise ConfigError(f"control_port must lie in [0, 65535], not {self.control_port}")
        if self.trace_size < 1:
            raise ConfigError(f"trace_size must be at least 1, not {self.trace_size}")
        if self.faults and not Path(self.faults).is_file():
            raise ConfigError(f"faults: there is no file {self.faults}")
        major = self.software[0]
        if self.robot.is_cb3 != (major == 3) or major not in (3, 5, 10):
            needed = "3.x" if self.robot.is_cb3 else "5.x or 10.x"
            raise ConfigError(f"version: a {self.robot.title} has software {needed}, not {major}.x")
        if self.robot.is_cb3 and not self.remote:
            raise ConfigError("remote: a CB3 controller has no local control")

    @property
    def robot(self) -> RobotModel:
        """The arm."""
        return MODELS[self.model]

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
    def ports(self) -> dict[str, int]:
        """The TCP ports that this controller has, by name, without the control port."""
        if self.software[0] < 10:
            return dict(PORTS)
        return {name: port for name, port in PORTS.items() if name != "dashboard"}


def make_config(config: SimConfig | None = None, **options: Any) -> SimConfig:
    """Make a configuration from another one and options that replace its values.

    Raises:
        ConfigError: for an unknown option (with a suggestion) or a wrong value.
    """
    names = {entry.name for entry in dataclasses.fields(SimConfig)}
    for name in options:
        if name not in names:
            raise ConfigError(unknown("simulator option", name, names))
    return dataclasses.replace(config or SimConfig(), **options)


def _check_loopback(host: str) -> None:
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError as error:
        raise ConfigError(f"host must be 'auto' or an IPv4 address, not {host!r}") from error
    if not address.is_loopback:
        raise ConfigError(
            f"host must be a loopback address (127.x.y.z), not {host}: the protocols of the "
            "controller have no authentication"
        )
