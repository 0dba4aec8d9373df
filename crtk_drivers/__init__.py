"""crtk-drivers: hardware drivers that speak CRTK, on ROS 2 and in plain Python."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crtk_drivers.front import LocalDevice, connect
    from crtk_drivers.samples import JointState, Pose, Twist, Wrench

__all__ = ["JointState", "LocalDevice", "Pose", "Twist", "Wrench", "connect"]

_MODULES = {"LocalDevice": "front", "connect": "front"}


def __getattr__(name: str) -> Any:
    # Imported when first used: `crtk-driver --help` needs none of it.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_MODULES.get(name, 'samples')}")
    return getattr(module, name)
