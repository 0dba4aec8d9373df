"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from crtk_driver_dvrk.config import DvrkConfig
from crtk_driver_dvrk.tools import TOOLS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim

_FILES: Final = Path(__file__).parent

TYPICAL: Mapping[str, Any] = {
    "io": str(_FILES / "sawRobotIO1394-PSM1-simulated.json"),
    "coupling": str(_FILES / "large-needle-driver-simulated.json"),
    "joint_names": ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"),
}
"""The arm that ``--sim`` shows when no file is given: a PSM with an instrument, on boards 6 and 7."""


def _create(config: DvrkConfig) -> Device:
    from crtk_driver_dvrk.device import DvrkDevice
    from crtk_driver_dvrk.driven import DrivenDevice

    return DrivenDevice(config) if config.drive else DvrkDevice(config)


def _check_real(config: DvrkConfig) -> None:
    examples = {"host": "--host 169.254.0.100", "io": "--io sawRobotIO1394-PSM1-12345.json"}
    for key, example in examples.items():
        if not getattr(config, key):
            raise ConfigError(
                f"{key}: is required for real hardware",
                where="dvrk",
                remedy=f"Give it ({example}), or use --sim.",
            )


def _with_arm(config: DvrkConfig) -> DvrkConfig:
    if config.io:
        return config
    return DvrkConfig(**{**TYPICAL, **config.model_dump(exclude_unset=True)})


def _at_sim(config: DvrkConfig, sim: RunningSim) -> DvrkConfig:
    place = {"host": sim.host, "udp_port": sim.ports["boards"], "broadcast": ""}
    return _with_arm(config).model_copy(update=place)


def _sim_options(config: DvrkConfig) -> Mapping[str, Any]:
    from crtk_driver_dvrk.arm_file import read_arm

    boards = sorted(read_arm(_with_arm(config).io, config.robot).boards)
    return {"boards": ",".join(map(str, boards))}


def _link(config: DvrkConfig, sim: RunningSim | None) -> DeviceLink | None:
    return DeviceLink(config.host, udp={"boards": config.udp_port})


def _at_link(config: DvrkConfig, link: DeviceLink) -> DvrkConfig:
    place = {"host": link.host, "udp_port": link.udp["boards"], "broadcast": ""}
    return config.model_copy(update=place)


PLUGIN = DevicePlugin(
    name="dvrk",
    summary="controllers of da Vinci Research Kits (FPGA1394, QLA, firmware 8): an arm is read, or driven",
    config=DvrkConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="dvrk",
    addresses=("host", "udp_port"),
    check_real=_check_real,
    sim_config=_at_sim,
    sim_options=_sim_options,
    typical=TYPICAL,
    tools=TOOLS,
    link=LinkAccess(_link, _at_link),
)
