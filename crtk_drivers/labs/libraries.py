"""Whether what the devices of a lab need is installed: known before any of them is started."""

from __future__ import annotations

from crtk_drivers.config import from_file
from crtk_drivers.errors import ConfigError, CrtkError, MissingExtra
from crtk_drivers.labs.lab_file import Lab, LabDevice

__all__ = ["require_libraries"]


def require_libraries(lab: Lab) -> None:
    """Make each device of a lab once, which touches no hardware, and forget it.

    Of a simulated one only the libraries count: its simulator fills in settings that are missing here.

    Raises:
        ConfigError: libraries are missing, of whichever devices, with the commands that install them; or a
            real device cannot be made with its settings.
    """
    missing: dict[str, MissingExtra] = {}
    for device in lab.devices.values():
        try:
            device.plugin.make(device.config)
        except MissingExtra as error:
            missing[device.name] = error
        except Exception as error:  # a constructor may fail in its own way where joints are missing
            if device.simulated:
                continue
            remedy = error.remedy if isinstance(error, CrtkError) else ""
            text = error.message if isinstance(error, CrtkError) else str(error)
            raise ConfigError(text, where=_place(lab, device), remedy=remedy) from error
    if missing:
        first = lab.devices[next(iter(missing))]
        raise ConfigError(
            "; ".join(f"{name}: {error.message}" for name, error in missing.items()),
            where=_place(lab, first),
            remedy="; ".join(dict.fromkeys(error.remedy for error in missing.values())),
        )


def _place(lab: Lab, device: LabDevice) -> str:
    return from_file(lab.path).place(("devices", device.name))
