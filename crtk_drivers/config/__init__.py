"""Configuration: typed tables, read from defaults, a file and the command line, later ones first."""

from crtk_drivers.config.attached import AttachedConfig, BehindConfig
from crtk_drivers.config.axis_joint import AxisJoint
from crtk_drivers.config.layers import (
    Layer,
    from_assignments,
    from_file,
    from_values,
    load,
    typed_value,
    values_of,
)
from crtk_drivers.config.settings import (
    BaseConfig,
    BoxConfig,
    DeviceConfig,
    DhRowConfig,
    Interval,
    KinematicsConfig,
    LimitsConfig,
    NodeConfig,
    PoseConfig,
    Seconds,
    Settings,
    SpaceConfig,
    ToolLimitsConfig,
    with_node,
)

__all__ = [
    "AttachedConfig",
    "AxisJoint",
    "BaseConfig",
    "BehindConfig",
    "BoxConfig",
    "DeviceConfig",
    "DhRowConfig",
    "Interval",
    "KinematicsConfig",
    "Layer",
    "LimitsConfig",
    "NodeConfig",
    "PoseConfig",
    "Seconds",
    "Settings",
    "SpaceConfig",
    "ToolLimitsConfig",
    "from_assignments",
    "from_file",
    "from_values",
    "load",
    "typed_value",
    "values_of",
    "with_node",
]
