"""The password of a live page: compared without a hint, and not guessed by trying."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable

from backhoe_planner.errors import InputError

_WRONG_AT_ONCE, _WRONG_PER_SECOND = 5.0, 0.1  # wrong passwords from one address; chosen, 8,640 a day
_WRONG_AT_ONCE_BY_ALL, _WRONG_PER_SECOND_BY_ALL = 50.0, 1.0  # and from all addresses; chosen
_NEIGHBOURS = 64  # bits of an IPv6 address that its owner cannot choose


class Password:
    """Decides who is let in: who says the word, or brings the key that was given for it.

    Parameters
    ----------
    word: the password.
    now: the clock [s].

    Attributes
    ----------
    key: a random one, for the cookie of whoever said the word.

    Raises
    ------
    InputError: the word is empty, or no text.
    """

    def __init__(self, word: str, *, now: Callable[[], float] = time.monotonic) -> None:
        if not isinstance(word, str) or not word:
            raise InputError("is empty", key="password", allowed="any word")
        self._digest = _digest(word)
        self.key = secrets.token_urlsafe(32)
        self._now = now
        self._all = _Wrong(_WRONG_AT_ONCE_BY_ALL, _WRONG_PER_SECOND_BY_ALL)
        self._of: dict[str, _Wrong] = {}

    def opens(self, key: str | None) -> bool:
        """Whether somebody brings the key."""
        return key is not None and hmac.compare_digest(_digest(key), _digest(self.key))

    def try_word(self, word: str, *, client: str) -> bool:
        """Whether somebody at the address `client` says the password; a wrong one is counted.

        Ask `wait` first.
        """
        if hmac.compare_digest(_digest(word), self._digest):
            return True
        now, who = self._now(), _owner(client)
        self._of = {other: wrong for other, wrong in self._of.items() if wrong.level(now) > 0.0}
        self._of.setdefault(who, _Wrong(_WRONG_AT_ONCE, _WRONG_PER_SECOND)).add(now)
        self._all.add(now)
        return False

    def wait(self, client: str) -> float:
        """How long the address `client` has to wait before it may say a word [s]."""
        now, own = self._now(), self._of.get(_owner(client))
        return max(self._all.wait(now), 0.0 if own is None else own.wait(now))


class _Wrong:
    """Wrong passwords: so many are free at once, and are forgotten with time."""

    def __init__(self, at_once: float, per_second: float) -> None:
        self._at_once, self._per_second = at_once, per_second
        self._level, self._at = 0.0, 0.0

    def level(self, now: float) -> float:
        """How many are not forgotten at the time `now` [s]."""
        return max(self._level - (now - self._at) * self._per_second, 0.0)

    def add(self, now: float) -> None:
        """Count one."""
        self._level, self._at = self.level(now) + 1.0, now

    def wait(self, now: float) -> float:
        """How long until another one is free [s]."""
        return max(self.level(now) - (self._at_once - 1.0), 0.0) / self._per_second


def _digest(word: str) -> bytes:
    """Of one length, so that a comparison does not tell the length of the word."""
    return hashlib.sha256(word.encode("utf-8", errors="surrogatepass")).digest()


def _owner(client: str) -> str:
    """The part of an address that one owner has."""
    try:
        ip = ipaddress.ip_address(client)
    except ValueError:
        return client
    if isinstance(ip, ipaddress.IPv4Address):
        return client
    return str(ip.ipv4_mapped or ipaddress.IPv6Network((int(ip), _NEIGHBOURS), strict=False))
