"""The latency timer of an adapter: read, lowered where that is permitted, else told how to."""

from pathlib import Path

import pytest

from crtk_drivers.kit import latency

DEVICE = Path("/dev/ttyUSB3")


@pytest.fixture
def timer(tmp_path):
    file = tmp_path / "ttyUSB3" / "latency_timer"
    file.parent.mkdir()
    file.write_text("16\n")
    return file


def nothing():
    """A port whose driver ignores the wish for low latency."""


def refuse_writing(monkeypatch):
    def refused(*_):
        raise PermissionError("not root")

    monkeypatch.setattr(Path, "write_text", refused)


def test_read(tmp_path, timer):
    assert latency.read(DEVICE, tmp_path) == 16
    assert latency.read(Path("/dev/ttyACM0"), tmp_path) is None
    timer.write_text("soon")
    assert latency.read(DEVICE, tmp_path) is None


def test_an_adapter_without_a_timer(tmp_path):
    assert latency.lower(DEVICE, nothing, tmp_path) == latency.Latency(None, "")


def test_lowered_where_the_file_can_be_written(tmp_path, timer):
    assert latency.lower(DEVICE, nothing, tmp_path) == latency.Latency(1, "")
    assert timer.read_text() == "1"


def test_lowered_by_the_port_where_it_cannot(tmp_path, timer, monkeypatch):
    refuse_writing(monkeypatch)

    def ask():
        with timer.open("w") as file:
            file.write("1")

    assert latency.lower(DEVICE, ask, tmp_path) == latency.Latency(1, "")


@pytest.mark.parametrize("error", [OSError("no"), ValueError("not supported")])
def test_the_remedy_where_nothing_helps(tmp_path, timer, monkeypatch, error):
    refuse_writing(monkeypatch)

    def ask():
        raise error

    found = latency.lower(DEVICE, ask, tmp_path)
    assert found.milliseconds == 16
    assert "udev" in found.remedy
    assert 'ATTR{latency_timer}="1"' in found.remedy
    assert str(timer) in found.remedy


def test_nothing_is_written_that_is_right(tmp_path, timer, monkeypatch):
    timer.write_text("1\n")
    refuse_writing(monkeypatch)
    assert latency.lower(DEVICE, nothing, tmp_path) == latency.Latency(1, "")
