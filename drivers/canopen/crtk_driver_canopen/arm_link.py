"""The drives of an arm on their bus: found, set up, exchanged with once a cycle. Belongs to one I/O thread.

A cycle begins with the SYNC, at which every drive takes over what it was sent and samples what it tells; then
the drives' PDOs are collected. What they are sent for the next SYNC goes out as soon as it is known.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final

from crtk_driver_canopen.axis import Axis, Feedback
from crtk_driver_canopen.bus import BusAddress, CanLink
from crtk_driver_canopen.candump import CandumpLog
from crtk_driver_canopen.commissioning import prepare_all, read_cob_ids
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.cycle import Cycle, CycleCounters, KernelSync, SentSync
from crtk_driver_canopen.foreign import SYNC_TEXT, ForeignMaster
from crtk_driver_canopen.heartbeat import NmtCommand, NmtState
from crtk_driver_canopen.jobs import NodeJobs
from crtk_driver_canopen.layout import CobIds, Layout, plan
from crtk_driver_canopen.lowered_limits import LoweredLimits
from crtk_driver_canopen.master import BootUp, Master
from crtk_driver_canopen.modes import WAYS, OpMode, Way
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.pdo import Pdo
from crtk_driver_canopen.read_once import Readings
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.signals import Outputs, Signals
from crtk_driver_canopen.statemachine import Control, State
from crtk_driver_canopen.stopping import RPDO_TIMEOUT, LastResort, quick_stop_frame, secure
from crtk_driver_canopen.targets import UNHEARD, PositionTarget
from crtk_driver_canopen.units import GroupUnits
from crtk_driver_canopen.whereabouts import Whereabouts
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, CrtkError
from crtk_drivers.samples import Stamp

logger = logging.getLogger(__name__)

NMT_TIME: Final = 1.0
"""Seconds for a node to follow an NMT command; it tells by its next heartbeat."""

MISSED_US: Final = frozenset({0x7500, 0x8100, 0x8700})
"""Classes of error codes (603F) of a drive that missed heartbeats, PDOs or SYNC."""

LISTEN: Final = 2.5
"""Times the periods of our heartbeat and SYNC in which another master would be heard."""

LEAST_LISTENING: Final = 0.1
"""Seconds for that at least."""

ASIDE: Final = 0.05
"""Seconds for the I/O thread to end what it is sending, before another one tells the drives to stop."""

PROBED: Final = 0.2
"""Seconds from one question to the next to a node that owes answers to SYNCs: are they lost, or held back?"""

COLLECT: Final = 0.6
"""Part of a period in which the drives' PDOs are waited for: the rest is for what they are sent."""

JOBS_TIME: Final = 0.5
"""Seconds at the end for jobs that go on: what they write into drives counts."""

JOB_SLICE: Final = 0.0005
"""Seconds for which a request of a job waits, while that time lasts: its thread wakes nobody."""


class ArmLink:
    """The bus of one arm, with its drives.

    Args:
        config: of the arm.
        layout: PDOs of its drives.
    """

    def __init__(self, config: CanopenConfig, layout: Layout) -> None:
        self._config = config
        self.layout = layout
        """PDOs of its drives."""
        bus = config.bus
        address = BusAddress(bus.interface, bus.channel, bus.bitrate, dict(bus.options))
        self._log = CandumpLog(Path(config.candump), bus.channel) if config.candump else None
        self.link = CanLink(address, None if self._log is None else self._log.put)
        self.outputs = Outputs(len(config.joints))
        self.axes: list[Axis] = []
        self.stamp = Stamp(0, 0.0)
        """Of the newest SYNC."""
        self.sampled = Stamp(0, 0.0)
        """Of the newest SYNC that all drives have answered: what they told last is of that time."""
        self.restarted: set[int] = set()
        """Nodes that have started anew since they were set up."""
        self._master: Master | None = None
        self._cycle: Cycle | None = None
        self._foreign: ForeignMaster | None = None
        self._foreign_syncs = 0
        self._sent = True
        self.jobs = NodeJobs()
        """What goes on with nodes beside the cycle."""
        self.last_resort = LastResort(self)
        self.found: dict[str, str] = {}
        """In what powered or moving state the joints were found, in words, by name."""
        self._stops_quickly = threading.Event()
        self.held: frozenset[str] = frozenset()
        """Joints that had power when they were found, and have been left holding."""
        self.lowered = LoweredLimits()
        """Limits of speed that the drives held before this program lowered them."""
        self._tardy: list[int] = []
        self._probed: dict[int, float] = {}
        self.targets: list[PositionTarget] = []
        """The positions that the drives are really sent."""
        self.whereabouts: list[Whereabouts] = []
        """Where the drives are, as far as they can be believed."""
        self._unbegun = 0
        self._signals = Signals(layout, [])

    @property
    def where(self) -> str:
        """The bus, for messages."""
        return self.link.where

    @property
    def counters(self) -> CycleCounters:
        """What happened in the cycles so far."""
        return CycleCounters() if self._cycle is None else self._cycle.counters

    @property
    def master(self) -> Master:
        """Everything on the bus but PDOs."""
        assert self._master is not None
        return self._master

    @property
    def cycle(self) -> Cycle:
        """The PDOs."""
        assert self._cycle is not None
        return self._cycle

    @property
    def foreign(self) -> ForeignMaster:
        """What is heard of another master."""
        assert self._foreign is not None
        return self._foreign

    # ----------------------------------------------------------------------------------- life cycle

    def open(self, deadline: float) -> None:
        """Open the bus, set up every drive, and exchange until each has told where it is.

        Drives with power lose it, once they stand; but those that hold, where drives are left holding.

        Raises:
            ConnectionFailed: the bus cannot be used; a drive is missing, another one, or cannot be set up.
        """
        self.link.give_up_at = deadline
        try:
            if self._log is not None:
                self._log.open()
            self._open(deadline)
        except ConnectionFailed:
            self.close()
            raise
        except CrtkError as error:
            self.close()
            raise ConnectionFailed(
                error.message, where=error.where or self.where, remedy=error.remedy
            ) from error
        except BaseException:
            self.close()
            raise
        finally:
            self.link.give_up_at = math.inf

    def _open(self, deadline: float) -> None:
        config = self._config
        self.jobs.join(deadline)
        self.last_resort.reset(deadline)
        self.link.open()
        timeouts = dict.fromkeys(config.nodes, config.heartbeat.drives_timeout)
        self._master = Master(
            self.link,
            timeouts,
            node=config.master_node,
            period=config.heartbeat.ours,
            sdo_timeout=config.sdo_timeout,
        )
        self._foreign = ForeignMaster(self._master, config.master_node, config.nodes)
        self.layout = plan(config)
        if not self.layout.asked:
            self._foreign.watch(self.layout.rpdos.pdos)
        self._foreign_syncs = 0
        self._stops_quickly.clear()
        self._listen(deadline)
        self._master.command(NmtCommand.PRE_OPERATIONAL)
        readings = Readings(self._master)
        told = read_cob_ids(readings, self.layout) if self.layout.asked else None
        if told is not None:
            self.layout = plan(config, told)
            self._foreign.watch(self.layout.rpdos.pdos)
        self.found, self.held = secure(self, config, readings)
        try:
            self._set_up(told, readings, deadline)
        except CrtkError:
            self.link.give_up_at = math.inf
            with suppress(ConnectionLost):  # why it fails is known
                self.give_back_limits()
            raise

    def _set_up(self, told: CobIds | None, readings: Readings, deadline: float) -> None:
        """Make the drives ready, start them, and exchange until each has told where it is.

        Args:
            told: COB-IDs that the drives have, where they count.
            readings: what has been read of them just before.
            deadline: monotonic seconds.
        """
        config = self._config
        facts, self.layout = prepare_all(
            self.master, config, self.layout, told, self.lowered, readings, deadline
        )
        self.axes = [Axis(name, joint, facts[name]) for name, joint in config.joints.items()]
        for axis in self.axes:
            if axis.name in self.held:
                axis.use(axis.mode_for(config.ways[0]))
                axis.drive.request(State.ENABLED)
        self.units = GroupUnits({name: facts[name].units for name in config.joints})
        overflow, period = config.sync_counter, config.period
        kernel = config.kernel_sync
        sync = KernelSync(self.link, period, overflow) if kernel else SentSync(self.link, overflow)
        self._cycle = Cycle(self.master, self.layout.tpdos, self.layout.rpdos, sync)
        self._tardy = [0] * len(self.layout.tpdos)
        self._signals = Signals(self.layout, self.axes)
        self.targets, self.whereabouts = [], []
        for axis in self.axes:
            unit, joint = abs(axis.facts.units.position), axis.config
            fastest, sharpest = joint.velocity / unit, joint.acceleration / unit
            self.targets.append(PositionTarget(fastest * period, sharpest * period * period))
            self.whereabouts.append(Whereabouts(axis.facts.position, fastest, period))
        for index, axis in enumerate(self.axes):
            self.outputs.position[index] = facts[axis.name].position
        self._start(config.nodes)
        self._settle(deadline)

    def _listen(self, deadline: float) -> None:
        """See that nobody else commands these drives: a second master would stop them in motion.

        Raises:
            ConnectionFailed: somebody does.
        """
        periods = max(self._config.heartbeat.ours, self._config.period)
        listening = max(LISTEN * periods, LEAST_LISTENING)
        found = self.foreign.listen(min(deadline, time.monotonic() + listening))
        if found:
            raise ConnectionFailed(
                found,
                where=self.where,
                remedy="Stop the other program. One for other drives must not send SYNC, nor have the id "
                "of this computer (`master_node`).",
            )

    def _start(self, nodes: Iterable[int]) -> None:
        if self._config.heartbeat.drives:
            self.master.command_and_wait(NmtCommand.START, nodes, time.monotonic() + NMT_TIME)
        else:
            for node in nodes:
                self.master.watch.nodes[node].state = None
                self.master.command(NmtCommand.START, node)
        self.master.watch.restart(time.monotonic())
        self.master.take_events()
        self.restarted.clear()
        self.foreign.forget_commands(nodes)

    def _settle(self, deadline: float) -> None:
        """Exchange until every drive has told where it is, and no longer complains of our silence."""
        self.cycle.start()
        if not self._run_until(lambda: self.cycle.complete, deadline):
            silent = sorted({pdo.node for pdo in self.cycle.stale(0)})
            raise ConnectionFailed(
                f"no PDOs come from node {', '.join(map(str, silent))}",
                where=self.where,
                remedy="Is there another SYNC producer, or another master, on the bus?",
            )
        reset = [axis for axis in self.axes if self._missed_us(axis)]
        for axis in reset:
            axis.drive.reset_fault()
        self._run_until(
            lambda: all(axis.drive.reached or axis.drive.failure for axis in reset), deadline
        )
        others = [axis for axis in self.axes if axis.name not in self.held]
        if not self._run_until(lambda: not any(axis.is_enabled for axis in others), deadline):
            powered = ", ".join(axis.place for axis in others if axis.is_enabled)
            raise ConnectionFailed(
                f"does not let go of the power that it has: {powered}",
                where=self.where,
                remedy="Does somebody else control it (remote, bit 9 of the statusword)?",
            )

    def _missed_us(self, axis: Axis) -> bool:
        """Whether a drive is in fault only because nobody talked to it: before we came there was nobody."""
        if axis.drive.state is not State.FAULT:
            return False
        sdo = Sdo(self.master.sdo(axis.config.node), axis.config.axis)
        code = sdo.find(OBJECTS["error_code"]) or 0
        return code & 0xFF00 in MISSED_US

    def _run_until(self, done: Callable[[], bool], deadline: float) -> bool:
        """Exchange in the pace of the cycle; return whether it came to be so before the deadline."""
        period = self._config.period
        while not done():
            began = time.monotonic()
            self.link.check_aborted()
            if began > deadline:
                return False
            self.exchange(began + period)
            self.follow()
            self.send()
            time.sleep(max(0.0, began + period - time.monotonic()))
        return True

    @property
    def left(self) -> set[int]:
        """Nodes that tell that they are not operational, although they were started."""
        lives = self.master.watch.nodes
        return {
            node
            for node in self._config.nodes
            if lives[node].state not in (None, NmtState.OPERATIONAL)
        }

    @property
    def deaf(self) -> set[int]:
        """Nodes that tell that our PDOs do not reach them."""
        emergencies = self.master.emergencies
        return {
            node
            for node in self._config.nodes
            if node in emergencies and emergencies[node].code == RPDO_TIMEOUT
        }

    def forget_deafness(self) -> None:
        """Nodes that have not heard our PDOs have another chance."""
        for node in self.deaf:
            self.master.emergencies.pop(node)

    def stop_quickly(self) -> None:
        """Have all drives stop quickly, from any thread, without the one that owns the bus: it may be stuck.

        The drives are told by SDO, which needs no SYNC; no answer is waited for. They stay so until `enable`.
        """
        self._stops_quickly.set()
        frames = [quick_stop_frame(axis.config.node, axis.config.axis) for axis in self.axes]
        if frames and not self.link.send_aside(frames, ASIDE):
            logger.error(
                "%s: the drives could not be told to stop beside the I/O thread", self.where
            )

    def forget_quick_stop(self) -> None:
        """The drives may be enabled again."""
        self._stops_quickly.clear()

    def rpdos(self, node: int) -> list[Pdo]:
        """Return what a node is sent."""
        return [pdo for pdo in self.layout.rpdos.pdos if pdo.node == node]

    @property
    def is_live(self) -> bool:
        """Whether the drives can be exchanged with, from this thread."""
        return self._cycle is not None and self.link.is_open and self.link.owned

    def tardy(self, cycles: int) -> set[int]:
        """Nodes of which a PDO has come after its cycle, or not at all, more than `cycles` times in a row."""
        pdos = zip(self.layout.tpdos.pdos, self._tardy, strict=True)
        return {pdo.node for pdo, count in pdos if count > cycles and pdo.transmission == 1}

    def late(self, cycles: int) -> set[int]:
        """Nodes whose PDOs have not come for more than `cycles` of their turns."""
        return {pdo.node for pdo in self.cycle.stale(cycles) if cycles or pdo.transmission == 1}

    def give_back_limits(self) -> None:
        """Give drives without power the limits of speed that they held before this program lowered them.

        Raises:
            ConnectionLost: the bus cannot be used.
        """
        self.master.poll(time.monotonic() + JOBS_TIME, lambda: not self.jobs.running)
        if self.jobs.running:
            logger.warning("%s: drives that are being set up keep lowered limits", self.where)
            return
        lost = set(self.master.watch.lost(time.monotonic()))
        self.lowered.give_back(self.master, set(self._config.nodes) - lost)

    def close(self) -> None:
        """Leave the drives to themselves, and close the bus. May be called twice."""
        cycle, self._cycle = self._cycle, None
        if cycle is not None:
            cycle.stop()
        if self._master is not None:
            self._master.close()
        self.link.close()
        self._master = self._foreign = None
        if self._log is not None:
            self._log.close()

    # ------------------------------------------------------------------------------------ exchange

    def exchange(self, deadline: float) -> bool:
        """Begin a cycle and receive; return whether every drive told, and can be believed.

        Args:
            deadline: monotonic seconds.

        Raises:
            BusLost: the bus cannot be used.
        """
        if not self._sent:
            self.send()
        self._sent = False
        period = self._config.period
        if self._config.kernel_sync and time.monotonic() - self.stamp.monotonic > 2.0 * period:
            self.link.poll(0.0)  # cycles that have passed are not caught up with
        begun = self.cycle.begin(deadline)
        self._unbegun = 0 if begun else self._unbegun + 1
        if not begun:
            return False
        now = time.monotonic()
        self.stamp = Stamp(time.time_ns(), now)
        self._probe(now)
        collected = now + COLLECT * period
        if self.jobs.running:
            complete = self.cycle.collect(collected, JOB_SLICE)
            self.cycle.serve(collected, JOB_SLICE, lambda: self.jobs.running)
        else:
            complete = self.cycle.collect(collected)
        self._tardy = [
            count + 1 if age else 0 for count, age in zip(self._tardy, self.cycle.ages, strict=True)
        ]
        self.cycle.answers.doubt(self.restarted | self.left | self.late(self._config.missed_cycles))
        answered = self.cycle.answers.time
        self.sampled = Stamp(self.stamp.wall_ns - round(1e9 * (now - answered)), answered)
        if self.counters.foreign_syncs != self._foreign_syncs:
            self._foreign_syncs = self.counters.foreign_syncs
            self.foreign.note(SYNC_TEXT, now)
        for event in self.master.take_events():
            logger.warning("%s: %s", self.where, event)
            if event.node not in self._config.nodes:
                continue
            if isinstance(event, BootUp):
                self._note_boot_up(event.node)
            elif event.home_lost:
                self._note_home_lost(event.node)
        self._locate(now)
        return complete and not any(each.strange for each in self.whereabouts)

    def _probe(self, now: float) -> None:
        """Ask the nodes that owe answers to SYNCs something else, whose answer comes behind them."""
        answers = self.cycle.answers
        for node in answers.owing:
            if now >= self._probed.get(node, 0.0) + PROBED:
                answered = partial(answers.settle, node, answers.number)
                if self.master.sdo(node).probe(answered):
                    self._probed[node] = now

    def _locate(self, now: float) -> None:
        """Take where the drives say that they are, of those that have told."""
        told, ages = self._signals.picked("position_actual", self.cycle.values), self.cycle.ages
        for axis, position, slot, where in zip(
            self.axes, told, self._signals.position_slots, self.whereabouts, strict=True
        ):
            if not ages[slot]:
                homes = axis.mode is OpMode.HM or axis.homing is not None
                may_be_set = homes or axis.config.node in self.restarted
                where.take(position, now, may_be_set=may_be_set)

    def _note_boot_up(self, node: int) -> None:
        """What was known of a node is not true any more."""
        self.restarted.add(node)
        self.master.emergencies.pop(node, None)
        self._note_home_lost(node)

    def _note_home_lost(self, node: int) -> None:
        """A drive does not know any more where its joints are."""
        for axis in self.axes:
            if axis.config.node == node:
                axis.note_home_lost()

    def follow(self) -> None:
        """Step the axes by what they told, and make what they are sent harmless where they follow nothing."""
        now, outputs = time.monotonic(), self.outputs
        values = self.cycle.values
        words = self._signals.picked("statusword", values)
        positions = self.positions
        modes = self._signals.shown("mode_of_operation_display", values)
        for index, axis in enumerate(self.axes):
            feedback = Feedback(words[index], positions[index], modes[index])
            outputs.controlword[index] = axis.step(feedback, now)
            if self._stops_quickly.is_set() and axis.drive.goal is State.ENABLED:
                axis.drive.request(State.QUICK_STOP)
            outputs.mode[index] = int(axis.mode)
            if not axis.is_enabled or axis.mode is OpMode.HM:
                outputs.position[index] = positions[index]
                outputs.velocity[index] = outputs.torque[index] = 0

    def send(self) -> None:
        """Send what the drives take over at the next SYNC.

        Raises:
            BusLost: the bus cannot be used.
        """
        outputs = self.outputs
        for index, axis in enumerate(self.axes):  # also what was worked out before
            stops = axis.is_enabled and axis.drive.goal is State.QUICK_STOP
            if stops or self._stops_quickly.is_set():
                outputs.controlword[index] = int(Control.QUICK_STOP)
        self.cycle.send(self._signals.sent(outputs, self._positions_to_send()))
        self._sent = True

    def _positions_to_send(self) -> list[int]:
        return [
            target.step(wanted, heard=heard)
            if axis.is_enabled and axis.mode in WAYS[Way.POSITIONS]
            else target.set(wanted)
            for axis, target, wanted, heard in zip(
                self.axes, self.targets, self.outputs.position, self.heard, strict=True
            )
        ]

    @property
    def heard(self) -> list[bool]:
        """Which axes (n,) tell where they are."""
        ages, unbegun = self.cycle.ages, self._unbegun
        return [ages[slot] + unbegun <= UNHEARD for slot in self._signals.position_slots]

    @property
    def positions(self) -> list[int]:
        """Where the drives are (n,), in their counts."""
        return [each.position for each in self.whereabouts]

    @property
    def velocities(self) -> list[int] | None:
        """How fast they are (n,); None if that is not measured."""
        return self._signals.measured("velocity_actual", self.cycle.values)

    @property
    def torques(self) -> list[int] | None:
        """Their torques (n,) in thousandths of the rated one; None if that is not measured."""
        return self._signals.measured("torque_actual", self.cycle.values)

    @property
    def age(self) -> int:
        """Cycles since any drive told anything."""
        return min(self.cycle.ages, default=0)
