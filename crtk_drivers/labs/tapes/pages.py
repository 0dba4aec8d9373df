"""A recording as a page and as a picture."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from crtk_drivers.labs.tapes.contents import Contents
from crtk_drivers.labs.tapes.drawing import draw, height_of
from crtk_drivers.labs.tapes.figures import Figures, figures_of
from crtk_drivers.labs.tapes.png_canvas import PngCanvas
from crtk_drivers.labs.tapes.svg_canvas import svg_of
from crtk_drivers.labs.verdicts.html_page import details, page, table, text
from crtk_drivers.recording import Recording
from crtk_drivers.recording.foreign import Foreign


def all_figures(contents: Contents, begin: float = 0.0) -> list[Figures]:
    """Return the pictures of each device in a recording, from `begin` (s) on."""
    end = max(contents.seconds, begin + 1e-3)
    return [figures_of(device, begin, end) for _, device in sorted(contents.devices.items())]


def html(
    recording: Recording | Foreign, contents: Contents, figures: list[Figures], told: str
) -> str:
    """Return the page: one file, no script. `told` is what is to be known of the file."""
    return page(
        f"Recording: {recording.path.name}", "".join(_parts(recording, contents, figures, told))
    )


def png(figures: list[Figures]) -> bytes:
    """Return the picture.

    Raises:
        MissingExtra: Pillow is not installed.
    """
    canvas = PngCanvas(sum(map(height_of, figures)) + 10)
    top = 0.0
    for each in figures:
        draw(canvas, each, top)
        top += height_of(each)
    return canvas.png


def _parts(
    recording: Recording | Foreign, contents: Contents, figures: list[Figures], told: str
) -> Iterator[str]:
    began = datetime.fromtimestamp(contents.began / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    yield f"<h1>{text(recording.path.name)}</h1>"
    yield f'<p class="faint">{text(began)} · {contents.seconds:.1f} s</p>'
    if told:
        yield f'<div class="box open">{text(told)}.</div>'
    if contents.note:
        yield f'<div class="box open">{text(contents.note)}.</div>'
    for topic, number in contents.left_out.items():
        yield f'<div class="box open">{text(topic)}: one message in {number} is drawn.</div>'
    for name, texts in recording.metadata:
        why = texts.get("why", "")
        if why and why != "recorded":
            yield f'<div class="box bad"><b>{text(name)}:</b> {text(why)}</div>'
    for each in figures:
        yield svg_of(each, each.namespace)
    if not figures:
        yield "<p>It holds nothing that is drawn.</p>"
    for device in contents.devices.values():
        if device.refusals:
            rows = [(f"{at:.3f}", command, why) for at, command, why in device.refusals[:1000]]
            heading = f"{len(device.refusals)} refusals of {device.namespace}"
            yield details(heading, table(("s", "command", "reason"), rows, right=(0,)))
        reasons = [(f"{at:.3f}", state, why) for at, state, why in device.states if why]
        if reasons:
            heading = f"States of {device.namespace}, and why"
            yield details(heading, table(("s", "state", "why"), reasons[:1000], right=(0,)))
    rows = [(topic, kind, str(recording.counts[topic])) for topic, kind in recording.topics.items()]
    yield details(f"{len(rows)} topics", table(("topic", "type", "messages"), rows, right=(2,)))
    for name, texts in recording.metadata:
        yield details(name, table(("", ""), list(texts.items())))
    for attached in recording.attachments:
        if len(attached.data) < 100_000:
            shown = text(attached.data.decode("utf-8", "replace"))
            yield details(attached.name, f"<pre>{shown}</pre>")
