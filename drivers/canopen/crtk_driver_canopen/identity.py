"""Who a node is (1018), and whether that is who the configuration expects."""

from __future__ import annotations

from dataclasses import dataclass

from typing_extensions import override

from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo, SdoAborted
from crtk_drivers.errors import DeviceError

SERVO_PROFILE = 402


class WrongDevice(DeviceError):
    """Another device than the configured one has this node id."""


@dataclass(frozen=True)
class Identity:
    """Identity object and names of a node. None: it does not tell.

    Attributes:
        device_type: (1000) its low half is the number of the profile, 402 for a drive.
        vendor: (1018:1) number given by CiA.
    """

    device_type: int | None = None
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    name: str = ""
    hardware: str = ""
    software: str = ""

    @property
    def profile(self) -> int | None:
        """Number of the CiA profile, for example 402."""
        return None if self.device_type is None else self.device_type & 0xFFFF

    @override
    def __str__(self) -> str:
        numbers = {
            "vendor": self.vendor,
            "product": self.product,
            "revision": self.revision,
        }
        texts = [f"{key} 0x{value:08x}" for key, value in numbers.items() if value is not None]
        if self.serial is not None:
            texts.append(f"serial {self.serial}")
        return " ".join([self.name, *texts]).strip() or "unknown"


def read_identity(sdo: Sdo) -> Identity:
    """Return who a node is; numbers and names that it does not have are left out.

    Raises:
        SdoSilent, ProtocolError: it does not answer, or not as it should.
        SdoAborted: it refuses a number for another reason than that it has no such object.
    """

    def text(name: str) -> str:
        try:
            return sdo.read_text(OBJECTS[name])
        except SdoAborted:
            return ""

    return Identity(
        device_type=sdo.find(OBJECTS["device_type"]),
        vendor=sdo.find(OBJECTS["vendor_id"]),
        product=sdo.find(OBJECTS["product_code"]),
        revision=sdo.find(OBJECTS["revision_number"]),
        serial=sdo.find(OBJECTS["serial_number"]),
        name=text("device_name"),
        hardware=text("hardware_version"),
        software=text("software_version"),
    )


def check_identity(found: Identity, wanted: Identity, where: str) -> None:
    """Refuse a node that is another device than the one that is wanted, or no drive.

    Args:
        wanted: what is None or empty is not compared.
        where: the node and its bus.

    Raises:
        WrongDevice: naming all that differs.
    """
    if found.profile is not None and found.profile != SERVO_PROFILE:
        raise WrongDevice(
            f"the node has device profile {found.profile}, not {SERVO_PROFILE}: it is no drive ({found})",
            where=where,
            remedy="Check the node id: 'crtk-driver canopen scan' shows who has which.",
        )
    differences = []
    for key in ("vendor", "product", "revision"):
        asked, has = getattr(wanted, key), getattr(found, key)
        if asked is not None and asked != has:
            shown = "nothing" if has is None else f"0x{has:08x}"
            differences.append(f"{key} is {shown}, not 0x{asked:08x}")
    if wanted.serial is not None and wanted.serial != found.serial:
        differences.append(f"serial number is {found.serial}, not {wanted.serial}")
    if wanted.name and wanted.name != found.name:
        differences.append(f"name is {found.name!r}, not {wanted.name!r}")
    if differences:
        raise WrongDevice(
            f"another device than configured: {'; '.join(differences)} (found: {found})",
            where=where,
            remedy="Two drives may have been exchanged: check node ids and wiring, or correct `identity` "
            "in the configuration.",
        )
