"""A page that a server of this process shows to browsers of this machine, until it is closed."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

from redundancy_pin.errors import RedundancyPinError

PORT = 7000
"""Where the page is if the port is free; else the system chooses one."""

_HERE = "127.0.0.1"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class LiveView:
    """A running server.

    Attributes:
        url: where to look.
    """

    url: str
    _server: ThreadingHTTPServer
    _thread: Thread

    def wait(self) -> None:
        """Wait until the server is closed or Ctrl-C is pressed."""
        self._thread.join()

    def close(self) -> None:
        """End the server. Pages that are open stay as they are."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def serve_page(text: str) -> LiveView:
    """Start a server for one HTML page.

    Args:
        text: of the page.

    Raises:
        RedundancyPinError: no port can be opened.
    """
    server = _server(_handler(text.encode("utf-8")))
    thread = Thread(target=server.serve_forever, name="redundancy_pin view", daemon=True)
    thread.start()
    return LiveView(f"http://{_HERE}:{server.server_address[1]}/", server, thread)


def _server(handler: type[BaseHTTPRequestHandler]) -> ThreadingHTTPServer:
    try:
        return _Server((_HERE, PORT), handler)
    except OSError:
        pass  # taken, by another view as a rule
    try:
        return _Server((_HERE, 0), handler)
    except OSError as error:
        raise RedundancyPinError(
            f"No port of {_HERE} can be opened for the view: {error}.",
            remedy="Write a file instead (--html, View.save).",
        ) from error


class _Server(ThreadingHTTPServer):
    allow_reuse_address = os.name == "posix"  # elsewhere it would share a port that someone listens on
    daemon_threads = True


def _handler(page: bytes) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path.partition("?")[0] != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.send_header("Cache-Control", "no-store")  # the next view may have the same address
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *args: Any) -> None:
            _LOG.debug(format, *args)

    return Handler
