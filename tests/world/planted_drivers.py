"""Mistakes that are planted into one driver, or into what several drivers share; see `planted.py`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Final

from world.planted_table import (
    AFTER_CLOSE,
    AFTER_DEATH,
    CALM,
    DIE,
    FAILS,
    FAREWELL,
    LEFT,
    MOVES,
    NOT_ENABLED,
    OLD,
    STAMP,
    STILL,
    TOO_EARLY,
    UNASKED,
    USE,
    planted,
)

from crtk_driver_canopen.units import GroupUnits
from crtk_driver_galil.controller import GalilController
from crtk_driver_onrobot.device import Talk
from crtk_driver_onrobot.fingers import FingerHand
from crtk_driver_ur import samples as ur_samples
from crtk_driver_ur.native import link as ur_link
from crtk_driver_weiss_wsg.device import WsgHand
from crtk_driver_weiss_wsg.orders import Order as WsgOrder
from crtk_driver_weiss_wsg.tables import Command as WsgCommand
from crtk_drivers.engine import Engine
from crtk_drivers.kit.axes.counting import Counting
from crtk_drivers.kit.gripping.gripper_device import GripperDevice
from crtk_drivers.kit.modbus_link import ModbusLink
from crtk_drivers.kit.request_worker import RequestWorker
from crtk_drivers.samples import Stamp, vector

GEAR: Final = 100.0
"""Of the joints in `subjects.py`."""


# ---------------------------------------------------------------------------------------------------- ur


@planted("ur", DIE, AFTER_DEATH, seeds=30)
def ur_program_goes_on_without_setpoints() -> None:
    """The control program goes on with its motion when nothing comes from the driver any more."""
    plain = ur_link.program_text

    def program_text(*args: Any) -> str:
        text = plain(*args).replace('"stop")', '"ignore")')
        return text.replace("and age > second", "and age > 1e9")

    ur_link.program_text = program_text


@planted("ur", USE, STAMP, seeds=10)
def ur_joints_have_the_order_of_their_names() -> None:
    """Positions have the order in which ROS sorts the joints, where the elbow is the first one."""
    plain = ur_samples._measured_js

    def measured_js(reading: Any) -> Any:
        found = plain(reading)
        return dataclasses.replace(found, position=vector(found.position[[2, 1, 0, 3, 4, 5]]))

    ur_samples._MAKERS = {**ur_samples._MAKERS, "measured_js": measured_js}


@planted("ur", CALM, FAILS, LEFT, seeds=10)
def ur_worker_is_joined_without_a_deadline() -> None:
    """A connection that is closed waits for a worker that nobody has woken."""

    def stop(self: Any) -> None:
        self._stopped = True
        self._interrupt()

    RequestWorker.stop = stop
    RequestWorker.join = lambda self, deadline: self._thread.join()


# ----------------------------------------------------------------------------------------------- canopen


@planted("canopen", USE, STAMP, seeds=10)
def canopen_gear_is_applied_twice() -> None:
    """A position is divided by the gear, which is in its unit already."""
    plain = GroupUnits.positions
    GroupUnits.positions = lambda self, counts: vector(plain(self, counts) / GEAR)


# ------------------------------------------------------------------------------------------------ copley


@planted("copley", USE, STAMP, seeds=10)
def copley_counts_are_quadrupled_twice() -> None:
    """The counts of a turn are taken for lines of an encoder, of which each counts four times."""
    plain = Counting.__init__

    def init(self: Any, joints: Any, units: Any, efforts: Any) -> None:
        plain(self, joints, [unit / 4.0 for unit in units], efforts)

    Counting.__init__ = init


# ------------------------------------------------------------------------------------------------- galil


@planted("galil", FAREWELL, LEFT, seeds=10)
def galil_socket_of_records_is_left_open() -> None:
    """`close` ends the commands, and leaves the socket open by which the records come."""
    GalilController.close = lambda self, *, power_off: self._commander.close()


# ----------------------------------------------------------------------------------------------- onrobot


@planted("onrobot", STILL, OLD, seeds=10)
def onrobot_status_is_kept_for_later() -> None:
    """While no answer comes, the last one is given again with a new stamp, however long that lasts."""
    plain = Talk.exchange

    def exchange(self: Any, command: Any, deadline: float) -> Any:
        found = plain(self, command, deadline)
        if found is not None:
            self._last = found
            return found
        last = self.__dict__.get("_last")
        return last and dataclasses.replace(last, stamp=Stamp.now(), delivered=None)

    Talk.exchange, ModbusLink._lost_at = exchange, math.inf


@planted("onrobot", CALM, FAILS, TOO_EARLY, seeds=10)
def onrobot_goal_is_in_millimetres() -> None:
    """A goal in m is taken for one in mm, and is always within the range."""
    plain = FingerHand.order

    def order(self: Any, mode: Any, value: float, ratio: float) -> Any:
        return plain(self, mode, 1e-3 * value, ratio)

    FingerHand.order = order


# --------------------------------------------------------------------------------------------- weiss-wsg


@planted("weiss-wsg", USE, UNASKED, seeds=20)
def wsg_looks_for_its_reference_at_connection() -> None:
    """A gripper without a reference looks for it when it is connected, and not when it is enabled."""
    plain = WsgHand.open

    def open_and_home(self: Any, deadline: float, given_up: Callable[[], bool]) -> None:
        plain(self, deadline, given_up)
        self._link.put(WsgOrder(WsgCommand.HOME, (0.0,)))

    WsgHand.open = open_and_home


@planted("weiss-wsg", CALM, FAILS, TOO_EARLY, seeds=10)
def wsg_width_is_turned_into_millimetres_twice() -> None:
    """A width that the protocol tells in mm is turned into mm before it is encoded as well."""
    plain = WsgHand._to
    WsgHand._to = lambda self, width, ratio=1.0: plain(self, 1e3 * width, ratio)


# ------------------------------------------------------------------------------------------------ schunk


@planted("schunk", FAREWELL, AFTER_CLOSE, seeds=20)
def close_leaves_the_stop_to_the_hardware() -> None:
    """`close` ends the connection, for who hears nothing stops: this gripper goes on to its goal."""

    def shut_down(self: Any, alive: Callable[[float], object] = lambda until: None) -> None:
        self._connected = False
        alive(math.inf)
        self.device.close()

    Engine.stop_for_good, Engine.shut_down = lambda self: None, shut_down


@planted("schunk", USE, MOVES, NOT_ENABLED, seeds=20)
def enabling_sends_the_last_goal() -> None:
    """A gripper that is enabled goes on to where it was sent last."""
    plain_move, plain_enable = GripperDevice.move, GripperDevice.enable

    def move(self: Any, goal: Any) -> None:
        plain_move(self, goal)
        self._last_goal = self._asked

    def enable(self: Any) -> Any:
        yield from plain_enable(self)
        if order := self.__dict__.get("_last_goal"):
            self._hand.go(order, at_once=False)

    GripperDevice.move, GripperDevice.enable = move, enable
