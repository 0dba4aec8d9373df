"""A lab as units of systemd: a service a device, which may do little beyond its own, and a target for all.

systemd starts what comes after a device once its process runs, not once it measures: a driver that does not
find what it needs keeps trying. Stopping is as of `crtk_drivers.labs.supervisor`. Source: systemd.exec(5),
systemd.service(5) of systemd 252 to 257; older ones pass over keys that they do not know.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.exit_codes import USAGE_ERROR
from crtk_drivers.labs.child import FIRST_DELAY
from crtk_drivers.labs.invocation import device_command, settings_text
from crtk_drivers.labs.lab_file import Lab, LabDevice
from crtk_drivers.labs.supervisor import LONGEST_DELAY, STOP_TIMEOUT
from crtk_drivers.labs.unit_environment import unit_environment

HEADER: Final = "# Written by crtk-driver up --systemd; it is written anew the next time.\n"

_HARDENED: Final = """\
DynamicUser=yes
NoNewPrivileges=yes
CapabilityBoundingSet=
LimitRTPRIO=20
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=yes
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
LockPersonality=yes
RestrictNamespaces=yes
RestrictSUIDSGID=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK AF_CAN
SystemCallArchitectures=native
SystemCallFilter=@system-service
"""
"""Real-time priority takes LimitRTPRIO and no capability; RestrictRealtime would take it away."""

_DEVICES: Final = {
    "/dev/input/": """\
SupplementaryGroups=input
DevicePolicy=closed
DeviceAllow=char-input rw
""",
    "/dev/": """\
SupplementaryGroups=dialout
DevicePolicy=closed
DeviceAllow=char-ttyUSB rw
DeviceAllow=char-ttyACM rw
DeviceAllow=char-ttyS rw
DeviceAllow=char-ttyAMA rw
""",
}
"""What a unit may use, by how an address begins; the first that fits."""

_BY_A_LIBRARY: Final = """\
DevicePolicy=closed
DeviceAllow=char-usb_device rw
DeviceAllow=char-ttyACM rw
DeviceAllow=char-ttyUSB rw
"""
"""Of a device that its vendor's library finds: who may use it, the rules of udev say that come with that."""

_STEPS: Final = 5
"""Restarts until the delay is the longest."""


def units_of(lab: Lab, folder: Path) -> dict[str, str]:
    """Return the text of every file, by name: settings and service of each device, and the target.

    Args:
        lab: its programs are left out.
        folder: where the files will be.

    Raises:
        ConfigError: see `crtk_drivers.labs.unit_environment`.
    """
    found: dict[str, str] = {}
    variables = unit_environment(lab)
    for device in lab.devices.values():
        settings = f"{_stem(lab, device.name)}.yaml"
        found[settings] = HEADER + settings_text(device)
        command = device_command(device, folder / settings)
        found[_service(lab, device.name)] = _service_text(lab, device, command, variables)
    found[_target(lab)] = _target_text(lab)
    return found


def write_units(lab: Lab, folder: Path, place: Path | None = None) -> list[Path]:
    """Write the units of a lab into a folder, which is made, and return the files.

    Args:
        lab, folder: see `units_of`.
        place: where the files will be when systemd reads them, if that is another folder.

    Raises:
        ConfigError: they cannot be written, or one is there that was not written by this. Then none is.
    """
    texts = {folder / name: text for name, text in units_of(lab, place or folder).items()}
    try:
        whole = {path: text.encode() for path, text in texts.items()}
        for path in texts:
            if path.exists() and not path.read_text("utf-8").startswith(HEADER):
                raise ConfigError(
                    "is there already, and was not written by crtk-driver",
                    where=str(path),
                    remedy="Move it away, or give another folder.",
                )
        folder.mkdir(parents=True, exist_ok=True)
        for path, text in whole.items():
            path.write_bytes(text)
            path.chmod(0o644)  # the user of a unit reads it
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"units cannot be written: {error}", where=str(folder)) from error
    return list(texts)


def _stem(lab: Lab, device: str) -> str:
    return f"crtk-{lab.name}-{device}"


def _service(lab: Lab, device: str) -> str:
    return f"{_stem(lab, device)}.service"


def _target(lab: Lab) -> str:
    return f"crtk-{lab.name}.target"


def _service_text(
    lab: Lab, device: LabDevice, command: tuple[str, ...], variables: Mapping[str, str]
) -> str:
    needed = " ".join(_service(lab, name) for name in device.after if name in lab.devices)
    own = f"crtk-{lab.name}/{device.name}"
    at = "simulated" if device.sim else device.address
    places = {"HOME": f"%S/{own}", "ROS_LOG_DIR": f"%L/{own}"}
    said = "".join(f'Environment="{name}={value}"\n' for name, value in places.items())
    said += "".join(
        f"Environment={_quoted(f'{name}={value}', dollar='$')}\n"
        for name, value in variables.items()
    )
    return (
        f"""\
{HEADER}[Unit]
Description={_escaped(f"{device.name} of {lab.name}: {device.plugin.name} {at}".strip())}
PartOf={_target(lab)}
Wants=network-online.target{_also(needed)}
After=network-online.target{_also(needed)}
StartLimitIntervalSec=0

[Service]
ExecStart={" ".join(_quoted(word) for word in command)}
WorkingDirectory=-{_escaped(str(lab.path.parent.resolve()))}
StateDirectory={own}
LogsDirectory={own}
"""
        + said
        + f"""\
Restart=always
RestartSec={FIRST_DELAY:g}
RestartSteps={_STEPS}
RestartMaxDelaySec={LONGEST_DELAY:g}
RestartPreventExitStatus={USAGE_ERROR}
KillMode=mixed
KillSignal=SIGTERM
TimeoutStopSec={STOP_TIMEOUT:g}
"""
        + _HARDENED
        + _device_rights(device)
        + f"\n[Install]\nWantedBy={_target(lab)}\n"
    )


def _device_rights(device: LabDevice) -> str:
    places = [part[part.index("/dev/") :] for part in device.address.split() if "/dev/" in part]
    fitting = (
        rights
        for start, rights in _DEVICES.items()
        if any(place.startswith(start) for place in places)
    )
    by_a_library = "library" in device.plugin.addresses and not device.simulated
    return next(fitting, _BY_A_LIBRARY if by_a_library else "PrivateDevices=yes\n")


def _target_text(lab: Lab) -> str:
    services = " ".join(_service(lab, name) for name in lab.devices)
    return f"""\
{HEADER}[Unit]
Description=Devices of {lab.name}
Wants={services}

[Install]
WantedBy=multi-user.target
"""


def _also(names: str) -> str:
    return f" {names}" if names else ""


def _escaped(text: str) -> str:
    """Return a text without what systemd would put something else for."""
    return text.replace("%", "%%").replace("\n", " ")


def _quoted(word: str, dollar: str = "$$") -> str:
    """Return an argument as `ExecStart` takes it; `Environment` takes a dollar as it is."""
    inner = word.replace("%", "%%").replace("\\", "\\\\").replace('"', '\\"').replace("$", dollar)
    # a line ends for systemd at a carriage return too
    return '"' + "".join(f"\\x{ord(each):02x}" if each < " " else each for each in inner) + '"'
