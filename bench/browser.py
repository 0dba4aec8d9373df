"""Chromium without a window, over the two pipes of its DevTools protocol: for tests and pictures."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

PATIENCE: Final = 60.0
"""Seconds for what a page takes its time for."""

NAMES: Final = ("chromium", "chromium-browser", "google-chrome", "chrome")
BROWSER: Final = os.environ.get("CRTK_BROWSER") or next(
    filter(None, map(shutil.which, NAMES)), None
)
"""Path of the browser; None where there is none."""

_FLAGS: Final = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--hide-scrollbars",
    "--no-first-run",
)

_DECODE: Final = """(async () => {
  const file = Uint8Array.from(atob("%s"), (each) => each.charCodeAt(0));
  const { width, height } = await createImageBitmap(new Blob([file]));
  const canvas = new OffscreenCanvas(width, height);
  const pen = canvas.getContext("2d");
  pen.drawImage(await createImageBitmap(new Blob([file])), 0, 0);
  const { data } = pen.getImageData(0, 0, width, height);
  let text = "";
  for (let i = 0; i < data.length; i += 8192) text += String.fromCharCode(...data.subarray(i, i + 8192));
  return { width, height, data: btoa(text) };
})()"""


class Browser:
    """One browser with one page. A context manager.

    Args:
        profile: an empty folder for what it keeps.

    Attributes:
        problems: exceptions and errors of the page.
    """

    def __init__(self, profile: Path) -> None:
        if BROWSER is None:
            raise FileNotFoundError(
                f"no browser: install chromium, or give the path of one in CRTK_BROWSER ({', '.join(NAMES)})"
            )
        to_browser, self._requests = os.pipe()
        self._answers, from_browser = os.pipe()
        # The protocol is on the file descriptors 3 and 4.
        command = f'exec "$0" "$@" 3<&{to_browser} 4>&{from_browser}'
        arguments = [*_FLAGS, f"--user-data-dir={profile}", "about:blank"]
        self._log = open(profile / "browser.log", "w+")  # noqa: SIM115 - closed below
        self._process = subprocess.Popen(
            ["bash", "-c", command, BROWSER, *arguments],
            pass_fds=(to_browser, from_browser),
            stdout=self._log,
            stderr=self._log,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._count = 0
        self._session: str | None = None
        self.problems: list[Any] = []
        (target,) = (
            each for each in self.call("Target.getTargets")["targetInfos"] if each["type"] == "page"
        )
        attached = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(960, 600)

    def resize(self, width: int, height: int, dark: bool = False) -> None:
        """Be a window of that many pixels, on a light or a dark desktop; narrow ones are phones."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 500,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def call(self, method: str, **parameters: Any) -> Any:
        """Do a request of the protocol and return its result."""
        self._count += 1
        request = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            request["sessionId"] = self._session
        os.write(self._requests, json.dumps(request).encode() + b"\0")
        while True:
            message = self._read()
            if message.get("id") == self._count:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            piece = os.read(self._answers, 1 << 16)
            assert piece, f"the browser has ended: {Path(self._log.name).read_text()[-2000:]}"
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        found: dict[str, Any] = json.loads(message)
        return found

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        match message["method"]:
            case "Runtime.exceptionThrown":
                self.problems.append(parameters["exceptionDetails"])
            case "Log.entryAdded" if parameters["entry"]["level"] == "error":
                self.problems.append(parameters["entry"])

    def open(self, url: str) -> None:
        """Open a page, and wait until it is live."""
        self.call(
            "Page.navigate", url="about:blank"
        )  # an address that differs by its fragment is no new page
        self.call("Page.navigate", url=url)
        self.until("document.getElementById('link')?.textContent === 'live'")

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression, awaited."""
        found = self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, script: str) -> Any:
        """Wait until an expression is true, and return its value."""
        deadline = time.monotonic() + PATIENCE
        while not (found := self.run(script)):
            if time.monotonic() > deadline:
                raise TimeoutError(f"not within {PATIENCE:g} s: {script}")
            time.sleep(0.05)
        return found

    def pixels(self) -> NDArray[np.uint8]:
        """Return what it shows: (height, width, 3)."""
        shot = self.call("Page.captureScreenshot", format="png", optimizeForSpeed=True)["data"]
        found = self.run(_DECODE % shot)
        rgba = np.frombuffer(base64.b64decode(found["data"]), np.uint8)
        return rgba.reshape(found["height"], found["width"], 4)[:, :, :3]

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(OSError):
            self.call("Browser.close")
        for fd in (self._requests, self._answers):
            os.close(fd)
        try:
            self._process.wait(PATIENCE)
        finally:
            self._process.kill()
            self._process.wait()
            self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
