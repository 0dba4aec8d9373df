"""Universal Robots arms (CB3 and e-Series) over RTDE."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crtk_driver_ur.plugin import PLUGIN

__all__ = ["PLUGIN"]


def __getattr__(name: str) -> Any:
    """Import the plugin when it is first used: the control process starts without all that it needs."""
    if name != "PLUGIN":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from crtk_driver_ur.plugin import PLUGIN

    return PLUGIN
