"""A driver that is ended for a relay is there again where the relay cannot be had."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.labs.bench import conductor
from crtk_drivers.labs.bench.conducting import DeviceOrder
from crtk_drivers.plugins import DeviceLink


@pytest.mark.slow
def test_without_a_relay_its_device_has_its_driver_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(link: DeviceLink) -> None:
        raise ConnectionFailed("it cannot listen", where="relay")

    monkeypatch.setattr(conductor, "RelayProcess", fails)
    order = DeviceOrder("servos", "dynamixel", {"arm": "arm6"}, True, {}, None)
    lost: list[str] = []
    with (
        tempfile.TemporaryDirectory() as doors,
        conductor.hosted(order, Path(doors), tmp_path, (), lambda: lost.append("it")) as host,
    ):
        host.about()
        host.is_touched = True
        with pytest.raises(ConnectionFailed, match="it cannot listen"):
            host.put_relay()
        assert host.door.call("glance").connected
        host.settle()
    assert not lost
