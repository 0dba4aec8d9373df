"""``crtk-driver echo`` and ``crtk-driver call``: what is on a topic, and what a service answers, as YAML."""

from __future__ import annotations

import queue
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import typer
import yaml

from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.client import RemoteDevice
from crtk_drivers.commands import Payload, find, is_name
from crtk_drivers.errors import ConfigError, DataTimeout
from crtk_drivers.geometry.conversions import as_pose

WAITING = 64
"""Messages that wait to be printed; the oldest make place for new ones."""
_DIGITS = 9


class _Dumper(yaml.SafeDumper):
    """Writes numbers with as many digits as are worth reading."""


_Dumper.add_representer(
    float,
    lambda dumper, value: yaml.SafeDumper.represent_float(dumper, float(f"{value:.{_DIGITS}g}")),
)


def as_yaml(value: Any) -> str:
    """Return plain data as YAML, lists of numbers in one line each."""
    return yaml.dump(
        value,
        Dumper=_Dumper,
        default_flow_style=None,
        sort_keys=False,
        width=1_000_000,
        allow_unicode=True,
    )


def echo(device: RemoteDevice, topic: str, once: bool, rate: float | None, timeout: float) -> int:
    """Print the messages of a topic until Ctrl-C, and then how many came.

    Args:
        device: whose topic it is.
        topic: see `RemoteDevice.on_message`.
        once: end after the first.
        rate: print at most so many in a second; None: all.
        timeout: seconds to wait for the first with `once`.

    Raises:
        ConnectionFailed: nobody publishes it.
        DataTimeout: nothing came.
    """
    from crtk_drivers.ros.plain import plain as plain_data

    arrived: queue.Queue[Any] = queue.Queue()
    count, began, due = 0, time.monotonic(), 0.0

    def listen(message: Any) -> None:
        nonlocal count, due
        count += 1
        now = time.monotonic()
        if now < due or arrived.qsize() >= WAITING:
            return
        due = now + (1.0 / rate if rate else 0.0)
        arrived.put(plain_data(message))

    with ExitStack() as at_end:
        try:
            at_end.callback(device.on_message(topic, listen))
            if once:
                typer.echo(as_yaml(_first(arrived, device, topic, timeout)), nl=False)
                return 0
            while True:
                typer.echo(f"{as_yaml(arrived.get())}---")
        except KeyboardInterrupt:
            took = time.monotonic() - began
            ERR.print(f"{count} values of {plain(topic)} in {took:.1f} s: {count / took:.1f} Hz")
            return 0


def _first(arrived: queue.Queue[Any], device: RemoteDevice, topic: str, timeout: float) -> Any:
    try:
        return arrived.get(timeout=timeout)
    except queue.Empty:
        raise DataTimeout(
            f"nothing came on {topic} in {timeout:g} s",
            where=device.namespace,
            remedy="It may be told when it changes only. Without --once, echo waits until Ctrl-C.",
        ) from None


def call(device: RemoteDevice, service: str, arguments: Sequence[str], timeout: float) -> int:
    """Call a service, print its answer, and return 1 if that is a refusal.

    Raises:
        ConnectionFailed: nobody serves it.
        ConfigError: the arguments cannot be used.
        DataTimeout: no answer in time.
    """
    answer = device.call(service, _fields(service, arguments), timeout)
    failed = answer.get("success", answer.get("result")) is False
    OUT.print(as_yaml(answer), end="", markup=False, soft_wrap=True)
    return 1 if failed else 0


def _fields(service: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Return the fields of the request: ``a.b=1`` as they are typed, bare numbers as kinematics take them."""
    fields: dict[str, Any] = {}
    numbers: list[float] = []
    for text in arguments:
        path, equals, value = text.partition("=")
        if not equals:
            numbers.append(number(text))
            continue
        inside = fields
        *outer, last = path.split(".")
        for name in outer:
            inside = inside.setdefault(name, {})
        inside[last] = yaml.safe_load(value)
    return fields | _kinematics(service, numbers)


def number(text: str) -> float:
    """Return a number that was typed.

    Raises:
        ConfigError: it is none.
    """
    try:
        return float(text)
    except ValueError:
        raise ConfigError("not a number", where=text, remedy="See --help.") from None


def _kinematics(service: str, numbers: list[float]) -> dict[str, Any]:
    payload = find(service).payload if is_name(service) else None
    if not numbers:
        return {}
    if payload is Payload.FORWARD_KINEMATICS:
        return {"jp": numbers}
    if payload is not Payload.INVERSE_KINEMATICS:
        raise ConfigError(
            "takes no bare numbers", where=service, remedy="Name the field: field=value."
        )
    try:
        pose = as_pose(numbers[:7])
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"the first seven numbers are no pose: {error}",
            where=service,
            remedy="Give x y z in m and the quaternion x y z w, then the joints to start from.",
        ) from error
    position = dict(zip("xyz", pose.position.tolist(), strict=True))
    orientation = dict(zip("xyzw", pose.orientation.tolist(), strict=True))
    return {"cp": {"position": position, "orientation": orientation}, "jp": numbers[7:]}
