"""The NMT master of a bus: commands to nodes, our heartbeat, their heartbeats, boot-ups and emergencies."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_driver_canopen import emcy
from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.drive_profile import PLAIN, DriveProfile
from crtk_driver_canopen.emcy import Emergency
from crtk_driver_canopen.frames import Frame
from crtk_driver_canopen.heartbeat import (
    NMT_COMMANDS,
    HeartbeatWatch,
    NmtCommand,
    NmtState,
    NodeLife,
    nmt_text,
)
from crtk_driver_canopen.transfers import SdoChannel
from crtk_drivers.errors import DataTimeout

ALL_NODES: Final = 0
NODES: Final = range(1, 128)


class BootUp(NamedTuple):
    """A node has started: whatever was configured in it is lost."""

    node: int

    @override
    def __str__(self) -> str:
        return f"node {self.node} has started anew: its configuration is lost"


Event = Emergency | BootUp


class Master:
    """Everything on the bus but PDOs. Belongs to the thread that owns the link.

    Args:
        link: the bus.
        heartbeats: nodes that are expected, with the seconds without a heartbeat after which they are lost;
            0: not watched.
        node: our own id, with which we produce a heartbeat.
        period: between two heartbeats of ours, in s; 0: none.
        sdo_timeout: seconds for each answer of an SDO.

    Attributes:
        watch: what is known of the nodes.
        emergencies: the last emergency message of each node that has not said that it is over.
        silent: our heartbeat has ended, so that the drives stop.
        profiles: of the drives whose make is known, by node.
    """

    def __init__(
        self,
        link: CanLink,
        heartbeats: Mapping[int, float] | Iterable[tuple[int, float]] = (),
        *,
        node: int = 127,
        period: float = 0.0,
        sdo_timeout: float = 0.5,
    ) -> None:
        self.link = link
        self.watch = HeartbeatWatch(heartbeats)
        self.emergencies: dict[int, Emergency] = {}
        self.silent = False
        self.profiles: dict[int, DriveProfile] = {}
        self._events: deque[Event] = deque(maxlen=256)
        self._channels: dict[int, SdoChannel] = {}
        self._sdo_timeout = sdo_timeout
        self._period = period
        self._due = 0.0
        self._heartbeat = Frame(0x700 + node, bytes([NmtState.OPERATIONAL]))
        for number in NODES:
            link.subscribe(0x700 + number, self._heartbeat_handler(number))
            link.subscribe(0x080 + number, self._emergency_handler(number))

    def _heartbeat_handler(self, node: int) -> Callable[[bytes, float], None]:
        def take(data: bytes, now: float) -> None:
            if self.watch.take(node, data, now):
                self._events.append(BootUp(node))

        return take

    def _emergency_handler(self, node: int) -> Callable[[bytes, float], None]:
        def take(data: bytes, now: float) -> None:
            message = emcy.decode(node, data, self.profiles.get(node, PLAIN))
            if message.is_reset:
                self.emergencies.pop(node, None)
            else:
                self.emergencies[node] = message
            self._events.append(message)

        return take

    def sdo(self, node: int) -> SdoChannel:
        """Return the SDO channel of a node."""
        if node not in self._channels:
            self._channels[node] = SdoChannel(self.link, node, self._sdo_timeout, self.poll)
        return self._channels[node]

    def close(self) -> None:
        """Let no transfer of a node go on once the bus is open again."""
        for channel in self._channels.values():
            channel.close()

    def take_events(self) -> list[Event]:
        """Return what has happened since the last call: boot-ups and emergencies, in order."""
        events = []
        while self._events:
            events.append(self._events.popleft())
        return events

    def tick(self, now: float) -> None:
        """Send our heartbeat when it is due: once in every cycle, and while waiting.

        Raises:
            BusLost: the bus cannot be used.
        """
        if self._period and now >= self._due:
            self._due = now + self._period
            if not self.silent:
                self.link.send(self._heartbeat)

    def poll(self, until: float, done: Callable[[], bool] | None = None) -> bool:
        """Receive until a time or until `done`, outside of a cycle; our heartbeat goes on.

        Args:
            until: monotonic seconds.
            done: asked after each frame.

        Returns:
            Whether `done` was so.

        Raises:
            BusLost: the bus cannot be used.
        """
        until = min(until, self.link.give_up_at)
        while True:
            now = time.monotonic()
            self.tick(now)
            slice_end = min(until, self._due) if self._period else until
            if self.link.poll(slice_end, done):
                return True
            if time.monotonic() >= until:
                return False

    def command(self, command: NmtCommand, node: int = ALL_NODES) -> None:
        """Send an NMT command, to all nodes unless one is named.

        Raises:
            BusLost: the bus cannot be used.
        """
        self.link.post(0x000, bytes([command, node]))

    def command_and_wait(self, command: NmtCommand, nodes: Iterable[int], deadline: float) -> None:
        """Send an NMT command to each node, and wait until each tells the state it leads to.

        Only a node that produces a heartbeat tells, and the others are not waited for; a reset is told by the
        boot-up.

        Args:
            deadline: monotonic seconds.

        Raises:
            DataTimeout: naming the nodes that did not follow.
            BusLost: the bus cannot be used.
        """
        wanted = NMT_COMMANDS[command]
        lives = {node: self.watch.nodes.setdefault(node, NodeLife(0.0)) for node in nodes}
        booted = {node: life.boot_ups for node, life in lives.items()}
        for node, life in lives.items():
            life.state = None
            self.command(command, node)

        def followed(node: int) -> bool:
            if wanted is None:
                return lives[node].boot_ups > booted[node]
            return lives[node].mute or lives[node].state == wanted

        if self.poll(deadline, lambda: all(map(followed, lives))):
            return
        missing = [node for node in lives if not followed(node)]
        states = ", ".join(f"node {node} ({nmt_text(lives[node].state)})" for node in missing)
        raise DataTimeout(
            f"after the command '{command.name.lower().replace('_', ' ')}' these did not follow: {states}",
            where=self.link.where,
            remedy="Check their power and node ids: 'crtk-driver canopen scan' shows who answers.",
        )
