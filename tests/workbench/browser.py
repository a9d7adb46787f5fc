"""A real browser for the tests: chromium by its driver, spoken to in W3C WebDriver, with nothing in between."""

import base64
import json
import os
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path

CHROMIUM = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
DRIVER = next((p for p in map(shutil.which, ("chromedriver", "/usr/lib/chromium/chromedriver")) if p), None)
PATIENCE_S = 60.0
"""For what comes within a second on an idle machine; CI's guest is slow and loaded."""
TIMEOUTS_MS = {"script": 240_000, "pageLoad": 240_000}
"""The plots' script alone holds a starved page for longer than the driver's own half minute."""
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
RESTS = """
const body = document.body.dataset;
const rests = () => body.busy === '' && document.querySelector('#job').hidden && !Number(body.underway ?? 0);
if (!rests()) return false;
const { desk } = JSON.parse(sessionStorage.workbench ?? '{}');
const told = await fetch(`/api/state?desk=${desk}`).then(r => r.ok ? r.json() : null, () => null);
return Boolean(told && told.job === null && String(told.version) === body.version && rests());
"""
KEYS = {"Escape": "\ue00c", "Enter": "\ue007", "Tab": "\ue004", "Left": "\ue012", "Right": "\ue014", "Down": "\ue015"}
# what the driver says of an element that left the page after or before it was found, or moved under another
DRAWN_ANEW = ("stale element reference", "no such element", "element click intercepted", "element not interactable")
NOT_THERE = ("Cannot read properties of null", "Cannot read properties of undefined")
"""What a script says that looks into an element that is not there, or is being drawn anew."""


def why_none() -> str:
    """Why no browser can be driven here; empty where one can."""
    if CHROMIUM is None:
        return "no chromium here: apt-get install chromium"
    return "" if DRIVER else "no chromedriver here: apt-get install chromium-driver"


def come(condition, what, patience_s=PATIENCE_S):
    """Wait until a condition holds, and give what it gave."""
    begun = time.monotonic()
    while not (found := condition()):
        waited = time.monotonic() - begun
        if waited > patience_s:
            raise AssertionError(f"did not come within {patience_s:g} s: {what() if callable(what) else what}")
        # asking takes time from what is waited for: of a long wait, a tenth is no matter
        time.sleep(min(max(0.1 * waited, 0.02), 0.15))
    return found


class Driver:
    """The driver's process; windows are opened on it."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.port = s.getsockname()[1]
        self.log = (folder / "chromedriver.log").open("w")
        environment = {**os.environ, "HOME": str(folder), "XDG_CONFIG_HOME": str(folder), "XDG_CACHE_HOME": str(folder)}
        self.process = subprocess.Popen(
            [DRIVER, f"--port={self.port}"], stdout=self.log, stderr=self.log, env=environment
        )
        self.folder = folder
        self.windows: list[Window] = []
        come(lambda: self._ready(), "the driver of the browser")

    def _ready(self) -> bool:
        with suppress(OSError):
            return self.call("GET", "/status")["ready"]
        return False

    def call(self, method, path, body=None):
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.port}{path}",
            None if body is None else json.dumps(body).encode(),
            {"Content-Type": "application/json"},
            method=method,
        )
        try:
            with urllib.request.urlopen(request, timeout=300) as response:
                return json.load(response)["value"]
        except urllib.error.HTTPError as e:
            with e:
                told = json.load(e)["value"]
            raise AssertionError(f"{told['error']}: {told['message'].splitlines()[0]}") from None

    def window(self, url, size=(1280, 720), dark=False) -> "Window":
        arguments = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--force-prefers-reduced-motion",
            f"--window-size={size[0]},{size[1]}",
            *(["--force-dark-mode"] if dark else []),
        ]
        options = {"binary": CHROMIUM, "args": arguments, "prefs": {"download.default_directory": str(self.folder)}}
        match = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}, "timeouts": TIMEOUTS_MS}
        capabilities = {"alwaysMatch": match}
        session = self.call("POST", "/session", {"capabilities": capabilities})["sessionId"]
        window = Window(self, session)
        self.windows.append(window)
        # the page itself is to be so large, not the window around it
        window.cdp(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False
        )
        window.go(url)
        return window

    def close(self) -> None:
        for window in self.windows:
            window.close()
        self.process.terminate()
        self.process.wait(30)
        self.log.close()


class Window:
    """One browser with one tab, or more."""

    def __init__(self, driver: Driver, session: str) -> None:
        self.driver, self.session = driver, session

    def _call(self, method, path, body=None):
        return self.driver.call(method, f"/session/{self.session}{path}", body)

    def cdp(self, command, **parameters):
        return self._call("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def go(self, url) -> None:
        self._call("POST", "/url", {"url": url})

    def reload(self) -> None:
        self._call("POST", "/refresh", {})

    def run(self, script, *args):
        """Run a script; what it returns, a promise's value too."""
        return self._call("POST", "/execute/sync", {"script": script, "args": list(args)})

    def _element(self, css):
        found = self._call("POST", "/element", {"using": "css selector", "value": css})
        return found[ELEMENT]

    def there(self, css) -> bool:
        """Whether something matches and can be seen."""
        return self.run(
            "const e = document.querySelector(arguments[0]);"
            "return Boolean(e && e.getClientRects().length && getComputedStyle(e).visibility !== 'hidden');",
            css,
        )

    def click(self, css) -> None:
        come(lambda: self.there(css), lambda: f"{css} to click on; error line: {self.text('#error')!r}")
        self._with(css, lambda element: self._call("POST", f"/element/{element}/click", {}))

    def _with(self, css, act) -> None:
        """Do something with what matches, again where the page drew it anew before it was done."""
        why = ""

        def done() -> bool:
            nonlocal why
            try:
                self.run("document.querySelector(arguments[0])?.scrollIntoView({block: 'center'})", css)
                act(self._element(css))
            except AssertionError as e:
                why = str(e)
                if not why.startswith(DRAWN_ANEW):
                    raise
                return False
            return True

        come(done, lambda: f"{css} that stays long enough to be used; {why}")

    def type(self, css, text) -> None:
        def written(element) -> None:
            self._call("POST", f"/element/{element}/clear", {})
            self._call("POST", f"/element/{element}/value", {"text": str(text)})

        self._with(css, written)

    def upload(self, css, path) -> None:
        self._call("POST", f"/element/{self._element(css)}/value", {"text": str(path)})

    def press(self, key) -> None:
        """Press a key wherever the focus is."""
        value = KEYS.get(key, key)
        actions = [{"type": "keyDown", "value": value}, {"type": "keyUp", "value": value}]
        self._call("POST", "/actions", {"actions": [{"type": "key", "id": "keys", "actions": actions}]})

    def point(self, css) -> None:
        """Move the pointer onto something."""

        def moved(element) -> None:
            move = {"type": "pointerMove", "duration": 0, "origin": {ELEMENT: element}, "x": 0, "y": 0}
            self._call("POST", "/actions", {"actions": [{"type": "pointer", "id": "mouse", "actions": [move]}]})

        self._with(css, moved)

    def text(self, css) -> str:
        return self.run("return document.querySelector(arguments[0])?.innerText ?? ''", css)

    def wait(self, script, *args, patience_s=PATIENCE_S):
        """Wait until a script gives something true."""
        why = ""

        def found():
            nonlocal why
            try:
                return self.run(script, *args)
            except AssertionError as e:
                why = str(e)
                if not any(reason in why for reason in NOT_THERE):
                    raise
                return None

        return come(found, lambda: f"{script}; error line: {self.text('#error')!r} {why}", patience_s)

    def idle(self, patience_s=PATIENCE_S) -> None:
        """Wait until nothing runs, of what was clicked before too, and the page shows what came of it."""
        self.wait(RESTS, patience_s=patience_s)

    def complaints(self) -> list[str]:
        """What the browser's console holds against the page."""
        found = self._call("POST", "/se/log", {"type": "browser"})
        return [e["message"] for e in found if e["level"] == "SEVERE"]

    def picture(self, path) -> None:
        Path(path).write_bytes(base64.b64decode(self._call("GET", "/screenshot")))

    def close(self) -> None:
        with suppress(AssertionError, OSError):
            self._call("DELETE", "")


def faults(page, axe):
    """Serious faults by axe: rule and place."""
    page.run(axe + "; window.axe = axe;")
    return page.run(
        "const cb = await axe.run(document, {resultTypes: ['violations'],"
        " rules: {'label-content-name-mismatch': {enabled: true}}});"
        "return cb.violations.filter(v => ['serious', 'critical'].includes(v.impact))"
        ".flatMap(v => v.nodes.map(n => v.id + ' ' + n.target.join(' ') + ': ' + n.failureSummary));"
    )
