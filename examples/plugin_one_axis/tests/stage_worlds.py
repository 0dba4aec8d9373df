"""What happens to a stage in a simulated world.

A process of its own imports this file, in patched Python: so there is no pytest in it.
"""

from __future__ import annotations

import math
import time
from typing import Final

from crtk_sim_one_axis import SIM
from crtk_sim_one_axis.stage import SILENCE, Stage

import crtk_drivers
from crtk_drivers.errors import CrtkError, StopUnconfirmed
from crtk_drivers.front import LocalDevice
from crtk_drivers.testing.world import Subject, World, user

TRAVEL: Final = 10.0
"""m: a stage that runs away does so for longer than a world lasts."""
STILL: Final = 1e-3
"""m/s of a carriage that stands."""
PATIENCE: Final = SILENCE + 0.3
"""s of the stage within which it stands: it stops by itself, and braking from full speed takes 0.25 s."""
ARRIVED: Final = 2e-3
"""m by which the carriage is off its goal, at most, when a move is reached."""

STAGE: Final = Subject(
    device="one_axis",
    config={"travel": TRAVEL},
    truth=lambda server: [server.device.position],
    error=1e-3,
    early=math.inf,  # it only sends: nobody knows how long a report was on its way
    period=0.01,
    lasts=PATIENCE,
    step=0.1,
    velocity=0.2,
)


def any_use(world: World) -> None:
    """Do anything that a user may do with a stage, while the judges of all devices look on."""
    user.use(world, STAGE)


class Carriage:
    """The simulator's own truth, looked at from outside of the world.

    Attributes:
        is_asked: whether the user wants it to move.
    """

    def __init__(self, world: World, driver: LocalDevice) -> None:
        (server,) = SIM.serving
        assert isinstance(server.device, Stage)
        self._stage = server.device
        self._driver = driver
        self.is_asked = False
        self._calm = self._stage.time  # when it stood, or was allowed to move, for the last time
        world.watch(self._moves_unasked, "it moves unasked")

    @property
    def position(self) -> float:
        """In m."""
        return self._stage.position

    def _moves_unasked(self) -> str | None:
        """Say that it moves, and that for longer than a stop takes it should not.

        The stage's own time counts: while the simulator stands still it does not pass.
        """
        state, now = self._driver.operating_state().state, self._stage.time
        velocity = self._stage.velocity
        if abs(velocity) <= STILL or (self.is_asked and state == "ENABLED"):
            self._calm = now
        if (unasked := now - self._calm) <= PATIENCE:
            return None
        return (
            f"{state}, and it moves with {velocity:.3f} m/s, {unasked:.2f} s after it should stop"
        )


def working_day(world: World) -> None:
    """Enable, move and stop at random, again after each error; in a wild world much goes wrong meanwhile."""
    driver = crtk_drivers.connect("one_axis", sim=True, travel=TRAVEL)
    carriage = Carriage(world, driver)
    if world.wild:
        world.troubles.storm(0.0, 4.0, most=6)
    for _ in range(6):
        task = world.random.choice((move, stream, disable))
        world.say(task.__name__)
        try:
            if not driver.is_enabled():
                driver.enable()
            carriage.is_asked = True
            task(world, driver, carriage)
        except CrtkError as error:
            world.say(f"{type(error).__name__}: {error}")
        carriage.is_asked = False
        time.sleep(2.0 * PATIENCE)
    try:
        driver.close()
        world.say("closed")
    except StopUnconfirmed as error:
        world.say(f"closed, and it says so: {error}")


def move(world: World, driver: LocalDevice, carriage: Carriage) -> None:
    """Go somewhere; a move that is reached is there."""
    goal = carriage.position + world.random.uniform(-0.1, 0.1)
    if driver.move_jp([goal]).wait(5.0) and abs(carriage.position - goal) > ARRIVED:
        world.find("not there", f"{goal:.4f} m is reached, and it is at {carriage.position:.4f} m")


def stream(world: World, driver: LocalDevice, carriage: Carriage) -> None:
    """Send velocities, and stop it, perhaps just when it has begun to move."""
    world.troubles.around(0.3)  # in a fair world too
    for _ in range(world.random.randrange(1, 20)):
        driver.servo_jv([0.2])
        time.sleep(0.02)
    driver.hold()


def disable(world: World, driver: LocalDevice, carriage: Carriage) -> None:
    """Take its power while it moves."""
    driver.servo_jv([-0.2])
    time.sleep(0.1 * world.random.random())
    driver.disable()
