"""The plain Python front: a device in your own process, with the CRTK names as methods.

    with crtk_drivers.connect("ur", sim=True) as arm:
        arm.enable()
        arm.move_jp(arm.setpoint_js().position + 0.1).wait()

Every CRTK name that the device offers is a method; one that it does not offer is absent, and asking for
it says which devices have it. Names and values are those of the topics.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.commands import Command, Level, Payload, find, is_name
from crtk_drivers.config import from_values
from crtk_drivers.device import Reading
from crtk_drivers.device.offered import missing_for
from crtk_drivers.engine import Engine, Observer
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    DataTimeout,
    Reason,
    TransitionFailed,
)
from crtk_drivers.front.base import PARTS, DeviceFront, OfferedDoc, Reader, did_you_mean
from crtk_drivers.front.method_forms import (
    SERVICE_TIMEOUT,
    documented,
    first_line,
    form_of,
    form_of_input,
    form_of_reading,
    form_of_service,
)
from crtk_drivers.front.payloads import converted, value_for
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.motion.move import Move
from crtk_drivers.plugins import RunningSim
from crtk_drivers.samples import (
    Flag,
    Number,
    Numbers,
    Stamp,
    Text,
    Value,
)
from crtk_drivers.session import Session, open_session
from crtk_drivers.session.recordings import Recordings
from crtk_drivers.state import StateCommand, Status, target_of
from crtk_drivers.status.health import Health
from crtk_drivers.status.throttle import Throttle

if TYPE_CHECKING:
    from crtk_drivers.front.kinds import AnyDevice
else:
    AnyDevice = object  # a device gets the methods that it offers when it is made

logger = logging.getLogger(__name__)

CONNECT_TIMEOUT = 10.0
"""Seconds that `connect` tries for, unless it is told otherwise."""
REASON_TIME = 1.0
"""Seconds beyond `open_timeout` in which the first attempt says why it has failed."""
LOG_INTERVAL = 2.0
"""Seconds in which a refusal of one kind is logged once."""

_OPERATING_STATE, _STATE_COMMAND = "operating_state", "state_command"
"""Names whose methods every front has, see `DeviceFront`."""


class _Wait:
    """A client's thread that waits for a status."""

    def __init__(self, test: Callable[[Status], bool]) -> None:
        self.test = test
        self.seen = threading.Event()


class _StatusWatch(Observer):
    """Lets a client's thread wait for a status, also one that lasts for an instant only.

    It also logs warnings, and refusals of one kind once in `LOG_INTERVAL`. One that raises where the command
    was given is logged as INFO: Python prints warnings where logging is not set up, and whoever gave the
    command would read it twice. One of the I/O thread raises nowhere, and is a warning.
    """

    def __init__(self, engine: Engine) -> None:
        self.latest = engine.status
        self._where = engine.where
        self._afterwards = engine.after_telling
        self._lock = threading.Lock()
        self._waits: list[_Wait] = []
        self._refusals = Throttle(LOG_INTERVAL)
        self._raising: set[int] = set()
        self._awaited: set[int] = set()

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Know that what is refused within, in this thread, raises in it."""
        thread = threading.get_ident()
        self._raising.add(thread)
        try:
            yield
        finally:
            self._raising.discard(thread)

    @contextmanager
    def awaiting(self, stamp_ns: int) -> Iterator[None]:
        """Know that a refusal of the state command with a stamp raises in who waits within for its end."""
        self._awaited.add(stamp_ns)
        try:
            yield
        finally:
            self._awaited.discard(stamp_ns)

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        with self._lock:
            self.latest = status
            for wait in self._waits:
                if wait.test(status):
                    wait.seen.set()

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        if refusal.reason is Reason.FAILED:
            return  # the fault, or the warning of what broke it off, has been logged
        is_awaited = refusal.command == _STATE_COMMAND and refusal.stamp_ns in self._awaited
        is_raised = is_awaited or threading.get_ident() in self._raising
        level = logging.INFO if is_raised else logging.WARNING
        if self._refusals.passes((level, refusal.command, refusal.reason), time.monotonic()):
            self._afterwards(partial(logger.log, level, "%s", refusal))

    @override
    def warned(self, text: str) -> None:
        self._afterwards(partial(logger.warning, "%s: %s", self._where, text))

    def wait_for(self, test: Callable[[Status], bool], timeout: float) -> bool:
        """Wait until `test` holds for an announced status; return whether it did in time."""
        wait = _Wait(test)
        with self._lock:
            if test(self.latest):
                return True
            self._waits.append(wait)
        try:
            return wait.seen.wait(timeout)
        finally:
            with self._lock:
                self._waits.remove(wait)


class LocalFront(DeviceFront):
    """What a device in this process has, of whatever kind. See `LocalDevice`."""

    def __init__(self, session: Session, child: str = "") -> None:
        self._session = session
        self._engine = session.children[child] if child else session.engine
        self._client = Client("another handle of the driver's own program")
        self._watch = _StatusWatch(self._engine)
        self._engine.add_observer(self._watch)
        for name, command in self._engine.commands.items():
            self._add(name, command)
        self._extras = dict(self._made_extras())
        for name, method in self._extras.items():
            self._attach(name, method)
        self._children = {
            behind: LocalDevice(session, behind) for behind in session.children if not child
        }
        vars(self).update(self._children)

    # ----------------------------------------------------------------------------------- life cycle

    @override
    def close(self) -> None:
        """Leave the hardware holding and disconnect; with all that belongs to it.

        Raises:
            StopUnconfirmed: it was not seen to stand.
            DeviceError: it could not be told to stop, or the driver's thread did not end in time.
        """
        self._client.leave()
        self._session.close()

    @override
    def __repr__(self) -> str:
        engine = self._engine
        kind = self._session.plugin.name
        name = "" if engine.name == kind else f" {engine.name!r}"
        state = "closed" if self._session.is_closed else engine.status.state
        return f"<{kind}{name} {state} at {engine.device.address}>"

    if not TYPE_CHECKING:  # to a type checker a name that is not listed is a mistake

        def __getattr__(self, name: str) -> Any:
            """Explain why a CRTK name is absent on this device."""
            if name.startswith("_"):
                raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
            if not is_name(name):
                raise AttributeError(f"{self._engine.name} has no {name}. {self._instead(name)}")
            engine = self._engine
            others = [other for other in plugins.devices() if name in plugins.commands_of(other)]
            hint = f" Devices that offer it: {', '.join(others)}." if others else ""
            raise AttributeError(
                f"{engine.name} does not offer {name}. {missing_for(name, engine.device)}{hint}"
            )

    def _instead(self, name: str) -> str:
        """Return which names are near one that is none of CRTK's, and where all of them are listed."""
        own = [each for each in dir(self) if not each.startswith("_")]
        moves = [each for each in own if each.startswith("move_")]
        listed = f"It moves by {', '.join(moves)}. " if moves else ""
        return f"{did_you_mean(name, own)}{listed}crtk_commands has all that it offers."

    @property
    @override
    def crtk_commands(self) -> Mapping[str, Command]:
        """The CRTK names that this device offers."""
        return self._engine.commands

    @property
    def engine(self) -> Engine:
        """The engine behind this front."""
        return self._engine

    @property
    def sim(self) -> RunningSim | None:
        """The simulator behind the device, to inject faults into; None for real hardware."""
        return self._session.sim

    @property
    def recordings(self) -> Recordings:
        """What records the device: ``arm.recordings.start("run.mcap")``, and its black box."""
        return self._session.recordings

    @property
    def page(self) -> str:
        """Address of the page that shows the device in a browser; empty without ``web=True``."""
        page = self._session.page
        return "" if page is None else page.address

    @property
    def extras(self) -> Mapping[str, Callable[..., Any]]:
        """What it has beyond CRTK: ``arm.extras["tool_voltage"](24)`` is ``arm.tool_voltage(24)``."""
        return MappingProxyType(self._extras)

    def child(self, name: str) -> LocalDevice:
        """Return a device behind it: ``arm.child("gripper")`` is ``arm.gripper``.

        Raises:
            ConnectionFailed: there is no such device.
        """
        if name not in self._children:
            raise ConnectionFailed(
                f"there is no device {name!r} behind it",
                where=self._engine.where,
                remedy=f"{did_you_mean(name, self._children)}"
                f"There is: {', '.join(self._children) or 'none'}.",
            )
        return self._children[name]

    @override
    def summaries(self) -> Mapping[str, str]:
        """Return what the device offers, with one line for each name; also what is beyond CRTK."""
        own = {name: first_line(method.__doc__ or "") for name, method in self._extras.items()}
        return {**super().summaries(), **own}

    def health(self) -> Health:
        """Return the counters: rate, late cycles, refusals by reason, ..."""
        return self._engine.health()

    # ------------------------------------------------------------------------------ operating state

    @override
    def operating_state(self) -> Status:
        """Return state, is_homed and is_busy."""
        return self._watch.latest

    @override
    def wait_for_status(self, test: Callable[[Status], bool], timeout: float) -> bool:
        """Wait until `test` holds for an announced status; return whether it did in time."""
        return self._watch.wait_for(test, timeout)

    @override
    def state_command(self, command: str, timeout: float = 30.0) -> None:
        engine, stamp = self._engine, time.time_ns()
        before = engine.status.state
        if timeout <= 0.0:
            with self._watch.raising():
                engine.state_command(command, stamp)
            return
        refusals: list[CommandRefused] = []
        watch = _RefusalWatch(refusals, stamp)
        engine.add_observer(watch)
        try:
            with self._watch.awaiting(stamp):
                engine.state_command(command, stamp)
                target = target_of(before, StateCommand(command))
                has_ended = engine.wait_for(lambda: engine.transition_ended, timeout)
        finally:
            engine.remove_observer(watch)
        if not has_ended:
            raise TransitionFailed(f"{command} did not end in {timeout:g} s", where=engine.where)
        if refusals:
            raise refusals[-1]
        status = engine.transition_outcome
        if status.state is not target:
            raise TransitionFailed(
                f"{command} ended in {status.state}: {status.cause}",
                where=engine.where,
                remedy=status.remedy or "Remove the cause, then send enable.",
            )

    # ------------------------------------------------------------------------------------ CRTK names

    def _add(self, name: str, command: Command) -> None:
        if name in (_OPERATING_STATE, _STATE_COMMAND):
            return
        self._attach(name, documented(self._method(name, command), form_of(command)))
        for part, (whole, field) in PARTS.items():
            if whole == name:
                form = form_of(command, field)
                self._attach(part, documented(self._method(name, command, field), form))

    def _attach(self, name: str, method: Callable[..., Any]) -> None:
        owner: Any = self
        *spaces, last = name.split("/")
        method.__name__ = last
        for space in spaces:
            owner = vars(owner).setdefault(space, _SubNamespace(self, space))
        setattr(owner, last, method)

    # ---------------------------------------------------------------------------------- beyond CRTK

    def _made_extras(self) -> Iterator[tuple[str, Callable[..., Any]]]:
        """Return the methods of the device's own services, inputs and readings, by their names."""
        for name, service in self._engine.services.items():
            yield name, documented(self._requester(name), form_of_service(service.summary))
        for name, taken in self._engine.inputs.items():
            yield (
                name,
                documented(
                    self._giver(name, taken.payload), form_of_input(taken.summary, taken.payload)
                ),
            )
        for name, reading in self._engine.readings.items():
            told_as = reading.told_as(name)
            yield (
                told_as,
                documented(
                    self._teller(told_as, reading),
                    form_of_reading(reading.summary, reading.payload),
                ),
            )

    def _requester(self, name: str) -> Callable[..., str]:
        def request(timeout: float = SERVICE_TIMEOUT) -> str:
            with self._watch.raising():
                asked = self._engine.request(name)
            return asked.wait(timeout)

        return request

    def _giver(self, name: str, payload: Payload) -> Callable[[Any], None]:
        def give(value: Any) -> None:
            where = self._engine.where
            with self._watch.raising():
                taken = self._reported(lambda: converted(name, payload, value, where))
                self._engine.give(name, taken)

        return give

    def _teller(self, name: str, reading: Reading) -> Callable[[], Any]:
        def tell() -> Any:
            value = reading.tell()
            if value is None:
                raise DataTimeout(
                    f"{name}: not known now; the device is {self._engine.status.state}",
                    where=self._engine.where,
                    remedy="Is the device connected, and does it report this?",
                )
            match value:
                case Number() | Flag() | Text():
                    return value.value
                case Numbers():
                    return value.values
            return value

        return tell

    # -------------------------------------------------------------------- values to and from the device

    @override
    def _reader(self, name: str) -> Reader:
        is_latched = find(name).level in (Level.GOAL, Level.SETTING)
        look = self._engine.latched if is_latched else self._engine.feedback

        def read(oldest: float, timeout: float) -> tuple[Value, int]:
            found: tuple[Value, Stamp] | None = None

            def is_fresh() -> bool:
                nonlocal found
                found = look(name)
                if found is None or is_latched or oldest == 0.0:
                    return found is not None
                stamp = found[1]
                return stamp.wall_ns != 0 and time.monotonic() - stamp.monotonic <= oldest

            if not self._engine.wait_for(is_fresh, timeout) or found is None:
                raise self._no_data(name, found, oldest)
            value, stamp = found
            return value, stamp.wall_ns

        return read

    def _no_data(self, name: str, found: tuple[Value, Stamp] | None, oldest: float) -> DataTimeout:
        status = self._engine.status
        what = "no value yet" if found is None else f"nothing valid and newer than {oldest:g} s"
        return DataTimeout(
            f"{name}: {what}; the device is {status.state}"
            + (f" ({status.cause})" if status.cause else ""),
            where=self._engine.where,
            remedy="Pass age=0 to take the last value whatever its age.",
        )

    @property
    @override
    def _named(self) -> str:
        return self._engine.where

    @override
    def _sender(self, name: str, command: Command) -> Callable[..., Any]:
        engine, client, watch = self._engine, self._client, self._watch

        def send() -> None:
            with watch.raising():
                engine.submit(name, client=client)

        def send_value(value: Any) -> Move | None:
            with watch.raising():
                return engine.submit(name, self._payload(command, value), client=client)

        return send if command.payload is Payload.EMPTY else send_value

    def _payload(self, command: Command, value: Any) -> Value:
        return self._reported(lambda: value_for(command, value, self._engine.where))

    def _reported(self, convert: Callable[[], Value]) -> Value:
        try:
            return convert()
        except CommandRefused as refusal:
            self._engine.report_refusal(refusal)
            raise

    @override
    def _query(self, name: str, command: Command) -> Callable[..., Any]:
        engine = self._engine
        if command.payload is Payload.FORWARD_KINEMATICS:
            return lambda joints, _: engine.forward_kinematics(joints, name)
        return lambda pose, reference, _: engine.inverse_kinematics(pose, reference)


class LocalDevice(LocalFront, AnyDevice):
    """A device in this process. Made by `connect`; close it, or use it in a ``with`` statement.

    A device behind it is an attribute and closed with it: ``arm.gripper.move_jp(0.02)``.
    """

    if not TYPE_CHECKING:
        __doc__ = OfferedDoc(__doc__)


class _RefusalWatch(Observer):
    """Collects the refusals of the state command that has a stamp."""

    def __init__(self, refusals: list[CommandRefused], stamp_ns: int) -> None:
        self._refusals = refusals
        self._stamp_ns = stamp_ns

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        is_ours = refusal.command == _STATE_COMMAND and refusal.stamp_ns == self._stamp_ns
        # How a command ended that was begun, `transition_outcome` says.
        if is_ours and refusal.reason is not Reason.FAILED:
            self._refusals.append(refusal)


class _SubNamespace:
    """Holds the methods of a sub-namespace: ``arm.local.measured_cp()``."""

    def __init__(self, device: LocalFront, name: str) -> None:
        self._device = device
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._device, f"{self._name}/{name}")


def connect(
    device: str,
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> LocalDevice:
    """Bring a device up in this process and return it connected. ROS is neither needed nor imported.

    Args:
        device: the name of a plugin: ``ur``, ...
        sim: start a simulator and connect to that.
        config: a configuration, or the path of a TOML or YAML file.
        timeout: seconds to wait for the connection; None: `open_timeout` where the configuration gives it,
            else 10.
        sim_options: for the simulator.
        values: single configuration values, over `config`: ``host="192.168.1.10"``.

    Raises:
        PluginError, MissingExtra, ConfigError: it cannot be started as asked.
        ConnectionFailed: not connected in time; everything is closed again.
    """
    plugin = plugins.device(device)
    if sim:
        plugin.check_simulated(from_values(values))
    settings = plugin.load_config(config, values)
    session = open_session(device, settings, sim=sim, sim_options=sim_options)
    arm = LocalDevice(session)
    patience = 0.0
    if timeout is None and "open_timeout" in settings.model_fields_set:
        timeout, patience = settings.open_timeout, REASON_TIME
    elif timeout is None:
        timeout = CONNECT_TIMEOUT
    try:
        session.start()
        deadline = time.monotonic() + timeout
        for engine in session.engines:
            left = max(0.0, deadline - time.monotonic())
            if not engine.wait_for(partial(_is_measuring, engine), left):
                engine.wait_for(partial(_says_why, engine), patience)
                raise ConnectionFailed(
                    f"{engine.status.cause or 'no sample arrived'}; it was tried for {timeout:g} s",
                    where=engine.where,
                    remedy=engine.status.remedy,
                )
    except BaseException:
        arm.close()
        raise
    return arm


def _is_measuring(engine: Engine) -> bool:
    return engine.connected and engine.has_sample


def _says_why(engine: Engine) -> bool:
    """Whether the first attempt to connect has ended, by which it is known why it cannot be."""
    return not engine.status.connecting
