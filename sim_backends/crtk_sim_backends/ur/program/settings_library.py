"""The URScript built-ins that set what the simulated arm does not feel: checked, kept, told again.

PolyScope writes most of them at the start of each program. Names and parameters follow the URScript
manual, chapters "internals" and "motion".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from crtk_sim_backends.ur.urscript import Builtin, List, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.arguments import six, vector


def settings_builtins() -> Iterator[Builtin]:
    """Every built-in of this module for one controller, with settings of its own."""
    for call in _settings():
        yield Builtin(call.__name__, call)


def _settings() -> list[Callable[..., Any]]:
    base_acceleration = (0.0, 0.0, 0.0)
    motion_version = 1

    def chosen(name: str, value: Any, choices: tuple[int, ...]) -> int:
        if value not in choices:
            allowed = ", ".join(map(str, choices))
            raise ScriptRuntimeError(f"{name}: expected one of {allowed}, got {value}")
        return int(value)

    def set_base_acceleration(a: Any) -> None:
        nonlocal base_acceleration
        x, y, z = vector("set_base_acceleration", a, 3)
        base_acceleration = (x, y, z)

    def get_base_acceleration() -> List:
        return List(base_acceleration)

    def motion_version_set(version: int) -> None:
        nonlocal motion_version
        motion_version = chosen("motion_version_set", version, (1, 2))

    def motion_version_get() -> int:
        return motion_version

    def set_safety_mode_transition_hardness(type: int) -> None:
        chosen("set_safety_mode_transition_hardness", type, (0, 1))

    def tool_wrench_limit_set(
        frame_offset: Any,
        Fx: float | None = None,  # noqa: N803
        Fy: float | None = None,  # noqa: N803
        Fz: float | None = None,  # noqa: N803
        Mx: float | None = None,  # noqa: N803
        My: float | None = None,  # noqa: N803
        Mz: float | None = None,  # noqa: N803
    ) -> None:
        six("tool_wrench_limit_set", frame_offset)
        for limit in (Fx, Fy, Fz, Mx, My, Mz):
            if limit is not None and not limit > 0:
                raise ScriptRuntimeError(f"tool_wrench_limit_set: no limit {limit}")

    def tool_wrench_limit_disable() -> None:
        pass

    def high_holding_torque_enable() -> None:
        pass

    def high_holding_torque_disable() -> None:
        pass

    def reset_revolution_counter(qNear: Any = (0.0,) * 6) -> None:  # noqa: N803
        six("reset_revolution_counter", qNear)

    def set_baselight_off() -> None:
        pass

    def set_baselight_iec() -> None:
        pass

    def set_baselight_solid(r: int, g: int, b: int) -> None:
        for colour in (r, g, b):
            if not 0 <= colour <= 255:
                raise ScriptRuntimeError(f"set_baselight_solid: no colour {colour}")

    def position_deviation_warning(enabled: bool, threshold: float = 0.8) -> None:
        if not 0 <= threshold <= 1:
            raise ScriptRuntimeError(f"position_deviation_warning: no threshold {threshold}")

    return [
        set_base_acceleration,
        get_base_acceleration,
        motion_version_set,
        motion_version_get,
        set_safety_mode_transition_hardness,
        tool_wrench_limit_set,
        tool_wrench_limit_disable,
        high_holding_torque_enable,
        high_holding_torque_disable,
        reset_revolution_counter,
        set_baselight_off,
        set_baselight_iec,
        set_baselight_solid,
        position_deviation_warning,
    ]
