"""The report of ``--html`` in a real browser: nothing is fetched, nothing fails, all shows."""

import base64
import json
import os
import shutil
import struct
import subprocess
import time
import zlib
from pathlib import Path

import pytest

from support import EXAMPLES, run

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed"),
]


class Browser:
    """Headless Chromium over its debugging pipe: commands on fd 3, answers on fd 4."""

    def __init__(self, profile: Path):
        read_here, self._out = os.pipe()
        self._in, write_there = os.pipe()
        command = (
            f'exec "$0" --headless --no-sandbox --disable-gpu --no-first-run --disable-sync '
            f"--disable-background-networking --disable-component-update --disable-extensions "
            f'--disable-dev-shm-usage --user-data-dir="$1" --remote-debugging-pipe '
            f"about:blank 3<&{read_here} 4>&{write_there}"
        )
        self._process = subprocess.Popen(
            ["bash", "-c", command, CHROMIUM, str(profile)],
            pass_fds=(read_here, write_there),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(read_here)
        os.close(write_there)
        os.set_blocking(self._in, False)
        self._buffer, self._number, self.events = b"", 0, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]

    _session = None

    def call(self, method, **params):
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def wait_for(self, method):
        while not any(e.get("method") == method for e in self.events):
            self.events.append(self._receive())

    def drain(self, seconds):
        """Collect what still happens for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                self.events.append(self._receive(timeout=0.2))
            except TimeoutError:
                continue

    def _receive(self, timeout=60.0):
        end = time.monotonic() + timeout
        while b"\0" not in self._buffer:
            try:
                data = os.read(self._in, 1 << 20)
            except BlockingIOError:
                if time.monotonic() > end:
                    raise TimeoutError("the browser is silent") from None
                time.sleep(0.01)
                continue
            if not data:
                raise EOFError("the browser went away")
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def close(self):
        os.close(self._out)
        os.close(self._in)
        self._process.terminate()
        self._process.wait(timeout=30)


@pytest.fixture
def browser(tmp_path):
    b = Browser(tmp_path / "profile")
    yield b
    b.close()


def opened(browser, path):
    for domain in ("Network", "Page", "Runtime", "Log"):
        browser.call(f"{domain}.enable")
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=1200,
        height=900,
        deviceScaleFactor=1,
        mobile=False,
    )
    browser.call("Page.navigate", url=path.as_uri())
    browser.wait_for("Page.loadEventFired")
    browser.drain(1.0)


def fetched(browser, path):
    """What the page asked for, apart from itself and what it holds."""
    urls = [
        e["params"]["request"]["url"]
        for e in browser.events
        if e.get("method") == "Network.requestWillBeSent"
    ]
    return [u for u in urls if u != path.as_uri() and not u.startswith(("data:", "blob:"))]


def complaints(browser):
    found = []
    for event in browser.events:
        method, params = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            found.append(params["exceptionDetails"])
        if method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
            found.append(params["args"])
        if method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            found.append(params["entry"])
    return found


def value_of(browser, expression):
    answer = browser.call("Runtime.evaluate", expression=expression, returnByValue=True)
    return answer["result"].get("value")


def pixels(png):
    """Distinct colours of an 8-bit PNG without interlacing, coarsely: whether anything is drawn."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, data, width, height, channels = 8, b"", 0, 0, 0
    while at < len(png):
        size, kind = struct.unpack(">I4s", png[at : at + 8])
        body = png[at + 8 : at + 8 + size]
        if kind == b"IHDR":
            width, height, _, colour = struct.unpack(">IIBB", body[:10])
            channels = {2: 3, 6: 4}[colour]
        elif kind == b"IDAT":
            data += body
        at += 12 + size
    raw = zlib.decompress(data)
    stride = width * channels + 1
    return sum(any(raw[r * stride + 1 : (r + 1) * stride]) for r in range(height)), height


@pytest.mark.parametrize(
    "options",
    [
        (),
        (
            *("--mesh", EXAMPLES / "quadrotor.obj", "--camera", "252.7,252.7,160,120,320,240"),
            *("--by", "scene", "--by", "distance", "--bootstrap", "100"),
            *("--compare", EXAMPLES / "predictions_baseline.csv"),
        ),
    ],
    ids=["plain", "everything"],
)
def test_the_report_opens_without_network_or_errors(options, browser, tmp_path):
    path = tmp_path / "report.html"
    done = run(EXAMPLES / "predictions.csv", EXAMPLES / "gt.csv", *options, "--html", path)
    assert done.returncode == 0, done.stderr
    opened(browser, path)
    assert fetched(browser, path) == []
    assert complaints(browser) == []
    text = value_of(browser, "document.body.innerText")
    for word in ("predictions.csv", "NPE", "2000"):
        assert word in text.replace(",", "").replace("\u202f", ""), word
    assert "NaN" not in text
    assert "undefined" not in text
    # No element is wider than the window: nothing to scroll sideways for.
    assert value_of(browser, "document.documentElement.scrollWidth") <= 1200
    png = base64.b64decode(browser.call("Page.captureScreenshot", format="png")["data"])
    (tmp_path / "report.png").write_bytes(png)
    drawn, height = pixels(png)
    assert height == 900
    assert drawn > 100


def test_the_browser_would_notice(browser, tmp_path):
    path = tmp_path / "bad.html"
    path.write_text(
        "<!doctype html><img src='http://localhost:9/x.png'><script>undefinedName()</script>",
        encoding="utf-8",
    )
    opened(browser, path)
    assert fetched(browser, path) == ["http://localhost:9/x.png"]
    assert any("undefinedName" in json.dumps(c) for c in complaints(browser))


def test_names_are_text_and_not_markup(browser, tmp_path):
    head = "id,qw,qx,qy,qz,tx,ty,tz,scene\n"
    row = "<script>window.hit=1</script>,1,0,0,0,0,0,2,<img src=x onerror=window.hit=1>\n"
    gt, est = tmp_path / "gt.csv", tmp_path / "<b>est<b>.csv"
    gt.write_text(head + row, encoding="utf-8")
    est.write_text(head + row, encoding="utf-8")
    path = tmp_path / "report.html"
    done = run(est, gt, "--by", "scene", "--html", path)
    assert done.returncode == 0, done.stderr
    opened(browser, path)
    assert fetched(browser, path) == []
    assert value_of(browser, "window.hit") is None
