"""What a device offers, as seen from outside: by its manifest, or else by the topics that exist.

The manifest (see `crtk_drivers.ros.manifest`) is found by its name, ``<namespace>/<any node>/
crtk_capabilities``; it follows a device that starts again with other capabilities. A device without one
(dVRK, cisst) offers what it publishes, listens to and serves right now under CRTK names of CRTK types.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from crtk_drivers.client.told_manifest import usable
from crtk_drivers.commands import COMMANDS, Command, Direction, find
from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.ros.manifest import MANIFEST

if TYPE_CHECKING:
    from crtk_drivers.client.inbox import Inbox, Received
    from crtk_drivers.client.ros_link import Link

logger = logging.getLogger(__name__)

SETTLE = 1.0
"""Seconds without anything new in a namespace after which it counts as complete."""
POLL = 0.02


@dataclass(frozen=True, slots=True)
class Feature:
    """One CRTK name of a device: where it is on ROS, and whether both sides mean the same type."""

    name: str
    command: Command
    topic: str
    ros_type: str


class Catalogue:
    """The features of the device in one namespace.

    Args:
        link: to ROS.
        namespace: full, for example ``/ur5``.
    """

    def __init__(self, link: Link, namespace: str) -> None:
        self.namespace = namespace
        self._link = link
        self._inboxes: dict[str, Inbox] = {}
        self._read: dict[str, tuple[int, dict[str, Any]]] = {}

    # -------------------------------------------------------------------------------------- manifest

    def look(self) -> None:
        """Subscribe to the manifests that have appeared."""
        for topic in self._link.topics():
            if self._is_manifest(topic) and topic not in self._inboxes:
                if self._link.publishers(topic) == 0:
                    continue
                self._inboxes[topic] = self._link.text_inbox(topic)

    def _is_manifest(self, topic: str) -> bool:
        rest = topic.removeprefix(self.prefix)
        return rest != topic and rest.count("/") == 1 and rest.endswith(f"/{MANIFEST}")

    @property
    def prefix(self) -> str:
        """What comes before the names of the device's topics."""
        return f"{self.namespace.rstrip('/')}/"

    @property
    def has_manifest(self) -> bool:
        """Whether the device publishes a manifest, which may still be on its way."""
        return bool(self._inboxes)

    @property
    def manifest(self) -> Mapping[str, Any]:
        """The manifest, empty for a device without one. Several nodes in a namespace are merged."""
        merged: dict[str, Any] = {}
        commands: dict[str, Any] = {}
        for topic, inbox in tuple(self._inboxes.items()):
            if inbox.latest is not None:
                content = self._content(topic, inbox.latest)
                merged.update(content)
                commands.update(content.get("commands", {}))
        if merged:
            merged["commands"] = commands
        return merged

    def _content(self, topic: str, received: Received) -> dict[str, Any]:
        cached = self._read.get(topic)
        if cached is not None and cached[0] == received.serial:
            return cached[1]
        try:
            content: dict[str, Any] = json.loads(received.text)
            if not isinstance(content, dict):
                raise ValueError("it is no object")
            if not isinstance(content.get("commands", {}), dict):
                raise ValueError("its commands are no object")
            content, wrong = usable(content)
            if wrong:
                logger.warning("%s has values of a wrong type in: %s", topic, ", ".join(wrong))
        except (ValueError, RecursionError) as error:
            logger.warning("%s holds no manifest: %s", topic, error)
            content = {} if cached is None else cached[1]
        self._read[topic] = received.serial, content
        return content

    # -------------------------------------------------------------------------------------- features

    def features(self) -> dict[str, Feature]:
        """Return what the device offers now, in the order of the command table."""
        self.look()
        manifest = self.manifest
        features = self._told(manifest["commands"]) if manifest else self._seen()
        order = {name: index for index, name in enumerate(COMMANDS)}
        return dict(
            sorted(features.items(), key=lambda item: order.get(item[1].command.base_name, 0))
        )

    def _told(self, commands: Mapping[str, Any]) -> dict[str, Feature]:
        features = {}
        for name, row in commands.items():
            try:
                features[name] = Feature(name, find(name), row["name"], row["type"])
            except (KeyError, TypeError):
                logger.debug("%s: %s is not a CRTK name known here", self.namespace, name)
        return features

    def _seen(self) -> dict[str, Feature]:
        link, features = self._link, {}
        for topic, types in (*link.services().items(), *link.topics().items()):
            name = topic.removeprefix(self.prefix)
            if name == topic:
                continue
            try:
                command = find(name)
            except KeyError:
                continue
            if self._is_served(command, topic, types):
                features[name] = Feature(name, command, topic, types[0])
        return features

    def _is_served(self, command: Command, topic: str, types: Iterable[str]) -> bool:
        service = any("/srv/" in ros_type for ros_type in types)
        if command.direction is Direction.SERVICE or service:
            return service and command.direction is Direction.SERVICE
        if command.direction is Direction.PUBLISHED:
            return self._link.publishers(topic) > 0
        return self._link.subscribers(topic) > 0

    # --------------------------------------------------------------------------------------- waiting

    def wait(self, timeout: float) -> None:
        """Wait until the device is there and known.

        Raises:
            ConnectionFailed: no CRTK name is there in `timeout` s; says where there are some.
        """
        deadline = time.monotonic() + timeout
        known: set[str] = set()
        settled = time.monotonic()
        while True:
            now = time.monotonic()
            self.look()
            if self.manifest:
                return
            seen = set(self._seen())
            if seen != known:
                known, settled = seen, now
            # Who serves, who listens and who publishes are found by different ways, one maybe long before
            # another; a manifest is published.
            publishes = any(find(name).direction is Direction.PUBLISHED for name in known)
            if publishes and not self._inboxes and now - settled > SETTLE:
                return
            if now >= deadline:
                break
            time.sleep(POLL)
        if not known:
            raise self._nobody(timeout)
        if self._inboxes:
            logger.warning(
                "%s has a manifest, and it did not arrive in %g s; going by the topics. If the node "
                "is your own, is it spun?",
                self.namespace,
                timeout,
            )

    def _nobody(self, timeout: float) -> ConnectionFailed:
        others = sorted(devices(self._link))
        seen = f"CRTK devices are at: {', '.join(others)}." if others else "There is none at all."
        return ConnectionFailed(
            f"no CRTK device in the namespace {self.namespace} within {timeout:g} s",
            remedy=f"{seen} Is the driver running, and are ROS_DOMAIN_ID and "
            "ROS_AUTOMATIC_DISCOVERY_RANGE the same on both sides?",
        )


def devices(link: Link) -> set[str]:
    """Return the namespaces in which an operating state is published."""
    return {
        topic.removesuffix("/operating_state") or "/"
        for topic in link.topics()
        if topic.endswith("/operating_state") and link.publishers(topic)
    }
