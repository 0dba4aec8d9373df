"""Waiting for what has come, in a world: rclpy's wait sets, and its executor of events."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable
from functools import partial, partialmethod
from typing import Any, Final

from crtk_drivers.testing.world.machine.kernel import NS, here
from crtk_drivers.testing.world.middleware.rclpy_clocks import GuardCondition, Timer
from crtk_drivers.testing.world.middleware.rclpy_handles import Handle

_KINDS: Final = ("subscription", "guard_condition", "timer", "client", "service", "event")


class WaitSet(Handle):
    """Handles of each kind, and which of them are ready."""

    def __init__(self, *_: object) -> None:
        super().__init__()
        self._handles: dict[str, list[Any]] = {}
        self._ready: set[int] = set()
        self.clear_entities()

    def clear_entities(self) -> None:
        """As rclpy."""
        self._handles = {kind: [] for kind in _KINDS}

    def _add(self, kind: str, handle: Any) -> int:
        self._handles[kind].append(handle)
        return len(self._handles[kind]) - 1

    add_subscription = partialmethod(_add, "subscription")
    add_guard_condition = partialmethod(_add, "guard_condition")
    add_timer = partialmethod(_add, "timer")
    add_client = partialmethod(_add, "client")
    add_service = partialmethod(_add, "service")
    add_event = partialmethod(_add, "event")

    @property
    def all(self) -> list[Any]:
        """Its handles of all kinds."""
        return [handle for kind in _KINDS for handle in self._handles[kind]]

    def wait(self, timeout_ns: int) -> None:
        """As rclpy."""
        kernel, handles = here(), self.all
        end = None if timeout_ns < 0 else kernel.now + timeout_ns
        queues = tuple(each.waiters for each in handles)
        while not any(each.ready for each in handles):
            if end is not None and kernel.now >= end:
                break
            kernel.wait(queues, _earliest(end, handles))
        self.look()

    def look(self) -> None:
        """Note which handles are ready; a guard condition is so once."""
        ready = [each for each in self.all if each.ready]
        self._ready = {each.pointer for each in ready}
        for each in ready:
            if isinstance(each, GuardCondition):
                each.is_triggered = False

    def is_ready(self, kind: str, index: int) -> bool:
        """As rclpy."""
        return self._handles[kind][index].pointer in self._ready

    def get_ready_entities(self, kind: str) -> list[int]:
        """As rclpy."""
        return [each.pointer for each in self._handles[kind] if each.pointer in self._ready]


def _earliest(end: int | None, handles: list[Any]) -> int | None:
    dues = [each.wakes_at for each in handles if isinstance(each, Timer)]
    return min((each for each in (end, *dues) if each is not None), default=None)


class EventsExecutor:
    """Runs what has come in the order in which it came, as rclpy's own of this name.

    Args:
        context: of rclpy.
    """

    def __init__(self, context: Any) -> None:
        self.context = context
        self._nodes: dict[Any, None] = {}
        self._known: dict[Any, _Source] = {}
        self._events: deque[_Source] = deque()
        self._tasks: deque[Any] = deque()
        self._waiters: dict[Any, None] = {}
        self._is_stale = self._is_awake = self._is_shut = False

    def add_node(self, node: Any) -> bool:
        """As rclpy."""
        if node in self._nodes:
            return False
        self._nodes[node] = None
        node.executor = self
        self.wake()
        return True

    def remove_node(self, node: Any) -> None:
        """As rclpy."""
        if self._nodes.pop(node, self) is not self:
            self.wake()

    def get_nodes(self) -> list[Any]:
        """As rclpy."""
        return list(self._nodes)

    def wake(self) -> None:
        """As rclpy: something was made or destroyed."""
        self._is_stale = self._is_awake = True
        here().wake(self._waiters)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """As rclpy."""
        self._is_shut = True
        self._nodes.clear()
        self.wake()
        self._refresh()
        return True

    def create_task(self, callback: Any, *given: Any, **named: Any) -> Any:
        """As rclpy."""
        from rclpy.task import Task

        task = Task(callback, given, named, executor=self)
        self._tasks.append(task)
        self._is_awake = True
        here().wake(self._waiters)
        return task

    def spin(self) -> None:
        """As rclpy."""
        while self.context.ok() and not self._is_shut:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """As rclpy."""
        kernel = here()
        kernel.read_clock()  # also where there is something to do without end
        end = kernel.deadline(timeout_sec)
        self._refresh()
        while not (self._events or self._tasks or self._is_awake or self._push_due()):
            if end is not None and kernel.now >= end:
                return
            timers = [each.handle for each in self._known.values() if each.is_timer]
            kernel.wait((self._waiters,), _earliest(end, timers))
        self._is_awake = False
        for _ in range(len(self._events)):
            if self._events:
                self._events.popleft().run()
        for _ in range(len(self._tasks)):
            self._go_on_with(self._tasks.popleft())

    def spin_until_future_complete(self, future: Any, timeout_sec: float | None = None) -> None:
        """As rclpy."""
        end = here().deadline(timeout_sec)
        while not future.done() and self.context.ok() and not self._is_shut:
            left = None if end is None else (end - here().now) / NS
            if left is not None and left <= 0.0:
                return
            self.spin_once_until_future_complete(future, left)

    def spin_once_until_future_complete(
        self, future: Any, timeout_sec: float | None = None
    ) -> None:
        """As rclpy."""
        future.add_done_callback(lambda _: self.wake())
        if not future.done():
            self.spin_once(timeout_sec)

    def __enter__(self) -> EventsExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()

    def _go_on_with(self, task: Any) -> None:
        task()
        if not task.done():
            self._tasks.append(task)
        elif task.exception() is not None:
            raise task.exception()

    def _call(self, callback: Callable[..., Any], *given: Any) -> None:
        found = callback(*given)
        if inspect.iscoroutine(found):
            self.create_task(found)

    def _push_due(self) -> bool:
        due = [each for each in self._known.values() if each.is_timer and each.handle.ready]
        self._events.extend(due)
        return bool(due)

    # Which entities there are

    def _refresh(self) -> None:
        if not self._is_stale:
            return
        self._is_stale = False
        takes = {
            "subscriptions": self._take_message,
            "services": self._take_request,
            "clients": self._take_response,
            "timers": self._call_timer,
            "guards": self._call_guard,
            "waitables": self._take_of,
        }
        found = {
            each: partial(take, each)
            for node in self._nodes
            for kind, take in takes.items()
            for each in getattr(node, kind)
        }
        for each in [each for each in self._known if each not in found]:
            self._known.pop(each).leave()
        for each, run in found.items():
            if each not in self._known:
                self._known[each] = _Source(each, run, self._push)

    def _push(self, source: _Source) -> None:
        self._events.append(source)
        here().wake(self._waiters)

    def _take_message(self, subscription: Any) -> None:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is not None:
            only = subscription._callback_type is subscription.CallbackType.MessageOnly  # noqa: SLF001
            self._call(subscription.callback, *(taken[:1] if only else taken))

    def _take_request(self, service: Any) -> None:
        with service.handle:
            request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is None:
            return
        response = service.callback(request, service.srv_type.Response())
        if not inspect.iscoroutine(response):
            service.send_response(response, header)
            return

        async def answer() -> None:
            service.send_response(await response, header)

        self.create_task(answer())

    def _take_response(self, client: Any) -> None:
        with client.handle:
            header, response = client.handle.take_response(client.srv_type.Response)
        if header is None:
            return
        try:
            future = client.get_pending_request(header.request_id.sequence_number)
        except KeyError:
            return  # nobody waits for it any more
        future._set_executor(self)  # noqa: SLF001 - as rclpy's executors do
        future.set_result(response)

    def _call_timer(self, timer: Any) -> None:
        with timer.handle:
            if not timer.handle.is_timer_ready():
                return
            timer.handle.call_timer()
        self._call(timer.callback)

    def _call_guard(self, guard: Any) -> None:
        guard.handle.is_triggered = False
        if guard.callback is not None:
            self._call(guard.callback)

    def _take_of(self, waitable: Any) -> None:
        ready = WaitSet()
        waitable.add_to_wait_set(ready)
        ready.look()
        if waitable.is_ready(ready):
            data = waitable.take_data()
            self.create_task(waitable.execute(data))


class _Source:
    """Something that an executor listens to: one event for each time that something is to be taken."""

    def __init__(
        self, entity: Any, take: Callable[[], None], push: Callable[[_Source], None]
    ) -> None:
        self._take = take
        self.handle: Any = getattr(entity, "handle", None)
        self.is_timer = isinstance(self.handle, Timer)
        self._push = push
        self._pushed = 0  # events that wait
        self._is_gone = False
        if self.handle is None:
            collected = WaitSet()
            entity.add_to_wait_set(collected)
            self._handles = collected.all
        else:
            self._handles = [self.handle]
        for each in self._handles:
            each.listeners.append(self._look)
        if not self.is_timer:
            self._look()

    def _look(self) -> None:
        while self._pushed < sum(each.unread for each in self._handles):
            self._pushed += 1
            self._push(self)

    def run(self) -> None:
        """Carry out one event, unless it has left."""
        self._pushed = max(0, self._pushed - 1)
        if not self._is_gone:
            self._take()

    def leave(self) -> None:
        """Listen no more."""
        self._is_gone = True
        for each in self._handles:
            each.listeners.remove(self._look)
