"""Access to the live page: requests that foreign web pages make a browser send to this machine are refused."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, TypeAlias
from urllib.parse import urlsplit

from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

    _Process: TypeAlias = Callable[[ServerConnection, Request], Awaitable[Response | None] | Response | None]

_ATTEMPTS = 100  # number of ports to try
_wrapping = threading.Lock()


def free_port(host: str, port: int) -> int:
    """The first free port of ``host``, from ``port`` on; 0 stays 0.

    Raises:
        InvalidInput: not an address of this machine, or no free port.
    """
    try:
        places = {
            (family, address[0])
            for family, _, _, _, address in socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM)
        }
    except (OSError, TypeError, UnicodeError) as error:
        raise InvalidInput(f"host: expected a name or an address of this machine, got {host!r} ({error})") from error
    reason = ""
    for one in range(port, min(port + _ATTEMPTS, 65536)):
        try:
            for family, address in places:
                with socket.socket(family, socket.SOCK_STREAM) as trial:
                    trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    trial.bind((address, one))
        except OSError as error:
            reason = str(error)
            continue
        return one
    raise InvalidInput(
        f"host, port: cannot listen on {host!r} from port {port} on ({reason}): give another port or host"
    )


def is_welcome(host: str, hosts: list[str], origins: list[str]) -> bool:
    """Whether a server that listens on ``host`` may answer a request with these headers ``Host`` and ``Origin``.

    Only this machine's own names are accepted: an attacker's name may resolve to this machine (DNS rebinding).
    Addresses are safe from that. The origin of a page must be the server itself; only browsers send an origin.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        name = (urlsplit(f"//{hosts[0]}").hostname or "").lower()
        if origins and urlsplit(origins[0]).netloc.lower() != hosts[0].lower():
            return False
    except ValueError:
        return False
    own = {"localhost", host.lower()}
    try:
        loopback = ipaddress.ip_address(name).is_loopback
        is_address = True
    except ValueError:
        loopback = is_address = False
    if _loopback(host):
        return name in own or loopback
    return is_address or name in own | {socket.gethostname().lower(), socket.getfqdn().lower()}


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


@contextlib.contextmanager
def guard_server(host: str) -> Iterator[None]:
    """A viser server that starts within this context refuses requests that are not :func:`welcome`."""
    from websockets.asyncio import server

    serve = server.serve

    def wrap_serving(
        handler: Callable[[ServerConnection], Awaitable[None]],
        *args: Any,
        process_request: _Process | None = None,
        **settings: Any,
    ) -> server.serve:
        if not handler.__module__.startswith("viser."):
            return serve(handler, *args, process_request=process_request, **settings)

        def process(connection: ServerConnection, request: Request) -> Awaitable[Response | None] | Response | None:
            if not is_welcome(host, request.headers.get_all("Host"), request.headers.get_all("Origin")):
                return connection.respond(HTTPStatus.FORBIDDEN, "This page is served only at its own address.\n")
            return None if process_request is None else process_request(connection, request)

        return serve(handler, *args, process_request=process, **settings)

    with _wrapping:
        server.serve = wrap_serving  # type: ignore[misc, assignment]  # viser has no setting for it
        try:
            yield
        finally:
            server.serve = serve  # type: ignore[misc]  # likewise
