"""One namespace on ROS: its features, and the endpoints made for them so far."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from crtk_drivers.client.announcements import StatusTracker
from crtk_drivers.client.discovery import POLL, SETTLE, Catalogue, Feature
from crtk_drivers.commands import ROS_TYPES, Direction, Payload
from crtk_drivers.errors import ConnectionFailed, CrtkError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.front.base import did_you_mean

if TYPE_CHECKING:
    from crtk_drivers.client.inbox import Inbox
    from crtk_drivers.client.ros_link import Caller, Endpoint, Link

_OF_ANY_NODE = ("rcl_interfaces", "type_description_interfaces")


class NotOffered(Exception):
    """The other side lacks what was asked for."""


class Space:
    """The topics and services of one device, or of a sub-namespace of one. Thread-safe.

    Args:
        link: to ROS.
        namespace: full, for example ``/ur5``.
        timeout: seconds in which the other end of a topic must be found.
        parent: the space that this is a sub-namespace of.
    """

    def __init__(
        self, link: Link, namespace: str, timeout: float, parent: Space | None = None
    ) -> None:
        self.link = link
        self.namespace = namespace
        self.timeout = timeout
        self.parent = parent
        self.catalogue = Catalogue(link, namespace)
        self.endpoints: dict[str, Endpoint] = {}
        self.tracker: StatusTracker | None = None
        self._lock = threading.RLock()
        self._began = time.monotonic()
        self._children: dict[str, Space] = {}

    def features(self) -> dict[str, Feature]:
        """Return what is offered here now; a parent's manifest may list it with the sub-namespace."""
        features = self.catalogue.features()
        if self.parent is not None:
            prefix = self.catalogue.prefix.removeprefix(self.parent.catalogue.prefix)
            for name, feature in self.parent.catalogue.features().items():
                if name.startswith(prefix):
                    features[name.removeprefix(prefix)] = feature
        return features

    def feature(self, name: str) -> Feature:
        """Return one feature.

        Raises:
            NotOffered: it does not exist on the other side, or is of another type there.
        """
        features = self.features()
        feature = features.get(name)
        if feature is None:
            raise NotOffered(
                f"{self.namespace} does not offer {name}. "
                f"It offers: {', '.join(features) or 'nothing at all'}."
            )
        wanted = ROS_TYPES[feature.command.payload]
        if feature.ros_type != wanted:
            raise NotOffered(
                f"{feature.topic} is a {feature.ros_type} on the other side and a {wanted} here; in "
                "ROS 2 the two never meet. Update the older side."
            )
        return feature

    def tells_of(self, name: str) -> bool:
        """Whether the device tells that another one is behind it, in the sub-namespace `name`."""
        return name in self.catalogue.manifest.get("children", ())

    def child(self, name: str, timeout: float) -> Space:
        """Return a sub-namespace, known whole if the device tells of it.

        Raises:
            ConnectionFailed: there is nothing in it within `timeout` s; at once if the manifest does not list
                it, with the names that there are.
            CrtkError: to wait for it in a callback would be for ever.
        """
        from crtk_drivers.client.inbox import may_wait

        child = self._children.get(name)
        if child is not None:
            return child
        child = Space(self.link, f"{self.catalogue.prefix}{name}", self.timeout, self)
        deadline = time.monotonic() + timeout
        self._check_child(child, name, deadline)
        # Its topics may be found a little later than those of the device, and one by one.
        is_told = self.tells_of(name)
        if not child.features() or (is_told and not child.catalogue.manifest):
            if is_told:
                may_wait(f"the first use of {name}")
            left = max(0.0, deadline - time.monotonic())
            child.catalogue.wait(left)  # without the lock: others command the device meanwhile
        with self._lock:
            return self._children.setdefault(name, child)

    def _check_child(self, child: Space, name: str, deadline: float) -> None:
        """Return unless the device's manifest lacks `name`, and nothing of anybody else is found in there.

        A manifest that has not come is waited for.

        Raises:
            ConnectionFailed: says which names there are.
            CrtkError: to wait for the manifest in a callback would be for ever.
        """
        from crtk_drivers.client.inbox import may_wait

        # Another driver may be in there; what was connected just now may not have found it yet.
        settled = min(deadline, self._began + SETTLE)
        while not child.features():
            if self.tells_of(name.partition("/")[0]) or not self.catalogue.has_manifest:
                return
            is_known = bool(self.catalogue.manifest)
            if not is_known:
                may_wait(f"the manifest of {self.namespace}")
            if time.monotonic() >= (settled if is_known else deadline):
                break
            time.sleep(POLL)
        else:
            return
        if is_known:
            told = self.catalogue.manifest.get("children", ())
            spaces = (each.partition("/")[0] for each in self.features() if "/" in each)
            names = [*dict.fromkeys((*told, *spaces))]
            raise ConnectionFailed(
                f"there is nothing in {name}/",
                where=self.namespace,
                remedy=f"{did_you_mean(name, names)}There is: {', '.join(names) or 'none'}.",
            )

    # ------------------------------------------------------------------------------------ endpoints

    def endpoint(self, name: str) -> Endpoint:
        """Return the endpoint of a CRTK name, made if it is not there yet.

        Raises:
            NotOffered: see `feature`.
        """
        from crtk_drivers.ros.messages import TYPES

        with self._lock:
            if name in self.endpoints:
                return self.endpoints[name]
            feature = self.feature(name)
            payload = feature.command.payload
            endpoint: Endpoint
            if feature.command.direction is Direction.PUBLISHED:
                endpoint = self.link.inbox(feature.topic, TYPES[payload])
            elif feature.command.direction is Direction.COMMANDED:
                endpoint = self.link.outbox(feature.topic, payload)
            else:
                endpoint = self.link.caller(feature.topic, TYPES[payload])
            self.endpoints[name] = endpoint
            return endpoint

    def connected(self, name: str) -> Any:
        """Return the endpoint of a CRTK name once it has met its other end.

        Raises:
            NotOffered: see `feature`.
            ConnectionFailed: no other end within `timeout` s.
        """
        from crtk_drivers.client.inbox import may_wait

        endpoint = self.endpoint(name)
        if not endpoint.was_connected:
            if not endpoint.connected:
                may_wait(f"the first use of {name}")
            self.wait_connected([endpoint], self.timeout)
        return endpoint

    def all_endpoints(self) -> list[Endpoint]:
        """Return the endpoints made so far, with those of sub-namespaces."""
        with self._lock:
            endpoints = list(self.endpoints.values())
            children = list(self._children.values())
        for child in children:
            endpoints += child.all_endpoints()
        return endpoints

    def wait_connected(self, endpoints: list[Endpoint], timeout: float) -> None:
        """Wait until all `endpoints` have met their other end.

        Raises:
            ConnectionFailed: some have not; names them.
        """
        from crtk_drivers.client.ros_link import Caller, Outbox, wait_connected

        if wait_connected(endpoints, time.monotonic() + timeout):
            return
        kinds = {Caller: "nobody serves", Outbox: "nobody listens to"}
        missing = [
            f"{kinds.get(type(endpoint), 'nobody publishes')} {endpoint.topic}"
            for endpoint in endpoints
            if not endpoint.connected
        ]
        raise ConnectionFailed(
            f"{'; '.join(missing)} (waited {timeout:.3g} s)",
            where=self.namespace,
            remedy=f"Is the driver running? It offers now: {', '.join(self.features()) or 'nothing'}.",
        )

    # ---------------------------------------------------------------------------------- beyond CRTK

    def published(self, name: str) -> Inbox:
        """Return the subscription of any topic: a CRTK name, another one in here, or a full name.

        Raises:
            ConnectionFailed: nobody publishes it; says what is published here.
            ConfigError: its type is not known here.
        """
        from crtk_drivers.ros.plain import message_class

        feature = self.features().get(name)
        if feature is not None and feature.command.direction is Direction.PUBLISHED:
            inbox: Inbox = self.connected(name)
            return inbox
        link, topic = self.link, self._full(name)
        ros_type = self._type_of(
            topic, "publishes", link.topics, lambda each: link.publishers(each) > 0
        )
        return link.inbox(topic, message_class(ros_type))

    def service(self, name: str) -> Caller:
        """Return the client of any service: a CRTK name, another one in here, or a full name.

        Raises:
            ConnectionFailed: nobody serves it; says what is served here.
            ConfigError: its type is not known here.
        """
        from crtk_drivers.ros.plain import message_class

        feature = self.features().get(name)
        is_query = feature is not None and feature.command.direction is Direction.SERVICE
        service = feature.topic if feature is not None and is_query else self._full(name)
        ros_type = self._type_of(service, "serves", self.link.services, lambda each: True)
        return self.link.caller(service, message_class(ros_type))

    def _full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self.catalogue.prefix}{name}"

    def _type_of(
        self,
        name: str,
        verb: str,
        types_of_all: Callable[[], Mapping[str, list[str]]],
        is_there: Callable[[str], bool],
    ) -> str:
        # With a manifest all of the device is there; what is not in it may belong to somebody else.
        limit = min(SETTLE, self.timeout) if self.catalogue.manifest else self.timeout
        deadline = time.monotonic() + limit
        while True:
            types = types_of_all()
            if name in types and is_there(name):
                return types[name][0]
            if time.monotonic() >= deadline:
                break
            time.sleep(POLL)
        here = [
            topic.removeprefix(self.catalogue.prefix)
            for topic, (ros_type, *_) in types.items()
            if topic.startswith(self.catalogue.prefix)
            and ros_type.partition("/")[0] not in _OF_ANY_NODE
            and is_there(topic)
        ]
        raise ConnectionFailed(
            f"nobody {verb} {name}", where=self.namespace, remedy=_instead(name, here)
        )

    # ------------------------------------------------------------------------------ operating state

    def status(self) -> StatusTracker:
        """Return the tracker of the operating state, started.

        A sub-namespace without an operating state has that of its parent.

        Raises:
            NotOffered, ConnectionFailed, DataTimeout: there is none.
        """
        teller = self.state_teller
        if teller is not self:
            return teller.status()
        if self.tracker is None:
            with self._lock:
                if self.tracker is None:
                    self.tracker = self._make_tracker()
        self.tracker.start(self.timeout)
        self.endpoints.setdefault("operating_state", self.tracker.inbox)
        return self.tracker

    @property
    def condition(self) -> str:
        """Closed, or the operating state as heard last, or why none is heard. It never waits."""
        if not self.link.is_open:
            return "closed"
        space: Space | None = self
        while space is not None and space.tracker is None:
            space = space.parent
        if space is None or space.tracker is None or not space.tracker.has_status:
            return "(its operating state was not asked for yet)"
        try:
            lost = space.tracker.lost()
        except RuntimeError:  # rclpy's, where somebody has destroyed the node that was given to us
            return "closed"
        return f"lost: {lost}" if lost else str(space.tracker.latest.state)

    def answers(self, timeout: float) -> bool:
        """Whether the service that tells the operating state answers within `timeout` s."""
        teller = self.state_teller
        try:
            service = teller.feature("operating_state").topic
            teller.link.state_caller(service).operating_state(timeout)
        except CrtkError:
            return False
        return True

    @property
    def drivers(self) -> int:
        """How many tell the operating state, as far as DDS knows; one that was killed counts for 20 s."""
        teller = self.state_teller
        try:
            return teller.link.publishers(teller.feature("operating_state").topic)
        except NotOffered:
            return 0

    @property
    def hears_status(self) -> bool:
        """Whether `status` has nothing to wait for."""
        tracker = self.state_teller.tracker
        return tracker is not None and tracker.has_started

    @property
    def state_teller(self) -> Space:
        """The one whose operating state it has: itself, or its parent."""
        parent = self.parent
        if self.tracker is not None or parent is None or "operating_state" in self.features():
            return self
        return parent.state_teller

    def _make_tracker(self) -> StatusTracker:
        from crtk_drivers.ros.messages import TYPES

        topic = self.feature("operating_state").topic
        refusals = f"{self.catalogue.prefix}refusals"
        rates = self.catalogue.manifest.get("rates") or {}
        return StatusTracker(
            self.link,
            self.namespace,
            topic,
            TYPES[Payload.OPERATING_STATE],
            refusals if self.link.publishers(refusals) else None,
            topic if topic in self.link.services() else None,
            bool(rates.get("heartbeat")),
            self._is_alone,
        )

    def _is_alone(self, name: str) -> bool:
        endpoint = self.endpoints.get(name)
        return endpoint is not None and self.link.publishers(endpoint.topic) <= 1


def _instead(name: str, names: list[str]) -> str:
    """Return what may have been meant, and what there is: names, and how many are below others."""
    nearest = near_names(name.rpartition("/")[2], names)
    meant = f"Did you mean {nearest[0]}? " if nearest else ""
    own = sorted(each for each in names if "/" not in each)
    below = Counter(each.partition("/")[0] for each in names if "/" in each)
    listed = [*own, *(f"{count} in {space}/" for space, count in sorted(below.items()))]
    return f"{meant}There is: {', '.join(listed) or 'nothing at all'}."
