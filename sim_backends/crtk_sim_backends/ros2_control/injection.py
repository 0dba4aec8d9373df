"""The faults of a simulated robot behind ros2_control."""

from __future__ import annotations

from typing import Final

from crtk_sim_backends.faults import FaultKind, KindTable, Parameter

_JOINT: Final = Parameter(int, 0, minimum=0, maximum=63)
_CONTROLLER: Final = Parameter(str, "forward_position_controller")

_LASTING: Final = tuple(
    FaultKind(name, summary, parameters, lasting=True)
    for name, summary, parameters in (
        ("disconnect", "the network is cut: nothing is told, heard or answered", {}),
        ("broadcaster_stops", "joint_state_broadcaster is inactive", {}),
        ("frozen", "joint states repeat one stamp", {}),
        (
            "delay",
            "joint states arrive late",
            {"seconds": Parameter(float, 0.2, minimum=0.0, maximum=10.0)},
        ),
        ("unstamped", "joint states have no stamp", {}),
        (
            "not_a_number",
            "a joint has NaN in joint states",
            {
                "joint": _JOINT,
                "of": Parameter(str, "position", choices=("position", "velocity", "effort")),
            },
        ),
        ("missing", "a joint is missing in joint states", {"joint": _JOINT}),
        ("twice", "a joint is there twice in joint states", {"joint": _JOINT}),
        ("reorder", "joint states have the joints in the opposite order", {}),
        ("split", "joint states come in two messages, each with some joints", {}),
        ("garbage", "messages on joint_states are bytes of no message", {}),
        ("rival", "another node publishes joint states of the same joints, all at zero", {}),
        (
            "late_services",
            "services (one, or all if empty) answer late",
            {
                "seconds": Parameter(float, 1.0, minimum=0.0, maximum=60.0),
                "service": Parameter(str, ""),
            },
        ),
        (
            "silent_services",
            "services (one, or all if empty) do not answer",
            {"service": Parameter(str, "")},
        ),
        (
            "lost_answers",
            "the first answers of each service are lost, as to a client that was not found yet",
            {"count": Parameter(int, 1, minimum=1, maximum=100)},
        ),
        (
            "refuse_activation",
            "a controller refuses to be activated",
            {"controller": _CONTROLLER},
        ),
        (
            "feign_activation",
            "a switch is answered with ok, and a controller is not activated",
            {"controller": _CONTROLLER},
        ),
        ("block", "a joint is held by something", {"joint": _JOINT}),
        ("deaf", "forward controllers do not hear their commands", {}),
        ("other_order", "forward controllers have their joints in the opposite order", {}),
    )
)

KINDS: Final[KindTable] = {
    **{kind.name: kind for kind in _LASTING},
    "hardware_error": FaultKind(
        "hardware_error",
        "the hardware component leaves active by an error",
        {"to": Parameter(str, "inactive", choices=("inactive", "unconfigured", "finalized"))},
    ),
    "hardware_mended": FaultKind("hardware_mended", "all of it is active again, by hand"),
    "deactivate": FaultKind(
        "deactivate", "somebody deactivates a controller", {"controller": _CONTROLLER}
    ),
    "all_inactive": FaultKind("all_inactive", "somebody deactivates whatever commands joints"),
    "take_joints": FaultKind("take_joints", "somebody activates a controller of his own instead"),
    "give_joints": FaultKind("give_joints", "that controller is inactive again"),
    "unload": FaultKind("unload", "somebody unloads a controller", {"controller": _CONTROLLER}),
    "load": FaultKind("load", "somebody loads it again", {"controller": _CONTROLLER}),
    "restart": FaultKind(
        "restart",
        "ros2_control_node is started anew; it is away meanwhile",
        {"seconds": Parameter(float, 1.0, minimum=0.0, maximum=60.0)},
    ),
}
