"""A running device and everything that it needs: its simulator (if any), its threads, its engine.

Both fronts, plain Python and ROS, stand on a session.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from typing import Any, Self

from crtk_drivers import plugins
from crtk_drivers.config import DeviceConfig, from_values
from crtk_drivers.engine import Engine, EngineOptions
from crtk_drivers.engine.borrowed_state import Follower
from crtk_drivers.engine.threads import Looking, Runtime
from crtk_drivers.errors import ConfigError
from crtk_drivers.options import LimitPolicy
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.plugins.at_tool import attached
from crtk_drivers.plugins.page_plugin import RunningPage, start_page
from crtk_drivers.plugins.sim_plugin import RunningSim, start_sim
from crtk_drivers.session.grip_load import GripLoad
from crtk_drivers.session.recordings import Recordings
from crtk_drivers.session.scene import DeviceScene


class Session:
    """Owns simulator, runtime, engines and page of one device. No thread of it runs before `start`.

    Attributes:
        engine: of the device.
        page: that shows it in a browser; None if the configuration wants none.
        recordings: of it.
        children: of the devices behind it, by the name of their sub-namespace.
        is_closed: `close` was called.
    """

    def __init__(
        self, plugin: DevicePlugin, config: DeviceConfig, sim: RunningSim | None = None
    ) -> None:
        self.is_closed = False
        self.plugin = plugin
        self.config = config
        self.sim = sim
        device, name = plugin.make(config), config.name or plugin.name
        options = engine_options(config)
        self.engine = Engine(device, name, options)
        self.children = {
            child: Engine(
                behind, f"{name}/{child}", options, has_state=child not in device.followers
            )
            for child, behind in device.children.items()
        }
        followers: list[Looking] = [
            Follower(self.engine, self.children[child]) for child in device.followers
        ]
        tool = plugin.tool(config)
        if tool is not None and tool.payload_of_grip is not None:
            gripper = self.children[tool.name]
            followers.append(GripLoad(self.engine, gripper, tool.payload_of_grip))
        self.page: RunningPage | None = None
        self._scene: DeviceScene | None = None
        self.recordings = Recordings({"": self.engine, **self.children}, config)
        self._runtime = Runtime(
            ((engine, config.open_timeout) for engine in self.engines), followers
        )

    @property
    def engines(self) -> tuple[Engine, ...]:
        """All of them, that of the device first."""
        return (self.engine, *self.children.values())

    def open_page(self) -> None:
        """Serve the page, if the configuration wants it.

        Raises:
            PluginError: no package that brings it is installed.
            ConnectionFailed: it did not start, as its port is in use.
        """
        if self.config.web:
            detail = "simulated" if self.sim else "CRTK device"
            self._scene = DeviceScene(self.engine, self.children, detail)
            self.page = start_page(plugins.page(), self._scene, self.config.web_port)

    def place(self, namespace: str) -> None:
        """Note the namespace on ROS, for recordings and the page."""
        self.recordings.place(namespace)
        if self._scene is not None:
            self._scene.place = namespace

    def start(self) -> None:
        """Start the threads; the device is opened by them."""
        self.recordings.begin()
        self._runtime.start()

    def close(self, timeout: float = 1.5) -> None:
        """Leave the device holding, end the threads, the page and the simulator. May be called twice."""
        self.is_closed = True
        with ExitStack() as stack:
            for other in (self.sim, self.page):
                if other is not None:
                    stack.callback(other.stop)
            stack.callback(self.recordings.close)
            self._runtime.close(timeout)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        # One that failed in its constructor has no runtime.
        runtime = getattr(self, "_runtime", None)
        if runtime is not None and runtime.is_open:
            text = (
                f"{self.engine.where} was forgotten, not closed: its threads go on. "
                "Close it, or use it in a with statement."
            )
            warnings.warn(text, ResourceWarning, stacklevel=2, source=self)


def engine_options(config: DeviceConfig) -> EngineOptions:
    """Return the engine's share of a configuration."""
    given = {key.name: getattr(config, key.name) for key in fields(EngineOptions)}
    return EngineOptions(**given | {"limits": LimitPolicy(**config.limits.model_dump())})


def open_session(
    device: str,
    config: DeviceConfig,
    *,
    sim: bool = False,
    sim_options: Mapping[str, Any] | None = None,
) -> Session:
    """Return a session for `device`, not yet started; its simulator and its page, if wanted, are running.

    Args:
        device: the name of a plugin.
        config: of the plugin's configuration class.
        sim: start the plugin's simulator in a process of its own and connect to it.
        sim_options: for the simulator, over those that suit the configuration.

    Raises:
        PluginError, MissingExtra: no such device or page, or a library of it is missing.
        ConfigError: `sim` for a device without a simulator, or a wrong option for it.
        ConnectionFailed: the simulator or the page did not start.
    """
    plugin = plugins.device(device)
    if not sim:
        plugin.check_real(config)
        session = Session(plugin, config)
        session.open_page()
        return session
    running = start_sim_of(plugin, config, sim_options)
    try:
        session = Session(plugin, plugin.sim_config(config, running), running)
        session.open_page()
    except BaseException:
        running.stop()
        raise
    return session


@contextmanager
def reached(
    plugin: DevicePlugin,
    config: DeviceConfig,
    *,
    sim: bool = False,
    sim_options: Mapping[str, Any] | None = None,
) -> Iterator[DeviceConfig]:
    """The configuration that points at the hardware, or at a simulator that runs meanwhile. Makes no device.

    Raises:
        as `open_session`; what real hardware needs is not checked.
    """
    if not sim:
        yield config
        return
    running = start_sim_of(plugin, config, sim_options)
    try:
        yield plugin.sim_config(config, running)
    finally:
        running.stop()


def start_sim_of(
    plugin: DevicePlugin, config: DeviceConfig, options: Mapping[str, Any] | None
) -> RunningSim:
    """Start the simulator of a device, with the options that suit its configuration, and `options` over them.

    Raises:
        ConfigError: it has none, or a wrong option.
        PluginError, MissingExtra, ConnectionFailed: it did not start.
    """
    if plugin.sim is None:
        raise ConfigError(f"{plugin.name} has no simulator", remedy="Leave --sim out.")
    simulator, given = plugins.simulator(plugin.sim), options or {}
    suited = from_values(plugin.sim_options(config), f"the configuration of {plugin.name}")
    of_user = from_values(given, "the options of the simulator")
    tool = plugin.tool(config)
    if tool is None:
        return start_sim(simulator, suited, of_user)
    at_tool = start_sim_of(*attached(tool, ""), None)
    try:
        hung = from_values(plugin.sim_tool(at_tool), f"what {tool.plugin} is at the tool")
        return SimWithTool(start_sim(simulator, suited, hung, of_user), at_tool)
    except BaseException:
        at_tool.stop()
        raise


class SimWithTool:
    """A simulator of an arm, and that of what hangs at its tool; it is the arm's in all else.

    Attributes:
        tool: the simulator of what hangs there.
    """

    def __init__(self, arm: RunningSim, tool: RunningSim) -> None:
        self._arm = arm
        self.tool = tool

    def __getattr__(self, name: str) -> Any:
        return getattr(self._arm, name)

    def stop(self, timeout: float = 2.0) -> None:
        """End both. May be called twice."""
        try:
            self._arm.stop(timeout)
        finally:
            self.tool.stop(timeout)
