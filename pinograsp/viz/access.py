"""Who may look at the live page: browsers send any web page's requests to this machine, so each must say that it comes
from here.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import threading
from urllib.parse import urlsplit

from pinograsp.errors import InvalidInput

_ATTEMPTS = 100  # ports tried from the first one on
_wrapping = threading.Lock()


def free_port(host: str, port: int) -> int:
    """The first port from ``port`` on that ``host`` can listen on; 0 stays 0.

    Raises:
        InvalidInput: no address of this machine, or no free port.
    """
    try:
        places = {
            (family, address[0])
            for family, _, _, _, address in socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM)
        }
    except (OSError, TypeError, UnicodeError) as error:
        raise InvalidInput(f"host: expected a name or an address of this machine, got {host!r} ({error})") from error
    for one in range(port, min(port + _ATTEMPTS, 65536)):
        try:
            for family, address in places:
                with socket.socket(family, socket.SOCK_STREAM) as trial:
                    trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    trial.bind((address, one))
        except OSError as error:
            reason = error
            continue
        return one
    raise InvalidInput(
        f"host, port: cannot listen on {host!r} from port {port} on ({reason}): give another port or host"
    )


def welcome(host: str, hosts: list[str], origins: list[str]) -> bool:
    """Whether a request with these headers ``Host`` and ``Origin`` may be answered by a server that listens on
    ``host``.

    Names are this machine's own: to any other one, a web page may have bound this machine's address (DNS rebinding).
    Addresses are safe from that. A page's origin must be the server itself; programs that are no browsers send none.
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
        address = ipaddress.ip_address(name)
    except ValueError:
        address = None
    if _loopback(host):
        return name in own or (address is not None and address.is_loopback)
    return address is not None or name in own | {socket.gethostname().lower(), socket.getfqdn().lower()}


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


@contextlib.contextmanager
def guarded(host: str):
    """A viser server that starts within it refuses requests that are not :func:`welcome`; viser has no setting."""
    from websockets.asyncio import server

    serve = server.serve

    def wrapped(handler, *args, process_request=None, **settings):
        if not handler.__module__.startswith("viser."):
            return serve(handler, *args, process_request=process_request, **settings)

        def process(connection, request):
            if not welcome(host, request.headers.get_all("Host"), request.headers.get_all("Origin")):
                return connection.respond(403, "This page answers to its own address alone.\n")
            return process_request(connection, request)

        return serve(handler, *args, process_request=process, **settings)

    with _wrapping:
        server.serve = wrapped
        try:
            yield
        finally:
            server.serve = serve
