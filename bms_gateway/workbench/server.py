"""The page's server: files of the page, state as JSON, changes as server-sent events. One thread per request.

It is the server of the standard library. A page for one person on one machine needs no framework; this server starts at
once and adds no dependency.
"""

import json
import secrets
import shutil
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext, suppress
from http import HTTPStatus
from http.server import ThreadingHTTPServer
from importlib.resources import files
from io import SEEK_END, BytesIO
from math import isfinite
from pathlib import Path
from socketserver import TCPServer
from typing import TYPE_CHECKING, Any, ClassVar, Final
from urllib.parse import parse_qs, unquote, urlsplit

from bms_gateway.errors import GatewayError, UsageError
from bms_gateway.report.page import plotly_script
from bms_gateway.workbench.beside import Beside
from bms_gateway.workbench.busy import BusyError
from bms_gateway.workbench.clients import Clients
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.doors import CLOSED, HEADERS, Door
from bms_gateway.workbench.heads import ShortHeads, body_of
from bms_gateway.workbench.session import additions_of, diagnoses_of, notes_of
from bms_gateway.workbench.site import Site, session_files, wanted_files
from bms_gateway.workbench.stretch import in_order, on_desk, signals, table_name
from bms_gateway.workbench.takes import KINDS, attached, taken
from bms_gateway.workbench.uploads import safe_name

if TYPE_CHECKING:  # the engine: only the live page needs it
    from bms_gateway.workbench.live_estimates import Watch

LARGEST_JSON: Final = 64 * 1024
LARGEST_SESSION: Final = 1024**2
"""Greatest body of a request: some hundred effects and places, a few hundred bytes each, and notes that are too
long."""
LARGEST_UPLOAD: Final = 256 * 1024**2
LONGEST_LENGTH: Final = 20
"""Most digits of a Content-Length: those of 64 bits."""
MOST_FIGURES: Final = 40
"""Most figures that are measured in one request."""
LARGEST_NUMBER: Final = 1e9
"""Largest number of a query: seconds, or the index of a string."""
PING_S: Final = 10.0
"""Time between signs of life on an event stream, s; they show when a browser has left."""
IDLE_S: Final = 120.0
"""Time, s, after which a silent connection is closed."""
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
CSV: Final = "text/csv; charset=utf-8"


class Server(ThreadingHTTPServer):
    """Serves one site.

    Parameters
    ----------
    site : Site
    host, port : str, int
    more : iterable of str
        Other names of this machine.
    tell : callable, optional
        Gets the address for the next browser when a token was used.

    Raises
    ------
    UsageError
        The address cannot be used.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(
        self, site: Site, host: str, port: int, more: Iterable[str] = (), tell: Callable[[str], None] | None = None
    ) -> None:
        if not host.strip():  # an unset variable of a script; the system would take it for every address
            raise UsageError("workbench: --host is empty; give an address of this machine, or 0.0.0.0 for all of them")
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), Handler)
        except (OSError, OverflowError, UnicodeError) as e:
            reason = getattr(e, "strerror", None) or e
            raise UsageError(f"workbench: --host {host} --port {port}: cannot be used: {reason}") from None
        address, port = self.socket.getsockname()[:2]
        self.site, self.tell, self.clients = site, tell, Clients()
        self.door = Door(host, address, port, more)
        site.local = self.door.local

    def server_bind(self) -> None:
        """Bind, without the base class's request to a name server, which is not needed."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = self.socket.getsockname()[:2]

    def verify_request(self, request: Any, client_address: Any) -> bool:  # noqa: ARG002 - the base class gives it
        """Return whether there is room for a connection."""
        return self.clients.come(request)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.clients.go(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that closes its connection; every other error is a bug and is printed."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class Handler(ShortHeads):
    """Answers one connection."""

    server: Server
    protocol_version = "HTTP/1.1"
    timeout = IDLE_S
    server_version = "bms-gateway"
    sys_version = ""
    GETS: ClassVar = {
        *("state", "figure", "measures", "curves", "events", "take", "site", "presets", "watch", "history", "window"),
        *("signals", "happened"),
    }
    """Requests with GET under /api; a method with an underscore and the name answers each."""

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class calls it so
        """Keep the terminal clean."""

    def do_GET(self) -> None:
        """Serve the page, or a part of the state."""
        self._guarded(self._get)

    def do_POST(self) -> None:
        """Carry out a request of the page."""
        self._guarded(self._post)

    def _guarded(self, answer: Any) -> None:
        self.answers(begins=True)
        try:
            self._checked(answer)
        finally:
            self.answers(begins=False)

    def answers(self, *, begins: bool) -> None:
        """Protect a connection that is being answered; others are closed if there are too many."""
        self.server.clients.answer(self.connection, begins=begins)

    def _checked(self, answer: Any) -> None:
        headers = {k.lower(): v for k, v in self.headers.items()}
        door = self.server.door
        why_not = door.refusal(self.command, headers, self.connection.getsockname()[0])
        try:
            self._url, self._query = self._asked()
            if not why_not and not door.admits(headers.get("cookie", "")):
                if self._let_in():
                    return
                why_not = CLOSED
            if why_not:
                self.close_connection = True  # the body is not read
                self._json({"error": why_not}, HTTPStatus.FORBIDDEN)
                return
            answer()
        except GatewayError as e:
            busy = {"busy": e.title} if isinstance(e, BusyError) else {}
            self._json({"error": " ".join(str(e).split()), **busy}, HTTPStatus.BAD_REQUEST)
        except (BrokenPipeError, ConnectionResetError, TimeoutError):
            self.close_connection = True  # the browser has disconnected
        except OSError as e:
            if not e.filename:
                raise
            self._json({"error": f"a file of this name cannot be used: {e.strerror}"}, HTTPStatus.BAD_REQUEST)

    def _asked(self) -> tuple[str, dict[str, str]]:
        """Path and query of the request."""
        try:
            url = urlsplit(self.path)
        except ValueError:
            self.close_connection = True
            raise UsageError("the request names no address") from None
        return url.path, {k: v[0] for k, v in parse_qs(url.query).items()}

    def _let_in(self) -> bool:
        """Give a browser that shows the token its cookie, and send it to the page without the token."""
        server = self.server
        if self.command != "GET" or self._url != "/":
            return False
        cookie = server.door.enter(self._query.get("token", ""))
        if cookie is None:
            return False
        self.send_response(HTTPStatus.SEE_OTHER)
        for header, value in {"Set-Cookie": cookie, "Location": "/", "Content-Length": "0", **HEADERS}.items():
            self.send_header(header, value)
        self.end_headers()
        if server.tell is not None:
            server.tell(f"for one more browser: {server.door.url}")
        return True

    # what is read

    def _get(self) -> None:
        path = unquote(self._url)
        if path == "/":
            self._asset("page.html")
        elif path == "/plotly.js":
            self._bytes(plotly_script(), TYPES[".js"], cached=True, packed=True)
        elif path.startswith("/page/"):
            self._asset(path.removeprefix("/page/"))
        elif path.removeprefix("/api/") in self.GETS:
            getattr(self, "_" + path.removeprefix("/api/"))()
        else:
            self._json({"error": f"there is nothing at {path}"}, HTTPStatus.NOT_FOUND)

    def _site(self) -> None:
        site = self.server.site
        self._json({"watch": site.watch.about() if site.watch else None, "local": site.local, "grafana": site.grafana})

    def _presets(self) -> None:
        from bms_gateway.workbench.presets import presets  # not with the program, because it loads NumPy

        self._json({"presets": presets()})

    def _watch(self) -> None:
        self._stream(self._live().stream(self._query.get("view", "")))

    def _history(self) -> None:
        string, span = self._number("string"), self._number("span")
        self._json(self._live().history(self._query.get("view", ""), int(string), span, self._ends()))

    def _happened(self) -> None:
        self._bytes(self._live().events_table(), CSV, name="events.csv")

    def _desk(self) -> Desk:
        return self.server.site.desk(self._query.get("desk", ""))

    def _asset(self, name: str) -> None:
        folder = files("bms_gateway.workbench").joinpath("page")
        known = {p.name: p for p in (*folder.iterdir(), files("bms_gateway.report").joinpath("told.js"))}
        if name not in known or Path(name).suffix not in TYPES:
            self._json({"error": f"there is nothing at {name}"}, HTTPStatus.NOT_FOUND)
            return
        self._bytes(known[name].read_bytes(), TYPES[Path(name).suffix])

    def _state(self) -> None:
        self._json(self._desk().state())

    def _figure(self) -> None:
        window, beside = self._pair("from", "to"), self._beside()
        self._json({"figure": self._desk().figure(self._query.get("name", ""), window, beside)})

    def _measures(self) -> None:
        names = self._query.get("names", "").split(",")[:MOST_FIGURES]
        window, at, beside = self._pair("from", "to"), self._pair("a", "b"), self._beside()
        self._json({"curves": self._desk().measures(names, window, at, beside)})

    def _beside(self) -> Beside | None:
        return Beside.of(self._query.get("beside", ""), self._query.get("by", "start"))

    def _pair(self, one: str, other: str) -> tuple[float, float] | None:
        """Return two numbers of the query; None if they are missing."""
        texts = [self._query.get(k, "") for k in (one, other)]
        if not all(texts):
            return None
        try:
            a, b = map(float, texts)
        except ValueError:
            a = b = float("nan")
        if not (isfinite(a) and isfinite(b)):
            raise UsageError(f"figure: {one} and {other} must be numbers")
        return a, b

    def _ends(self) -> tuple[float, float] | None:
        return in_order(self._pair("from", "to"))

    def _curves(self) -> None:
        desk, name = self._desk(), self._query.get("name", "")
        self._json({"curves": desk.fitting(name) if self._query.get("fitting") else desk.curves(name)})

    def _take(self) -> None:
        desk, what = self._desk(), self._query.get("what", "")
        if what not in KINDS:
            told = f"take: '{what[:40]}' is not one of model, report, session"
            self._json({"error": told}, HTTPStatus.NOT_FOUND)
            return
        found = taken(desk, self._query)
        try:
            self._bytes(found.body, found.kind, name=found.name)
        finally:
            if found.once and isinstance(found.body, Path):
                found.body.unlink(missing_ok=True)

    # streams

    def _events(self) -> None:
        desk = self._desk()
        self._stream(self._changes(desk))

    def _changes(self, desk: Desk) -> Iterator[str]:
        seen = -1
        while not self.server.site.closing:
            with desk.changed:
                if desk.version == seen:
                    desk.changed.wait(PING_S)
                news = desk.version != seen
                seen = desk.version
                state = desk.state() if news else {}
            few = {k: state[k] for k in ("version", "job", "error")} if news else None
            yield json.dumps(few) if few else ""

    def _live(self) -> "Watch":
        watch = self.server.site.watch
        if watch is None:
            raise UsageError("nothing is live here: start with --live CHANNEL --config C")
        return watch

    def _number(self, name: str) -> float:
        try:
            x = float(self._query.get(name, "0"))
        except ValueError:
            x = float("nan")
        if not 0.0 <= x < LARGEST_NUMBER:
            raise UsageError(f"{name}: a number from 0 on is needed")
        return x

    def _signals(self) -> None:
        """Send the signals of one string in a window as a table that the commands can read."""
        string, out = int(self._number("string")), self._desk().folder / f".{secrets.token_hex(8)}.csv"
        watch, view = self._live(), self._query.get("view", "")
        try:
            signals(watch, view, string, self._number("span"), self._ends(), out)
            self._bytes(out, CSV, name=table_name(watch, string))
        finally:
            out.unlink(missing_ok=True)

    def _window(self) -> None:
        parts = self._live().table(self._query.get("view", ""), self._number("span"), self._ends())
        self.close_connection = True  # its length is not known yet
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", CSV)
        self.send_header("Content-Disposition", attached("estimates.csv"))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self._safe_headers()
        self.end_headers()
        for part in parts:
            self.wfile.write(part)

    def _stream(self, parts: Iterator[str]) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self._safe_headers()
        self.end_headers()
        self.close_connection = True
        for part in parts:
            self.wfile.write(f"data: {part}\n\n".encode() if part else b": alive\n\n")
            self.wfile.flush()
            if self.server.site.closing:
                return

    # what is asked for

    def _post(self) -> None:
        if self._url == "/api/upload":
            self._upload()
            return
        body = self._body()
        site = self.server.site
        if self._url == "/api/desk":
            self._json({"desk": site.new_desk().name})
            return
        if self._url == "/api/watch":
            self._live().steer(str(body.get("view", "")), body)
            self._json({})
            return
        if self._url == "/api/acknowledge":
            self._live().acknowledge(str(body.get("view", "")), body)
            self._json({})
            return
        if self._url == "/api/window":
            self._json({"files": on_desk(self._live(), self._desk(), body)})
            return
        self._work(self._desk(), self._url.removeprefix("/api/"), body)
        self._json({})

    def _work(self, desk: Desk, what: str, body: dict[str, Any]) -> None:
        match what:
            case "open":
                desk.open(wanted_files(self.server.site, desk, body))
            case "look":
                desk.look(wanted_files(self.server.site, desk, body))
            case "resume":
                additions, notes, kept = additions_of(body), notes_of(body.get("notes", "")), diagnoses_of(body)
                files = session_files(self.server.site, desk, body["files"])
                desk.resume(wanted_files(self.server.site, desk, files), additions, notes, kept)
            case "note":
                desk.note(notes_of(body.get("notes")))
            case "compare" | "diagnose" | "confirm" | "undo" | "cancel":
                getattr(desk, what)()
            case "add":
                words = body.get("words")
                if not isinstance(words, list) or not all(isinstance(w, str) for w in words):
                    raise UsageError("add: words must be a list of effects")
                desk.add(words, force=body.get("force") is True)
            case "track":
                desk.track(*_track_of(body))
            case _:
                raise UsageError(f"the page cannot ask for '{what}'")

    def _body(self) -> dict[str, Any]:
        length = self._length(LARGEST_SESSION if self._url in ("/api/resume", "/api/note") else LARGEST_JSON)
        try:
            document = body_of(self.rfile.read(length))
        except (ValueError, RecursionError):
            raise UsageError("the request is no JSON, has half a character, or is nested too deeply") from None
        if not isinstance(document, dict):
            raise UsageError("the request must be a JSON object")
        return document

    def _length(self, most: int) -> int:
        text = self.headers.get("Content-Length", "")
        if not text.isdecimal() or len(text) > LONGEST_LENGTH or int(text) > most:
            self.close_connection = True  # the rest is not read
            raise UsageError(f"too large: at most {most / 1024**2:g} MiB are taken at once")
        return int(text)

    def _upload(self) -> None:
        close, self.close_connection = self.close_connection, True  # in case a part of the body is not read
        desk, size = self._desk(), self._length(LARGEST_UPLOAD)
        name = safe_name(self._query.get("name", ""))
        if not name:
            raise UsageError("upload: the file has no name")
        replaced = desk.uploads.receive(self.rfile, size, name)
        self.close_connection = close
        self._json({"name": name} | ({"replaced": True} if replaced else {}))

    # answers

    def _json(self, document: Any, status: HTTPStatus = HTTPStatus.OK) -> None:
        text = json.dumps(document, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        with suppress(BrokenPipeError, ConnectionResetError):
            self._bytes(text.encode(), "application/json", status=status)

    def _bytes(
        self,
        body: bytes | Path,
        kind: str,
        *,
        status: HTTPStatus = HTTPStatus.OK,
        name: str = "",
        cached: bool = False,
        packed: bool = False,
    ) -> None:
        with nullcontext(BytesIO(body)) if isinstance(body, bytes) else body.open("rb") as content:
            size = content.seek(0, SEEK_END)
            content.seek(0)
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(size))
            self.send_header("Cache-Control", "max-age=86400" if cached else "no-store")
            if packed:
                self.send_header("Content-Encoding", "gzip")  # every browser accepts it
            if name:
                self.send_header("Content-Disposition", attached(name))
            self._safe_headers()
            self.end_headers()
            shutil.copyfileobj(content, self.wfile)

    def _safe_headers(self) -> None:
        for header, value in HEADERS.items():
            self.send_header(header, value)


def _track_of(body: dict[str, Any]) -> tuple[int, str]:
    record, column = body.get("record"), body.get("column")
    if not isinstance(record, int) or not isinstance(column, str):
        raise UsageError("track: the place of a record and the name of a column are needed")
    return record, column
