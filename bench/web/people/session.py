"""`/session`: the present user, signing in and out."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import BaseModel, Field

from bench.base import __version__
from bench.web.people.access import Access, Role, Who

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


class SignIn(BaseModel):
    """A token, in exchange for a cookie."""

    token: str = Field(min_length=1, max_length=200)


@router.get("/session")
def session(request: Request) -> SessionAnswer:
    """The present user; may be asked without signing in."""
    access: Access = request.app.state.access
    try:
        return _answer(access.who(request), access)
    except HTTPException as error:
        if error.status_code == 429:
            raise
        return _answer(None, access)


@router.post("/session")
def sign_in(wanted: SignIn, request: Request, response: Response) -> SessionAnswer:
    """Sign in with a token; sets a cookie that scripts cannot read and other sites cannot send."""
    access: Access = request.app.state.access
    return _answer(access.sign_in(wanted.token, request, response), access)


@router.delete("/session")
def sign_out(request: Request, response: Response) -> SessionAnswer:
    """Sign out; the cookie is no longer valid."""
    access: Access = request.app.state.access
    access.sign_out(request, response)
    return _answer(access.who(request) if access.open else None, access)


def _answer(who: Who | None, access: Access) -> SessionAnswer:
    return SessionAnswer(
        name=who.name if who else None,
        role=who.role if who else None,
        version=__version__,
        languages=list(LANGUAGES),
        open=access.open,
    )
