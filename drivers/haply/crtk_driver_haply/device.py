"""A Haply Inverse3 with its VerseGrip as a CRTK device.

Each cycle sends a force, zero unless one is streamed, and takes the state that the service answers with; what
a client asks for is sent at once. A force is zero when its stream ends, on pause and disable, when the link
is lost, and at the end.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from functools import partial
from typing import Final

from typing_extensions import override

from crtk_driver_haply.config import HaplyConfig
from crtk_driver_haply.force import ForceInForce
from crtk_driver_haply.link import ServiceLink
from crtk_driver_haply.messages import (
    FULL_STATE,
    NO_FORCE,
    Arm,
    ForceMessage,
    Grip,
    Told,
    Triple,
    parse,
)
from crtk_driver_haply.turning import Turning
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Condition,
    Device,
    Mode,
    Note,
    Reading,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, CrtkError, TransitionFailed
from crtk_drivers.samples import Flag, Joy, Number, Pose, Sample, Stamp, Twist, vector
from crtk_drivers.state import OperatingState

__all__ = ["HaplyDevice"]

TORQUE: Final = 1e3
"""N·m: whatever the torque of a wrench is, it does not make the force smaller."""
UNASKED: Final = 0.3
"""Seconds in which a service tells its devices by itself; one that does not is asked."""
RECENT: Final = 2.0
"""Seconds for which a message that could not be read is told."""
STALE: Final = 0.25
"""Seconds after which a grip's buttons are not known any more."""
LATE: Final = 0.05
"""Seconds after the end of a stream in which the core has stopped the device: then a force ends by itself."""
NOT_EXERTED: Final = 0.5
"""Seconds after which a force that the service does not have exerted is told."""
FELT: Final = 0.02
"""N below which a force is none."""
_ZERO: Final = vector((0.0, 0.0, 0.0))
_UPRIGHT: Final = vector((0.0, 0.0, 0.0, 1.0))
_REST: Final = "Put the handle into its rest position (the inkwell), and wait for its light."
_SEE_HUB: Final = "Is it plugged in, and powered? Haply Hub lists what the service sees."


class HaplyDevice(Device):
    """One Inverse3, with the VerseGrip that is in its user's hand."""

    def __init__(self, config: HaplyConfig) -> None:
        self._config = config
        self._aborted = self._is_open = False
        self._link = ServiceLink(
            config.host, config.port, lambda: self._aborted and not self._is_open
        )
        self._force = ForceInForce(config.ramp, config.stream_timeout + LATE)
        self._message = ForceMessage("", None, config.force_member)
        self._device_id = self._grip_id = ""
        self._arm: Arm | None = None
        self._grip: Grip | None = None
        self._grip_told = self._bad_at = -math.inf
        self._unfelt_since = math.inf
        self._turning = Turning()
        self._firmware = self._bad = ""
        self._stopped = True
        self._sent = NO_FORCE
        self._since = 0
        """Number of the message from which on each has had a force, or none, as the newest one."""
        self._woken = threading.Event()
        self._due = 0.0
        self._messages = self._malformed = self._torques = 0
        self._capabilities = Capabilities(
            model="Inverse3",
            modes=frozenset({Mode.CARTESIAN_EFFORT}),
            cartesian_limits=CartesianLimits(1.0, 10.0, 50.0, 500.0, config.max_force, TORQUE),
            measured=("measured_cp", "measured_cv"),
            has_free=True,
            rate=config.rate,
            paced_by_stream=True,
            base_frame=config.base_frame,
            tool_frame=config.tool_frame,
            transition_timeout=5.0,
            stop=StopPolicy(
                0.1,
                "exerts no force. The service applies each force once: without commands the device goes "
                "idle, in a time that its manual does not tell",
            ),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return f"{self._config.host}:{self._config.port}"

    # ------------------------------------------------------------------------------------- connection

    @override
    def open(self, deadline: float) -> None:
        self._is_open = False
        self._force.drop()
        self._stopped = (
            False  # until the service tells so: what it was told before the link was lost may go on
        )
        self._turning.forget()
        texts = self._link.open(deadline)
        try:
            told = self._inventory(texts, deadline)
            self._arm = self._chosen_arm(told)
            self._grip = self._chosen_grip(told)
        except ConnectionFailed:
            self._link.close()
            raise
        except ConnectionLost as error:
            self._link.close()
            raise ConnectionFailed(
                error.message, where=self._link.where, remedy=error.remedy
            ) from error
        self._device_id = self._arm.device_id
        self._firmware = self._arm.firmware
        self._point_at_grip()
        self._unfelt_since = math.inf
        self._sent, self._since = NO_FORCE, self._link.sent + 1
        self._is_open = True

    def _inventory(self, texts: list[bytes], deadline: float) -> Told:
        """Return the first message, which has all devices; ask for it if it does not come by itself."""
        asked = False
        while not texts:
            now = time.monotonic()
            texts = self._link.receive(min(deadline, now + UNASKED))
            if texts:
                break
            if time.monotonic() >= deadline:
                raise self._failed("it does not tell its devices")
            if not asked:
                self._link.send(FULL_STATE)
                asked = True
        try:
            told = parse(texts[-1])
        except ValueError as error:
            raise self._failed(f"its first message cannot be read: {error}") from error
        if told.arms is None:
            raise self._failed(
                "its first message has no list of Inverse3: it is another service, or a version that this "
                "driver does not know"
            )
        return told

    def _failed(self, what: str, remedy: str = _SEE_HUB) -> ConnectionFailed:
        return ConnectionFailed(what, where=self._link.where, remedy=remedy)

    def _chosen_arm(self, told: Told) -> Arm:
        arms, wanted = told.arms or {}, self._config.device_id
        names = ", ".join(sorted(arms)) or "none"
        if wanted and wanted not in arms:
            raise self._failed(f"it has no Inverse3 {wanted}, but {names}")
        if not arms:
            raise self._failed("it has no Inverse3")
        if not wanted and len(arms) > 1:
            raise self._failed(f"it has several Inverse3: {names}", "Choose one: --device-id.")
        return arms[wanted] if wanted else next(iter(arms.values()))

    def _chosen_grip(self, told: Told) -> Grip | None:
        """Return the grip; None: there is none (yet)."""
        if not self._config.grip:
            return None
        wanted = self._config.grip_id or self._grip_id
        if wanted:
            return told.grips.get(wanted)
        if len(told.grips) > 1:
            names = ", ".join(sorted(told.grips))
            raise self._failed(f"it has several VerseGrips: {names}", "Choose one: --grip-id.")
        return next(iter(told.grips.values()), None)

    def _point_at_grip(self) -> None:
        self._grip_id = self._grip.device_id if self._grip is not None else self._grip_id
        self._message = ForceMessage(self._device_id, self._grip, self._config.force_member)

    @override
    def abort_open(self) -> None:
        self._aborted = True

    @override
    def close(self) -> None:
        self._force.drop()
        self._link.close()
        self._is_open = False

    # ---------------------------------------------------------------------------------------- reading

    @override
    def read(self, deadline: float) -> Sample | None:
        if self._woken.wait(self._due - time.monotonic()):
            self._woken.clear()
            return None
        self._due = max(self._due + 1.0 / self._config.rate, time.monotonic())
        texts, answered = self._late(deadline), self._answered
        if self._link.may_send:
            self._send(self._force.at(time.monotonic()))
        if newer := self._link.receive(deadline):
            texts, answered = newer, self._answered
        if not texts:
            return None
        stamp = Stamp.now()
        self._messages += len(texts)
        try:
            told = parse(texts[-1])
        except ValueError as error:
            self._malformed += 1
            self._bad, self._bad_at = str(error), stamp.monotonic
            return None
        if told.arms is None:
            return None
        arm = told.arms.get(self._device_id)
        if arm is None:
            raise ConnectionLost(
                f"the service has no Inverse3 {self._device_id} any more",
                where=self._link.where,
                remedy=f"{_SEE_HUB} The driver looks again by itself.",
            )
        self._arm = arm
        self._take_grip(told, stamp.monotonic)
        self._judge(answered, arm.force, stamp.monotonic)
        return self._sample(arm, stamp)

    @override
    def wake(self) -> bool:
        self._woken.set()
        return True

    def _late(self, deadline: float) -> list[bytes]:
        """Return the newest of what came since the last cycle: answers to forces that were sent at once."""
        newest: list[bytes] = []
        while texts := self._link.receive(0.0):
            newest = texts
            if time.monotonic() > deadline:
                break
        return newest

    def _take_grip(self, told: Told, now: float) -> None:
        if not self._config.grip:
            return
        grip = told.grips.get(self._grip_id)
        if grip is None and not self._grip_id and len(told.grips) == 1:
            (grip,) = told.grips.values()
        had_one, self._grip = self._grip is not None, grip
        if grip is None:
            self._turning.forget()
            return
        self._grip_told = now
        if not had_one:
            self._point_at_grip()

    @property
    def _answered(self) -> Triple | None:
        """The force (3,) that the newest answer is about; None while that of an earlier one may be meant."""
        return self._sent if self._link.answered >= self._since else None

    def _judge(self, asked: Triple | None, exerted: Triple | None, now: float) -> None:
        """See whether the device exerts what it was told: nothing after a stop, something for a force."""
        if asked is None:
            return
        is_none = exerted is None or max(map(abs, exerted)) < FELT
        if asked == NO_FORCE:
            self._stopped = self._stopped or is_none
        is_unfelt = max(map(abs, asked)) >= FELT and exerted is not None and is_none
        self._unfelt_since = min(self._unfelt_since, now) if is_unfelt else math.inf

    def _sample(self, arm: Arm, stamp: Stamp) -> Sample:
        grip, frame = self._grip, self._config.base_frame
        orientation, spin = _UPRIGHT, _ZERO
        is_known = arm.is_calibrated
        if grip is not None and grip.orientation is not None and grip.is_awake:
            orientation = vector(grip.orientation)
            spin = self._turning.take(orientation, stamp.monotonic)
        elif self._config.grip:
            is_known = False
            self._turning.forget()
        if not is_known:
            stamp = Stamp(0, stamp.monotonic)
        return Sample(
            stamp,
            {
                "measured_cp": Pose(vector(arm.position), orientation, frame),
                "measured_cv": Twist(vector(arm.velocity), spin, frame),
            },
        )

    # ---------------------------------------------------------------------------------------- forces

    @override
    def write(self, setpoint: Setpoint) -> None:
        """Exert the force of a wrench, and nothing of its torque: the handle has no motors to turn it."""
        x, y, z, *torque = setpoint.values.tolist()
        self._torques += any(torque)
        now = time.monotonic()
        before = self._force.at(now)
        self._stopped = False
        self._force.ask((x, y, z), now)
        force = self._force.at(now)
        if force != before and self._link.may_send:  # else the next cycle sends it
            self._send(force)

    @override
    def stop(self) -> None:
        self._force.drop()
        self._stopped = False
        self._send(NO_FORCE)

    def _send(self, force: Triple) -> None:
        if (force == NO_FORCE) != (self._sent == NO_FORCE):
            self._since = self._link.sent + 1
        self._sent = force
        self._link.send(self._message.of(force))

    @property
    @override
    def has_stopped(self) -> bool:
        return self._stopped

    @override
    def free(self) -> Steps:
        """Exert no force, which lets the handle be moved: it is what `stop` has done before."""
        yield from ()

    # ----------------------------------------------------------------------------------- its state

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        reason = self.condition.reason
        if not reason:
            return ()
        return (TransitionFailed(reason, where=self._link.where, remedy="Then enable again."),)

    @property
    def _is_calibrated(self) -> bool:
        return self._arm is not None and self._arm.is_calibrated

    @property
    @override
    def condition(self) -> Condition:
        if not self._is_calibrated:
            return Condition(OperatingState.DISABLED, f"it is not calibrated. {_REST}")
        trouble = self._grip_trouble
        return Condition(OperatingState.PAUSED, trouble) if trouble else Condition()

    @property
    def _grip_trouble(self) -> str:
        """Why orientation and buttons are not known; empty if they are, or come from nowhere."""
        if not self._config.grip:
            return ""
        if self._grip is None:
            named = f" {self._grip_id}" if self._grip_id else ""
            return f"the service has no VerseGrip{named}: switch it on, or set grip to false"
        if not self._grip.is_awake:
            return f"the VerseGrip {self._grip.device_id} is asleep: press its button"
        if self._grip.orientation is None:
            return f"the VerseGrip {self._grip.device_id} tells no orientation"
        return ""

    # ------------------------------------------------------------------------------- what else it tells

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        rows = {
            name: Reading(
                "1 while it is pressed", Payload.JOY, partial(self._button, button), True, True
            )
            for name, button in self._config.buttons.items()
            if self._config.grip
        }
        return {
            **rows,
            "battery": Reading("charge of the grip, 0 to 1", Payload.NUMBER, self._battery),
            "awake": Reading("whether the grip measures", Payload.FLAG, self._awake),
            "calibrated": Reading("whether positions count", Payload.FLAG, self._tell_calibrated),
        }

    def _button(self, button: str) -> Joy:
        grip = self._grip
        is_fresh = time.monotonic() - self._grip_told <= STALE
        if grip is None or not is_fresh or not grip.is_awake:
            return Joy(buttons=(0,), is_valid=False)
        return Joy(buttons=(int(button in grip.pressed),))

    def _tell_calibrated(self) -> Flag | None:
        return Flag(self._is_calibrated) if self._is_open else None

    def _battery(self) -> Number | None:
        grip = self._grip if self._is_open else None
        return None if grip is None or grip.battery is None else Number(grip.battery)

    def _awake(self) -> Flag | None:
        grip = self._grip if self._is_open else None
        return None if grip is None else Flag(grip.is_awake)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        battery = self._battery()
        counted = {
            "messages": self._messages,
            "malformed": self._malformed,
            "torques_dropped": self._torques,
        }
        return counted if battery is None else {**counted, "battery": battery.value}

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        now, battery = time.monotonic(), self._battery()
        is_low = battery is not None and battery.value < self._config.battery_low
        charge = f"{100 * battery.value:.0f} %: charge it" if battery is not None else ""
        is_bad = now - self._bad_at < RECENT
        unfelt = now - self._unfelt_since > NOT_EXERTED
        found = [
            (Severity.ERROR, "calibration", "" if self._is_calibrated else _REST),
            (Severity.ERROR, "grip", self._grip_trouble),
            (Severity.WARNING, "battery", charge if is_low else ""),
            (Severity.WARNING, "messages", f"one is dropped: {self._bad}" if is_bad else ""),
            (Severity.WARNING, "force", _UNFELT if unfelt else ""),
            (Severity.INFO, "torque", _NO_TORQUE if self._torques else ""),
            (Severity.INFO, "inverse3", f"{self._device_id}, firmware {self._firmware or '?'}"),
        ]
        return tuple(Note(severity, key, text) for severity, key, text in found if text)


_UNFELT: Final = (
    "the service tells that none is exerted: set force_member to what its version knows, and see whether "
    "another program has the device"
)
_NO_TORQUE: Final = "torques of wrenches are left out: the handle turns freely"
