"""Clocks of a world, in place of those of `time` and `datetime`."""

from __future__ import annotations

import copyreg
import datetime
import time
from datetime import date as real_date
from datetime import datetime as real_datetime
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.testing.world.machine.kernel import EPOCH, NS, running

_real_monotonic_ns: Final = time.monotonic_ns
_real_time_ns: Final = time.time_ns
_real_localtime: Final = time.localtime
_real_gmtime: Final = time.gmtime
_real_asctime: Final = time.asctime
_real_strftime: Final = time.strftime


def monotonic_ns(*_: object) -> int:
    """As `time.monotonic_ns`. It takes what a method is given, since a builtin in a class is no method."""
    kernel = running.kernel
    return _real_monotonic_ns() if kernel is None else kernel.read_clock()


def monotonic(*_: object) -> float:
    """As `time.monotonic`."""
    return monotonic_ns() / NS


def time_ns(*_: object) -> int:
    """As `time.time_ns`."""
    kernel = running.kernel
    return _real_time_ns() if kernel is None else EPOCH + kernel.read_clock() + kernel.wall_offset


def wall(*_: object) -> float:
    """As `time.time`."""
    return time_ns() / NS


def sleep(seconds: float) -> None:
    """As `time.sleep`."""
    if seconds < 0:
        raise ValueError("sleep length must be non-negative")
    kernel = running.kernel
    if kernel is None:
        return  # at import nothing is there to be waited for
    end = kernel.now + int(seconds * NS)
    if end == kernel.now:
        kernel.give_way()
    while kernel.now < end:
        kernel.wait((), end)


def localtime(seconds: float | None = None) -> time.struct_time:
    """As `time.localtime`."""
    return _real_localtime(wall() if seconds is None else seconds)


def gmtime(seconds: float | None = None) -> time.struct_time:
    """As `time.gmtime`."""
    return _real_gmtime(wall() if seconds is None else seconds)


def asctime(*at: Any) -> str:
    """As `time.asctime`."""
    return _real_asctime(*(at or (localtime(),)))


def ctime(seconds: float | None = None) -> str:
    """As `time.ctime`."""
    return _real_asctime(localtime(seconds))


def strftime(form: str, *at: Any) -> str:
    """As `time.strftime`."""
    return _real_strftime(form, *(at or (localtime(),)))


class _OfTheirs(type):
    """What makes objects of its first base, the real type, and takes them for its own."""

    @override
    def __call__(cls, *arguments: Any, **more: Any) -> Any:
        return cls.__bases__[0](*arguments, **more)

    @override
    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, cls.__bases__[0])

    @override
    def __subclasscheck__(cls, other: type) -> bool:
        return issubclass(other, cls.__bases__[0])


class Date(real_date, metaclass=_OfTheirs):
    """As `datetime.date`."""

    @classmethod
    @override
    def today(cls) -> Any:
        """Return the day in the world."""
        return real_date.fromtimestamp(wall())


class Datetime(real_datetime, metaclass=_OfTheirs):
    """As `datetime.datetime`."""

    @classmethod
    @override
    def now(cls, tz: datetime.tzinfo | None = None) -> Any:
        """Return the time in the world."""
        return real_datetime.fromtimestamp(wall(), tz)

    @classmethod
    @override
    def today(cls) -> Any:
        """Return the local time in the world."""
        return cls.now()

    @classmethod
    @override
    def utcnow(cls) -> Any:
        """Return the time in the world in UTC, without a time zone."""
        return cls.now(datetime.UTC).replace(tzinfo=None)


def _reduce(value: Any) -> tuple[Any, ...]:
    """Return how to make a date again: by the name of its type, which is that of ours."""
    named, *rest = value.__reduce_ex__(4)
    return (_REPLACED[named], *rest)


_REPLACED: Final[dict[type, type]] = {real_date: Date, real_datetime: Datetime}


def let_dates_be_copied() -> None:
    """Let dates be pickled and copied, though the names of their types are those of ours by now."""
    for theirs, ours in _REPLACED.items():
        ours.__module__, ours.__name__, ours.__qualname__ = "datetime", *2 * (theirs.__name__,)
        copyreg.pickle(theirs, _reduce)
