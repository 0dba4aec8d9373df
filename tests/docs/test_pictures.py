"""The pictures of the docs: the architecture shows what there is; the others are light, and can be taken."""

import re
import struct
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import numpy as np
import pytest

from bench import png, screenshots

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def test_the_architecture_shows_every_kind_of_device_and_has_no_empty_text():
    texts = [
        "".join(each.itertext())
        for each in ET.parse(DOCS / "architecture.svg").iter()
        if each.tag.endswith("}text")
    ]
    assert all(text.strip() for text in texts)
    for kind in ("Arms", "Drives", "Grippers, forces", "Trackers, hands", "Virtual arm"):
        assert kind in texts
    assert sum(text.startswith("Simulated ") for text in texts) == 4


def test_every_picture_is_light_shown_by_a_page_and_taken_by_the_command():
    pictures = {path.name: path.stat().st_size for path in DOCS.glob("*.png")}
    assert set(pictures) == {f"{shot.name}.png" for shot in screenshots.SHOTS}
    assert max(pictures.values()) <= screenshots.LARGEST
    pages = [ROOT / "README.md", *DOCS.glob("*.md")]
    shown = {name for page in pages for name in re.findall(r"\]\(([^)]*\.png)\)", page.read_text())}
    assert {Path(name).name for name in shown} == set(pictures)


def decoded(data: bytes) -> np.ndarray:
    """The pixels of a PNG file as we write it."""
    chunks, at = {}, 8
    while at < len(data):
        (size,) = struct.unpack_from(">I", data, at)
        body = data[at + 8 : at + 8 + size]
        assert struct.unpack_from(">I", data, at + 8 + size)[0] == zlib.crc32(
            data[at + 4 : at + 8 + size]
        )
        chunks[data[at + 4 : at + 8]] = body
        at += 12 + size
    width, height = struct.unpack_from(">II", chunks[b"IHDR"])
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, width + 1)
    assert not rows[:, 0].any()
    return np.frombuffer(chunks[b"PLTE"], np.uint8).reshape(-1, 3)[rows[:, 1:]]


def test_few_colours_are_kept_as_they_are():
    pixels = np.random.default_rng(1).integers(0, 4, (30, 40, 3)).astype(np.uint8) * 80
    assert (decoded(png.encode(pixels)) == pixels).all()


def test_many_colours_become_the_nearest_of_256():
    ramp = np.linspace(0, 255, 64).astype(np.uint8)
    pixels = np.stack(np.meshgrid(ramp, ramp[::-1]), axis=-1)
    pixels = np.concatenate([pixels, np.full((64, 64, 1), 128, np.uint8)], axis=2)
    found = decoded(png.encode(pixels))
    assert len(np.unique(found.reshape(-1, 3), axis=0)) <= 256
    assert np.abs(found.astype(int) - pixels).max() < 24
    assert np.abs(found.astype(int) - pixels).mean() < 6


def test_without_a_browser_the_command_says_which_it_wants(monkeypatch):
    monkeypatch.setattr(screenshots, "BROWSER", None)
    told = []
    assert screenshots.main([], told.append) == 1
    assert "install one of chromium" in told[0]


def test_an_unknown_picture_is_refused(capsys):
    with pytest.raises(SystemExit):
        screenshots.main(["moon"])
    assert "there is no picture moon" in capsys.readouterr().err
