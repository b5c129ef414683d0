"""The cockpit's HTTP and WebSocket interface."""

import json
import secrets
from importlib.resources import files
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Header, HTTPException, Path, Request, Response, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, HTMLResponse, PlainTextResponse, StreamingResponse
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4
from pydantic import BaseModel, ConfigDict, Field

from follower.ui.cockpit.asgi_guard import AsgiGuard, RateLimiter, address_of, client_identity
from follower.ui.cockpit.auth import AccessControl, cookie_name
from follower.ui.cockpit.detections import Objects
from follower.ui.cockpit.hub import Hub
from follower.ui.cockpit.metrics import FlightMetrics
from follower.ui.cockpit.mjpeg import BOUNDARY, JpegStream, MjpegResponse
from follower.ui.cockpit.recordings_api import RecordingFolder, RecordingSummary
from follower.ui.cockpit.requests import OperatorRequest, is_release
from follower.ui.cockpit.webrtc import OfferError, WebRtcPeers
from follower.ui.cockpit.websocket import WebSocketSession
from follower_vision.clock import Clock

_GUESSES_HZ, _GUESSES_BURST = 1.0, 8
"""How often a client may show a wrong token."""
_WRITES_HZ, _WRITES_BURST = 50.0, 100
"""How often a client may ask for anything by POST."""
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


class RefusalResponse(BaseModel):
    """Why something was refused."""

    detail: str


_REFUSALS: dict[int | str, dict[str, Any]] = {
    code: {"model": RefusalResponse} for code in (400, 401, 403, 413, 415, 421, 429)
}


def make_app(
    *,
    hub: Hub,
    access: AccessControl,
    jpegs: JpegStream,
    peers: WebRtcPeers,
    flights: RecordingFolder,
    objects: Objects | None,
    clock: Clock,
    secure: bool,
) -> AsgiGuard:
    """Return the application behind its guard.

    Args:
        hub: of all clients.
        access: judges who may come in.
        jpegs: the video as MJPEG.
        peers: the video by WebRTC.
        flights: the recordings.
        objects: what may be selected, None without a detector.
        clock: this process's.
        secure: it is reached by https: the cookie is to go no other way.
    """
    app = FastAPI(title="follower cockpit", docs_url=None, redoc_url=None, responses=_REFUSALS)
    guesses = RateLimiter(_GUESSES_HZ, _GUESSES_BURST, clock)
    writes = RateLimiter(_WRITES_HZ, _WRITES_BURST, clock)
    nonce = secrets.token_urlsafe(12)
    _add_refusal(app)
    _add_page(app, nonce)
    _add_session(app, access, guesses, secure)
    _add_requests(app, hub, writes)
    _add_video(app, jpegs, peers)
    _add_flights(app, flights)
    _add_metrics(app, FlightMetrics(hub))

    @app.websocket("/ws")
    async def converse(socket: WebSocket) -> None:
        await WebSocketSession(socket, hub, objects, clock).run()

    return AsgiGuard(app, access, guesses, writes, nonce)


def _add_refusal(app: FastAPI) -> None:
    @app.exception_handler(RequestValidationError)
    async def refuse(request: Request, error: RequestValidationError) -> Response:
        """Say what is wrong, but not repeat it: it may be what JSON cannot say, such as NaN."""
        del request
        found = [{key: one[key] for key in ("type", "loc", "msg")} for one in error.errors()]
        return Response(json.dumps({"detail": found}), 422, media_type="application/json")


def _add_page(app: FastAPI, nonce: str) -> None:
    html = files("follower.ui.cockpit").joinpath("page.html").read_text("utf-8")
    page = html.replace("NONCE", nonce)

    @app.get("/", response_class=HTMLResponse, include_in_schema=False)
    async def show_page() -> str:
        return page


def _add_session(app: FastAPI, access: AccessControl, guesses: RateLimiter, secure: bool) -> None:
    @app.post("/api/session", status_code=204)
    async def open_session(token: Token, request: Request, response: Response) -> None:
        """Show the token once; the cookie that comes back stands for it."""
        if not guesses.allows(address_of(request.scope)):
            raise HTTPException(429, "slower, please")
        session = access.open_session(token.token)
        if session is None:
            raise HTTPException(401, "this is not the token", {"www-authenticate": "Bearer"})
        name = cookie_name(request.headers)
        response.set_cookie(name, session, httponly=True, samesite="strict", secure=secure)


def _add_requests(app: FastAPI, hub: Hub, writes: RateLimiter) -> None:
    @app.get("/api/page")
    async def page() -> dict[str, Any]:
        """Return what is being flown, and which settings may be changed."""
        return hub.page

    @app.get("/api/state")
    async def state() -> dict[str, Any]:
        """Return the flight's newest state; `at` less `told_s` is its age, in seconds."""
        return hub.moment()

    @app.post("/api/request", responses={409: {"model": RefusalResponse}})
    async def request(
        wanted: OperatorRequest,
        http: Request,
        x_client: Annotated[str, Header(max_length=64)] = "",
    ) -> Answer:
        """Send a request to the flight. All may stop; the client in control may do the rest."""
        if not is_release(wanted) and not writes.allows(client_identity(http.scope)):
            raise HTTPException(429, "slower, please")
        if not hub.may(x_client, wanted):
            raise HTTPException(409, "another client is in control, or none")
        answer = await hub.ask(wanted, "cockpit")
        return Answer(accepted=answer["accepted"], text=answer["text"])


def _add_video(app: FastAPI, jpegs: JpegStream, peers: WebRtcPeers) -> None:
    @app.get(
        "/video.mjpeg",
        response_class=StreamingResponse,
        responses={
            200: {"content": {f"multipart/x-mixed-replace; boundary={BOUNDARY}": {}}},
            503: {"model": RefusalResponse},
        },
        include_in_schema=False,
    )
    async def mjpeg() -> StreamingResponse:
        if jpegs.full:
            raise HTTPException(503, "too many watch already")
        return MjpegResponse(jpegs.parts())

    @app.post("/api/webrtc", responses={409: {"model": RefusalResponse}})
    async def webrtc(offer: Offer) -> Offer:
        """Watch by WebRTC: the answer to an offer."""
        try:
            return Offer(sdp=await peers.answer(offer.sdp))
        except OfferError as error:
            raise HTTPException(409, str(error)) from None


def _add_flights(app: FastAPI, recordings: RecordingFolder) -> None:
    @app.get("/api/flights")
    def flights() -> list[RecordingSummary]:
        """Return the recorded flights, the newest first."""
        return recordings.listed()

    @app.get(
        "/api/flights/{name}/{what}",
        response_class=FileResponse,
        responses={200: {"content": {"text/html": {}}}, 404: {"model": RefusalResponse}},
    )
    def report(name: Annotated[str, Path(max_length=120)], what: Literal["report"]) -> FileResponse:
        """Return a flight's report."""
        del what
        path = recordings.report(name)
        if path is None:
            raise HTTPException(404, "there is no such report")
        headers = {"content-security-policy": _REPORT_POLICY}
        return FileResponse(path, media_type="text/html", headers=headers)


def _add_metrics(app: FastAPI, metrics: FlightMetrics) -> None:
    @app.get("/metrics", response_class=PlainTextResponse)
    async def show_metrics() -> Response:
        """Return the flight's newest state as Prometheus metrics."""
        return Response(metrics.text(), media_type=CONTENT_TYPE_PLAIN_0_0_4)
