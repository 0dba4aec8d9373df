"""The process of one device under test: its driver, a recorder of every sample, and a door for commands.

``python -m crtk_drivers.labs.bench.host`` takes a pickled `HostOrder` from its standard input. It needs no
ROS. Who started it supervises it through the first connection: when that is lost, or who started it stands
still, the device is held and left, so that none goes on without its bench.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import socket
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any, Final

from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.engine import Engine, Observer
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    CrtkError,
    DeviceError,
    WrongReading,
    unexpected,
)
from crtk_drivers.labs.bench.calls import (
    EFFORT,
    STANDS_STILL,
    TOOLS,
    About,
    Failed,
    Glance,
    HostOrder,
)
from crtk_drivers.labs.bench.taping import SampleRecorder
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.samples import JointState, Pose, Stamp, Value, Vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.pulse import Pulse
from crtk_drivers.status.stop_request import StopRequest, stop_signals

MARGIN: Final = 2.0
"""Seconds in which a device must measure, beside twice what its configuration gives it to connect."""

POLL_PERIOD: Final = 0.05

FIRST_CONNECTION: Final = 40.0
"""Seconds in which the bench comes, before which nobody supervises."""

LEAVING: Final = 0.5
"""Seconds between the hold and the end when the bench was lost."""

_MOVING: Final = ("submit", "service", "state_command")
"""Calls that are refused once the device is left."""

logger = logging.getLogger(__name__)


class _Refusals(Observer):
    """Keeps what was refused and every change of state, for the recording."""

    def __init__(self, recorder: SampleRecorder) -> None:
        self._recorder = recorder

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self._recorder.event("state", f"{status.state}{' busy' if status.is_busy else ''}")

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        self._recorder.event("refused", f"{refusal.command}: {refusal.reason}: {refusal.message}")

    @override
    def warned(self, text: str) -> None:
        self._recorder.event("warned", text)


class Host:
    """Serves one session.

    Args:
        session: started by `serve`.
        order: see there.
    """

    def __init__(self, session: Session, order: HostOrder) -> None:
        self._session = session
        self._engine: Engine = session.engine
        self._order = order
        self._recorder = SampleRecorder(session.engine)
        self._engine.add_observer(_Refusals(self._recorder))
        for prefix, engine in {"": session.engine, **session.children}.items():
            engine.on_sample = self._recorder.taker(engine, prefix and f"{prefix}/")
        session.recordings.may_be_asked = True
        self._ended = threading.Event()
        self._is_closing = False
        self._is_supervised = False
        self._leaving = threading.Lock()
        self._pulse = Pulse.start(socket.socket(fileno=order.pulse)) if order.pulse >= 0 else None
        self._calls: dict[str, Callable[..., Any]] = {
            "about": self._about,
            "glance": self._glance,
            "health": self._engine.health,
            "state_command": self._state_command,
            "hold": partial(self._engine.submit, "hold"),
            "readings": self._readings,
            "service": self._service,
            "record": self._recorder.begin,
            "mark": partial(self._recorder.event, "mark"),
            "note": partial(self._recorder.event, "note"),
            "stop_recording": self._recorder.end,
            "dump": self._dump,
            "forward": self._forward,
            "inverse": self._inverse,
            "jacobian": self._jacobian,
            "leave": self._ended.set,
        }

    def serve(self, stop: StopRequest) -> None:
        """Bring the device up and do what connections ask, until the first of them is lost or says so."""
        door = Path(self._order.door)
        with Listener(str(door), "AF_UNIX", authkey=self._order.key) as listener, self._session:
            accepting = threading.Thread(target=self._accept, args=(listener,), daemon=True)
            accepting.start()
            parent, deadline = os.getppid(), time.monotonic() + FIRST_CONNECTION
            while not stop.is_set() and not self._ended.wait(POLL_PERIOD):
                is_alone = os.getppid() != parent or time.monotonic() > deadline
                if is_alone and not self._is_supervised:
                    logger.error("%s: the bench did not come: left", self._engine.where)
                    break
                silence = 0.0 if self._pulse is None else self._pulse.silence()
                if silence > STANDS_STILL:
                    self._let_go(f"the bench stands still for {silence:.1f} s")
            self._recorder.end()
            self._is_closing = True
        door.unlink(missing_ok=True)

    def calls(self, visitor: Client) -> dict[str, Callable[..., Any]]:
        """Return what a connection may ask for, by name."""
        return {**self._calls, "submit": partial(self._submit, visitor)}

    def _accept(self, listener: Listener) -> None:
        first = True
        while True:
            try:
                connection = listener.accept()
            except Exception:  # a stranger without the key, or the end
                if self._is_closing:
                    return
                logger.exception("%s: a connection to the door failed", self._engine.where)
                time.sleep(POLL_PERIOD)
                continue
            self._is_supervised = True
            thread = threading.Thread(target=self._serve_one, args=(connection, first), daemon=True)
            thread.start()
            first = False

    def _serve_one(self, connection: Connection, supervises: bool) -> None:
        visitor = Client("a connection of the bench")
        calls = self.calls(visitor)
        try:
            while True:
                number, name, *arguments = connection.recv()
                try:
                    if name in _MOVING and self._leaving.locked():
                        raise DeviceError("the bench was lost: the device is held and left")
                    answer = calls[name](*arguments)
                except CrtkError as error:
                    answer = Failed(str(error), str(getattr(error, "reason", "")))
                except Exception as error:
                    logger.exception("%s: %s", self._engine.where, name)
                    answer = Failed(unexpected(error), "")
                connection.send((number, answer))
        except (EOFError, OSError):
            pass
        finally:
            visitor.leave()
            connection.close()
            if supervises and not self._ended.is_set():
                self._let_go("the bench is gone")

    def _let_go(self, why: str) -> None:
        """Hold and disable what is powered, and end, whatever of that is refused; for the first reason."""
        if not self._leaving.acquire(blocking=False):
            return
        logger.error("%s: %s: held, and left", self._engine.where, why)
        try:
            powered = self._engine.status.state in (OperatingState.ENABLED, OperatingState.PAUSED)
            if powered or not self._engine.transition_ended:
                with contextlib.suppress(CrtkError):
                    self._engine.submit("hold")
                time.sleep(LEAVING)
                self._engine.state_command("disable")
                timeout = self._engine.capabilities.transition_timeout
                self._engine.wait_for(lambda: self._engine.transition_ended, timeout)
        except CrtkError as error:
            logger.error("%s: %s", self._engine.where, error)
        finally:
            self._ended.set()

    # ------------------------------------------------------------------------------------- the calls

    def _dump(self, reason: str, path: str) -> None:
        self._session.recordings.dump(reason, Path(path))

    def _about(self) -> About:
        engine = self._engine
        timeout = 2.0 * self._order.config.open_timeout + MARGIN
        if not engine.wait_for(lambda: engine.connected and engine.has_sample, timeout):
            raise ConnectionFailed(
                f"{engine.status.cause or 'no sample arrived'}; it was tried for {timeout:g} s",
                where=engine.where,
                remedy=engine.status.remedy,
            )
        return About(
            name=engine.where,
            capabilities=engine.capabilities,
            commands=(
                *engine.commands,
                *(reading.told_as(name) for name, reading in engine.readings.items()),
                *self._efforts(),
                *self._tools(),
            ),
            silence=engine.options.stream_timeout,
            sample_timeout=engine.options.sample_timeout,
            stale_after=engine.stale_after,
            max_step=engine.options.limits.max_step,
            has_kinematics=engine.device.kinematics is not None,
            readings=self._readings(),
            is_homed=engine.status.is_homed,
            services=tuple(engine.services),
        )

    def _efforts(self) -> tuple[str, ...]:
        value, _ = self._engine.feedback("measured_js") or (None, None)
        return (EFFORT,) if isinstance(value, JointState) and value.effort.size else ()

    def _tools(self) -> tuple[str, ...]:
        behind = self._session.children.values()
        return (TOOLS,) if any("measured_cp" in each.commands for each in behind) else ()

    def _glance(self) -> Glance:
        engine = self._engine
        names = ("measured_js", "setpoint_js", "measured_cp", "measured_cf")
        found = {name: engine.feedback(name) for name in names}
        health = engine.health()
        return Glance(
            engine.status,
            engine.connected,
            health.sample_age,
            {name: value for name, value in found.items() if value is not None},
            sum(health.refusals.values()),
            time.monotonic(),
        )

    def _state_command(self, text: str, timeout: float) -> Status:
        engine = self._engine
        engine.state_command(text)
        engine.wait_for(lambda: engine.transition_ended, timeout)
        return engine.status

    def _service(self, name: str, timeout: float) -> str:
        return self._engine.request(name).wait(timeout)

    def _submit(self, visitor: Client, name: str, value: Value | None, stamp_ns: int) -> None:
        self._recorder.command(name, value, stamp_ns)
        self._engine.submit(name, value, stamp_ns, visitor)

    def _readings(self) -> dict[str, str]:
        told: dict[str, Value | None] = {}
        for name, reading in self._engine.readings.items():
            with contextlib.suppress(WrongReading):
                told[name] = reading.tell()
        return {
            name: str(getattr(value, "value", getattr(value, "values", value)))
            for name, value in told.items()
            if value is not None
        }

    def _forward(self, joints: Vector) -> Pose:
        return self._engine.forward_kinematics(joints)

    def _inverse(self, pose: Pose, reference: Vector) -> Vector:
        return self._engine.inverse_kinematics(pose, reference)

    def _jacobian(self, joints: Vector) -> Any:
        kinematics = self._engine.device.kinematics
        return None if kinematics is None else kinematics.jacobian(joints)


def main() -> int:
    """Host the order that comes on standard input; return the exit code."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    order: HostOrder = pickle.load(sys.stdin.buffer)
    with stop_signals() as stop:
        try:
            session = Session(plugins.device(order.plugin), order.config)
        except CrtkError as error:
            logger.error("%s", error)
            return 1
        Host(session, order).serve(stop)
    return 0


if __name__ == "__main__":
    sys.exit(main())
