"""The report of a run, made of `Run` only: a page of HTML, JUnit XML, and lines for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Final

from crtk_drivers.labs.bench.acquisition import SAFETY_LETTERS
from crtk_drivers.labs.bench.acquisition import Suite as Named
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.history import Key, key_of
from crtk_drivers.labs.bench.results import DeviceResult, Measured, Result, Run
from crtk_drivers.labs.tapes.svg_canvas import svg_of_plot
from crtk_drivers.labs.verdicts.html_page import Cell, badge, details, page, table, text
from crtk_drivers.labs.verdicts.judging import Plot, Series, Verdict, number
from crtk_drivers.labs.verdicts.junit import Case, Suite, junit_xml

KINDS: Final[Mapping[Verdict, str]] = {
    Verdict.PASS: "good",
    Verdict.FAIL: "bad",
    Verdict.INCONCLUSIVE: "open",
    Verdict.SKIPPED: "none",
}

WORST_FIRST: Final = (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS, Verdict.SKIPPED)

EXIT_CODES: Final[Mapping[Verdict, int]] = {
    Verdict.PASS: 0,
    Verdict.FAIL: 1,
    Verdict.INCONCLUSIVE: 3,
    Verdict.SKIPPED: 3,
}

ABORTED: Final = 4
"""Exit code of a run that did not come to its end, or cannot be kept."""

NO_SAFETY_SYSTEM: Final = (
    "The bench is no safety system: what it watches, it watches by a program on one machine. "
    "An emergency stop within reach, and nobody within the arm's, are not replaced by it."
)


def exit_code(run: Run, *, inconclusive_ok: bool = False, regression_fails: bool = False) -> int:
    """Return the exit code: 0 passed, 1 failed, 3 something is open, 4 it did not come to its end."""
    if not run.complete:
        return ABORTED
    regressed = any(found.regressed for _, test in run.tests for found in test.measurements)
    if regression_fails and regressed:
        return 1
    if run.verdict is Verdict.INCONCLUSIVE and inconclusive_ok:
        return 0
    return EXIT_CODES[run.verdict]


def summary(run: Run) -> str:
    """Return a line: ``12 passed, 1 failed, 2 inconclusive, 5 skipped in 31 s``."""
    counts = Counter(test.verdict for _, test in run.tests)
    told = [f"{counts[verdict]} {word}" for verdict, word in _WORDS.items() if counts[verdict]]
    return f"{', '.join(told) or 'nothing was tested'} in {run.seconds:.0f} s"


_WORDS: Final = {
    Verdict.PASS: "passed",
    Verdict.FAIL: "failed",
    Verdict.INCONCLUSIVE: "inconclusive",
    Verdict.SKIPPED: "skipped",
}


def junit(run: Run) -> str:
    """Return JUnit XML: a suite for each device, and one named `bench` for the run itself."""
    suites = [
        Suite(
            device.name,
            tuple(_case(device, test) for test in device.tests),
            {
                "plugin": device.plugin,
                "address": device.address,
                "simulated": str(device.simulated).lower(),
                **device.firmware,
            },
            run.started,
        )
        for device in run.devices
    ]
    whole = Verdict.PASS if run.complete else Verdict.INCONCLUSIVE
    own = Case("the run came to its end", "bench", run.seconds, whole, run.ended_by)
    suites.append(Suite("bench", (own,), {**run.machine, "lab": run.lab}, run.started))
    return junit_xml(suites)


def _case(device: DeviceResult, test: Result) -> Case:
    figures = "\n".join(
        f"{found.id}{f' [{found.part}]' if found.part else ''}: {found.told}"
        + (f"; REGRESSED: {found.regressed}" if found.regressed else "")
        for found in test.measurements
    )
    name = f"{test.id} {test.name}"
    return Case(
        name, f"{device.name}.{test.group}", test.seconds, test.verdict, test.reason, figures
    )


def html(run: Run, earlier: Mapping[Key, list[float]] | None = None) -> str:
    """Return the page.

    Args:
        run: what was found.
        earlier: values of earlier runs, drawn beside the figures.
    """
    return page(f"Bench: {run.lab}", "".join(_parts(run, earlier or {})))


def _parts(run: Run, earlier: Mapping[Key, list[float]]) -> Iterator[str]:
    yield f"<h1>{text(run.lab)} {badge(run.verdict, KINDS[run.verdict])}</h1>"
    suite = f"suite {run.suite}" if run.suite in set(Named) else run.suite
    when = run.started.replace("T", " ").replace("+00:00", " UTC")
    yield f'<p class="faint">{text(when)} · {text(suite)} · {text(summary(run))}</p>'
    if not run.complete:
        why = text(run.ended_by or "it was still running, or was killed")
        yield f'<div class="box bad"><b>This run did not come to its end:</b> {why}.</div>'
    yield _matrix(run)
    yield from _attention(run)
    for device in run.devices:
        yield from _device(device, earlier)
    yield "<h2>About this run</h2>"
    rows = [("lab file", run.lab_file), ("its sha256", run.lab_file_sha256), *run.machine.items()]
    yield table(("", ""), rows)
    yield f'<p class="faint">{text(NO_SAFETY_SYSTEM)}</p>'


def _matrix(run: Run) -> str:
    headings = ("device", "", *(word for word in _WORDS.values()), "regressed")
    rows = []
    for device in run.devices:
        counts = Counter(test.verdict for test in device.tests)
        regressed = sum(
            bool(found.regressed) for test in device.tests for found in test.measurements
        )
        name = Cell(f'<a href="#{text(device.name)}">{text(device.name)}</a>')
        figures = [str(counts[verdict] or "") for verdict in _WORDS]
        rows.append((name, badge(device.verdict, KINDS[device.verdict]), *figures, regressed or ""))
    return table(headings, rows, right=range(2, 7))


def _attention(run: Run) -> Iterator[str]:
    """Yield what failed, what is open, and what became worse."""
    for verdict, title in ((Verdict.FAIL, "Failed"), (Verdict.INCONCLUSIVE, "Not decided")):
        found = [(device, test) for device, test in run.tests if test.verdict is verdict]
        if not found:
            continue
        yield f"<h2>{title}</h2>"
        for device, test in found:
            link = Cell(f'<a href="#{text(device.name)}-{text(test.id)}">{text(test.id)}</a>')
            yield (
                f'<div class="box {KINDS[verdict]}"><b>{text(device.name)} · {link} '
                f"{text(test.name)}</b><br>{text(test.reason)}</div>"
            )
    worse = [
        (device.name, test.id, found.title, found.part, found.regressed)
        for device, test in run.tests
        for found in test.measurements
        if found.regressed
    ]
    if worse:
        yield "<h2>Worse than it was</h2>"
        yield table(("device", "test", "", "", "now, and usually"), worse)


def _device(device: DeviceResult, earlier: Mapping[Key, list[float]]) -> Iterator[str]:
    yield f'<h2 id="{text(device.name)}">{text(device.name)}</h2>'
    kind = "simulated" if device.simulated else "real"
    address = device.address.removeprefix(device.plugin).strip()
    told = ", ".join(part for part in (device.plugin, kind, address) if part)
    yield f'<p class="faint">{text(told)}</p>'
    if device.trouble:
        yield f'<div class="box open">{text(device.trouble)}</div>'
    if device.firmware:
        yield details("What it says of itself", table(("", ""), device.firmware.items()))
    skipped = [test for test in device.tests if test.verdict is Verdict.SKIPPED]
    order = {verdict: index for index, verdict in enumerate(WORST_FIRST)}
    for test in sorted(device.tests, key=lambda test: order[test.verdict]):
        if test.verdict is not Verdict.SKIPPED:
            yield _test(device, test, earlier)
    if skipped:
        rows = [(test.id, test.name, test.reason) for test in skipped]
        yield details(f"{len(skipped)} skipped", table(("test", "", "why"), rows))


def _test(device: DeviceResult, test: Result, earlier: Mapping[Key, list[float]]) -> str:
    rows = []
    plots = "".join(
        svg_of_plot(
            Plot(
                plot.title,
                plot.x_label,
                plot.y_label,
                tuple(Series(line.name, line.x, line.y) for line in plot.series),
            )
        )
        for plot in test.plots
    )
    for found in test.measurements:
        rows.append(_row(found))
        values = earlier.get(key_of(device, found), [])
        if len(values) > 1 and found.value is not None:
            plots += svg_of_plot(_trend(found, [*values, found.value]))
    body = table(("", "", "value", "95 %", "bound", "from", "verdict"), rows, right=(2, 3, 4))
    if test.reason:
        body = Cell(f"<p>{text(test.reason)}</p>{body}")
    summary_line = Cell(
        f'{badge(test.verdict, KINDS[test.verdict])} <b id="{text(device.name)}-{text(test.id)}">'
        f'{text(test.id)}</b> {text(test.name)} <span class="faint">{text(_does(test.id))} '
        f"{test.seconds:.1f} s</span>"
    )
    raw = f'<p class="faint">raw data: {text(test.recording)}</p>' if test.recording else ""
    return details(summary_line, body + plots + raw, is_open=test.verdict is Verdict.FAIL)


def _does(test_id: str) -> str:
    for test in TESTS:
        if test.id == test_id:
            return f"[{SAFETY_LETTERS[test.acquisition.safety]}] {test.acquisition.summary}"
    return ""


def _row(found: Measured) -> tuple[object, ...]:
    value = "not measured" if found.value is None else f"{number(found.value)} {found.unit}"
    spread = ""
    if found.lower is not None and found.upper is not None and found.lower < found.upper:
        spread = f"{number(found.lower)} to {number(found.upper)}"
    bound = ""
    if found.bound is not None and found.comparison != "told":
        bound = f"{found.comparison} {number(found.bound)}"
        if found.comparison == "within" and found.bound_lower is not None:
            bound = f"{number(found.bound_lower)} to {number(found.bound)}"
    verdict = badge(found.verdict, KINDS[found.verdict]) if bound or found.value is None else ""
    marks = [
        mark
        for mark, is_so in (("marginal", found.marginal), ("REGRESSED", found.regressed))
        if is_so
    ]
    told = Cell(f"{verdict} {text(', '.join(marks))}")
    where = found.bound_from if bound else found.why
    title = Cell(f'<span title="{text(found.id)}">{text(found.title)}</span>')
    return title, found.part, value, spread, bound, where, told


def _trend(found: Measured, values: list[float]) -> Plot:
    title = f"{found.title} {found.part}".strip()
    runs = tuple(float(index - len(values) + 1) for index in range(len(values)))
    return Plot(f"{title}, over runs", "runs ago", found.unit, (Series("", runs, tuple(values)),))
