"""Server of the workbench: reachable from this machine only, at a path with a secret token."""

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

CHECK_MILLISECONDS, LIFETIME_MILLISECONDS = 2_000, 60_000
"""Interval at which sessions without a page are sought, and the age at which they end.

A busy machine may need many seconds from the page to its first connection.
"""


def serve(design: Path, port: int = 0, grade: str = "precision", *, show: bool = True) -> None:
    """Serve the workbench of a design until it is stopped.

    Parameters
    ----------
    design
        The design file.
    port
        Port of the server; 0 (default): that of the last session if it is free, else any free port.
    grade
        Tolerances for the prediction as built (default: precision).
    show
        Whether to open the browser (default: True).

    Raises
    ------
    InputError
        If the file does not describe a lens or is open in another workbench, or the port is in use.
    """
    autosave = Autosave(design)
    kept = autosave.read()
    token = _token(kept.get("token"))
    if _answers(address := _address(kept.get("port"), token)):
        raise InputError(
            f"{design} is open in a workbench already, which stores its unsaved edits: use its page "
            f"{address}, or stop it first"
        )
    bench = Workbench(design, grade, autosave)
    port = _port(port, kept.get("port"))
    server = server_of(bench, port, token)
    server.start()
    autosave.keep(token=token, port=port)
    address = _address(port, token)
    print(f"{design} on {address}", flush=True)
    if bench.editing.undo_steps:
        print("with the unsaved edits of the last session; undo takes them back", flush=True)
    if show:
        server.io_loop.add_callback(_open, address)
    bench.request_update()
    try:
        server.run_until_shutdown()
    finally:
        bench.close()
        print("stopped; unsaved edits are kept for the next time", file=sys.stderr)


def _address(port: Any, token: str) -> str:
    return f"http://{ADDRESS}:{port}/{token}/"


def _answers(address: str) -> bool:
    """Return whether a workbench is running at an address."""
    from http.client import HTTPException
    from urllib.request import ProxyHandler, build_opener

    seconds = 2.0  # a page that is being computed delays the answer
    try:
        with build_opener(ProxyHandler({})).open(f"{address}alive", timeout=seconds) as answer:
            return bool(answer.status == 200)
    except (OSError, HTTPException, ValueError):  # no server, another one, or a port that is none
        return False


def server_of(bench: Workbench, port: int, token: str) -> Any:
    """Return a server of a workbench that is not yet started."""
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
        check_unused_sessions_milliseconds=CHECK_MILLISECONDS,
        unused_session_lifetime_milliseconds=LIFETIME_MILLISECONDS,
        session_token_expiration=86_400,
        admin=False,
        liveness=False,
    )
    _guard(server, token)
    return server


def _guard(server: Any, token: str) -> None:
    """Reject requests without the token before they reach a handler, and close dead connections.

    The host must be a name of this machine: another site can let its own name point here (DNS rebinding), but
    the browser still sends that name as the host.
    """
    from tornado.web import ErrorHandler

    application = server._tornado
    # Time after which a page without an answer counts as closed and its session ends.
    ping_seconds = 20.0
    application.settings |= {"websocket_ping_interval": ping_seconds, "websocket_ping_timeout": ping_seconds}
    find_default = application.find_handler

    def find_handler(request: Any, **kwargs: Any) -> Any:
        status = _refusal(request.headers.get("Host"), request.uri or "", token)
        if status is None:
            return find_default(request, **kwargs)
        return application.get_handler_delegate(request, ErrorHandler, {"status_code": status})

    application.find_handler = find_handler


def _refusal(host: str | None, uri: str, token: str) -> int | None:
    """Return the status with which a request is rejected; None if it is accepted."""
    # Accepted host names; the server listens on the first.
    hosts = (ADDRESS, "localhost", "[::1]")
    if host is not None and _name_of(host) not in hosts:
        return 403
    path, _, query = uri.partition("?")
    # Decoded like in the handlers, some of which decode twice.
    names = unquote(unquote(path)).split("/")
    if not secrets.compare_digest(names[1].encode() if len(names) > 1 else b"", token.encode()):
        return 404
    shown = "".join(names) + unquote(unquote(query))
    if any(ord(c) < 32 or ord(c) == 127 for c in shown) or max(len(n.encode()) for n in names) > 255:
        return 404
    return None


def _name_of(host: str) -> str:
    """Return the name in a Host header without the port."""
    name, colon, port = host.strip().rpartition(":")
    return (name if colon and port.isdecimal() else host.strip()).lower()


def _alive() -> type:
    """Return the handler by which a page checks that the same server is still running."""
    from tornado.web import RequestHandler

    name = uuid.uuid4().hex

    class Heartbeat(RequestHandler):
        def get(self) -> None:
            self.set_header("Cache-Control", "no-store")
            self.finish(name)

    return Heartbeat


def _token(kept: Any) -> str:
    """Return the token of the last session, so that open pages find the server again, or a new one."""
    return kept if isinstance(kept, str) and len(kept) == 32 and kept.isalnum() else secrets.token_hex(16)


def _port(requested: int, kept: Any) -> int:
    if requested:
        if not _is_free(requested):
            raise InputError(f"--port {requested}: is taken by another program; give another one, or none")
        return requested
    if isinstance(kept, int) and 1024 <= kept < 65536 and _is_free(kept):
        return kept
    with closing(socket.socket()) as free:
        free.bind((ADDRESS, 0))
        return int(free.getsockname()[1])


def _is_free(port: int) -> bool:
    with closing(socket.socket()) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((ADDRESS, port))
        except OSError:
            return False
    return True


def _open(address: str) -> None:
    import webbrowser

    webbrowser.open(address)
