"""Threads: one for each bus, and the watchdog. On the real clock, with devices that misbehave."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest

from crtk_drivers.device import Capabilities, Setpoint
from crtk_drivers.engine import Engine, threads
from crtk_drivers.engine.threads import LONGEST_RETRY, SWITCH_INTERVAL, Runtime
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    DeviceError,
    MotionAborted,
    StopUnconfirmed,
)
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import JointState, Sample, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.waiting import LONG, eventually

S = OperatingState


class Misbehaving(LoopbackDevice):
    """A loopback whose methods a test may replace, and that counts what the runtime does."""

    def __init__(self, address: str = "a", rate: float = 200.0) -> None:
        super().__init__(LoopbackConfig(address=address, rate=rate))
        self.in_read: Callable[[], None] = lambda: None
        self.in_open: Callable[[], None] = lambda: None
        self.in_close: Callable[[], None] = lambda: None
        self.in_stop: Callable[[], None] = lambda: None
        self.opened = 0
        self.closed = 0
        self.stopped = 0
        self.stoppers: list[str] = []
        self.reads: list[float] = []

    def open(self, deadline: float) -> None:
        self.opened += 1
        self.in_open()
        super().open(deadline)

    def close(self) -> None:
        self.closed += 1
        self.in_close()
        super().close()

    def read(self, deadline: float) -> Sample | None:
        self.reads.append(time.monotonic())
        self.in_read()
        return super().read(deadline)

    def stop(self) -> None:
        self.stopped += 1
        self.stoppers.append(threading.current_thread().name)
        self.in_stop()
        super().stop()


@contextmanager
def running(*devices: Misbehaving, open_timeout: float = 1.0) -> Iterator[list[Engine]]:
    engines = [Engine(device, f"engine {i}") for i, device in enumerate(devices)]
    runtime = Runtime([(engine, open_timeout) for engine in engines])
    before = set(threading.enumerate())
    runtime.start()
    try:
        yield engines
    finally:
        runtime.close()
        assert set(threading.enumerate()) <= before, "threads are left"


def enable(engine: Engine) -> None:
    eventually(lambda: engine.connected and engine.has_sample)
    engine.state_command("enable")
    eventually(lambda: engine.status.state is S.ENABLED)


def raising(error: BaseException) -> Callable[[], None]:
    def fail() -> None:
        raise error

    return fail


def once(error: BaseException) -> Callable[[], None]:
    left = [error]

    def fail() -> None:
        if left:
            raise left.pop()

    return fail


def test_a_device_is_cycled_at_its_rate_and_closed_at_the_end() -> None:
    device = Misbehaving(rate=200.0)
    with running(device) as (engine,):
        enable(engine)
        eventually(lambda: engine.health().cycles > 100)
        assert engine.health().rate_expected == 200.0
    assert (device.opened, device.closed) == (1, 1)
    assert device.stopped == 1
    assert engine.status.state is S.DISABLED
    assert not engine.connected


def test_nothing_runs_before_start_and_close_may_be_called_twice() -> None:
    device = Misbehaving()
    before = threading.active_count()
    runtime = Runtime([(Engine(device, "x"), 1.0)])
    runtime.close()
    assert (threading.active_count(), device.opened, device.closed) == (before, 0, 0)
    runtime.start()
    eventually(lambda: device.opened)
    runtime.close()
    runtime.close()
    assert device.closed == 1


def test_a_lost_device_is_opened_again_and_stays_disabled() -> None:
    device = Misbehaving()
    with running(device) as (engine,):
        enable(engine)
        engine.submit("servo_jp", JointState(position=vector([0.005] * 4)))
        eventually(lambda: device.writes)
        device.reachable = False
        eventually(lambda: engine.status.state is S.FAULT)
        assert "the link is gone" in engine.status.detail
        writes = device.writes
        device.reachable = True
        eventually(lambda: engine.connected and engine.has_sample)
        cycles = engine.health().cycles
        eventually(lambda: engine.health().cycles > cycles + 20)
        assert engine.status.state is S.DISABLED
        assert device.writes == writes
        assert engine.health().reconnects == 1


@pytest.fixture
def as_for_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """Links are tried again as late as for users: in tests it is soon (`soon_again`)."""
    monkeypatch.setattr(threads, "LONGEST_RETRY", LONGEST_RETRY)


@pytest.mark.usefixtures("as_for_users")
def test_attempts_to_connect_become_rarer() -> None:
    device = Misbehaving()
    device.reachable = False
    attempts: list[float] = []
    device.in_open = lambda: attempts.append(time.monotonic())
    with running(device) as (engine,):
        eventually(lambda: len(attempts) >= 3)
        assert engine.status.state is S.FAULT
        assert "no answer" in engine.status.detail
    assert attempts[1] - attempts[0] >= 0.25
    assert attempts[2] - attempts[1] >= 0.5


@pytest.mark.usefixtures("as_for_users")
def test_attempts_become_rarer_where_the_link_opens_and_brings_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device = Misbehaving()
    attempts: list[float] = []
    delays: list[float] = []
    failed = threads._Reconnect.failed

    def told(reconnect: threads._Reconnect, now: float) -> None:
        delays.append(reconnect.delay)
        failed(reconnect, now)

    monkeypatch.setattr(threads._Reconnect, "failed", told)
    device.in_open = lambda: attempts.append(time.monotonic())
    device.in_read = raising(ConnectionLost("nothing but noise"))
    with running(device) as (engine,):
        eventually(lambda: len(delays) >= 3)
        assert attempts[2] - attempts[1] >= 0.5
        device.in_read = lambda: None
        eventually(lambda: engine.has_sample)
        assert delays[:3] == [0.25, 0.5, 1.0]
        count = len(attempts)
        device.in_read = once(ConnectionLost("once"))
        eventually(lambda: len(attempts) > count)
    assert delays[-1] == 0.25, "a sample is a new beginning"


@pytest.mark.parametrize("error", [KeyError("x"), ZeroDivisionError(), OSError("bad descriptor")])
@pytest.mark.parametrize("where", ["in_read", "in_open"])
def test_no_exception_of_a_plugin_ends_the_thread(where: str, error: Exception) -> None:
    device = Misbehaving()
    states: list[str] = []
    setattr(device, where, once(error))
    with running(device) as (engine,):
        eventually(lambda: device.opened == 2 and engine.has_sample)
        states.append(engine.status.state)
        enable(engine)
    assert states == [S.DISABLED]


def test_an_unexpected_error_is_a_fault_that_names_it(caplog: pytest.LogCaptureFixture) -> None:
    device = Misbehaving()
    with running(device) as (engine,):
        enable(engine)
        device.in_read = raising(KeyError("joint_7"))
        eventually(lambda: engine.status.state is S.FAULT)
        assert "unexpected KeyError: 'joint_7'" in engine.status.detail
        assert "report" in engine.status.detail
    assert "unexpected error in the I/O thread" in caplog.text


def test_errors_while_closing_and_stopping_do_not_stop_the_thread_either() -> None:
    device = Misbehaving()
    device.in_close = once(OSError("close"))
    device.in_stop = once(RuntimeError("stop"))
    with running(device) as (engine,):
        enable(engine)
        device.in_read = once(OSError("read"))
        eventually(lambda: device.opened == 2 and engine.has_sample)
        assert engine.status.state is S.DISABLED


@pytest.fixture
def soon_stuck(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what waits until a thread counts as stuck."""
    monkeypatch.setattr(threads, "STALL_LIMIT", 1.5)


@pytest.mark.usefixtures("soon_stuck")
def test_a_stuck_thread_is_an_alarm_that_stops_its_device_and_leaves_its_neighbours() -> None:
    stuck, well = Misbehaving("a"), Misbehaving("b")
    release = threading.Event()

    def hang() -> None:
        release.wait(LONG)

    with running(stuck, well) as (engine, neighbour):
        enable(engine)
        enable(neighbour)
        move = engine.submit("move_jp", JointState(position=vector([0.5] * 4)))
        assert move is not None
        stuck.in_read = hang
        eventually(lambda: engine.status.state is S.FAULT)
        assert engine.status.detail == "the I/O thread of a is stuck"
        eventually(lambda: "watchdog" in stuck.stoppers)
        eventually(lambda: move.outcome is Outcome.ABORTED)
        with pytest.raises(MotionAborted):
            move.wait()
        cycles, writes = neighbour.health().cycles, stuck.writes
        eventually(lambda: neighbour.health().cycles > cycles + 20)
        assert neighbour.status.state is S.ENABLED
        stuck.in_read = lambda: None
        release.set()
        cycles = engine.health().cycles
        eventually(lambda: engine.health().cycles > cycles + 20)
        assert engine.status.state is S.FAULT
        assert stuck.writes == writes
        enable(engine)
        assert well.stopped == 0


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_dies_is_a_fault_and_its_device_is_stopped() -> None:
    device, well = Misbehaving("a"), Misbehaving("b")
    with running(device, well) as (engine, neighbour):
        enable(engine)
        enable(neighbour)
        device.in_read = raising(SystemExit("a plugin called sys.exit"))
        eventually(lambda: "has died" in engine.status.detail)
        assert engine.status.state is S.FAULT
        eventually(lambda: (device.stopped, device.closed) == (1, 1))
        with pytest.raises(CommandRefused):
            engine.submit("servo_jp", JointState(position=vector([0.0] * 4)))
        assert neighbour.status.state is S.ENABLED
        assert well.stopped == 0


def test_a_thread_that_does_not_end_is_told_and_its_moves_are_released() -> None:
    device = Misbehaving()
    release = threading.Event()
    engine = Engine(device, "x")
    runtime = Runtime([(engine, 1.0)])
    runtime.start()
    enable(engine)
    move = engine.submit("move_jp", JointState(position=vector([0.5] * 4)))
    assert move is not None
    entered = threading.Event()

    def hang() -> None:
        entered.set()
        release.wait(LONG)

    device.in_read = hang
    assert entered.wait(LONG)
    with pytest.raises(StopUnconfirmed, match=r"the I/O thread of a did not end in 1.1 s: a stop"):
        runtime.close(0.1)
    assert device.stopped
    assert move.outcome is Outcome.ABORTED
    assert engine.status.state is S.FAULT
    release.set()
    eventually(lambda: device.closed)
    eventually(lambda: "io a" not in [thread.name for thread in threading.enumerate()])


def test_the_watchdog_stops_a_stuck_thread_while_closing() -> None:
    device, release = Misbehaving(), threading.Event()
    runtime = Runtime([(engine := Engine(device, "x"), 1.0)])
    runtime.start()
    enable(engine)
    device.in_read = lambda: (release.wait(LONG), None)[1]
    closing = threading.Thread(target=runtime.close, args=(LONG,))
    closing.start()
    try:
        eventually(lambda: "watchdog" in device.stoppers)
        assert closing.is_alive()
        eventually(lambda: engine.status.detail == "the I/O thread of a is stuck")
        device.stoppers.clear()
    finally:
        release.set()
        closing.join(LONG)
    assert "io a" in device.stoppers, "that it stands was not read back"
    assert device.closed == 1


@pytest.mark.parametrize("phase", ["stopping", "reading back"])
def test_the_watchdog_stops_what_hangs_as_it_is_shut_down(phase: str) -> None:
    device, release = Misbehaving(), threading.Event()
    runtime = Runtime([(engine := Engine(device, "x"), 1.0)])
    runtime.start()
    enable(engine)

    def hang() -> None:
        if threading.current_thread().name == "io a":
            release.wait(LONG)

    def stopped() -> None:
        if phase == "stopping":
            hang()
        else:
            device.in_read = hang

    device.in_stop = stopped
    closing = threading.Thread(target=runtime.close, args=(LONG,))
    closing.start()
    try:
        eventually(lambda: "watchdog" in device.stoppers)
        assert closing.is_alive()
    finally:
        device.in_stop = lambda: None
        release.set()
        closing.join(LONG)
    assert device.closed == 1


@pytest.mark.usefixtures("soon_stuck")
def test_a_link_that_takes_long_to_close_is_no_alarm() -> None:
    device = Misbehaving()
    with running(device) as (engine,):
        enable(engine)
        told: list[str] = []

        def close() -> None:
            threading.Event().wait(threads.STALL_LIMIT + 5.0 * threads.WATCHDOG_PERIOD)
            told.append(engine.status.detail)

        device.in_close = close
    assert told == ["shut down"]


def test_after_a_stall_cycles_are_not_caught_up() -> None:
    device = Misbehaving(rate=100.0)
    with running(device) as (engine,):
        eventually(lambda: engine.health().cycles > 5)
        stalled = threading.Event()

        def stall() -> None:
            if not stalled.is_set():
                stalled.set()
                time.sleep(0.2)

        device.in_read = stall
        assert stalled.wait(LONG)
        count = len(device.reads)
        eventually(lambda: len(device.reads) > count + 30)
    after = device.reads[count : count + 30]
    # Twenty periods were missed. At most one cycle follows at once, none of the others.
    assert after[-1] - after[0] > 27 * 0.01
    assert engine.health().late_cycles >= 1


def test_devices_on_one_bus_share_a_thread_and_one_of_them_may_be_lost() -> None:
    first, second = Misbehaving("line"), Misbehaving("line")
    with running(first, second) as (one, two):
        assert [t.name for t in threading.enumerate()].count("io line") == 1
        enable(one)
        enable(two)
        first.reachable = False
        eventually(lambda: one.status.state is S.FAULT)
        cycles = two.health().cycles
        eventually(lambda: two.health().cycles > cycles + 20)
        assert two.status.state is S.ENABLED


def test_all_devices_of_a_lost_bus_are_stopped_before_the_first_is_waited_for() -> None:
    """To close may take as long as a stop takes to be read back."""
    gripper, arm = Misbehaving("bus"), Misbehaving("bus")
    stopped_by_then: list[bool] = []
    with running(gripper, arm) as engines:
        for engine in engines:
            enable(engine)
        stops = arm.stopped
        gripper.in_close = lambda: stopped_by_then.append(arm.stopped > stops)
        broken = threading.Event()

        def fail() -> None:
            if broken.is_set():
                raise ConnectionLost("unplugged", where="bus")

        gripper.in_read = arm.in_read = fail
        broken.set()
        eventually(lambda: stopped_by_then)
    assert stopped_by_then[0]


def test_all_devices_of_a_bus_are_stopped_at_the_end_before_the_first_is_waited_for() -> None:
    gripper, arm = Misbehaving("bus"), Misbehaving("bus")
    stopped_by_then: list[bool] = []
    with running(gripper, arm) as engines:
        for engine in engines:
            enable(engine)
        stops = arm.stopped
        gripper.in_close = lambda: stopped_by_then.append(arm.stopped > stops)
    assert stopped_by_then == [True]
    assert arm.closed == 1


@pytest.mark.usefixtures("soon_stuck")
def test_what_a_lost_device_is_closed_with_is_not_taken_for_a_stuck_thread() -> None:
    """It may take as long as a stop takes to be read back; that the link was lost stays told."""
    device = Misbehaving()
    told: list[str] = []
    with running(device) as (engine,):
        enable(engine)

        def close() -> None:
            threading.Event().wait(threads.STALL_LIMIT + 5.0 * threads.WATCHDOG_PERIOD)
            told.append(engine.status.detail)

        device.in_close = close
        device.in_read = once(ConnectionLost("unplugged"))
        eventually(lambda: told)
        device.in_close = lambda: None
    assert "unplugged" in told[0]


def test_opening_one_device_again_does_not_leave_its_neighbour_on_the_bus_alone() -> None:
    first, second = Misbehaving("line"), Misbehaving("line")
    limits: list[float] = []
    first_open = first.open

    def watched(deadline: float) -> None:
        limits.append(deadline - time.monotonic())
        first_open(deadline)

    with running(first, second, open_timeout=4.0) as (one, two):
        enable(one)
        enable(two)
        first.open = watched  # type: ignore[method-assign]
        first.reachable = False
        eventually(lambda: len(limits) >= 2)
        first.reachable = True
        eventually(lambda: one.connected)
    assert max(limits) <= 0.25


def test_a_slow_device_is_not_taken_for_a_stuck_one() -> None:
    device = Misbehaving(rate=1.0)
    with running(device) as (engine,):
        eventually(lambda: engine.health().cycles >= 2)
        assert engine.status.state is S.DISABLED


class Streaming(Misbehaving):
    """Its `read` waits for a clock of its own, for `patience` seconds."""

    patience = 0.3

    def __init__(self, address: str = "a") -> None:
        super().__init__(address)
        self.ticks = threading.Semaphore(0)

    @property
    def capabilities(self) -> Capabilities:
        return replace(super().capabilities, paced_by_stream=True)

    def read(self, deadline: float) -> Sample | None:
        sample = super().read(deadline)
        return sample if self.ticks.acquire(timeout=self.patience) else None


def test_two_streams_that_wait_cannot_share_a_bus() -> None:
    with pytest.raises(ValueError, match="cannot share a bus"):
        Runtime([(Engine(Streaming("a"), "x"), 1.0), (Engine(Streaming("a"), "y"), 1.0)])


def test_what_shares_the_bus_of_a_stream_is_read_after_it_in_each_of_its_cycles() -> None:
    class SlowStream(Streaming):
        patience = LONG  # a cycle without its tick would be one of the other's alone

        @property
        def capabilities(self) -> Capabilities:
            return replace(super().capabilities, rate=0.1)

    class Slow(Misbehaving):
        @property
        def capabilities(self) -> Capabilities:
            return replace(super().capabilities, rate=0.1)

    stream, behind = SlowStream(), Slow()
    with running(stream, behind) as (pacer, follower):
        for count in range(1, 6):
            stream.ticks.release()
            eventually(lambda count=count: follower.health().samples >= count)  # type: ignore[misc]
            assert pacer.health().samples == count
        stream.patience = 0.01  # for the end
        stream.ticks.release()


def test_what_shares_the_bus_of_a_stream_goes_on_by_our_clock_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slept: list[str] = []

    def sleep(seconds: float) -> None:
        slept.append(threading.current_thread().name)
        time.sleep(seconds)

    clock = SimpleNamespace(monotonic=time.monotonic, sleep=sleep)
    monkeypatch.setattr(threads, "time", clock)
    stream, behind = Streaming(), Misbehaving()
    with running(stream, behind) as (pacer, follower):
        stream.in_open = raising(ConnectionFailed("gone"))
        stream.in_read = raising(ConnectionLost("gone"))
        eventually(lambda: not pacer.connected)
        goal = follower.health().cycles + 20
        eventually(lambda: follower.health().cycles > goal and "io a" in slept)
        assert follower.status.state is S.DISABLED


def test_every_setpoint_is_written_by_the_io_thread() -> None:
    writers: set[str] = set()

    class Watched(Misbehaving):
        def write(self, setpoint: Setpoint) -> None:
            writers.add(threading.current_thread().name)
            super().write(setpoint)

    device = Watched()
    with running(device) as (engine,):
        enable(engine)
        move = engine.submit("move_jp", JointState(position=vector([0.05] * 4)))
        assert move is not None
        assert move.wait(LONG)
    assert writers == {"io a"}


@pytest.mark.usefixtures("soon_stuck")
def test_an_open_that_ignores_its_deadline_is_an_alarm() -> None:
    device = Misbehaving()
    release = threading.Event()

    def hang() -> None:
        release.wait(LONG)

    device.in_open = hang
    with running(device, open_timeout=0.1) as (engine,):
        eventually(lambda: engine.status.detail == "the I/O thread of a is stuck")
        assert device.stopped == 0, "there is nobody to stop yet"
        release.set()
        eventually(lambda: engine.connected)


def test_an_open_that_hangs_while_closing_moves_nothing() -> None:
    """As one whose host name nobody resolves: a device that was never reached was sent no motion."""
    device, release, entered = Misbehaving(), threading.Event(), threading.Event()

    def hang() -> None:
        entered.set()
        release.wait(LONG)

    device.in_open = hang
    runtime = Runtime([(Engine(device, "x"), 1.0)])
    runtime.start()
    try:
        assert entered.wait(LONG)
        with pytest.raises(DeviceError, match="did not end") as caught:
            runtime.close(0.1)
        assert not isinstance(caught.value, StopUnconfirmed)
    finally:
        release.set()


def test_a_motion_before_an_open_that_hangs_is_unconfirmed() -> None:
    device, release, entered = Misbehaving(), threading.Event(), threading.Event()
    engine = Engine(device, "x")
    runtime = Runtime([(engine, 1.0)])

    def hang() -> None:
        entered.set()
        release.wait(LONG)

    runtime.start()
    try:
        enable(engine)
        engine.submit("move_jp", JointState(position=vector([0.5] * 4)))
        eventually(lambda: device.writes, "it moves")
        device.in_open = hang
        device.in_read = raising(ConnectionLost("gone", where="a"))
        assert entered.wait(LONG)
        with pytest.raises(StopUnconfirmed, match="did not end"):
            runtime.close(0.1)
    finally:
        release.set()


def test_python_passes_its_lock_on_in_time_whoever_starts_it() -> None:
    """Beside a busy thread of the program a sensor at 500 Hz was heard at 139 Hz."""
    before = sys.getswitchinterval()
    try:
        for given, wanted in ((0.005, SWITCH_INTERVAL), (0.0001, 0.0001)):
            sys.setswitchinterval(given)
            runtime = Runtime([(Engine(Misbehaving(), "a"), 1.0)])
            runtime.start()
            runtime.close()
            assert sys.getswitchinterval() == pytest.approx(wanted, rel=0.05)
    finally:
        sys.setswitchinterval(before)
