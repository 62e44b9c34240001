"""Who may talk to a page: browsers that have opened it, and no page of another site that is open in the same browser.

Any page may open a websocket to any address, this machine's included, and say what it likes. Browsers tell where it
comes from (`Origin`) and which name they were given for the server (`Host`): the first must be the second, and the
second must be a name of this machine, lest another site's name be pointed at it.
"""

from __future__ import annotations

import http
import inspect
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

_installing = threading.Lock()


def objection(origin: str | None, host: str | None, names: frozenset[str]) -> str | None:
    """Why a request is refused, or None.

    Args:
        origin, host: the request's headers; what is no browser sends no `Origin`.
        names: that the server goes by, beside addresses in numbers and `localhost`.
    """
    name = _name_of(host)
    if name is None or not (_is_number(name) or name == "localhost" or name in names):
        return "this page goes by its address, localhost, or this machine's name"
    if origin is not None and (not (place := urlsplit(origin).netloc) or place.lower() != (host or "").lower()):
        return "this page talks to no other site"
    return None


def names_of(host: str) -> frozenset[str]:
    """Names of a server that listens at `host`, in small letters."""
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
    """Websocket servers that are started within the block refuse what `objection` says; yields those started.

    Viser passes nothing on to the server that it starts. `websockets` offers what is needed (`process_request`), so
    its public `serve` is replaced for the moment of starting.

    Args:
        host: where they listen.
    """
    import websockets.asyncio.server as module

    names, started = names_of(host), []

    class Serve(module.serve):
        def __init__(self, *args: Any, process_request: Any = None, **options: Any) -> None:
            super().__init__(*args, process_request=_checked(process_request, names), **options)
            started.append(self)

    with _installing:
        before, module.serve = module.serve, Serve
        try:
            yield started
        finally:
            module.serve = before


def _checked(inner: Callable[[Any, Any], Any] | None, names: frozenset[str]) -> Callable[[Any, Any], Any]:
    async def process_request(connection: Any, request: Any) -> Any:
        origins, hosts = request.headers.get_all("Origin"), request.headers.get_all("Host")
        several = len(origins) > 1 or len(hosts) > 1
        first = [values[0] if values else None for values in (origins, hosts)]
        refusal = "a request has one origin" if several else objection(first[0], first[1], names)
        if refusal is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {refusal}.\n")
        answer = None if inner is None else inner(connection, request)
        return await answer if inspect.isawaitable(answer) else answer

    return process_request


def _name_of(host: str | None) -> str | None:
    """The name or number in a `Host` header, in small letters, without port and brackets."""
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
