"""Which SYNCs can be those that the kernel sends for us, by their times alone."""

import pytest

from crtk_driver_canopen.bus import BusAddress, CanLink
from crtk_driver_canopen.cycle import SYNC, KernelSync
from crtk_driver_canopen.frames import Frame

PERIOD = 0.01
OURS = Frame(SYNC, b"", own=True)


@pytest.fixture
def bus() -> CanLink:
    link = CanLink(BusAddress("virtual", "nobody sends here", 1_000_000))
    link.open()
    return link


def extra(link: CanLink, times: list[tuple[float, bool]]) -> int:
    """Of SYNCs at some times (s after the begin; whether they were awaited), how many cannot be ours."""
    sync = KernelSync(link, PERIOD)
    sync.start()
    try:
        began = sync._began
        return sum(not sync.is_ours(OURS, began + at, awaited) for at, awaited in times)
    finally:
        sync.stop()
        link.close()


def test_those_of_the_kernel_are_ours_however_late_they_are_read(bus: CanLink) -> None:
    stalled = [(6.0, False)] * 599  # all of six seconds at once, and then in their pace
    assert extra(bus, [*stalled, *((6.0 + PERIOD * n, True) for n in range(1000))]) == 0


def test_those_are_that_come_while_the_first_of_them_was_awaited(bus: CanLink) -> None:
    """Who was held up as he waited does not see that others lie behind it."""
    in_time = [(PERIOD * n, True) for n in range(501)]
    late = [(5.3, True), *[(5.3, False)] * 29]
    assert extra(bus, [*in_time, *late, *((5.3 + PERIOD * n, True) for n in range(1, 1000))]) == 0


def test_twice_as_many_are_not(bus: CanLink) -> None:
    assert extra(bus, [(PERIOD * n / 2, True) for n in range(200)]) >= 95


def test_they_are_told_after_an_hour_of_periods_that_are_too_long(bus: CanLink) -> None:
    alone = [(1.005 * PERIOD * n, True) for n in range(360_000)]
    hour = alone[-1][0]
    assert extra(bus, [*alone, *((hour + PERIOD * n / 2, True) for n in range(1, 100))]) >= 40


def test_what_comes_from_the_bus_is_never_ours(bus: CanLink) -> None:
    sync = KernelSync(bus, PERIOD)
    assert not sync.is_ours(Frame(SYNC, b""), 1.0, awaited=True)
    bus.close()
