"""The node's ROS parameters, with descriptions and ranges: ``ros2 param describe`` shows them.

They are the fields of `NodeConfig`. The rates can be changed while the node runs; a value out of range is
refused by rclpy itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

from annotated_types import Ge, Gt, Le
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from crtk_drivers.config import NodeConfig
from crtk_drivers.errors import ConfigError
from crtk_drivers.ros.names import default_frame_prefix

Default = TypeVar("Default", float, str, bool)

_RATES = {
    name: field for name, field in NodeConfig.model_fields.items() if field.annotation is float
}

_KINDS = {float: "a number with a decimal point", str: "a text", bool: "true or false"}


def declare_rates(node: Node, initial: NodeConfig, apply: Callable[[str, float], None]) -> None:
    """Declare the rates, and call `apply` with name and value now and whenever one changes.

    Raises:
        ConfigError: a value given at the start is of another type or out of range.
    """
    for name, field in _RATES.items():
        descriptor = ParameterDescriptor(
            description=field.description or "", floating_point_range=[_range(field)]
        )
        apply(name, _declare(node, name, float(getattr(initial, name)), descriptor))

    def changed(parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name in _RATES:
                apply(parameter.name, float(parameter.value))

    node.add_post_set_parameters_callback(changed)


def declare_frame_prefix(node: Node, initial: NodeConfig) -> str:
    """Declare ``frame_prefix`` and return what it is."""
    default = initial.frame_prefix
    if default is None:
        default = default_frame_prefix(node.get_namespace())
    return _declare(node, "frame_prefix", default, _read_only("frame_prefix"))


def declare_fixed(node: Node, initial: NodeConfig, name: str) -> Any:
    """Declare a parameter that cannot be changed, and return what it is."""
    return _declare(node, name, getattr(initial, name), _read_only(name))


def _read_only(name: str) -> ParameterDescriptor:
    description = NodeConfig.model_fields[name].description or ""
    return ParameterDescriptor(description=description, read_only=True)


def _range(field: FieldInfo) -> FloatingPointRange:
    lower, upper = -math.inf, math.inf
    for bound in field.metadata:
        if isinstance(bound, Ge):
            lower = float(bound.ge)  # type: ignore[arg-type]
        elif isinstance(bound, Gt):
            lower = math.nextafter(float(bound.gt), math.inf)  # type: ignore[arg-type]
        elif isinstance(bound, Le):
            upper = float(bound.le)  # type: ignore[arg-type]
    return FloatingPointRange(from_value=lower, to_value=upper, step=0.0)


def _declare(node: Node, name: str, default: Default, descriptor: ParameterDescriptor) -> Default:
    try:
        value: Default = node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException as error:
        kind = _KINDS[type(default)]
        raise ConfigError(
            f"the parameter {name} is of the wrong type",
            remedy=f"Give {kind}, for example: --ros-args -p {name}:={default}",
        ) from error
    except InvalidParameterValueException as error:
        bounds = descriptor.floating_point_range[0]
        raise ConfigError(
            f"the parameter {name} is out of range",
            remedy=f"Give a value from {bounds.from_value:g} to {bounds.to_value:g}.",
        ) from error
    return value
