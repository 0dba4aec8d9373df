"""What runs a device: its cycle, its state, its threads; no ROS in it."""

from crtk_drivers.engine.cycle import Engine
from crtk_drivers.options import EngineOptions
from crtk_drivers.status.board import Observer

__all__ = ["Engine", "EngineOptions", "Observer"]
