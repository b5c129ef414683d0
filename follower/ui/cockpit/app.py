"""The cockpit's HTTP and WebSocket interface."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from importlib.resources import files
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Header, HTTPException, Path, Request, Response, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, HTMLResponse, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from follower.cockpit.access import COOKIE, Access
from follower.cockpit.asker import address_of, asker_of
from follower.cockpit.conversation import Conversation
from follower.cockpit.flights import Flights
from follower.cockpit.hub import Hub
from follower.cockpit.limiters import Limiters
from follower.cockpit.mjpeg import BOUNDARY, JpegStream
from follower.cockpit.objects import Objects
from follower.cockpit.patient_response import PatientResponse
from follower.cockpit.requests import OperatorRequest, lets_go
from follower.cockpit.webrtc import OfferError, Peers
from follower_vision.clock import Clock

_REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"


class Token(BaseModel):
    """The token that the terminal shows."""

    model_config = ConfigDict(extra="forbid")
    token: Annotated[str, Field(max_length=200)]


class Offer(BaseModel):
    """A browser's WebRTC offer."""

    model_config = ConfigDict(extra="forbid")
    sdp: Annotated[str, Field(max_length=60_000)]


class Answer(BaseModel):
    """What came of a request."""

    accepted: bool
    text: str


class FlightEntry(BaseModel):
    """One recorded flight."""

    name: str
    changed_s: float
    megabytes: float
    has_video: bool
    has_report: bool


class Refusal(BaseModel):
    """Why something was refused."""

    detail: str


_REFUSALS: dict[int | str, dict[str, Any]] = {
    code: {"model": Refusal} for code in (400, 401, 403, 413, 415, 421, 429)
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What the interface is made of; see each class.

    Attributes:
        objects: None without a detector.
        guesses: how often each one may show a wrong token.
        writes: how often each one may ask for anything by POST.
    """

    hub: Hub
    access: Access
    jpegs: JpegStream
    peers: Peers
    flights: Flights
    objects: Objects | None
    guesses: Limiters
    writes: Limiters
    clock: Clock


def make_app(parts: Parts, nonce: str, secure: bool) -> FastAPI:
    """Return the application; `Guard` belongs in front of it.

    Args:
        parts: what it is made of.
        nonce: for the page's script and style.
        secure: it is reached by https: the cookie is to go no other way.
    """
    app = FastAPI(title="follower cockpit", docs_url=None, redoc_url=None, responses=_REFUSALS)
    _add_refusal(app)
    _add_page(app, parts, nonce, secure)
    _add_requests(app, parts)
    _add_video(app, parts)
    _add_flights(app, parts)
    return app


def _add_refusal(app: FastAPI) -> None:
    @app.exception_handler(RequestValidationError)
    async def refuse(request: Request, error: RequestValidationError) -> Response:
        """Say what is wrong, but not repeat it: it may be what JSON cannot say, such as NaN."""
        del request
        found = [{key: one[key] for key in ("type", "loc", "msg")} for one in error.errors()]
        return Response(json.dumps({"detail": found}), 422, media_type="application/json")


def _add_page(app: FastAPI, parts: Parts, nonce: str, secure: bool) -> None:
    html = files("follower.cockpit").joinpath("page.html").read_text("utf-8")
    page = html.replace("NONCE", nonce)

    @app.get("/", response_class=HTMLResponse, include_in_schema=False)
    async def show_page() -> str:
        return page

    @app.post("/api/session", status_code=204)
    async def open_session(token: Token, request: Request, response: Response) -> None:
        """Show the token once; the cookie that comes back stands for it."""
        if not parts.guesses[address_of(request.scope)].allows():
            raise HTTPException(429, "slower, please")
        session = parts.access.open_session(token.token)
        if session is None:
            raise HTTPException(401, "this is not the token", {"www-authenticate": "Bearer"})
        response.set_cookie(COOKIE, session, httponly=True, samesite="strict", secure=secure)


def _add_requests(app: FastAPI, parts: Parts) -> None:
    hub = parts.hub

    @app.get("/api/page")
    async def page() -> dict[str, Any]:
        """Return what is being flown, and which settings may be changed."""
        return hub.page

    @app.get("/api/state")
    async def state() -> dict[str, Any]:
        """Return the flight's newest moment."""
        return hub.state

    @app.post("/api/request", responses={409: {"model": Refusal}})
    async def request(
        wanted: OperatorRequest,
        http: Request,
        x_client: Annotated[str, Header(max_length=64)] = "",
    ) -> Answer:
        """Ask the flight for something. Anybody may stop; the client in control may do the rest."""
        if not lets_go(wanted) and not parts.writes[asker_of(http.scope)].allows():
            raise HTTPException(429, "slower, please")
        if not hub.may(x_client, wanted):
            raise HTTPException(409, "another client is in control, or none")
        answer = await hub.ask(wanted, "cockpit")
        return Answer(accepted=answer["accepted"], text=answer["text"])

    @app.websocket("/ws")
    async def converse(socket: WebSocket) -> None:
        await Conversation(socket, hub, parts.objects, parts.clock).run()


def _add_video(app: FastAPI, parts: Parts) -> None:
    @app.get(
        "/video.mjpeg",
        response_class=StreamingResponse,
        responses={
            200: {"content": {f"multipart/x-mixed-replace; boundary={BOUNDARY}": {}}},
            503: {"model": Refusal},
        },
        include_in_schema=False,
    )
    async def jpegs() -> StreamingResponse:
        if parts.jpegs.full:
            raise HTTPException(503, "too many watch already")
        return PatientResponse(parts.jpegs.parts())

    @app.post("/api/webrtc", responses={409: {"model": Refusal}})
    async def webrtc(offer: Offer) -> Offer:
        """Watch by WebRTC: the answer to an offer."""
        try:
            return Offer(sdp=await parts.peers.answer(offer.sdp))
        except OfferError as error:
            raise HTTPException(409, str(error)) from None


def _add_flights(app: FastAPI, parts: Parts) -> None:
    @app.get("/api/flights")
    def flights() -> list[FlightEntry]:
        """Return the recorded flights, the newest first."""
        return [FlightEntry(**asdict(flight)) for flight in parts.flights.listed()]

    @app.get(
        "/api/flights/{name}/{what}",
        response_class=FileResponse,
        responses={200: {"content": {"text/html": {}}}, 404: {"model": Refusal}},
    )
    def report(name: Annotated[str, Path(max_length=120)], what: Literal["report"]) -> FileResponse:
        """Return a flight's report."""
        del what
        path = parts.flights.report(name)
        if path is None:
            raise HTTPException(404, "there is no such report")
        headers = {"content-security-policy": _REPORT_POLICY}
        return FileResponse(path, media_type="text/html", headers=headers)
