"""Participants of DDS, one for each context of a process, and how they find each other.

Each learns of the others, of their endpoints and of the names of their nodes at moments of its own.
"""

from __future__ import annotations

import itertools
import struct
from collections import deque
from typing import Any, Final

from crtk_drivers.testing.world.machine.endpoints import network
from crtk_drivers.testing.world.machine.kernel import NS, Process, here
from crtk_drivers.testing.world.machine.network import arrival
from crtk_drivers.testing.world.middleware.dds import Endpoint, Listener

LEASE: Final = 20.0
"""s after which a process that is silent counts as gone (Fast DDS, leaseDuration)."""
_FINDS: Final = 0.08
"""s in which a participant finds another one, at most."""
_LEARNS: Final = 0.03
"""s in which it learns of an endpoint of a participant that it has found, or of a node's name, at most."""
_STANDS: Final = NS // 50
"""ns after which it is looked again whether a process that stands still goes on."""


class Participant:
    """A process' part in a domain: what it has, and what it knows of others.

    Args:
        domain: of ROS.
        process: that it is of.

    Attributes:
        prefix: twelve bytes, the beginning of the ids of its endpoints.
        numbers: of its endpoints.
        known: endpoints that it has found, and its own, with their node once that is known.
        nodes: that it has.
        known_nodes: that it has found, with their participants.
        found: participants that it has found.
    """

    def __init__(self, domain: Domain, process: Process) -> None:
        self.domain = domain
        self.process = process
        self.prefix = struct.pack(">III", 0x010F0000, process.pid, next(domain.numbers))
        self.numbers = itertools.count(0x103)
        self.endpoints: dict[Endpoint, None] = {}
        self.known: dict[Endpoint, tuple[str, str] | None] = {}
        self.nodes: dict[tuple[str, str], None] = {}
        self.known_nodes: dict[tuple[Participant, tuple[str, str]], None] = {}
        self.found: dict[Participant, None] = {}
        self._arrives: dict[Participant, int] = {}  # when what was sent last comes, at the latest
        self._postponed: deque[Listener] = deque()  # while the process stands still
        self.is_open = True
        process.ended.append(self._leave)
        for other in domain.participants:
            self.find_later(other)
            other.find_later(self)
        domain.participants.append(self)

    def do(self, work: Listener) -> None:
        """Let its threads do something: now, or in turn once they run again; never if it is gone."""
        if not (self.is_open and self.process.alive):
            return
        if self._postponed or self._stands:
            self._postponed.append(work)
            if len(self._postponed) == 1:
                self._look_again()
        else:
            work()

    @property
    def _stands(self) -> bool:
        return self.process.is_stopped or self.process.frozen_until > here().now

    def _look_again(self) -> None:
        """Do what was postponed once the process runs again, in the order in which it came."""
        kernel = here()
        until = min(max(self.process.frozen_until, kernel.now + 1), kernel.now + _STANDS)
        kernel.at(until, self._go_on)

    def _go_on(self) -> None:
        if self._stands and self.process.alive:
            self._look_again()
            return
        while self._postponed:
            work = self._postponed[0]
            if self.is_open and self.process.alive:
                work()
            self._postponed.popleft()

    def send(self, to: Participant, then: Listener) -> None:
        """Let a datagram go to a participant, which then does something; it may be lost, or come twice."""
        kernel, weather = here(), network().weather
        late = [weather.moment()] if to is self else weather.datagram()
        for seconds in late:
            last = self._arrives.get(to, 0)
            when = arrival(kernel.now, seconds, last)
            self._arrives[to] = max(last, when)
            kernel.at(when, lambda: to.do(then))

    # What it has

    def add(self, endpoint: Endpoint) -> None:
        """Add an endpoint, and announce it."""
        self.endpoints[endpoint] = None
        for other in tuple(self.known):
            if endpoint.fits(other):
                endpoint.meet(other)
            if other.owner is self and other.fits(endpoint):
                other.meet(endpoint)
        self.known[endpoint] = endpoint.node
        for each in self.domain.participants:
            if self in each.found:
                each.learn_later(endpoint)

    def remove(self, endpoint: Endpoint) -> None:
        """Remove an endpoint, and announce that."""
        self.endpoints.pop(endpoint, None)
        for other in self.domain.participants:
            if other is self:
                self._forget(endpoint)
            else:
                other.forget_later(endpoint)

    def add_node(self, node: tuple[str, str]) -> None:
        """Add a node, and announce it."""
        self.nodes[node] = None
        self.known_nodes[self, node] = None
        for other in self.domain.participants:
            if self in other.found:
                other.learn_node_later(self, node)

    def remove_node(self, node: tuple[str, str]) -> None:
        """Remove a node, and announce that."""
        self.nodes.pop(node, None)
        for other in self.domain.participants:
            other.forget_node_later(self, node)

    def close(self) -> None:
        """Leave, and say so."""
        if self.is_open:
            # Nobody acknowledges what a participant says of itself: where it is lost, the lease counts.
            arrives = network().weather.datagram()
            self._leave(arrives[0] if arrives else LEASE)

    def _leave(self, seconds: float = LEASE) -> None:
        """Let all others forget it after so many s. Once."""
        if self.is_open:
            self.is_open = False
            here().after(seconds, self._be_forgotten)

    def _be_forgotten(self) -> None:
        if self in self.domain.participants:
            self.domain.participants.remove(self)
        for endpoint in self.endpoints:
            endpoint.is_open = False
        for other in self.domain.participants:
            other.do(lambda other=other: other.forget_all(self))  # type: ignore[misc]

    def forget_all(self, gone: Participant) -> None:
        """Forget one that has gone, with all that it has."""
        for endpoint in [each for each in self.known if each.owner is gone]:
            self._forget(endpoint)
        for key in [key for key in self.known_nodes if key[0] is gone]:
            del self.known_nodes[key]
        self.found.pop(gone, None)

    # What it knows

    def find_later(self, other: Participant) -> None:
        """Find another one after a while."""
        here().after(self.domain.finding(), lambda: self.do(lambda: self._find(other)))

    def _find(self, other: Participant) -> None:
        if other.is_open and other not in self.found:
            self.found[other] = None
            for endpoint in tuple(other.endpoints):
                self.learn_later(endpoint)
            for node in tuple(other.nodes):
                self.learn_node_later(other, node)

    def learn_later(self, endpoint: Endpoint) -> None:
        """Learn of an endpoint after a while."""
        here().after(self.domain.learning(), lambda: self.do(lambda: self._learn(endpoint)))

    def _learn(self, endpoint: Endpoint) -> None:
        if not endpoint.is_open or endpoint in self.known:
            return
        is_named = (endpoint.owner, endpoint.node) in self.known_nodes
        self.known[endpoint] = endpoint.node if is_named else None
        for own in tuple(self.endpoints):
            if own.is_open and own.fits(endpoint):
                own.meet(endpoint)

    def forget_later(self, endpoint: Endpoint) -> None:
        """Learn after a while that an endpoint has gone."""
        here().after(self.domain.learning(), lambda: self.do(lambda: self._forget(endpoint)))

    def _forget(self, endpoint: Endpoint) -> None:
        self.known.pop(endpoint, None)
        for own in tuple(self.endpoints):
            own.part(endpoint)

    def learn_node_later(self, owner: Participant, node: tuple[str, str]) -> None:
        """Learn of a node after a while."""
        here().after(self.domain.learning(), lambda: self.do(lambda: self._learn_node(owner, node)))

    def forget_node_later(self, owner: Participant, node: tuple[str, str]) -> None:
        """Learn after a while that a node has gone."""
        seconds = 0.0 if owner is self else self.domain.learning()
        here().after(seconds, lambda: self.do(lambda: self._forget_node(owner, node)))

    def _forget_node(self, owner: Participant, node: tuple[str, str]) -> None:
        if node not in owner.nodes:
            self.known_nodes.pop((owner, node), None)

    def _learn_node(self, owner: Participant, node: tuple[str, str]) -> None:
        if owner.is_open and node in owner.nodes:
            self.known_nodes[owner, node] = None
            for endpoint, name in self.known.items():
                if name is None and endpoint.owner is owner and endpoint.node == node:
                    self.known[endpoint] = node


class Domain:
    """Who can find each other.

    Args:
        order: how many other domains were in use before: its number is of the environment, not of the seed.

    Attributes:
        participants: that are there, or are still taken to be there.
    """

    def __init__(self, order: int) -> None:
        self.participants: list[Participant] = []
        self.numbers = itertools.count(1)
        self._random = here().stream(f"dds {order}")

    def finding(self) -> float:
        """Return the s in which one participant finds another one."""
        return network().weather.handshake() + _FINDS * self._random.random()

    def learning(self) -> float:
        """Return the s in which one more thing is learnt of a participant that was found."""
        return network().weather.handshake() + _LEARNS * self._random.random()


class _Domains:
    kernel: Any = None
    domains: dict[int, Domain]


_all = _Domains()


def domain(number: int) -> Domain:
    """Return a domain of this world, by its number."""
    kernel = here()
    if _all.kernel is not kernel:
        _all.kernel, _all.domains = kernel, {}
    return _all.domains.setdefault(number, Domain(len(_all.domains)))
