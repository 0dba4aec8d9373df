"""A Galil controller as the kit's device of axes wants it: commands over TCP, data records over UDP."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from typing import Final

import numpy as np
from typing_extensions import override

from crtk_driver_galil import codes
from crtk_driver_galil.axis_faults import AxisFaults
from crtk_driver_galil.believed_records import BelievedRecords
from crtk_driver_galil.commander import Commander, CommandRefusedByController
from crtk_driver_galil.config import (
    MOST_ACCELERATION,
    MOST_SPEED,
    GalilConfig,
    HomingConfig,
    JointConfig,
)
from crtk_driver_galil.examination import Examination
from crtk_driver_galil.record import AXES, FORWARD_LIMIT, REVERSE_LIMIT, AxisRecord, Record
from crtk_driver_galil.replies import numbers
from crtk_driver_galil.tracking import (
    PositionTracking,
    PvtPieces,
    StopAndGo,
    Tracking,
    by_axes,
)
from crtk_drivers.device import Capabilities, Note, Severity, Steps
from crtk_drivers.errors import ConnectionFailed, DeviceError
from crtk_drivers.kit import UdpTransport, until
from crtk_drivers.kit.axes import (
    AxesDevice,
    AxisTold,
    Complaint,
    Counted,
    Counting,
    Heard,
    MotionController,
    Words,
    braking_time,
    promises,
)
from crtk_drivers.samples import Stamp

__all__ = ["GalilController", "create"]

HOMED_WORD: Final = "crtkhm"
"""Begin of the name of a variable of the controller that a restart forgets: whether an axis was homed."""
HOME_WORD: Final = "crtkat"
"""Begin of the name of another one: what the axis was set to count there."""
QUICK: Final = 8.0
"""Acceleration towards the newest position with pt, in those of the joint: its ramp slows down before it."""
TRANSITION: Final = 5.0
STEP: Final = 1024
"""Counts/s² in which AC and DC count."""
AMPLE: Final = 1.2
"""Speed of the controller's own ramps and of pieces, in those of the joints."""
BLIND: Final = 0.1
"""Seconds without a record after which no setpoint is sent."""
WAITING: Final = 1024
"""Datagrams that are taken in one cycle; more than a system keeps are somebody's flood."""
EXPLAINED: Final = 5.0
"""Records in which a controller tells why it refuses commands."""

WORDS: Final = Words(
    Complaint(
        "the axes do not come to rest, although ST was taken",
        "Does a program on the controller move them? Stop it (HX).",
    ),
    Complaint(
        "the motors are on although MO was taken",
        "Does a program on the controller switch them on? Stop it (HX).",
    ),
)


def create(config: GalilConfig) -> AxesDevice:
    """Return an arm of axes of one controller."""
    return AxesDevice(GalilController(config), f"{config.host}:{config.tcp_port}", config.on_close)


class GalilController(MotionController):
    """Axes of one controller.

    Args:
        config: its address and joints.
    """

    words = WORDS
    blind = BLIND
    patience = TRANSITION

    def __init__(self, config: GalilConfig) -> None:
        self._config = config
        self._joints = tuple(config.joints.values())
        self._letters = "".join(joint.axis for joint in self._joints)
        self._commander = Commander(config.host, config.tcp_port, config.reply_timeout)
        self._link = UdpTransport(
            config.host, config.udp_port, "galil", "Does a firewall keep UDP out?"
        )
        self._faults = AxisFaults(config.joints)
        self._records = BelievedRecords(self._joints, config.record_period, self._faults.of)
        self._tracking = _tracking(config, self._letters)
        self._stop_seen = True
        self._stopped = -math.inf  # monotonic s of the answer to ST; inf while there is none
        self._refused = ""
        self._refused_at = 0.0
        self._revision = ""
        self._skipped = 0
        self.homes = [place for place, joint in enumerate(self._joints) if joint.homing]
        self._homed = not self.homes
        units = [joint.scale for joint in self._joints]
        self.counting = Counting(
            config.joints, units, [joint.torque_per_volt for joint in self._joints]
        )
        self.capabilities = _capabilities(config, needs_homing=bool(self.homes))

    @property
    @override
    def where(self) -> str:
        return self._commander.where

    @property
    @override
    def axes(self) -> Sequence[AxisTold]:
        return [
            AxisTold(
                name, not axis.motor_off, axis.motor_off, axis.is_moving, _limit(axis.switches)
            )
            for name, axis in zip(self._config.joints, self._told, strict=False)
        ]

    @property
    def _told(self) -> list[AxisRecord]:
        """What the axes have told last; empty: nothing yet."""
        record = self._records.newest
        return [] if record is None else [record.axes[letter] for letter in self._letters]

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {
            **self._records.lost,
            "skipped setpoints": self._skipped,
            "restarted streams": self._tracking.restarts,
            "echoes": self._commander.echoes,
            "characters said unasked": self._commander.said,
        }

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        said = "the controller repeats commands: EO 0 ends that"
        revision = [Note(Severity.INFO, "controller", self._revision)] if self._revision else []
        echo = [Note(Severity.WARNING, "echo", said)] if self._commander.echoes else []
        amplifiers = [
            Note(Severity.WARNING, name, f"the amplifier tells {text}")
            for name, text in self._amplifiers().items()
        ]
        return (*revision, *echo, *amplifiers)

    def _amplifiers(self, bits: int = 0xFFFF_FFFF) -> dict[str, str]:
        """Return what the amplifiers of joints say is wrong, of these bits of their status."""
        record = self._records.newest
        if record is None:
            return {}
        told = {
            name: codes.amplifier_text(record.amplifier & bits, AXES.index(joint.axis))
            for name, joint in self._config.joints.items()
        }
        return {name: text for name, text in told.items() if text}

    # --------------------------------------------------------------------------------------- the link

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._stopped = -math.inf
        self._records.forget()
        self._faults.begin()
        self._tracking.reset()
        self._commander.open(deadline)
        examination = Examination(self._commander, self._config, deadline)
        self._revision = examination.revision()
        layout = examination.layout(self._revision)
        self._records.begin(layout, examination.axes(layout))
        examination.check_samples()
        for name, joint in self._config.joints.items():
            examination.watch_position(name, joint)
        self._homed = not self.homes or self._remembers_home(examination)
        self._link.open(deadline)
        self._link.write(f"DR {round(1000 * self._config.record_period)}\r".encode())
        while self.exchange(min(deadline, time.monotonic() + 0.1)).counted is None:
            if time.monotonic() > deadline:
                raise ConnectionFailed(
                    "it takes commands, and sends no data records (DR) by UDP",
                    where=self._link.where,
                    remedy="Check the firewall of this computer, `udp_port`, and that a handle is free (TH).",
                )

    def _remembers_home(self, examination: Examination) -> bool:
        """Whether all axes count from where this configuration says; another one may have homed them."""
        wanted = self._words_of_home
        try:
            told = [numbers(examination.ask(f"{word}=?"))[0] for word in wanted]
        except (CommandRefusedByController, ValueError):
            return False  # it has been restarted since, and knows no such variable
        return told == list(wanted.values())

    @property
    def _words_of_home(self) -> dict[str, int]:
        """Variables of the controller with all axes homed, by name."""
        joints = [self._joints[place] for place in self.homes]
        at = {f"{HOME_WORD}{joint.axis}": _home_counts(joint) for joint in joints}
        return at | {f"{HOMED_WORD}{joint.axis}": 1 for joint in joints}

    @override
    def close(self, *, power_off: bool) -> None:
        try:
            if self._link.is_open:
                self._link.write(b"DR 0\r")
                if power_off:
                    self._commander.send(f"MO {self._letters}")
        except DeviceError:
            pass  # the link is gone, and with it who would be told
        finally:
            self._link.close()
            self._commander.close()

    @override
    def exchange(self, deadline: float) -> Heard:
        data = self._link.read(deadline)
        newest: Record | None = None
        now = time.monotonic()
        for _ in range(WAITING):
            if not data:
                break
            newest = self._records.take(data, now) or newest
            data = self._link.read(0.0)
        self._commander.collect()
        self._look_at_refusals()
        if newest is None:
            return Heard()
        fault = self._judged(newest)
        made, axes = self._records.heard, self._told
        counted = Counted(
            Stamp.at(made),
            [axis.position for axis in axes],
            [axis.velocity for axis in axes],
            [axis.torque for axis in axes],
        )
        return Heard(counted, fault)

    def _judged(self, record: Record) -> str:
        """Return what is a fault, and see whether a stop has been carried out."""
        rests = not any(axis.is_moving for axis in self._told)
        later = self._records.heard - self._stopped > 2.0 * self._config.record_period
        if rests and later:
            self._stop_seen = True
        found = self._faults.of(record)
        self._faults.take(record)
        if not found and self._refused and time.monotonic() > self._refused_at:
            found = [self._refused]
        return "; ".join(found)

    def _look_at_refusals(self) -> None:
        """Take what was refused; it counts when no record has told the reason by then."""
        if not self._faults.watched:
            return  # a procedure goes on, which looks itself
        for refused in self._commander.take_refused():
            if not self._refused:
                self._refused = f"{refused.message}. {refused.remedy}".strip()
                self._refused_at = time.monotonic() + EXPLAINED * self._config.record_period

    # ---------------------------------------------------------------------------------------- motion

    @property
    @override
    def here(self) -> Sequence[float]:
        return [axis.reference for axis in self._told]

    @override
    def admits(self) -> bool:
        is_busy = self._commander.is_busy
        self._skipped += is_busy
        return not is_busy

    @override
    def follow(self, now: float, counts: Sequence[float]) -> None:
        assert self._records.newest is not None
        self._faults.streams = True
        whole = np.rint(counts).astype(int).tolist()
        self._send(self._tracking.lines(whole, self._records.newest))

    def _send(self, lines: Iterable[str]) -> None:
        for line in lines:
            self._commander.send(line)

    @override
    def halt(self, *, aside: bool) -> None:
        if self._stop_seen:
            self._stopped = math.inf
        self._faults.streams = False
        self._stop_seen = False
        self._tracking.reset()
        self._commander.send(f"ST {self._letters}", self._stop_taken)

    def _stop_taken(self, _: str) -> None:
        self._stopped = min(self._stopped, time.monotonic())

    @property
    @override
    def has_stopped(self) -> bool:
        return self._stop_seen

    @override
    def give_up(self) -> None:
        self._refused = ""
        self._faults.streams = False
        self._tracking.reset()

    # ------------------------------------------------------------------------------------------ power

    @override
    def watch(self, on: bool) -> None:
        self._faults.watched = on
        self._refused = ""

    @property
    @override
    def hindered(self) -> Sequence[Complaint]:
        remedy = "Check the supply and the temperature of the amplifier."
        return [
            Complaint(f"{name}: the amplifier tells {text}", remedy)
            for name, text in self._amplifiers(codes.LASTS).items()
        ]

    @override
    def prepare(self) -> Steps:
        if self._records.newest is not None:
            self._faults.take(self._records.newest)
        quick = QUICK if self._config.tracking == "pt" else 1.0
        ramp = self._rates("acceleration", quick, STEP, MOST_ACCELERATION)
        yield from self._do(
            [
                f"ST {self._letters}",  # also leaves a mode that somebody else began
                f"SP {self._speeds()}",
                f"AC {ramp}",
                f"DC {ramp}",
            ]
        )

    @override
    def switch(self, on: bool) -> Steps:
        yield from self._do([f"{'SH' if on else 'MO'} {self._letters}"])

    @override
    def without_power(self) -> Complaint:
        off = ", ".join(axis.name for axis in self.axes if not axis.has_power)
        return Complaint(
            f"the motor of {off} has no power although SH was taken",
            "Check its amplifier, ELO and abort input, and the encoder (OA).",
        )

    # ----------------------------------------------------------------------------------------- homing

    @property
    @override
    def is_homed(self) -> bool:
        return self._homed

    @override
    def home(self, place: int) -> Generator[None, None, Complaint | None]:
        joint = self._joints[place]
        assert joint.homing is not None
        yield from self._do([f"{HOMED_WORD}{joint.axis}=0"])  # whoever connects after a half homing
        if joint.homing.method != "here":
            complaint = yield from self._search(place, joint, joint.homing)
            if complaint is not None:
                return complaint
        counts = _home_counts(joint)
        yield from self._do([f"DP{joint.axis}={counts}", f"SP {self._speeds()}"])
        counted = yield from until(
            lambda: abs(self._told[place].position - counts) * joint.scale < joint.arrives_within,
            1.0,
        )
        if counted:
            return None
        return Complaint(
            f"it counts {self._told[place].position}, not {counts}",
            "Does a program on the controller move it, or set its position (DP)?",
        )

    def _search(
        self, place: int, joint: JointConfig, homing: HomingConfig
    ) -> Generator[None, None, Complaint | None]:
        """Look for the home switch or the index, and return why it was not found."""
        letter = joint.axis
        speed = max(1, round(homing.speed / joint.scale))
        search = f"HM {letter}" if homing.method == "home" else f"FI {letter}"
        rate = f"SP{letter}={speed}"
        if homing.method == "index":
            rate = f"JG{letter}={speed * homing.direction * joint.sign}"
        self._faults.searching = letter
        try:
            yield from self._do([rate, search, f"BG {letter}"])
            begun = time.monotonic() + 10.0 * self._config.record_period
            done = yield from until(
                lambda: self._records.heard > begun and not self._told[place].is_moving,
                homing.timeout,
            )
        finally:
            self._faults.searching = ""
        code = self._told[place].stop_code
        if done and code == codes.HOMED:
            return None
        why = codes.stop_text(code) if done else f"it is not done after {homing.timeout:g} s"
        return Complaint(
            f"{why} (stop code {code})",
            "Check its switches, their level (CN) and the direction.",
        )

    @override
    def homed(self) -> Steps:
        yield from self._do([f"{word}={value}" for word, value in self._words_of_home.items()])
        self._homed = True

    @override
    def unhome(self) -> Steps:
        self._homed = False
        yield from self._do([f"{HOMED_WORD}{self._joints[place].axis}=0" for place in self.homes])

    def _speeds(self) -> str:
        """Operands of SP: those of the joints, or more where positions are limited on their way here."""
        ample = 1.0 if self._config.tracking == "stop_go" else AMPLE
        return self._rates("velocity", ample, 1, MOST_SPEED)

    def _rates(self, key: str, factor: float, step: int, most: int) -> str:
        counts = [factor * getattr(joint, key) / joint.scale for joint in self._joints]
        return by_axes(
            self._letters, [min(most, max(step, int(rate // step) * step)) for rate in counts]
        )

    def _do(self, commands: Iterable[str]) -> Steps:
        """Send commands, wait until all are answered, and raise why one was refused."""
        self._commander.take_refused()
        watched, self._faults.watched = self._faults.watched, False  # a refusal is this procedure's
        try:
            self._send(commands)
            while self._commander.waiting:
                yield
            refused = self._commander.take_refused()
            if refused:
                raise refused[0]
        finally:
            self._faults.watched = watched


def _home_counts(joint: JointConfig) -> int:
    """Return what an axis counts where it is homed."""
    return 0 if joint.homing is None else round(joint.counts(joint.homing.position))


def _limit(switches: int) -> str:
    """Return at which of its limits an axis is, in words."""
    ends = ((FORWARD_LIMIT, "forward"), (REVERSE_LIMIT, "reverse"))
    active = [text for bit, text in ends if switches & bit]
    return f"the {' and '.join(active)} limit switch is active" if active else ""


def _tracking(config: GalilConfig, letters: str) -> Tracking:
    if config.tracking == "pvt":
        joints = config.joints.values()
        fastest = [AMPLE * joint.velocity / joint.scale for joint in joints]
        return PvtPieces(letters, fastest, round(1000 * config.pvt_period), config.pvt_lead)
    return PositionTracking(letters) if config.tracking == "pt" else StopAndGo(letters)


def _capabilities(config: GalilConfig, *, needs_homing: bool) -> Capabilities:
    joints = config.joints
    buffered = (config.pvt_lead + 1) * config.pvt_period
    is_buffered = config.tracking == "pvt"
    homing = [joint.homing.timeout for joint in joints.values() if joint.homing is not None]
    return promises(
        joints,
        rate=1.0 / config.record_period,
        units=[joint.scale for joint in joints.values()],
        lag=2.0 if config.tracking == "stop_go" else (buffered if is_buffered else 0.05) + 0.05,
        runs_on=buffered if is_buffered else braking_time(joints.values()),
        stops="comes to rest at the last position that it was sent; ST slows it down within its acceleration",
        needs_homing=needs_homing,
        transition_timeout=TRANSITION + max(homing, default=5.0),
    )
