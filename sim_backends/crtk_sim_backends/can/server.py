"""A virtual bus with all its doors, faults, log and control socket, ready for clients."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Final, Protocol

from crtk_sim_backends.can import frames, scene
from crtk_sim_backends.can.candump import LogError, LogWriter, parse_frame
from crtk_sim_backends.can.config import NONE, SimConfig
from crtk_sim_backends.can.effects import BusEffects
from crtk_sim_backends.can.hub import Hub
from crtk_sim_backends.can.injection import EVENTS, KINDS, PLACES
from crtk_sim_backends.can.native import socket_path
from crtk_sim_backends.can.replay import Replay
from crtk_sim_backends.control import Handlers
from crtk_sim_backends.faults import Fault, FaultError
from crtk_sim_backends.kit import Device, FaultDesk, TcpServer, control_door
from crtk_sim_backends.page import Live, Scene
from crtk_sim_backends.process import (
    AUTO,
    SimStartError,
    bind_somewhere,
    listen,
    prepare_process,
)

_LOG_PERIOD: Final = 0.5  # s after which a log is on the disk


class Devices(Device, Protocol):
    """Simulated devices on the bus, in the process of the hub."""

    events: Collection[str]
    """What fault files can wait for, beside the events of the bus."""
    places: tuple[str, ...]
    """Parameters that say where a fault is."""
    handlers: Handlers
    """Requests on the control socket, beside those of the bus."""


class HubServer:
    """A bus in a process of its own, with simulated devices or without.

    Args:
        config: its options; everything is bound by the constructor.
        devices: makes the devices, which attach themselves to the hub.
        parent_fd: file descriptor that becomes readable when the process that wants this bus has
            died, None for none.

    Raises:
        SimStartError: when something cannot be bound or opened, or a file is wrong.
    """

    def __init__(
        self,
        config: SimConfig,
        parent_fd: int | None = None,
        devices: Callable[[Hub], Devices] | None = None,
    ) -> None:
        self.config = config
        self.hub = Hub(config.bitrate, config.stuffing, echo=config.echo, queue=config.queue)
        self.paths: dict[str, str] = {}
        self.ttys: dict[str, str] = {}
        self.ports: dict[str, int] = {}
        self._control: TcpServer | None = None
        self._replay: Replay | None = None
        try:
            self._effects = BusEffects(self.hub)
            self._devices = None if devices is None else devices(self.hub)
            self._faults = self._fault_desk(self._devices)
            self.hub.happened = self._faults.event
            self._open_doors()
            if config.log:
                self.hub.recorder = LogWriter(Path(config.log), config.channel)
            if config.replay:
                self._start_replay(config.replay, config.replay_speed)
        except (FaultError, LogError) as error:
            self.close()
            raise SimStartError(str(error)) from error
        except BaseException:
            self.close()
            raise
        if parent_fd is not None:
            self.hub.loop.watch(parent_fd, lambda _: self.stop())

    def _fault_desk(self, devices: Devices | None) -> FaultDesk:
        kinds, events = {**KINDS}, [*EVENTS]
        places: tuple[str, ...] = PLACES
        if devices is not None:
            kinds.update(devices.kinds)
            events += devices.events
            places += tuple(name for name in devices.places if name not in PLACES)
        path = self.config.faults
        return FaultDesk(
            self.hub.loop, kinds, self._begin, self._end, path=path, events=events, places=places
        )

    def _begin(self, fault: Fault) -> None:
        (self._effects if fault.kind in KINDS else self._devices_there).begin(fault)

    def _end(self, fault: Fault) -> None:
        (self._effects if fault.kind in KINDS else self._devices_there).end(fault)

    @property
    def _devices_there(self) -> Devices:
        assert self._devices is not None  # only they have other kinds
        return self._devices

    def _open_doors(self) -> None:
        config, hub = self.config, self.hub
        self.host, _ = bind_somewhere(config.host, self._bind)
        if config.socket != NONE:
            name = config.socket
            if name == AUTO:
                name = os.path.join(tempfile.gettempdir(), f"crtk-can-{os.getpid()}.sock")
            self.paths["crtk"] = hub.open_socket(socket_path(name)).path
        if config.interface:
            hub.join_interface(config.interface)
        for number in range(1, config.terminals + 1):
            name = "slcan" if number == 1 else f"slcan-{number}"
            link = config.link and (config.link if number == 1 else f"{config.link}-{number}")
            self.ttys[name] = hub.open_slcan(link).tty

    def _bind(self, host: str) -> None:
        """Open the TCP ports at an address."""
        listener = listen(host, self.config.control_port, "control")
        try:
            door = self.hub.open_socketcand(host, self.config.socketcand_port, self.config.channel)
        except BaseException:
            listener.close()
            raise
        self.ports = {"control": listener.getsockname()[1], "socketcand": door.port}
        handlers: Handlers = {
            **self._faults.handlers,
            "status": self.status,
            "send": self._send,
            "replay": self._start_replay,
            "scene": self.scene,
            "live": self.live,
            **({} if self._devices is None else self._devices.handlers),
        }
        self._control = control_door(self.hub.loop, listener, handlers)

    def run(self) -> None:
        """Keep the bus going until `stop`, or until the parent process has died."""
        prepare_process(realtime=self.config.realtime)
        self._faults.start()
        if self.hub.recorder is not None:
            self._flush_log()
        self.hub.run()

    def stop(self) -> None:
        """Let `run` return; may be called from a signal handler."""
        self.hub.stop()

    def close(self) -> None:
        """Close everything; safe to repeat."""
        if self._control is not None:
            self._control.close()
            self._control = None
        self.hub.close()

    def _flush_log(self) -> None:
        if self.hub.recorder is not None:
            self.hub.recorder.flush()
            self.hub.call_at(time.monotonic() + _LOG_PERIOD, self._flush_log)

    # Requests on the control socket

    def _send(self, frame: str) -> int:
        """Send a frame such as ``123#DEADBEEF``, from a node that exists only for it."""
        raw = parse_frame(frame)
        fault = frames.fault_of(raw)
        if fault is not None:
            raise ValueError(fault)
        node = self.hub.attach(lambda can_id, data: None, "control")
        result = self.hub.transmit(node, raw)
        self.hub.call_at(time.monotonic() + 1.0, node.detach)
        return result

    def _start_replay(self, path: str, speed: float = 1.0) -> None:
        if self._replay is not None:
            self._replay.stop()
        self._replay = Replay(
            self.hub, Path(path), speed, lambda: self._faults.event("replay_ended")
        )

    def scene(self) -> Scene:
        """What the page shows and does not change."""
        return scene.scene(self.config, self.host)

    def live(self) -> Live:
        """What the page shows and changes."""
        return scene.live(self.hub.status(), self._faults.kinds, self._faults.now)

    def status(self) -> dict[str, Any]:
        """Everything that a test or a person wants to know, ready for JSON."""
        replay = self._replay
        return {
            **self.hub.status(),
            **({} if self._devices is None else self._devices.status()),
            "host": self.host,
            "ports": self.ports,
            "paths": self.paths,
            "ttys": self.ttys,
            "time": self._faults.now,
            "cpu": time.process_time(),
            "replay": None if replay is None else {"sent": replay.sent, "error": replay.error},
            "faults": self._faults.describe(),
        }
