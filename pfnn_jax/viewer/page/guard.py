"""Protects the page from other sites that are open in the same browser.

Any site can open a websocket to any address, including this machine's. Browsers send the site's origin (`Origin`) and
the name under which they reach the server (`Host`). A request is accepted if both agree, which rejects other sites,
and if the name is one of this machine's, to prevent DNS rebinding.

What a connection sends must be messages that the page's browsers send (`browser_messages`). One that sends anything
else is closed: viser would end it as well, but with a traceback on the terminal of whoever runs the page. A value that
does not fit its control is dropped, for the same reason.
"""

from __future__ import annotations

import asyncio
import http
import inspect
import ipaddress
import socket
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

NOT_A_MESSAGE = 1007
"""Code with which a connection is closed: of data that do not fit the type of message (RFC 6455, section 7.4.1)."""

_installing = threading.Lock()


def objection(origin: str | None, host: str | None, names: frozenset[str]) -> str | None:
    """Returns why a request is refused, or None.

    Args:
        origin, host: the request's headers; only browsers send `Origin`.
        names: names of the server, in addition to numeric addresses and `localhost`.
    """
    name = _name_of(host)
    if name is None or not (_is_number(name) or name == "localhost" or name in names):
        return "open this page by its address, localhost, or this machine's name"
    if origin is not None and (not (place := urlsplit(origin).netloc) or place.lower() != (host or "").lower()):
        return "requests of other sites are not accepted"
    return None


def is_message(frame: bytes | str) -> bool:
    """Returns whether what a connection has sent is a message of a browser, which viser can read."""
    from viser._messages import Message

    from pfnn_jax.viewer.page.browser_messages import is_browser_message  # needs what viser brings with it

    if not isinstance(frame, bytes) or not is_browser_message(frame):
        return False
    try:
        Message.deserialize(frame)
    except Exception:  # of any kind: the bytes are decoded, and a class is made with what they name
        return False
    return True


def names_of(host: str) -> frozenset[str]:
    """Returns the names of a server that listens at `host`, in lower case."""
    names = {host.lower()}
    try:
        own = host in ("", "::") or not ipaddress.ip_address(host).is_loopback
    except ValueError:
        own = host.lower() != "localhost"
    if own:
        machine = socket.gethostname().lower()
        names |= {machine, f"{machine}.local"}
    return frozenset(names)


@contextmanager
def guarded(host: str) -> Iterator[list[Any]]:
    """Makes websocket servers that are started within the block refuse requests by `objection`; yields those started.

    They also close connections that send what is not a message.

    `websockets` can check requests (`process_request`), but viser does not pass this option on. The public `serve` of
    `websockets` is therefore replaced while the server starts.

    Args:
        host: address at which they listen.
    """
    import websockets.asyncio.server as module

    names, started = names_of(host), []

    class Connection(module.ServerConnection):
        async def recv(self, *args: Any, **options: Any) -> Any:
            frame = await super().recv(*args, **options)
            if is_message(frame):
                return frame
            await self.close(NOT_A_MESSAGE, "not a message")
            while True:  # what has come since is dropped; then it raises that it is closed, which viser expects
                await super().recv()

    class Serve(module.serve):
        def __init__(self, *args: Any, process_request: Any = None, **options: Any) -> None:
            checked = {"process_request": _checked(process_request, names), "create_connection": Connection}
            super().__init__(*args, **options, **checked)
            asyncio.get_running_loop().set_exception_handler(_drop_values)
            started.append(self)

    with _installing:
        before, module.serve = module.serve, Serve
        try:
            yield started
        finally:
            module.serve = before


def _drop_values(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Drops values that a browser has sent and viser cannot make one of their control, such as a word for a number."""
    error = context.get("exception")
    if isinstance(error, TypeError | ValueError | OverflowError):
        place = traceback.extract_tb(error.__traceback__)[-1]
        if place.name == "_handle_gui_updates" and Path(place.filename).name == "_gui_api.py":
            return
    loop.default_exception_handler(context)


def _checked(inner: Callable[[Any, Any], Any] | None, names: frozenset[str]) -> Callable[[Any, Any], Any]:
    async def process_request(connection: Any, request: Any) -> Any:
        origins, hosts = request.headers.get_all("Origin"), request.headers.get_all("Host")
        several = len(origins) > 1 or len(hosts) > 1
        first = [values[0] if values else None for values in (origins, hosts)]
        refusal = "a request must have one origin and one host" if several else objection(first[0], first[1], names)
        if refusal is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {refusal}.\n")
        answer = None if inner is None else inner(connection, request)
        return await answer if inspect.isawaitable(answer) else answer

    return process_request


def _name_of(host: str | None) -> str | None:
    """Returns the name or numeric address in a `Host` header, in lower case, without port and brackets."""
    try:
        return urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return None


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name.partition("%")[0])
    except ValueError:
        return False
    return True
