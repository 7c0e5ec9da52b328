"""Whom our HTTP APIs serve: our own pages and programs, never a page of another origin."""

import ipaddress
import re
from collections.abc import Callable
from http import HTTPStatus

from foundation.rest.access import Access, GuardedRequest, Role, TokenCheck
from foundation.rest.problems import Refusal, RefusalLog, advised

_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+?)\.?(:[0-9]{1,5})?", re.IGNORECASE)
_OWN_SITE = frozenset({"same-origin", "none"})  # none: the person typed the address
Refuse = Callable[[GuardedRequest], Refusal | None]


class Guard:
    """Judges requests by their heads.

    Loopback and the address that the client reached may always be called by. A request for another name may
    come from a page whose DNS name was turned to us (DNS rebinding). Headers that only browsers send decide
    about the origin; a program that sends none is served, where tokens are wanted with one. What is refused
    is told to ``refusals``. ``refuse``: what is refused beside that, after all else.
    """

    def __init__(self, access: Access, refusals: RefusalLog, refuse: Refuse | None = None) -> None:
        self._allowed = frozenset(host.lower() for host in access.allowed_hosts)
        self._origins = access.allowed_origins
        self._senders = access.senders
        self._tokens = TokenCheck(access.tokens, access.stops, access.public) if access.tokens else None
        self._refusals = refusals
        self._advise = access.advise
        self._refuse = refuse

    def refusal(self, asked: GuardedRequest) -> Refusal | None:
        """Why a request is refused, with what to do about it; None when it may go on."""
        refusal = self._refusal_for(asked)
        return None if refusal is None else self.told(refusal, asked.client)

    def told(self, refusal: Refusal, client: str) -> Refusal:
        """A refusal that is counted, and says what to do about it."""
        self._refusals.tell(refusal, client)
        return advised(refusal, self._advise)

    def role_of(self, asked: GuardedRequest) -> Role | None:
        """Of whoever asks; None where no token is wanted, or none was sent."""
        return None if self._tokens is None else self._tokens.role_of(asked)

    def _refusal_for(self, asked: GuardedRequest) -> Refusal | None:
        if self._senders is not None and asked.client not in self._senders:
            detail = f"without tokens only this machine may ask, not {asked.client}: unset LONGREACH_NO_TOKEN"
            return asked.refused(HTTPStatus.FORBIDDEN, "refused.other_machine", detail)
        hosts = asked.values(b"host")
        if len(hosts) != 1 or not self._is_ours(hosts[0], asked.server):
            detail = f"this service is not {', '.join(hosts)[:80] or 'without a name'}: see allowed_hosts"
            return asked.refused(HTTPStatus.MISDIRECTED_REQUEST, "refused.foreign_host", detail)
        own = f"{asked.scheme}://{hosts[0]}".lower()
        origins = [origin.lower() for origin in asked.values(b"origin")]
        for origin in origins:
            if origin != own and origin not in self._origins:
                return _foreign_origin(asked, f"a page of {origin[:80]}")
        for site in asked.values(b"sec-fetch-site"):
            if site.lower() not in _OWN_SITE and self._origins.isdisjoint(origins):
                return _foreign_origin(asked, f"a page of another origin ({site[:20]})")
        refusal = None if self._tokens is None else self._tokens.refusal(asked)
        return self._refuse(asked) if refusal is None and self._refuse is not None else refusal

    def _is_ours(self, host: str, reached: str) -> bool:
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = match[1].strip("[]").lower()
        if name == "localhost" or name in self._allowed:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or str(address) == reached


def _foreign_origin(asked: GuardedRequest, who: str) -> Refusal:
    return asked.refused(HTTPStatus.FORBIDDEN, "refused.foreign_origin", f"{who} may not ask this service")
