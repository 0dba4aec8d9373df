"""Pedals in a world: somebody treads on one at random; what is released may not be told as pressed.

This file is imported by the host of a world, in patched Python, so it imports no pytest.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.samples import Joy
from crtk_drivers.testing.world.promises.instrument import History
from crtk_drivers.testing.world.promises.subject import PERIOD, Installed, Setting
from crtk_drivers.testing.world.promises.user import close, connects, storm
from crtk_drivers.testing.world.world import World
from crtk_sim_backends.control import ControlError

_COMES_BACK: Final = 8.0
"""s in which a pedal that is pressed is told so in a fair world, also one that was just plugged in."""
_SHOWN: Final = 0.1


@dataclass(frozen=True, kw_only=True)
class Pedal(Installed):
    """A pedal, and what is true of it in its simulator.

    Attributes:
        name: of its reading.
        press: kind and parameters of the simulator's fault that presses it.
        unplug: the same of the one that unplugs it.
        pressed: whether it is pressed, from the simulator's server object.
        late: s for which one that was released may still be told as pressed.
    """

    name: str
    press: tuple[str, dict[str, Any]]
    unplug: tuple[str, dict[str, Any]]
    pressed: Callable[[Any], bool]
    late: float


class _Tread(Setting):
    """A pedal in a world: who treads on it is looked at all the time."""

    def __init__(self, world: World, pedal: Pedal) -> None:
        super().__init__(world, pedal)
        self.pedal = pedal
        self.is_plugged = True
        self._pressed = History()
        self.look()

    @override
    def look(self) -> None:
        super().look()
        if self.sim.running:
            is_pressed = self.is_plugged and self.pedal.pressed(self._server)
            self._pressed.note(self.now, (float(is_pressed),))

    @property
    def told(self) -> bool:
        """Whether the driver tells that it is pressed."""
        if self.engine is None:
            return False
        value = self.engine.readings[self.pedal.name].tell()
        return isinstance(value, Joy) and bool(value.buttons[0])

    def was(self, *, pressed: bool, within: float) -> bool:
        """Return whether it was pressed, or released, at any time in the last s."""
        begin = self.now - within
        return (float(pressed),) in self._pressed.between(begin, self.now)

    def judged(self) -> str | None:
        """Return what is wrong with what is told."""
        self.look()
        late = self.pedal.late
        if self.told and not self.was(pressed=True, within=late):
            return f"it is told as pressed, and was not for {late:g} s"
        return None


def tread(world: World, pedal: Pedal, *, faults: int = 6) -> None:
    """Tread on a pedal, unplug it and plug it in, in one to three sessions of its driver.

    Args:
        world, pedal: where and what.
        faults: how many come meanwhile, at most.
    """
    scene = _Tread(world, pedal)
    world.watch(scene.judged, "a released pedal is told as pressed", PERIOD)
    draw = world.random

    def session() -> None:
        scene.closing = scene.closed = None
        if not connects(scene):
            return
        time.sleep(1.0 + 4.0 * draw.random())
        close(scene)
        scene.arm = None

    def drive() -> None:
        for _ in range(draw.choice((1, 1, 2, 3))):
            session()

    storm(world, 4.0, faults)
    driver = world.start("driver", drive)
    while driver.alive:
        _touch(scene)
        time.sleep(0.6 * draw.random())


def _touch(scene: _Tread) -> None:
    """Press it, release it, unplug it, or plug it in."""
    control, world = scene.sim.control, scene.world
    press, unplug = scene.pedal.press, scene.pedal.unplug
    what = world.random.choice(("press", "release", "unplug", "plug in"))
    world.say(what)
    kind, parameters = press if what in ("press", "release") else unplug
    if what in ("release", "plug in"):
        is_done = _try(scene, lambda: control.clear(kind))
    else:
        is_done = _try(scene, lambda: control.inject(kind, **parameters))
    if is_done and what in ("unplug", "plug in"):
        scene.is_plugged = what == "plug in"
    if is_done and what == "press" and scene.is_plugged and not world.wild:
        _await_press(scene)


def _await_press(scene: _Tread) -> None:
    """Report a pedal that is pressed and not told so; one that was plugged in has its time."""
    begun, arm = scene.now, scene.arm
    while arm is not None and scene.arm is arm and scene.closing is None:
        if scene.told:
            return
        if scene.now > begun + _COMES_BACK:
            scene.world.find("it does not come back", "it is pressed, and never told as pressed")
        time.sleep(_SHOWN)


def _try(scene: _Tread, call: Callable[[], object]) -> bool:
    """Ask the simulator for something; return whether it did."""
    try:
        call()
    except ControlError as error:
        scene.world.say(f"  {error}")
        return False
    return True


_CODE: Final = 30

_ALL: Final = (
    Pedal(
        device="inputs",
        config={"pedals": {"clutch": _CODE}},
        name="clutch",
        press=("press", {"code": _CODE}),
        unplug=("disconnect", {"port": "evdev"}),
        pressed=lambda server: _CODE in server.device._pressed,
        late=0.3,  # 0.25 s if the driver's I/O thread stands, and what a world takes
    ),
)
PEDALS: Final = {pedal.device: pedal for pedal in _ALL}
"""All of them, by the name of the device."""
