"""The password of a live page: comparison gives no hint, and guessing by trial is limited."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable

from backhoe_planner.errors import InputError

_WRONG_AT_ONCE, _WRONG_PER_SECOND = 5.0, 0.1  # wrong passwords from one address; chosen, 8,640 a day
_WRONG_AT_ONCE_BY_ALL, _WRONG_PER_SECOND_BY_ALL = 50.0, 1.0  # wrong passwords from all addresses; chosen
_NEIGHBOURS = 64  # bits of an IPv6 address that its owner cannot choose


class Password:
    """Decides who is let in: whoever gives the password, or has the key that was issued for it.

    Parameters
    ----------
    word: the password.
    now: the clock [s].

    Attributes
    ----------
    key: a random key, for the cookie of a browser that gave the password.

    Raises
    ------
    InputError: the word is empty, or not text.
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
        """Whether `key` is the right key."""
        return key is not None and hmac.compare_digest(_digest(key), _digest(self.key))

    def try_word(self, word: str, *, client: str) -> bool:
        """Whether a word from the address `client` is the password; a wrong one is counted.

        Call `wait` first.
        """
        if hmac.compare_digest(_digest(word), self._digest):
            return True
        now, who = self._now(), _owner(client)
        self._of = {other: wrong for other, wrong in self._of.items() if wrong.level(now) > 0.0}
        self._of.setdefault(who, _Wrong(_WRONG_AT_ONCE, _WRONG_PER_SECOND)).add(now)
        self._all.add(now)
        return False

    def wait(self, client: str) -> float:
        """How long the address `client` has to wait before it may try a password [s]."""
        now, own = self._now(), self._of.get(_owner(client))
        return max(self._all.wait(now), 0.0 if own is None else own.wait(now))


class _Wrong:
    """Counts wrong passwords: a number of them is allowed at once, and they are forgotten over time."""

    def __init__(self, at_once: float, per_second: float) -> None:
        self._at_once, self._per_second = at_once, per_second
        self._level, self._at = 0.0, 0.0

    def level(self, now: float) -> float:
        """The number that is not forgotten at the time `now` [s]."""
        return max(self._level - (now - self._at) * self._per_second, 0.0)

    def add(self, now: float) -> None:
        """Count one wrong password."""
        self._level, self._at = self.level(now) + 1.0, now

    def wait(self, now: float) -> float:
        """The time until another one is allowed [s]."""
        return max(self.level(now) - (self._at_once - 1.0), 0.0) / self._per_second


def _digest(word: str) -> bytes:
    """A digest of fixed length, so that a comparison does not reveal the length of the word."""
    return hashlib.sha256(word.encode("utf-8", errors="surrogatepass")).digest()


def _owner(client: str) -> str:
    """The part of an address that identifies its owner."""
    try:
        ip = ipaddress.ip_address(client)
    except ValueError:
        return client
    if isinstance(ip, ipaddress.IPv4Address):
        return client
    return str(ip.ipv4_mapped or ipaddress.IPv6Network((int(ip), _NEIGHBOURS), strict=False))
