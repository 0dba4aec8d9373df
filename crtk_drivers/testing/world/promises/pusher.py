"""A haptic device under test, and what a user does with it: streams forces, stops, closes, dies.

A force is to a haptic device what a motion is to an arm, so the judges of arms look here: no force that
nobody asks for, none after a stop, after `close`, or after the driver's death.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.commands import find
from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_drivers.state import OperatingState, StateCommand
from crtk_drivers.testing.world.promises import judges
from crtk_drivers.testing.world.promises.acting import MOMENT, attempt
from crtk_drivers.testing.world.promises.judges import Judge
from crtk_drivers.testing.world.promises.subject import Installed, Scene, Subject
from crtk_drivers.testing.world.promises.user import COMES_BACK, close, connects, kill, storm
from crtk_drivers.testing.world.world import World

FELT: Final = 0.02
"""N below which a force is none."""
_CYCLE: Final = 0.008
_PATIENCE: Final = 10.0
_AFTER_DEATH: Final = 3.0
_ABOVE: Final = 1.001
_DIES: Final = 0.3
"""Share of the worlds in which the driver is killed."""


@dataclass(frozen=True, kw_only=True)
class Haptic(Installed):
    """A device that pushes a hand, and what is true of it in its simulator.

    Attributes:
        force: returns what its motors exert, in N, from the simulator's server object.
        most: N that the driver is configured to exert at most.
    """

    force: Callable[[Any], Sequence[float]]
    most: float


class Touch(Scene):
    """A haptic device in a world: its force is looked at all the time, and counts as its motion.

    Args:
        world: in which it is.
        haptic: that is tested.
    """

    def __init__(self, world: World, haptic: Haptic) -> None:
        self.haptic = haptic
        subject = Subject(
            device=haptic.device,
            config=haptic.config,
            sim_options=haptic.sim_options,
            truth=haptic.force,
            error=FELT,
            step=0.0,
            velocity=0.0,
        )
        super().__init__(world, subject)

    @property
    @override
    def speed(self) -> float:
        """Of the motors: the force in N."""
        return math.hypot(*self.joints)

    @property
    @override
    def is_moving(self) -> bool:
        """Whether there is a force."""
        return self.speed > FELT

    @override
    def stood_within(self, seconds: float) -> bool:
        """Return whether there was no force at any time in the last s."""
        forces = [force for at, force in self._looks if at >= self.now - seconds] or [self.joints]
        return any(math.hypot(*force) <= FELT for force in forces)


class Strength(Judge):
    """While the driver is there."""

    kind = "it pushes too hard"
    promise = "No force is greater than the configured one."

    @override
    def look(self, scene: Scene) -> str | None:
        assert isinstance(scene, Touch)
        if scene.speed <= _ABOVE * scene.haptic.most:
            return None
        return f"it pushes with {scene.speed:.3g} N, and {scene.haptic.most:g} N are allowed"


JUDGES: Final = (
    judges.Unasked,
    judges.Rests,
    judges.Asked,
    judges.AfterDeath,
    judges.AfterClose,
    judges.StopBelieved,
    judges.Fresh,
    judges.Stuck,
    Strength,
)
"""All that look at a haptic device."""


def push(world: World, haptic: Haptic, *, operations: int = 12, faults: int = 6) -> None:
    """Stream forces for some seconds, and close the driver, or let it die.

    Args:
        world, haptic: where and what.
        operations: how many things the user does.
        faults: how many come meanwhile, at most.
    """
    scene = Touch(world, haptic)
    judges.judge(scene, JUDGES)
    dies = world.random.random() < _DIES

    def drive() -> None:
        storm(world, 0.3 * operations, faults)
        if not connects(scene, COMES_BACK):
            return
        if dies:
            moment = 0.2 + 0.2 * operations * world.random.random()
            world.kernel.after(moment, partial(kill, scene))
        _Pusher(scene).work(1000 if dies else operations)
        close(scene)

    world.join(world.start("driver", drive))
    if scene.died is not None:
        time.sleep(_AFTER_DEATH)


class _Pusher:
    """A user who streams forces, and chooses by the world's generator.

    Args:
        scene: with the driver connected.
    """

    def __init__(self, scene: Touch) -> None:
        assert scene.arm is not None
        self._scene = scene
        self._arm: LocalDevice = scene.arm
        self._random = scene.world.random
        self._actions: dict[str, Callable[[], None]] = {
            "stream": self._stream,
            "stream on": self._stream,
            "stream and hold": lambda: self._stop(self._arm.hold),
            "stream and pause": lambda: self._stop(lambda: self._state(StateCommand.PAUSE)),
            "stream and disable": lambda: self._stop(lambda: self._state(StateCommand.DISABLE)),
            "rest": lambda: time.sleep(self._random.random()),
            "nonsense": self._nonsense,
        }

    def work(self, operations: int) -> None:
        """Do so many things."""
        names = tuple(self._actions)
        for _ in range(operations):
            name = self._random.choice(names)
            self._attempt("enable", self._until_enabled)
            self._attempt(name, self._actions[name])

    def _attempt(self, name: str, action: Callable[[], None]) -> None:
        world = self._scene.world
        if name != "enable":
            world.say(f"{name}, {self._arm.operating_state().state}")
        attempt(world, name, action, lambda _: False)

    def _until_enabled(self) -> None:
        state = self._arm.operating_state().state
        if state == OperatingState.PAUSED:
            self._state(StateCommand.RESUME)
        elif state != OperatingState.ENABLED:
            self._arm.wait_for_status(lambda status: status.state != OperatingState.FAULT, 0.5)
            self._state(StateCommand.ENABLE)

    def _state(self, command: StateCommand) -> None:
        self._arm.state_command(command, _PATIENCE)

    def _push(self, force: Sequence[float]) -> None:
        silence = self._arm.engine.options.silence(find("servo_cf").level)
        with self._scene.sending(silence=silence):
            self._arm.servo_cf([*force, 0.0, 0.0, 0.0])

    def _force(self, share: float = 1.0) -> list[float]:
        most = share * self._scene.haptic.most / math.sqrt(3.0)
        return [most * (2.0 * self._random.random() - 1.0) for _ in range(3)]

    def _stream(self) -> None:
        force = self._force()
        for _ in range(self._random.randrange(5, 50)):
            self._push(force)
            time.sleep(_CYCLE)

    def _stop(self, stop: Callable[[], None]) -> None:
        """Stop in a stream, with a fault around it in a wild world."""
        world = self._scene.world
        self._stream()
        if world.wild:
            world.troubles.around(MOMENT)
        with self._scene.stopping():
            stop()
        time.sleep(0.3 * self._random.random())

    def _nonsense(self) -> None:
        """Send what must be refused, or bounded."""
        chosen = self._random.choice((self._force(100.0), [math.nan, 0.0, 0.0]))
        try:
            self._push(chosen)
        except CommandRefused:
            return
        if math.isnan(chosen[0]):
            self._scene.world.find("nonsense is accepted", f"servo_cf {chosen}")
