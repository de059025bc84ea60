"""Identifies the user of a request by token or session, and checks roles."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

from fastapi import Depends, HTTPException, Request, Response

from bench.base import InputError, user_name
from bench.web.ground.callers import network, recognised
from bench.web.ground.settings import Settings
from bench.web.ground.throttle import Throttle
from bench.web.people.people import People, Person, Role
from bench.web.people.sessions import Sessions

__all__ = ["Access", "Engineer", "Operator", "Role", "Viewer", "Who", "named_by", "requires"]

_LOOKING = ("/figures", "/effects/formula")
"""POST routes that change nothing: their questions are too long for a GET."""
PIN_LIFE_S = 900
"""For so long a PIN or badge names the operator on a screen [s]."""
_BY_PIN = "pin "
"""Kind of a session that a PIN has begun: it is worth nothing as another one."""
RANKS: dict[Role, int] = {"viewer": 0, "operator": 1, "engineer": 2}


@dataclass(frozen=True)
class Who:
    """The user of a request, as the events of a run name it."""

    name: str
    role: Role
    address: str
    """IP address of the request."""

    def __str__(self) -> str:
        return f"{self.name} ({self.role}) from {self.address}"


class Access:
    """Recognises users by bearer token or by the cookie of their session."""

    def __init__(self, settings: Settings) -> None:
        self.people = None if settings.access is None else People(settings.access)
        self._sessions = Sessions(settings.own / "sessions.json") if self.people else None
        self._throttle, self._pin_throttle = Throttle(), Throttle()
        self._secure = settings.secure

    @property
    def open(self) -> bool:
        """Whether no token is needed: every user of this computer is an engineer."""
        return self.people is None

    def who(self, request: Request) -> Who:
        """User of this request; HTTPException 401 for an unknown one, 429 after too many wrong tokens."""
        who = self._who(request)
        recognised(request.scope, who.name)
        return who

    def _who(self, request: Request) -> Who:
        address = request.client.host if request.client else "unknown"
        if self.people is None:
            return Who(user_name(), "engineer", address)
        scheme, _, token = request.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            person: Person | None = self._by_token(token.strip(), address)
        else:
            person = self._by_cookie(request)
            if person is not None and (named := self._by_cookie(request, pin=True)) is not None:
                # Few digits can be seen over a shoulder: they never give what an engineer may do.
                role: Role = "operator" if named.role == "engineer" else named.role
                return Who(named.name, role, address)
        if person is None:
            raise HTTPException(401, "no valid token: sign in, or send `Authorization: Bearer <token>`",
                                {"WWW-Authenticate": "Bearer"})  # fmt: skip
        return Who(person.name, person.role, address)

    def knows_still(self, request: Request) -> bool:
        """Whether the user of a long-lived request still has access."""
        try:
            self.who(request)
        except (HTTPException, InputError):  # InputError: the access file was removed or cannot be read
            return False
        return True

    def sign_in(self, token: str, request: Request, response: Response) -> Who:
        """Exchange a token for a cookie; HTTPException 401 or 429 as for any wrong token."""
        address = request.client.host if request.client else "unknown"
        if self.people is None or self._sessions is None:
            return Who(user_name(), "engineer", address)
        person = self._by_token(token, address)
        recognised(request.scope, person.name)
        key = self._sessions.begin(person)
        response.set_cookie(
            self._cookie(request), key, max_age=self._sessions.life_s, path="/", secure=self._secure, httponly=True,
            samesite="strict",
        )  # fmt: skip
        return Who(person.name, person.role, address)

    def enter_pin(self, pin: str, request: Request, response: Response) -> None:
        """Name the operator on a screen that is signed in; HTTPException 401 for a wrong PIN, 429 after too many."""
        address = request.client.host if request.client else "unknown"
        if self.people is None or self._sessions is None:
            raise HTTPException(409, "this server needs no PIN: every user of this computer is an engineer")
        if wait_s := self._pin_throttle.wait_s(network(address)):
            raise HTTPException(429, f"too many wrong PINs: wait {wait_s} s", {"Retry-After": str(wait_s)})
        person = self.people.by_pin(pin)
        if person is None:
            self._pin_throttle.wrong(network(address))
            raise HTTPException(401, "this PIN or badge is not known", {"WWW-Authenticate": "Bearer"})
        key = self._sessions.begin(person, PIN_LIFE_S, _BY_PIN)
        response.set_cookie(
            self._cookie(request, pin=True), key, max_age=PIN_LIFE_S, path="/", secure=self._secure, httponly=True,
            samesite="strict",
        )  # fmt: skip

    def pin_left_s(self, request: Request) -> float | None:
        """For how long a PIN still names the operator of this screen [s]; None where none does."""
        key = request.cookies.get(self._cookie(request, pin=True))
        return (self._sessions.left_s(key) or None) if self._sessions and key else None

    def sign_out(self, request: Request, response: Response, *, pin: bool = False) -> None:
        """End the session of this request's cookie, or only what a PIN has begun, if it has one."""
        if not pin:
            self.sign_out(request, response, pin=True)
        name = self._cookie(request, pin=pin)
        if self._sessions is not None and (key := request.cookies.get(name)):
            self._sessions.end(key)
        response.delete_cookie(name, path="/", secure=self._secure, httponly=True, samesite="strict")

    def _by_token(self, token: str, address: str) -> Person:
        assert self.people is not None
        # Tokens of 256 bits cannot be guessed, so a right one always passes: a stray script with an old token on the
        # same computer, or behind the same address, must not keep an operator from aborting a run.
        if person := self.people.by_token(token):
            return person
        if wait_s := self._throttle.wait_s(network(address)):
            text = f"too many wrong tokens from {address}: wait {wait_s} s; a right one is accepted at once"
            raise HTTPException(429, text,
                                {"Retry-After": str(wait_s)})  # fmt: skip
        self._throttle.wrong(network(address))
        raise HTTPException(401, "this token is not valid: ask the administrator of this server for one",
                            {"WWW-Authenticate": "Bearer"})  # fmt: skip

    def _by_cookie(self, request: Request, *, pin: bool = False) -> Person | None:
        assert self.people is not None
        assert self._sessions is not None
        key = request.cookies.get(self._cookie(request, pin=pin))
        token = self._sessions.token(key) if key else None
        mark = _BY_PIN if pin else ""
        return self.people.by_hash(token.removeprefix(mark)) if token and token.startswith(mark) else None

    def _cookie(self, request: Request, *, pin: bool = False) -> str:
        """Name of the cookie; cookies ignore ports, so servers on one computer need different names."""
        return f"{'__Host-' if self._secure else ''}bench-{request.url.port or 0}{'-pin' if pin else ''}"


def permitted(request: Request, role: Role) -> Who:
    """The user of a request; HTTPException 401, 403 or 429."""
    access: Access = request.app.state.access
    who = access.who(request)
    if RANKS[who.role] < RANKS[role]:
        raise HTTPException(403, f"{who.name} is {who.role}; this needs {role}")
    return who


def named_by(who: Who, operator: str, request: Request, started: Mapping[str, str] | None = None) -> Who:
    """The user; where nobody signs in, by the name that was typed, else by that of whom `started` it.

    HTTPException 400 for a name that was typed where somebody has signed in.
    """
    own: bool = not request.app.state.access.open
    name = " ".join(operator.split())
    if name and own:
        raise HTTPException(400, "operator: whoever signed in is the operator; leave it out")
    if not name.isprintable():
        raise HTTPException(400, "operator: must be visible characters")
    name = name or ("" if own else (started or {}).get("name", ""))
    return replace(who, name=name) if name else who


def requires(role: Role) -> Callable[[Request], Awaitable[Who]]:
    """A dependency that returns the user of a request, or answers 401 or 403; it waits for no thread."""

    async def dependency(request: Request) -> Who:
        return permitted(request, role)

    return dependency


async def at_least(request: Request) -> Who:
    """Role that every route needs at least: viewer to look, operator to change something."""
    looking = request.method in {"GET", "HEAD"} or request.url.path.endswith(_LOOKING)
    return permitted(request, "viewer" if looking else "operator")


Viewer = Annotated[Who, Depends(requires("viewer"))]
Operator = Annotated[Who, Depends(requires("operator"))]
Engineer = Annotated[Who, Depends(requires("engineer"))]
"""A parameter of a route that needs the role: `def hold(who: Operator)`."""
