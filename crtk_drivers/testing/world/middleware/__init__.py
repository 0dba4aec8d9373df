"""ROS 2 in a world: rclpy, unchanged, on a middleware between the processes of the world.

dds              writers, readers, and what is lost between them
participants     their owners, and how these find each other
ros_arguments    what follows ``--ros-args``
rclpy_handles    replacements for rclpy's `Context` and `Node`
rclpy_endpoints  for `Publisher`, `Subscription`, `Client`, `Service`
rclpy_clocks     for `GuardCondition`, `Clock`, `Timer`
rclpy_waiting    for `WaitSet` and `EventsExecutor`
rclpy_actions    for `ActionClient`
message_bytes    messages as CDR, without what was in memory before
rcl_functions    what is called of rcl by ctypes

rclpy is not imported here. When a program in a world imports it, its compiled module gets what is here.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any, Final, NoReturn

from typing_extensions import override

from crtk_drivers.testing.world.machine.kernel import NotSimulated

_COMPILED: Final = "rclpy._rclpy_pybind11"
_REFUSED: Final = ("ActionServer", "ClockEvent", "LifecycleStateMachine")


def install() -> None:
    """Let rclpy, when it is imported, be that of a world."""
    from crtk_drivers.testing.world.middleware import rcl_functions

    sys.meta_path.insert(0, _Finder())
    ctypes.CDLL = rcl_functions.Library  # type: ignore[misc]


class _Finder(MetaPathFinder):
    @override
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _COMPILED:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _Compiled(spec.loader)
        return spec


class _Compiled(Loader):
    """Loads rclpy's module, and replaces what reaches the middleware."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    @override
    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    @override
    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        from crtk_drivers.testing.world.middleware import rclpy_handles

        rclpy_handles.compiled = module
        for name, ours in _replaced().items():
            if not hasattr(module, name):
                raise NotSimulated(f"an rclpy that has no {name}")
            setattr(module, name, ours)


def _replaced() -> dict[str, Any]:
    from crtk_drivers.testing.world.middleware import message_bytes
    from crtk_drivers.testing.world.middleware import rclpy_clocks as clocks
    from crtk_drivers.testing.world.middleware import rclpy_endpoints as endpoints
    from crtk_drivers.testing.world.middleware import rclpy_handles as handles
    from crtk_drivers.testing.world.middleware import rclpy_waiting as waiting
    from crtk_drivers.testing.world.middleware.dds import Reader, Writer
    from crtk_drivers.testing.world.middleware.rclpy_actions import ActionClient

    def do_nothing(*_: object) -> None:
        pass

    found = handles.names_and_types
    return {
        "Context": handles.Context,
        "Node": handles.Node,
        "Publisher": endpoints.Publisher,
        "Subscription": endpoints.Subscription,
        "Client": endpoints.Client,
        "Service": endpoints.Service,
        "TypeDescriptionService": endpoints.TypeDescriptionService,
        "EventHandle": endpoints.EventHandle,
        "GuardCondition": clocks.GuardCondition,
        "ActionClient": ActionClient,
        "Clock": clocks.Clock,
        "Timer": clocks.Timer,
        "rmw_request_id_t": endpoints.RequestId,
        "rmw_service_info_t": endpoints.ServiceInfo,
        "WaitSet": waiting.WaitSet,
        "EventsExecutor": waiting.EventsExecutor,
        "rclpy_serialize": message_bytes.serialize,
        "rclpy_resolve_name": lambda node, name, only_expand, _: node.full(
            name, is_remapped=not only_expand
        ),
        "rclpy_remap_topic_name": lambda node, name: node.remapped(name),
        "rclpy_get_topic_names_and_types": lambda node, _: found(node, "rt"),
        "rclpy_get_service_names_and_types": lambda node: found(node, "rq", Reader),
        "rclpy_get_publisher_names_and_types_by_node": lambda node, _, *of: found(
            node, "rt", Writer, of
        ),
        "rclpy_get_subscriber_names_and_types_by_node": lambda node, _, *of: found(
            node, "rt", Reader, of
        ),
        "rclpy_get_service_names_and_types_by_node": lambda node, *of: found(
            node, "rq", Reader, of
        ),
        "rclpy_get_client_names_and_types_by_node": lambda node, *of: found(node, "rq", Writer, of),
        "rclpy_get_publishers_info_by_topic": lambda node, topic, _: handles.infos(
            node, topic, Writer
        ),
        "rclpy_get_subscriptions_info_by_topic": lambda node, topic, _: handles.infos(
            node, topic, Reader
        ),
        "rclpy_logging_configure": do_nothing,
        "rclpy_logging_fini": do_nothing,
        "rclpy_logging_shutdown": do_nothing,
        "rclpy_logging_rcutils_log": handles.log,
        "rclpy_logging_rosout_add_sublogger": lambda *_: False,
        "rclpy_logging_rosout_remove_sublogger": do_nothing,
        "rclpy_assert_liveliness": do_nothing,
        "install_signal_handlers": do_nothing,
        "uninstall_signal_handlers": do_nothing,
        "register_sigint_guard_condition": do_nothing,
        "unregister_sigint_guard_condition": do_nothing,
        **{name: _refused(name) for name in _REFUSED},
    }


def _refused(name: str) -> Any:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise NotSimulated(f"rclpy's {name}")

    return refuse
