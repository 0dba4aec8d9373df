"""The whole examination of a device."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from rclpy.node import Node

from crtk_drivers.client.conformance.clause_rows import Needs
from crtk_drivers.client.conformance.clauses import CLAUSES
from crtk_drivers.client.conformance.expectations import Expectations
from crtk_drivers.client.conformance.findings import Finding
from crtk_drivers.client.conformance.observed import Observation
from crtk_drivers.client.conformance.outcome import Outcome
from crtk_drivers.client.conformance.probe.client_opening import open_with_client
from crtk_drivers.client.conformance.probe.ears import Ears
from crtk_drivers.client.conformance.probe.graph_reading import find_device
from crtk_drivers.client.conformance.probe.looking import look
from crtk_drivers.client.conformance.probe.ros_probe import RosProbe
from crtk_drivers.client.conformance.rounds import NOT_PERMITTED, judge
from crtk_drivers.client.conformance.trial import NO_LEAVE, Leave, Opening, Told, Trial
from crtk_drivers.client.conformance.trials import HEARD_BELOW, run_trials
from crtk_drivers.client.ros_link import Link
from crtk_drivers.ros import environment

FIND_TIME = 5.0
LISTEN_TIME = 5.0


def examine(
    namespace: str,
    ids: Sequence[str],
    listen: float = LISTEN_TIME,
    timeout: float = FIND_TIME,
    may_move: bool = False,
    expected: Expectations | None = None,
    tell: Callable[[str], None] = lambda text: None,
    leave: Leave = NO_LEAVE,
) -> Outcome:
    """Judge the device in a namespace.

    Args:
        namespace: ``/ur5``.
        ids: of the clauses.
        listen: seconds.
        timeout: seconds to find the device.
        may_move: also command it. However that ends, it is held, and brought back to the state it was in.
        expected: tolerances and steps.
        tell: called with what is being done.
        leave: what `may_move` allows beside small motions.

    Raises:
        ConnectionFailed: there is no device.
        MissingExtra, ConfigError: ROS 2 cannot be used here.
    """
    environment.check()
    link = Link("crtk_conform")
    began, since = time.time(), time.monotonic()
    try:
        link.start()
        tell(f"looking for {namespace}")
        graph, manifest = find_device(link, namespace, timeout)
        ears = Ears(link.node, graph)
        tell(f"listening to {namespace} for {listen:g} s")
        seen = look(link, ears, graph, manifest, listen)
        tried: Mapping[str, Sequence[Finding]] = {}
        why = NOT_PERMITTED
        if may_move and any(CLAUSES[each].needs is not Needs.PASSIVE for each in ids):
            wanted = expected or Expectations()
            client = open_with_client(namespace)
            tried, why = try_out(link.node, ears, seen, ids, wanted, tell, leave, client)
        results = judge(seen, ids, tried, why)
        seconds = time.monotonic() - since
        ended = why if may_move and why != NOT_PERMITTED else ""
        return Outcome(namespace, began, results, manifest, seconds, ended)
    finally:
        link.close()


def try_out(
    node: Node,
    ears: Ears,
    seen: Observation,
    ids: Sequence[str],
    expected: Expectations,
    tell: Callable[[str], None],
    leave: Leave = NO_LEAVE,
    client: Callable[[Opening], Told] | None = None,
) -> tuple[Mapping[str, Sequence[Finding]], str]:
    """Command a device, and return what `run_trials` does.

    Args:
        node: to publish with.
        ears: that hear the device.
        seen: of it while nobody commanded it.
        ids: of the clauses.
        expected: tolerances and steps.
        tell: called with what is being done.
        leave: what may be done beside small motions.
        client: see `Trial`.

    Raises:
        ConnectionFailed: the device does not hear a command that it offers.
    """
    ears.drop([name for name in seen.graph.offered() if "/" in name and name not in HEARD_BELOW])
    probe = RosProbe(node, seen.graph, ears)
    try:
        return run_trials(Trial(probe, expected, seen, leave, client), ids, tell)
    finally:
        probe.close()
