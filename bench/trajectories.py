"""A trajectory of 200 points, carried out and as it should be; what its action costs, and beside it move_jp.

The driver and its node are in this process, the client of the action (rclpy's own) is another one. `off` is
how far setpoints, and joints as measured, are from the trajectory at most: cubic between its points, by
Hermite polynomials that share no code with the driver, with the delay that fits best. `over` is what the
whole takes beyond the trajectory's own time, to the result at the client. The second table says how late the
I/O thread was meanwhile, with goals of 200 points, and of 100 000, which are refused. The last one is of
streams at 100 Hz as MoveIt Servo's: from before `publish` in the client to the setpoint that the driver
sends for it.

    python -m bench.trajectories
"""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.serialization import deserialize_message, serialize_message

from bench.commands import CYCLE, Arm, Clock
from bench.report import options, show, spread
from bench.trajectory_client import MANY, POINTS, SECONDS, goal_of, points
from crtk_drivers import plugins
from crtk_drivers.config import NodeConfig
from crtk_drivers.device import Setpoint
from crtk_drivers.engine import Engine, EngineOptions
from crtk_drivers.recording.cdr_trajectories import decode_goal
from crtk_drivers.ros.serving import Serving
from crtk_drivers.samples import JointState, JointTrajectory, vector
from crtk_drivers.session import Session, open_session

SPACE: Final = "/bench_trajectories"
PATIENCE: Final = 60.0
DEVICES: Final = {
    "virtual": {"sample_timeout": 3.0},
    "ur": {"sample_timeout": 3.0, "watchdog_frequency": 2.0},
    "canopen": {"sample_timeout": 3.0, "missed_cycles": 20},
    "dynamixel": {"sample_timeout": 3.0, "watchdog": 1.0},
}


def ideal(times: np.ndarray, p: np.ndarray, v: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the positions (k, n) at times (k,) between points, by cubic Hermite polynomials."""
    at = np.clip(at, times[0], times[-1])
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    h = (times[i + 1] - times[i])[:, None]
    s = (at - times[i])[:, None] / h
    first = (1 + 2 * s) * (1 - s) ** 2 * p[i] + s * (1 - s) ** 2 * h * v[i]
    return first + s**2 * (3 - 2 * s) * p[i + 1] + s**2 * (s - 1) * h * v[i + 1]


def off(
    way: tuple[np.ndarray, np.ndarray, np.ndarray], rows: list[tuple[float, np.ndarray]]
) -> tuple[float, float]:
    """Return the greatest distance of positions from the way, and the delay (s) at which that is least."""
    at, found = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    worst, delay = np.inf, 0.0
    for step in (0.01, 0.001, 0.0001):
        for tried in delay + step * np.arange(-40, 41):
            distance = float(np.abs(ideal(*way, at - tried) - found).max())
            if distance < worst:
                worst, delay = distance, float(tried)
    return worst, delay


class Watched:
    """What goes on in an engine while something is carried out."""

    def __init__(self, engine: Any) -> None:
        self._engine = engine
        self.rows: dict[str, list[tuple[float, np.ndarray]]] = {
            "setpoint_js": [],
            "measured_js": [],
        }
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self) -> Watched:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._stop.wait(0.0005):
            for name, rows in self.rows.items():
                value, stamp = self._engine.feedback(name)
                if not rows or rows[-1][0] != stamp.monotonic:
                    rows.append((stamp.monotonic, np.array(value.position)))


@contextmanager
def serving(name: str) -> Iterator[Session]:
    """Serve a simulated device for MoveIt."""
    config = plugins.device(name).load_config(None, DEVICES[name])
    session = open_session(name, config, sim=name != "virtual")
    stop = threading.Event()
    with (
        Serving(session.engine, SPACE, (), NodeConfig(moveit=True), session.children) as node,
        session,
    ):
        thread = threading.Thread(target=node.spin, args=(stop,))
        thread.start()
        try:
            wait(lambda: session.engine.has_sample)
            session.engine.state_command("enable")
            wait(lambda: session.engine.status.state == "ENABLED")
            yield session
        finally:
            stop.set()
            thread.join()


def wait(test: Any) -> None:
    """Return as soon as a test holds."""
    end = time.monotonic() + PATIENCE
    while not test():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.001)


class Client:
    """The client in its own process: a line in, a line of numbers out."""

    def __init__(self, engine: Any) -> None:
        names = ",".join(engine.capabilities.joints)
        command = [sys.executable, "-m", "bench.trajectory_client", SPACE, names]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._read()

    def ask(self, *words: object) -> list[float]:
        """Send a line and return the answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(" ".join(map(str, words)) + "\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> list[float]:
        assert self._process.stdout is not None
        return [float(word) for word in self._process.stdout.readline().split()]

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(PATIENCE)


def measure(name: str, rounds: int) -> list[str]:
    """Return a device's row."""
    with serving(name) as session:
        engine = session.engine
        client = Client(engine)
        try:
            accepts, overs, moves, ends, runs = [], [], [], [], []
            for _ in range(rounds):
                start = np.array(engine.feedback("setpoint_js")[0].position)
                way = points(start)
                begun = time.monotonic()
                with Watched(engine) as seen:
                    accept, result, status = client.ask("follow", *start)
                if status != 4.0:
                    why = f"{engine.status.detail} {engine.health().last_refusal}"
                    raise RuntimeError(f"{name}: the goal ended with status {status}: {why}")
                accepts.append(accept)
                overs.append(result - SECONDS)
                runs.append((way, begun, seen.rows))
                ends.append(
                    float(
                        np.abs(
                            np.array(engine.feedback("measured_js")[0].position) - way[1][-1]
                        ).max()
                    )
                )
                back = time.monotonic()
                move = engine.submit("move_jp", JointState(position=vector(start)))
                move.wait(PATIENCE)
                moves.append(time.monotonic() - back)
        finally:
            client.close()
    paths: dict[str, list[float]] = {"setpoint_js": [], "measured_js": []}
    lags = []
    for way, begun, told in runs:
        for topic, rows in told.items():
            mine = [(t - begun, p) for t, p in rows if begun + 0.1 < t < begun + SECONDS]
            worst, lag = off(way, mine)
            paths[topic].append(worst)
        lags.append(lag)
    return [
        name,
        *(f"{1e3 * np.median(paths[topic]):.2f}" for topic in ("setpoint_js", "measured_js")),
        f"{1e3 * np.median(lags):.0f}",
        f"{1e3 * np.median(ends):.2f}",
        f"{1e3 * np.median(accepts):.1f}",
        f"{1e3 * np.median(overs):.0f}",
        f"{np.median(moves):.2f}",
    ]


def lateness(name: str, goals: int) -> list[list[str]]:
    """Return how late the I/O thread of a device was while goals came."""
    rows = []
    with serving(name) as session:
        engine = session.engine
        client = Client(engine)
        start = np.array(engine.feedback("setpoint_js")[0].position)
        try:
            for label, words, count in (
                ("nothing", ("wait", 4.0), 1),
                (f"goals of {POINTS} points", ("follow", *start), goals),
                ("goals of 100 000 points", ("many", *start), 1),
            ):
                periods: list[float] = []
                last = [time.monotonic()]

                def sampled() -> None:
                    now = time.monotonic()
                    periods.append(now - last[0])  # noqa: B023
                    last[0] = now  # noqa: B023

                before, engine.on_sample = engine.on_sample, sampled
                for _ in range(count):
                    client.ask(*words)
                engine.on_sample = before
                rows.append([label, *spread(periods[1:], 1e3, 2)])
        finally:
            client.close()
    return rows


def followed(name: str) -> list[list[str]]:
    """Return how long a device's setpoints take to follow the steps of a stream."""
    rows = []
    with serving(name) as session:
        engine = session.engine
        client = Client(engine)
        try:
            for label, word in (("joint_trajectory", "point"), ("Float64MultiArray", "array")):
                start = np.array(engine.feedback("setpoint_js")[0].position)
                sent: list[tuple[float, float]] = []
                write = engine.device.write

                def keep(setpoint: Setpoint) -> None:
                    write(setpoint)  # noqa: B023
                    sent.append((time.monotonic(), float(setpoint.values[0])))  # noqa: B023

                engine.device.write = keep  # type: ignore[method-assign]
                steps = client.ask(word, *start)
                engine.device.write = write  # type: ignore[method-assign]
                rows.append([label, str(len(steps)), *spread(delays(steps, sent), 1e3, 2)])
                wait(lambda: not engine.status.is_busy)
                time.sleep(1.0)  # the stream is over
        finally:
            client.close()
    return rows


def delays(steps: list[float], sent: list[tuple[float, float]]) -> list[float]:
    """Return the seconds from each step to the first setpoint that is another than the one before it."""
    found = []
    for step in steps:
        before = [value for at, value in sent if at <= step][-1]
        found.append(
            next(at for at, value in sent if at > step and abs(value - before) > 1e-6) - step
        )
    return found


def engine_on(clock: Clock) -> Engine:
    """Return an engine that is enabled, with an arm of six axes that is where it is sent."""
    engine = Engine(Arm(6, clock), "bench", EngineOptions(), clock)
    engine.connect(math.inf)
    engine.cycle(math.inf)
    engine.state_command("enable")
    for _ in range(3):
        clock.now += CYCLE
        engine.cycle(math.inf)
    return engine


def carried_out(
    engine: Engine, clock: Clock, name: str, value: Any
) -> tuple[float, list[Any], list[float]]:
    """Return how long a move takes, its setpoints with their times, and µs of the processor a cycle."""
    begun, rows, spent = clock.now, [], []
    move = engine.submit(name, value)
    while move.is_busy():
        clock.now += CYCLE
        before = time.thread_time_ns()
        engine.cycle(math.inf)
        spent.append((time.thread_time_ns() - before) / 1e3)
        rows.append((clock.now - begun, np.array(engine.feedback("setpoint_js")[0].position)))
    return clock.now - begun, rows, spent


def by_clock() -> list[list[str]]:
    """Return how exact a trajectory is, and move_jp back, on a clock that is the bench's."""
    clock = Clock()
    engine = engine_on(clock)
    start = np.array(engine.feedback("measured_js")[0].position)
    way = points(start)
    asked = JointTrajectory(
        engine.capabilities.joints, *map(np.asarray, way), np.full_like(way[1], np.nan)
    )
    seconds, rows, spent = carried_out(engine, clock, "follow_joint_trajectory", asked)
    worst, delay = off(way, rows)
    end = float(np.abs(rows[-1][1] - way[1][-1]).max())
    goal = JointState(position=vector(start))
    back, _, simple = carried_out(engine, clock, "move_jp", goal)
    return [
        [
            "a trajectory of 200 points",
            f"{seconds:.3f}",
            f"{1e6 * worst:.2g}",
            f"{1e3 * delay:.1f}",
            f"{1e6 * end:.2g}",
            *spread(spent)[:2],
        ],
        ["move_jp back from its end", f"{back:.3f}", "-", "-", "-", *spread(simple)[:2]],
    ]


def costs(calls: int = 200) -> list[list[str]]:
    """Return what a goal costs of the processor until it is accepted, and what rclpy's own message would."""
    clock = Clock()
    engine = engine_on(clock)
    start = np.array(engine.feedback("measured_js")[0].position)
    request = FollowJointTrajectory.Impl.SendGoalService.Request()
    request.goal = goal_of(list(engine.capabilities.joints), start)
    data = serialize_message(request)
    asked = decode_goal(data)
    target = JointState(position=vector(start + 0.1))
    many = goal_of(list(engine.capabilities.joints), start, MANY // POINTS)
    whole = serialize_message(FollowJointTrajectory.Impl.SendGoalService.Request(goal=many))

    def refused() -> None:
        with suppress(ValueError):
            decode_goal(whole)

    def once(call: Any, count: int) -> list[float]:
        spent = []
        for _ in range(count):
            before = time.thread_time_ns()
            call()
            spent.append((time.thread_time_ns() - before) / 1e6)
        return spent

    kind = type(request)
    return [
        [label, *spread(once(call, count), 1.0, 2)[:2]]
        for label, call, count in (
            ("read from bytes", lambda: decode_goal(data), calls),
            ("judged and accepted", lambda: engine.submit("follow_joint_trajectory", asked), calls),
            ("move_jp judged and accepted", lambda: engine.submit("move_jp", target), calls),
            (
                "rclpy: bytes to message, with the lock held",
                lambda: deserialize_message(data, kind),
                calls,
            ),
            ("100 000 points: read from bytes until refused", refused, 5),
            (
                "rclpy: 100 000 points, with the lock held",
                lambda: deserialize_message(whole, kind),
                1,
            ),
        )
    ]


def main() -> None:
    """Print the tables."""
    given = options(str(__doc__), rounds=(5, "trajectories for each simulator; 0: none"))
    rounds = int(given.rounds)
    show(
        f"{POINTS} points in {SECONDS:g} s, on a clock of its own, six axes at 500 Hz",
        ("", "took s", "off µrad", "delay ms", "end off µrad", "cycle p50 µs", "p99"),
        by_clock(),
    )
    show(
        f"What a goal of {POINTS} points costs of the processor", ("", "p50 ms", "p99 ms"), costs()
    )
    if not rounds:
        return
    show(
        f"A trajectory of {POINTS} points in {SECONDS:g} s, by FollowJointTrajectory",
        ("device", "setpoints off mrad", "joints off mrad", "joints late ms", "end off mrad",
         "accepted ms", "over ms", "move_jp back s"),
        [measure(name, rounds) for name in DEVICES],
    )  # fmt: skip
    show(
        "Between two samples of the simulated UR (500 Hz) in the I/O thread",
        ("meanwhile", "p50 ms", "p99 ms", "max ms"),
        lateness("ur", rounds),
    )
    show(
        "A stream at 100 Hz, published to the setpoint that the simulated UR is sent (500 Hz)",
        ("topic", "steps", "p50 ms", "p99 ms", "max ms"),
        followed("ur"),
    )


if __name__ == "__main__":
    main()
