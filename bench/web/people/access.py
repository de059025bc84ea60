"""Who asks, and what they may do: tokens, sessions and roles."""

from __future__ import annotations

import getpass
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, HTTPException, Request, Response

from bench.base import InputError
from bench.web.ground.settings import Settings
from bench.web.ground.throttle import Throttle
from bench.web.people.people import People, Person, Role
from bench.web.people.sessions import Sessions

__all__ = ["Access", "Engineer", "Operator", "Role", "Viewer", "Who", "requires"]

_LOOKING = ("/figures", "/effects/formula")
"""What changes nothing, and is a POST only because the question is long."""
RANKS: dict[Role, int] = {"viewer": 0, "operator": 1, "engineer": 2}


@dataclass(frozen=True)
class Who:
    """Somebody who asks: what stands in the run's events."""

    name: str
    role: Role
    address: str
    """Where from: an IP address."""

    def __str__(self) -> str:
        return f"{self.name} ({self.role}) from {self.address}"


class Access:
    """Knows people by bearer token or by the cookie that they got for it."""

    def __init__(self, settings: Settings) -> None:
        self.people = None if settings.access is None else People(settings.access)
        self._sessions = Sessions(settings.own / "sessions.json") if self.people else None
        self._throttle = Throttle()
        self._secure = settings.secure

    @property
    def open(self) -> bool:
        """No token is asked for: everybody on this machine is an engineer."""
        return self.people is None

    def who(self, request: Request) -> Who:
        """Who sends this request; HTTPException 401 when nobody that we know, 429 after too many wrong tokens."""
        address = request.client.host if request.client else "unknown"
        if self.people is None:
            return Who(_user(), "engineer", address)
        scheme, _, token = request.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            person: Person | None = self._by_token(token.strip(), address)
        else:
            person = self._by_cookie(request)
        if person is None:
            raise HTTPException(401, "no valid token: sign in, or send `Authorization: Bearer <token>`",
                                {"WWW-Authenticate": "Bearer"})  # fmt: skip
        return Who(person.name, person.role, address)

    def knows_still(self, request: Request) -> bool:
        """Whether who sent this request, which is being answered for long, may still look."""
        try:
            self.who(request)
        except (HTTPException, InputError):  # InputError: there is no access file any more, or none that can be read
            return False
        return True

    def sign_in(self, token: str, request: Request, response: Response) -> Who:
        """Exchange a token for a cookie; HTTPException 401 or 429 as for any wrong token."""
        address = request.client.host if request.client else "unknown"
        if self.people is None or self._sessions is None:
            return Who(_user(), "engineer", address)
        person = self._by_token(token, address)
        key = self._sessions.begin(person)
        response.set_cookie(
            self._cookie(request), key, max_age=self._sessions.life_s, path="/", secure=self._secure, httponly=True,
            samesite="strict",
        )  # fmt: skip
        return Who(person.name, person.role, address)

    def sign_out(self, request: Request, response: Response) -> None:
        """End the session of this request's cookie, if it has one."""
        name = self._cookie(request)
        if self._sessions is not None and (key := request.cookies.get(name)):
            self._sessions.end(key)
        response.delete_cookie(name, path="/", secure=self._secure, httponly=True, samesite="strict")

    def _by_token(self, token: str, address: str) -> Person:
        assert self.people is not None
        # 256 bits are not guessed: a right token passes, so that a stray script on the same machine, with a token of
        # last year, keeps nobody from aborting.
        if person := self.people.by_token(token):
            return person
        if wait_s := self._throttle.wait_s(address):
            raise HTTPException(429, f"too many wrong tokens from {address}: wait {wait_s} s",
                                {"Retry-After": str(wait_s)})  # fmt: skip
        self._throttle.wrong(address)
        raise HTTPException(401, "this token is not valid (any more): ask whoever runs this server for one",
                            {"WWW-Authenticate": "Bearer"})  # fmt: skip

    def _by_cookie(self, request: Request) -> Person | None:
        assert self.people is not None
        assert self._sessions is not None
        key = request.cookies.get(self._cookie(request))
        token = self._sessions.token(key) if key else None
        return self.people.by_hash(token) if token else None

    def _cookie(self, request: Request) -> str:
        """Cookies know no ports: two servers on one machine need two names."""
        return f"{'__Host-' if self._secure else ''}bench-{request.url.port or 0}"


def requires(role: Role) -> Callable[[Request], Who]:
    """A dependency that gives who asks, or answers 401 or 403."""

    def dependency(request: Request) -> Who:
        access: Access = request.app.state.access
        who = access.who(request)
        if RANKS[who.role] < RANKS[role]:
            raise HTTPException(403, f"{who.name} is {who.role}; this needs {role}")
        return who

    return dependency


def at_least(request: Request) -> Who:
    """What every route of the API asks for, whatever else it asks: looking a viewer, changing an operator."""
    looking = request.method in {"GET", "HEAD"} or request.url.path.endswith(_LOOKING)
    return requires("viewer" if looking else "operator")(request)


Viewer = Annotated[Who, Depends(requires("viewer"))]
Operator = Annotated[Who, Depends(requires("operator"))]
Engineer = Annotated[Who, Depends(requires("engineer"))]
"""A parameter of a route that needs the role: `def hold(who: Operator)`."""


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a container without a name for its user
        return "unknown"
