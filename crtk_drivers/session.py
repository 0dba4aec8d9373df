"""A running device and everything that it needs: its simulator (if any), its threads, its engine.

Both fronts, plain Python and ROS, stand on a session.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from crtk_drivers import plugins
from crtk_drivers.config import DeviceConfig, from_values
from crtk_drivers.device import Device
from crtk_drivers.engine import Engine, EngineOptions
from crtk_drivers.errors import ConfigError
from crtk_drivers.limits import LimitPolicy
from crtk_drivers.placed import PlacedDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.runtime import Runtime
from crtk_drivers.sims import RunningSim, start


class Session:
    """Owns simulator, runtime and engines of one device. Nothing runs before `start`.

    Attributes:
        engine: of the device.
        children: of the devices behind it, by the name of their sub-namespace.
    """

    def __init__(
        self, plugin: DevicePlugin, config: DeviceConfig, sim: RunningSim | None = None
    ) -> None:
        self.plugin = plugin
        self.config = config
        self.sim = sim
        device, name = make_device(plugin, config), config.name or plugin.name
        options = engine_options(config)
        self.engine = Engine(device, name, options)
        self.children = {
            child: Engine(behind, f"{name}/{child}", options)
            for child, behind in device.children.items()
        }
        self._runtime = Runtime((engine, config.open_timeout) for engine in self.engines)

    @property
    def engines(self) -> tuple[Engine, ...]:
        """All of them, that of the device first."""
        return (self.engine, *self.children.values())

    def start(self) -> None:
        """Start the threads; the device is opened by them."""
        self._runtime.start()

    def close(self, timeout: float = 1.5) -> None:
        """Leave the device holding, end the threads, stop the simulator. May be called twice."""
        try:
            self._runtime.close(timeout)
        finally:
            if self.sim is not None:
                self.sim.stop()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def make_device(plugin: DevicePlugin, config: DeviceConfig) -> Device:
    """Return the device of a configuration, with the kinematics and the place that it names.

    Raises:
        ConfigError, MissingExtra: it cannot be made.
    """
    device = plugin.create(config)
    if config.kinematics is not None:
        from crtk_drivers.modelled import ModelledDevice  # pinocchio is not needed otherwise

        device = ModelledDevice(device, config.kinematics)
    if config.base is not None:
        device = PlacedDevice(device, replace(config.base.pose, frame_id=config.base.frame_id))
    return device


def engine_options(config: DeviceConfig) -> EngineOptions:
    """Return the engine's share of a configuration."""
    limits = config.limits
    return EngineOptions(
        stream_timeout=config.stream_timeout,
        interpolate_timeout=config.interpolate_timeout,
        on_stream_timeout=config.on_stream_timeout,
        sample_timeout=config.sample_timeout,
        mode_switch_dwell=config.mode_switch_dwell,
        move_cp=config.move_cp,
        limits=LimitPolicy(
            clamp_servo=limits.clamp_servo,
            max_step=limits.max_step,
            max_linear_step=limits.max_linear_step,
            max_command_age=limits.max_command_age,
        ),
    )


def open_session(
    device: str,
    config: DeviceConfig,
    *,
    sim: bool = False,
    sim_options: Mapping[str, Any] | None = None,
) -> Session:
    """Return a session for `device`, not yet started; with `sim`, its simulator is running.

    Args:
        device: the name of a plugin.
        config: of the plugin's configuration class.
        sim: start the plugin's simulator in a process of its own and connect to it.
        sim_options: for the simulator, over those that suit the configuration.

    Raises:
        PluginError, MissingExtra: no such device, or a library of it is missing.
        ConfigError: `sim` for a device without a simulator, or a wrong option for it.
        ConnectionFailed: the simulator did not start.
    """
    plugin = plugins.device(device)
    if not sim:
        plugin.check_real(config)
        return Session(plugin, config)
    if plugin.sim is None:
        raise ConfigError(f"{device} has no simulator", remedy="Leave --sim out.")
    running = start(
        plugins.simulator(plugin.sim),
        from_values(plugin.sim_options(config), f"the configuration of {device}"),
        from_values(sim_options or {}, "the options of the simulator"),
    )
    try:
        return Session(plugin, plugin.sim_config(config, running), running)
    except BaseException:
        running.stop()
        raise
