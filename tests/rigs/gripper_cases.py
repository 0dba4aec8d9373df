"""Grippers as the contract of grippers asks them: what is different between them, as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from crtk_sim_backends.onrobot import SIM as ONROBOT
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.robotiq import SIM as ROBOTIQ
from crtk_sim_backends.robotiq.epick import SIM as EPICK
from crtk_sim_backends.schunk.gripper import SIM as SCHUNK
from crtk_sim_backends.weiss_wsg import SIM as WSG
from rigs import epick_bench, onrobot_bench, robotiq_bench, schunk_bench, wsg_bench
from rigs.gripper_bench import GripperBench
from rigs.waiting import LONG, eventually

WIDTH: Final = 0.03
"""Of what is gripped, in m."""
WIDER: Final = WIDTH + 0.004
"""To which no finger may open that holds it."""
VACUUM: Final = 40_000.0
"""Pa below which no cup may come that holds something."""


@dataclass(frozen=True)
class Case:
    """One gripper, by one way.

    Attributes:
        name: of the case.
        simulator, options: what is started.
        bench: makes the driver at it, with settings.
        link: its way.
        ready: brings the simulated gripper into the state of a new one.
        start: from where something is gripped.
        closed, opened: goals that grip, and that let go.
        writes: entry of the simulator's status that counts what is written.
        ratio: of the speed, at which a test has time; 1: it has one speed.
        refused: inputs that it must refuse.
        moving: services that move it, or let go.
        fault: that stops it.
        on_close: ways in which it may be left.
        service: it grips by its service, not by a move.
        sweep: service that makes it ready, for which its fingers move; empty: there is none.
        other: how its simulator has another program close it.
        sweeping: settings with which it is not ready before that, and `enable` does it too.
    """

    name: str
    simulator: Any
    options: Mapping[str, Any]
    bench: Callable[..., GripperBench]
    link: str
    ready: Callable[[RunningSim], None]
    start: float
    closed: float
    opened: float
    writes: str = "writes"
    ratio: float = 0.02
    refused: tuple[tuple[str, float], ...] = ()
    moving: tuple[str, ...] = ()
    fault: tuple[str, Mapping[str, Any]] = ("", {})
    on_close: tuple[str, ...] = ("hold", "nothing", "release")
    service: bool = False
    sweep: str = ""
    sweeping: Mapping[str, Any] = field(default_factory=dict)
    other: tuple[str, Mapping[str, Any]] = ("", {})

    @property
    def is_suction(self) -> bool:
        """Whether it has no fingers."""
        return self.simulator is EPICK

    @staticmethod
    def enable(bench: GripperBench) -> None:
        """Enable it when it has told how it is: an error that it begins with is acknowledged then."""
        bench.samples(2)
        bench.front.enable()

    def grip(self, bench: GripperBench) -> None:
        """Have an enabled gripper hold something."""
        if self.is_suction:
            bench.sim.control.inject("object")
        else:
            assert bench.front.move_jp([self.start]).wait(LONG)
            bench.sim.control.inject("object", width=WIDTH)
        if self.service:
            bench.front.part_width(WIDTH)
            bench.front.grip()
        else:
            assert bench.front.move_jp([self.closed]).wait(LONG)
        bench.grip("holds an object")

    def keeps(self, sim: RunningSim) -> bool:
        """Whether what it gripped has not been let go."""
        status = sim.control.call("status")
        return status["vacuum"] > VACUUM if self.is_suction else status["opening"] < WIDER


def _onrobot(sim: RunningSim) -> None:
    sim.control.inject("unpowered")
    sim.control.clear()


def _schunk(sim: RunningSim) -> None:
    sim.control.inject("unpowered")
    sim.control.clear()


def _wsg(sim: RunningSim) -> None:
    eventually(lambda: not any(sim.control.status()["connections"].values()), "nobody there")
    sim.control.inject("as_new", opening=0.06)


def _epick(sim: RunningSim) -> None:
    sim.control.inject("deactivated")
    sim.control.inject("activated")
    eventually(lambda: sim.control.status()["vacuum"] < 1000.0, "open")


def _robotiq_bench(sim: RunningSim, **values: Any) -> GripperBench:
    return robotiq_bench.RobotiqBench(sim, robotiq_bench.configuration(sim, **values))


def _onrobot_bench(sim: RunningSim, **values: Any) -> GripperBench:
    return onrobot_bench.OnRobotBench(sim, onrobot_bench.configuration(sim, **values))


def _schunk_bench(sim: RunningSim, **values: Any) -> GripperBench:
    return schunk_bench.SchunkBench(sim, schunk_bench.configuration(sim, **values))


def _epick_bench(sim: RunningSim, **values: Any) -> GripperBench:
    return epick_bench.EpickBench(sim, epick_bench.configuration(sim, **values))


NAN: Final = float("nan")
CASES: Final = (
    *(
        Case(
            name=f"robotiq-{link}",
            simulator=ROBOTIQ,
            options=robotiq_bench.FREE_PORTS,
            bench=_robotiq_bench,
            link=link,
            ready=robotiq_bench.activate_anew,
            start=0.05,
            closed=0.0,
            opened=0.085,
            ratio=0.01,
            refused=(("force", 1.5), ("force", -0.1), ("force", NAN), ("force", 40.0)),
            fault=("gripper_fault", {"code": 0xE}),
            sweep="activate",
            sweeping={"activate": "always"},
            other=("other_master", {"position": 255, "speed": 0}),
        )
        for link in robotiq_bench.LINKS
    ),
    *(
        Case(
            name=f"onrobot-{link}",
            simulator=ONROBOT,
            options={**onrobot_bench.FREE_PORTS, "model": "rg2"},
            bench=_onrobot_bench,
            link=link,
            ready=_onrobot,
            start=0.06,
            closed=0.0,
            opened=0.11,
            ratio=1.0,
            refused=(("force", 41.0), ("force", 0.3), ("force", -1.0), ("force", NAN)),
            fault=("flags", {"set": 0x04}),
            other=("other_master", {"opening": 0.0}),
        )
        for link in onrobot_bench.LINKS
    ),
    *(
        Case(
            name=f"schunk-{link}",
            simulator=SCHUNK,
            options={**schunk_bench.FREE_PORTS, **schunk_bench.BRISK},
            bench=_schunk_bench,
            link=link,
            ready=_schunk,
            start=0.05,
            closed=0.0,
            opened=0.083,
            refused=(("force", 150.1), ("force", 0.0), ("force", -10.0), ("force", NAN)),
            moving=("release", "brake_test"),
            fault=("error", {"code": 0xDE}),
            other=("other_master", {"position": 0.0, "speed": 0.03}),
        )
        for link in schunk_bench.LINKS
    ),
    *(
        Case(
            name=f"wsg-{link}",
            simulator=WSG,
            options={**wsg_bench.FREE_PORTS, "homing_speed": 0.04},
            bench=wsg_bench.WsgBench,
            link=link,
            ready=_wsg,
            start=0.05,
            closed=0.0,
            opened=0.11,
            writes="motions",
            refused=(("force", 0.3), ("force", 500.0), ("force", NAN), ("part_width", 30.0)),
            moving=("grip", "release"),
            fault=("flag", {"name": "current"}),
            service=True,
            sweep="reference",
            sweeping={"home": "always"},
            other=("other_program", {"opening": 0.0}),
        )
        for link in wsg_bench.LINKS
    ),
    *(
        Case(
            name=f"epick-{link}",
            simulator=EPICK,
            options=epick_bench.FREE_PORTS,
            bench=_epick_bench,
            link=link,
            ready=_epick,
            start=0.0,
            closed=60_000.0,
            opened=0.0,
            fault=("gripper_fault", {"code": 8}),
            on_close=("hold", "release"),
        )
        for link in ("serial", "tool", "modbus")
    ),
)
ONE_WAY: Final = tuple({case.simulator.name: case for case in reversed(CASES)}.values())
"""Each gripper, by its first way."""
SWEEPING: Final = tuple(case for case in ONE_WAY if case.sweep)
"""Those whose fingers move to make them ready."""
FINGERS: Final = tuple(case for case in ONE_WAY if not case.is_suction)
