"""The environment of every test: ROS 2 shut in on this machine, no traffic beyond it.

All of it is set when this file is imported, which is before rclpy or any message package is, and
is inherited by the processes that tests start.
"""

import faulthandler
import gc
import ipaddress
import os
import signal
import sys
import tempfile
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch
from zlib import crc32

import pytest
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.workermanage import WorkerController

from crtk_drivers.engine import threads
from crtk_drivers.errors import MissingExtra, wording
from crtk_drivers.front import base
from crtk_drivers.kit import child_process
from crtk_drivers.ros import environment
from crtk_drivers.testing import world
from crtk_sim_backends import process
from rigs import examples, failures, programs, scheduling, spent, warm_start
from rigs.proof_table import proof_table

# What a shell may hold that changes how ROS 2 talks, or with whom.
FOREIGN = (
    "CYCLONEDDS_URI",
    environment.TRANSPORTS,
    *environment.PROFILES,
    "RMW_FASTRTPS_USE_QOS_FROM_XML",
    "RMW_IMPLEMENTATION",
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    "ROS_NAMESPACE",
    "ROS_SECURITY_ENABLE",
    "ROS_STATIC_PEERS",
    "ROS_SUPER_CLIENT",
)
for name in FOREIGN:
    os.environ.pop(name, None)
# `crtk-driver` words its hints as it was started.
for started_by in ("UV_RUN_RECURSION_DEPTH", wording.SCRIPT):
    os.environ.pop(started_by, None)
# Each of a thousand processes would compile all that it imports, which takes as long as to run it.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
environment.share_no_memory()  # tests kill processes, and others must not hang or crash for that
# Domains 1 to 101: their ports lie below those that Linux gives to outgoing connections. No two workers of a
# run have the same: they are counted from that of the process that started them.
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")
FIRST = os.getppid() if WORKER else os.getpid()
os.environ["ROS_DOMAIN_ID"] = str(1 + (FIRST + int(WORKER.removeprefix("gw") or 0)) % 101)
# Without it an int in a float64 field is published as another number.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"

# A script's shell ignores Ctrl-C in what it starts in the background; programs that tests start inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Black boxes of drivers that tests start.
os.environ.setdefault("XDG_STATE_HOME", tempfile.mkdtemp(prefix="crtk_tests_"))

settings.register_profile(
    "dev", deadline=None, max_examples=examples.ALL, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("ci", settings.get_profile("dev"), derandomize=True, database=None)
settings.load_profile("ci" if os.environ.get("CI") else "dev")

NO_SLOW_ONES = "not slow"
"""What `-m` says if nobody says anything else."""


def forbid_traffic_beyond_this_machine(event: str, args: tuple[object, ...]) -> None:
    """Audit hook: let no Python socket of this process reach another machine."""
    if event not in ("socket.connect", "socket.sendto"):
        return
    address = args[1]
    if not isinstance(address, tuple) or len(address) < 2 or not isinstance(address[0], str):
        return  # a Unix or CAN socket, or one that is connected already
    host = address[0]
    if host in ("", "localhost"):
        return
    try:
        allowed = ipaddress.ip_address(host).is_loopback
    except ValueError:
        allowed = False
    # No OSError: the code under test would handle it as an unreachable device.
    if not allowed:
        raise RuntimeError(f"a test tried to reach {host}; tests stay on the loopback addresses")


sys.addaudithook(forbid_traffic_beyond_this_machine)


# Failures inside the contract explain themselves.
pytest.register_assert_rewrite("crtk_drivers.testing.contract")

if world.is_here():
    scheduling.keep_share()

gc.disable()  # until all is collected: in each worker it would take a second to find that all is kept

COLD_START, COLD_CHILD = process._start, child_process._start
"""How simulators, and processes of drivers, are started for users."""


HAVE_ROS = find_spec("rclpy") is not None
if not HAVE_ROS:
    collect_ignore_glob = ["ros/*/*"]


@pytest.fixture(scope="session", autouse=True)
def warm_simulators() -> Iterator[None]:
    """Fork simulators, and processes of drivers, but for tests that use `cold_start`."""
    if world.is_here():
        yield
        return
    server = warm_start.server()
    with (
        patch.object(process, "_start", server.start),
        patch.object(child_process, "_start", server.start_child),
    ):
        yield
    server.close()


@pytest.fixture(scope="session", autouse=True)
def soon_again() -> Iterator[None]:
    """Have drivers try a link again as soon after the tenth time as after the first."""
    with patch.object(threads, "LONGEST_RETRY", threads.FIRST_RETRY):
        yield


@pytest.fixture(scope="session", autouse=True)
def late_threads() -> Iterator[None]:
    """Have no device in FAULT because others had the processor."""
    with patch.object(threads, "STALL_LIMIT", warm_start.LATE_THREAD):
        yield


LATE_SAMPLE = 10.0
"""Seconds, in place of one, that feedback is waited for which is not fresh, unless a test says otherwise."""


@pytest.fixture(scope="session", autouse=True)
def late_samples() -> Iterator[None]:
    """Have no test read in vain because others had the processor."""
    with patch.object(base, "DEFAULT_WAIT", LATE_SAMPLE):
        yield


@pytest.fixture(scope="module")
def cold_start() -> Iterator[None]:
    """Start simulators, and processes of drivers, as users do: for tests of how that is done."""
    with (
        patch.object(process, "_start", COLD_START),
        patch.object(child_process, "_start", COLD_CHILD),
    ):
        yield


@pytest.fixture(scope="module", params=["forked", pytest.param("started", marks=pytest.mark.slow)])
def start(request: pytest.FixtureRequest) -> programs.Start:
    """Start a program: forked, and at night also as users do."""
    return {"forked": warm_start.server().start_text, "started": programs.start}[request.param]


HAVE_UR_RTDE = find_spec("rtde_control") is not None


@contextmanager
def skipping_what_needs_ur_rtde() -> Iterator[None]:
    """Where it cannot be installed, `control: ur_rtde` refuses to start, and says why."""
    try:
        yield
    except MissingExtra as error:
        if HAVE_UR_RTDE or "ur-rtde" not in error.message:
            raise
        pytest.skip(str(error))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, None, None]:
    """Skip where a fixture needs what is not there."""
    with skipping_what_needs_ur_rtde():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, None, None]:
    """Skip where the test itself needs it."""
    with skipping_what_needs_ur_rtde():
        return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Give what tells of a failure all the time that it needs, as pytest-timeout does once it is told.

    A test that fails in its last second would be over time while its frames are looked up, and take its
    worker with it.
    """
    if call.excinfo is not None:
        item.config.hook.pytest_timeout_cancel_timer(item=item)
    if call.when == "teardown":
        item.user_properties.append((spent.CPU, spent.cpu() - item.stash.get(BEGAN, 0.0)))


AFTER_ITS_TIME = 60.0
"""Seconds past its time after which a test ends with its worker: it hangs in a library or its teardown."""

BEGAN = pytest.StashKey[float]()
"""Seconds that this process had computed when a test began."""

STACKS = pytest.StashKey[int]()
"""Descriptor to which a worker writes the stacks of its threads when a test hangs."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option by which CI learns what failed."""
    parser.addoption("--failures", metavar="FILE", help="write what failed to a JSON file")


def pytest_configure(config: pytest.Config) -> None:
    """In a worker, open the file for the stacks of a test that hangs; elsewhere, collect what fails.

    Where the slow tests are left out, so are most examples of each property: they are for the night, too.
    """
    given = getattr(config, "workerinput", None)
    if given is None:
        stderr = os.dup(2)  # what a test writes there itself is captured
        file = config.option.failures
        config.pluginmanager.register(failures.Failures(stderr, Path(file) if file else None))
        if file:
            config.pluginmanager.register(spent.Spent())
    else:
        stacks = failures.stacks_of(given, WORKER)
        config.stash[STACKS] = os.open(stacks, os.O_WRONLY | os.O_CREAT)
    if config.option.markexpr == NO_SLOW_ONES:
        settings.register_profile("quick", settings.default, max_examples=examples.QUICK)
        settings.load_profile("quick")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """End a worker, and tell where it was, whose test `timeout` could not end: all would wait for it."""
    item.stash[BEGAN] = spent.cpu()
    if not hasattr(item.config, "workerinput"):  # somebody looks on, perhaps with a debugger
        return (yield)
    marker = item.get_closest_marker("timeout")
    limit = marker.args[0] if marker else float(item.config.getini("timeout"))
    faulthandler.dump_traceback_later(
        limit + AFTER_ITS_TIME, file=item.config.stash[STACKS], exit=True
    )
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


def pytest_report_header() -> Iterable[str]:
    """Say which ROS domain the tests are in, or that there is no ROS."""
    if HAVE_ROS:
        return [f"ROS 2: domain {os.environ['ROS_DOMAIN_ID']}, this machine only"]
    return ["ROS 2: rclpy not found, the tests that need it are left out"]


@pytest.hookimpl(wrapper=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> Generator[None, int, int]:
    """For all tests, more workers than cores; for a file, as many as there are cores."""
    cores = yield
    is_all = config.args == config.getini("testpaths")
    is_chosen = "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ
    return scheduling.workers(cores) if is_all and not is_chosen else cores


def pytest_configure_node(node: WorkerController) -> None:
    """Tell a worker whether it is one of those that compute."""
    scheduling.invite(node)


def pytest_keyboard_interrupt() -> None:
    """Pass Ctrl-C on."""
    scheduling.interrupt()


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> scheduling.Scheduling:
    """Give the tests that compute to the workers that do."""
    return scheduling.Scheduling(config, log)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Give each worker of a divided run its share, and the processor to others in one that computes."""
    given = getattr(session.config, "workerinput", None)
    if given is not None and given[scheduling.SORT] != scheduling.Sort.ANY:
        scheduling.take_share(given)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Let the first worker compile the tests, and rewrite their assertions, before the others read them."""
    given = getattr(session.config, "workerinput", None)
    if given is None:
        return (yield)
    with scheduling.turn(given):
        return (yield)


@pytest.hookimpl(tryfirst=True)  # before those are left out that are slow
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give time to what computes, in workers that get what others leave; let some cases be quick.

    Of a sweep that is one in `every`, and not the same in all functions of a file; of what takes long, one in
    `scheduling.EVERY`; of a class with a set `quick`, those that are in it.
    """
    sweeps: dict[str, list[tuple[pytest.Item, int]]] = {}
    for item in items:
        name = item.nodeid
        if not HAVE_UR_RTDE and "ur_rtde" in name.partition("[")[2]:
            item.add_marker(pytest.mark.skip("ur-rtde is not installed"))
        marks = {mark.name: mark for mark in reversed(list(item.iter_markers()))}
        if scheduling.is_of_a_world(name) and "real_time" not in marks:
            item.add_marker(pytest.mark.world)
        if scheduling.computes(name) and "timeout" not in marks:
            item.add_marker(pytest.mark.timeout(scheduling.LONGEST_COMPUTATION))
        quick = getattr(getattr(item, "cls", None), "quick", None)
        if quick is not None and item.name.partition("[")[0] not in quick:
            item.add_marker("slow")
        elif "slow" not in marks and ("sweep" in marks or scheduling.takes_long(name)):
            # What is slow anyway is not the quick one of its function.
            every = marks["sweep"].args[0] if "sweep" in marks else scheduling.EVERY
            sweeps.setdefault(name.partition("[")[0], []).append((item, every))
    for function, cases in sweeps.items():
        every = min(cases[0][1], len(cases))
        first = crc32(function.rpartition("::")[2].encode()) % every
        for number, (item, _) in enumerate(cases):
            if number % every != first:
                item.add_marker("slow")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what the bench found of arms with defects."""
    lines = list(proof_table(terminalreporter.stats.get("passed", [])))
    if lines:
        terminalreporter.section("bench: figure, without a defect, with it")
        terminalreporter.write_line("\n".join(lines))


def pytest_collection_finish() -> None:
    """Spare the collector what the thousands of tests hold: it stopped all threads for half a second.

    An I/O thread that shares the process then starves a controller's watchdog, which is not what is tested.
    """
    gc.freeze()  # what is garbage among it, too: to find that takes half a second of CPU
    gc.enable()
