"""The address on which a live page is served: who can reach it, its names, and its URL."""

from __future__ import annotations

import errno
import ipaddress
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

from backhoe_planner.errors import InputError, OutputError

_FIRST_PORT, _PORTS = 7000, 100  # meshcat's own server begins at the same port; the number of attempts is chosen
_NOT_HERE = {errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT}  # another computer's address, or no IPv6 on this one


@dataclass(frozen=True)
class Address:
    """An address of this computer.

    Attributes
    ----------
    host: the name or address that was given.
    ip: the IP address of the host.
    """

    host: str
    ip: ipaddress.IPv4Address | ipaddress.IPv6Address

    @property
    def is_of_this_computer_alone(self) -> bool:
        """Whether no other computer can reach the address."""
        return self.ip.is_loopback

    def url(self, port: int) -> str:
        """The URL for a browser on this computer, for a port."""
        host = self.host
        if self.ip.is_unspecified:
            host = "127.0.0.1" if self.ip.version == 4 else "::1"
        return f"http://{_in_url(host)}:{port}/"

    def url_from_elsewhere(self, port: int) -> str | None:
        """The URL for a browser on another computer; None if none can connect."""
        if self.is_of_this_computer_alone:
            return None
        return f"http://{socket.gethostname().lower()}:{port}/" if self.ip.is_unspecified else self.url(port)

    def answers_to(self, host: str) -> bool:
        """Whether a request's Host header names this address.

        The owner of another name can make that name point to this computer. A page from there would then count as one
        of this server.
        """
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:  # not an address
            return False
        if name in ("localhost", self.host.lower(), socket.gethostname().lower()):
            return True
        try:
            found = ipaddress.ip_address(name)
        except ValueError:
            return False
        return found.is_loopback or found == self.ip or self.ip.is_unspecified

    def listen(self, port: int | None, *, backlog: int) -> socket.socket:
        """A socket that listens on a port; None takes the first free one from 7000 on, 0 any free one.

        Raises
        ------
        InputError: the address is not one of this computer.
        OutputError: the port is in use.
        """
        family = socket.AF_INET if self.ip.version == 4 else socket.AF_INET6
        both = self.ip.version == 6 and self.ip.is_unspecified and socket.has_dualstack_ipv6()
        for number in range(_FIRST_PORT, _FIRST_PORT + _PORTS) if port is None else [port]:
            try:
                listening = socket.create_server(
                    (str(self.ip), number), family=family, backlog=backlog, dualstack_ipv6=both
                )
            except OSError as error:
                if error.errno in _NOT_HERE:
                    raise InputError(
                        "is no address of this computer", key="host", found=self.host, hint=str(error)
                    ) from error
                if port is not None:
                    raise OutputError("the port cannot be used", key="port", found=port, hint=str(error)) from error
                continue
            listening.setblocking(False)
            return listening
        raise OutputError("no free port", key="port", allowed=f"{_FIRST_PORT} to {_FIRST_PORT + _PORTS - 1}")


def find_address(host: str) -> Address:
    """The address of `host`: a name, an IPv4 or an IPv6 address, with or without brackets.

    Raises
    ------
    InputError: there is no such address, or browsers cannot open it.
    """
    plain = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if "%" in plain:  # fe80::1%eth0
        raise InputError(
            "names a network interface, and browsers cannot open such an address", key="host", found=host,
            allowed="an address without %",
        )  # fmt: skip
    try:
        found = socket.getaddrinfo(plain or "0.0.0.0", None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, ValueError) as error:  # ValueError: the text cannot be a name, such as one with a null character
        raise InputError("is no address of this computer", key="host", found=host, hint=str(error)) from error
    ips = [ipaddress.ip_address(where[0]) for *_, where in found]
    ip = next((one for one in ips if one.version == 4), ips[0])  # a name may have both
    mapped = ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None
    return Address(plain or "0.0.0.0", mapped or ip)


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
