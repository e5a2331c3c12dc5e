"""The server: on this machine alone, behind a path that nobody can guess."""

from __future__ import annotations

import secrets
import socket
import sys
import uuid
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from lensdesign.errors import InputError
from studio.model.bench import Workbench
from studio.model.document import Autosave

ADDRESS = "127.0.0.1"

HOSTS = (ADDRESS, "localhost", "[::1]")
"""Names under which the workbench is asked for; it listens on the first."""

PING_SECONDS = 20.0
"""After which a page that has not answered counts as closed, and its session goes."""


def serve(design: Path, port: int = 0, grade: str = "precision", *, show: bool = True) -> None:
    """Serve the workbench of a design until it is stopped.

    Parameters
    ----------
    design
        The design file.
    port
        On which to listen; 0 takes the one of the last time where that is free, else any.
    grade
        By which the lens is predicted as built.
    show
        Whether to open the browser.

    Raises
    ------
    InputError
        If the file holds no lens, or the port is taken.
    """
    aside = Autosave(design)
    bench = Workbench(design, grade, aside)
    kept = aside.read()
    token, port = _token(kept.get("token")), _port(port, kept.get("port"))
    server = server_of(bench, port, token)
    server.start()
    aside.keep(token=token, port=port)
    address = f"http://{ADDRESS}:{port}/{token}/"
    print(f"{design} on {address}", flush=True)
    if bench.editing.before:
        print("with the unsaved edits of the last session; undo takes them back", flush=True)
    if show:
        server.io_loop.add_callback(_open, address)
    bench.ask()
    try:
        server.run_until_shutdown()
    finally:
        bench.close()
        print("stopped; unsaved edits are kept for the next time", file=sys.stderr)


def server_of(bench: Workbench, port: int, token: str) -> Any:
    """A server of a workbench, not yet started."""
    import panel as pn

    from studio.page.frame import page

    pn.extension(inline=True)
    server = pn.serve(
        {"/": lambda: page(bench)},
        port=port,
        address=ADDRESS,
        prefix=f"/{token}",
        websocket_origin=[f"{ADDRESS}:{port}", f"localhost:{port}"],
        extra_patterns=[("/alive", _alive())],
        show=False,
        start=False,
        title="transferlens studio",
        keep_alive_milliseconds=10_000,
        check_unused_sessions_milliseconds=2_000,
        unused_session_lifetime_milliseconds=5_000,
        session_token_expiration=86_400,
        admin=False,
        liveness=False,
    )
    _guard(server, token)
    return server


def _guard(server: Any, token: str) -> None:
    """Refuse requests before any handler of the server sees them, and end connections that nobody answers.

    Answered is what lies behind the token, under a name of this machine: a page of another site can make its
    own name lead here (DNS rebinding), but the browser still sends that name as the host.
    """
    from tornado.web import ErrorHandler

    application = server._tornado
    application.settings |= {"websocket_ping_interval": PING_SECONDS, "websocket_ping_timeout": PING_SECONDS}
    found = application.find_handler

    def find_handler(request: Any, **kwargs: Any) -> Any:
        status = _refusal(request.headers.get("Host"), request.uri or "", token)
        if status is None:
            return found(request, **kwargs)
        return application.get_handler_delegate(request, ErrorHandler, {"status_code": status})

    application.find_handler = find_handler


def _refusal(host: str | None, uri: str, token: str) -> int | None:
    """The status with which a request is refused; None if it is answered."""
    if host is not None and _name_of(host) not in HOSTS:
        return 403
    path, _, query = uri.partition("?")
    # As a handler will read it; some unquote once more.
    names = unquote(unquote(path)).split("/")
    if not secrets.compare_digest(names[1].encode() if len(names) > 1 else b"", token.encode()):
        return 404
    shown = "".join(names) + unquote(unquote(query))
    if any(ord(c) < 32 or ord(c) == 127 for c in shown) or max(len(n.encode()) for n in names) > 255:
        return 404
    return None


def _name_of(host: str) -> str:
    """The name in a Host header, without its port."""
    name, colon, port = host.strip().rpartition(":")
    return (name if colon and port.isdecimal() else host.strip()).lower()


def _alive() -> type:
    """What answers whether the server is there, and which one it is."""
    from tornado.web import RequestHandler

    name = uuid.uuid4().hex

    class Alive(RequestHandler):
        def get(self) -> None:
            self.set_header("Cache-Control", "no-store")
            self.finish(name)

    return Alive


def _token(kept: Any) -> str:
    """That of the last time, so that a page that is still open finds the server again; else a new one."""
    return kept if isinstance(kept, str) and len(kept) == 32 and kept.isalnum() else secrets.token_hex(16)


def _port(asked: int, kept: Any) -> int:
    if asked:
        if not _is_free(asked):
            raise InputError(f"--port {asked}: is taken by another program; give another one, or none")
        return asked
    if isinstance(kept, int) and 1024 <= kept < 65536 and _is_free(kept):
        return kept
    with closing(socket.socket()) as free:
        free.bind((ADDRESS, 0))
        return int(free.getsockname()[1])


def _is_free(port: int) -> bool:
    with closing(socket.socket()) as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((ADDRESS, port))
        except OSError:
            return False
    return True


def _open(address: str) -> None:
    import webbrowser

    webbrowser.open(address)
