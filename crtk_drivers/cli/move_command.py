"""``crtk-driver move``: take a running device to joint positions or a pose, and hold it at Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

from crtk_drivers.cli.reaching import Interrupted, held_when_interrupted, need
from crtk_drivers.cli.state_view import NEXT, joint_units, print_position
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.cli.typed_goals import Goal, joint_goal, pose_goal
from crtk_drivers.client import RemoteDevice
from crtk_drivers.client.move_handle import START_TIMEOUT
from crtk_drivers.errors import (
    CommandRefused,
    ConfigError,
    CrtkError,
    DataTimeout,
    MotionAborted,
    Reason,
)
from crtk_drivers.motion.move import Move
from crtk_drivers.state import OperatingState

LOOK_PERIOD = 0.1
POLL = 0.01
_RATIOS = "trajectory_j"


def move(
    device: RemoteDevice,
    values: Sequence[str],
    *,
    pose: bool,
    relative: bool,
    degrees: bool,
    speed: float | None = None,
) -> int:
    """Move, show the progress on a terminal, print where it ended, and return 0.

    Args:
        device: to move.
        values: numbers, or ``joint=number``.
        pose: they are x y z, and a quaternion x y z w if the tool shall turn.
        relative: they are added to the setpoint.
        degrees: joint values are degrees.
        speed: share of the limits of velocity and acceleration for this move; None: as the device has it.

    Raises:
        CommandRefused: the device is not enabled, or does not accept this.
        ConfigError: the values are no goal for this device.
        MotionAborted, ConnectionLost: it ended elsewhere.
        typer.Exit: after an interrupt; the device holds.
    """
    if speed is not None and not 0.0 < speed <= 1.0:
        raise ConfigError(
            f"{speed:g} is no share of its speed",
            where=f"{device.namespace} --speed",
            remedy="Give a number above 0, up to 1: 0.1 is a tenth.",
        )
    need(device, "move_cp" if pose else "move_jp")
    _require_enabled(device)
    goal = (pose_goal if pose else joint_goal)(device, values, relative, degrees)
    try:
        _go(device, goal, speed)
    except CommandRefused as refusal:
        if refusal.reason is not Reason.OUT_OF_RANGE or pose or degrees:
            raise
        units = joint_units(device)
        degrees_too = "; --degrees takes degrees" if "rad" in units else ""
        raise CommandRefused(
            refusal.command,
            refusal.reason,
            refusal.detail,
            where=refusal.where,
            remedy=f"{refusal.remedy} Values are in {' or '.join(units)}{degrees_too}.",
        ) from refusal
    print_position(device)
    return 0


@contextmanager
def _at_speed(
    device: RemoteDevice, speed: float | None, heed: Callable[[], None]
) -> Iterator[Callable[[], bool]]:
    """Set the share of the device's limits for moves within the block, and put the old shares back after it.

    The share and the goal go over two topics, and the goal may come first. So the block begins once the
    device has reported the share. Another client may set the share, too: it is put back only if it is ours.

    Signals must raise `Interrupted` within, as in `held_when_interrupted`.

    Args:
        device: that moves.
        speed: the share; None: leave it as it is.
        heed: raises `Interrupted` if a signal came and its exception was lost.

    Yields:
        A function that returns whether the device still has our share.

    Raises:
        ConfigError: the device knows no such share.
        DataTimeout: it does not report that it has taken the share.
    """
    if speed is None:
        yield lambda: True
        return
    for each in ("set_ratio", "set_ratio_v", "set_ratio_a", "ratio_v", "ratio_a"):
        need(device, f"{_RATIOS}/{each}")
    ratios = device.trajectory_j
    before, ours = (ratios.ratio_v(), ratios.ratio_a()), (speed, speed)

    def is_ours() -> bool:
        return (ratios.ratio_v(), ratios.ratio_a()) == ours

    def restore() -> None:
        ratios.set_ratio(before[0])
        if before[1] != before[0]:
            ratios.set_ratio_a(before[1])

    @contextmanager
    def reported() -> Iterator[None]:
        """Print an error: the interrupt goes on, and what follows it."""
        try:
            yield
        except CrtkError as error:
            ERR.print(
                f"[yellow]warning:[/] {plain(device.namespace)}: the share of its speed was not put back "
                f"to {before[0]:g}: {plain(error.statement)}",
                soft_wrap=True,
            )

    def put_back() -> None:
        is_due = True
        try:
            is_due = is_ours()  # else another client has set it since, and it is that one's
            if is_due:
                restore()
        except Interrupted:  # halfway, perhaps; no signal comes after this one
            if is_due:
                with reported():
                    restore()
            raise

    try:
        ratios.set_ratio(speed)
        deadline = time.monotonic() + START_TIMEOUT
        while not is_ours():
            heed()
            if time.monotonic() > deadline:
                raise DataTimeout(
                    f"did not report within {START_TIMEOUT:g} s that moves take {speed:g} of its speed",
                    where=device.namespace,
                    remedy="Nothing was moved. Does another client set it, too?",
                )
            time.sleep(POLL)
        yield is_ours
    except Interrupted:
        device.hold()  # before anything else
        with reported():
            put_back()
        raise
    except BaseException:
        with suppress(CrtkError):  # what went wrong first is told
            put_back()
        raise
    put_back()


def _go(device: RemoteDevice, goal: Goal, speed: float | None) -> None:
    # Within: of a terminal that is gone the end of what is shown fails, and the hold comes before that.
    with (
        ERR.status(f"{goal.command} ...") as shown,
        held_when_interrupted(device) as heed,
        _at_speed(device, speed, heed) as is_at_speed,
    ):
        began = time.monotonic()
        heed()  # a signal may have been lost in rclpy while the share was set
        handle: Move = getattr(device, goal.command)(goal.value)
        is_seen = False
        while not handle.wait(LOOK_PERIOD if is_seen else POLL):
            heed()
            if not is_seen and handle.wait(0.0, is_busy=True):
                is_seen = True
                if not is_at_speed():
                    device.hold()
                    raise MotionAborted(
                        "another client has changed the share of the speed meanwhile",
                        where=device.namespace,
                        remedy="It was told to hold. Move it by one client at a time.",
                    )
            passed = time.monotonic() - began
            if passed > START_TIMEOUT and not handle.wait(0.0, is_busy=True):
                device.hold()  # else what comes late after all moves it, and nobody looks
                raise MotionAborted(
                    f"{goal.command} was sent {passed:.0f} s ago, and the device was never busy",
                    where=device.namespace,
                    remedy="It was told to hold. Is it ENABLED, and does it accept this command?",
                )
            shown.update(f"{goal.command}  {passed:.1f} s  {plain(goal.to_go())}")
    OUT.print(f"[green]reached[/] in {time.monotonic() - began:.1f} s")


def _require_enabled(device: RemoteDevice) -> None:
    status = device.operating_state()
    if status.state is not OperatingState.ENABLED:
        raise CommandRefused(
            "move",
            Reason.NOT_ENABLED,
            f"the device is {status.state}",
            where=device.namespace,
            remedy=f"Why: crtk-driver state {device.namespace}. Then: "
            f"{NEXT[status.state].format(device.namespace)}",
        )
