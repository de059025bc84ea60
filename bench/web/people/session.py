"""`/session`: the present user, signing in and out."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import BaseModel, Field

from bench.base import __version__
from bench.web.people.access import Access, Role, Viewer, Who
from bench.web.people.people import PIN_MOST

LANGUAGES = ("en", "uk", "zh")

router = APIRouter(tags=["session"])


class SessionAnswer(BaseModel):
    """The present user, and the server's version and languages."""

    name: str | None
    """None: not signed in."""
    role: Role | None
    version: str
    languages: list[str]
    open: bool
    """Whether this server needs no token."""
    pins: bool
    """Whether a PIN or a badge can name the operator."""
    pin_s: float | None
    """For how long one still does [s]."""


class SignIn(BaseModel):
    """A token, in exchange for a cookie."""

    token: str = Field(min_length=1, max_length=200)


@router.get("/session")
def session(request: Request) -> SessionAnswer:
    """The present user; may be asked without signing in."""
    access: Access = request.app.state.access
    try:
        return _answer(access.who(request), access, access.pin_left_s(request))
    except HTTPException as error:
        if error.status_code == 429:
            raise
        return _answer(None, access)


@router.post("/session")
def sign_in(wanted: SignIn, request: Request, response: Response) -> SessionAnswer:
    """Sign in with a token; sets a cookie that scripts cannot read and other sites cannot send."""
    access: Access = request.app.state.access
    return _answer(access.sign_in(wanted.token, request, response), access)


class PinEntered(BaseModel):
    """A PIN, or what a badge reader types."""

    pin: str = Field(min_length=1, max_length=PIN_MOST)


@router.post("/session/pin", status_code=204)
def enter_pin(entered: PinEntered, request: Request, response: Response, who: Viewer) -> None:
    """Name the operator on a screen that is signed in, for a quarter of an hour."""
    access: Access = request.app.state.access
    access.enter_pin(entered.pin, request, response)


@router.delete("/session/pin", status_code=204)
def leave_pin(request: Request, response: Response, who: Viewer) -> None:
    """The screen has no operator any more."""
    access: Access = request.app.state.access
    access.sign_out(request, response, pin=True)


@router.delete("/session")
def sign_out(request: Request, response: Response) -> SessionAnswer:
    """Sign out; the cookie is no longer valid."""
    access: Access = request.app.state.access
    access.sign_out(request, response)
    return _answer(access.who(request) if access.open else None, access)


def _answer(who: Who | None, access: Access, pin_s: float | None = None) -> SessionAnswer:
    return SessionAnswer(
        name=who.name if who else None,
        role=who.role if who else None,
        version=__version__,
        languages=list(LANGUAGES),
        open=access.open,
        pins=access.people is not None and access.people.have_pins,
        pin_s=pin_s,
    )
