"""What a client of the cockpit may ask for. Everything else is refused before it goes anywhere."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

_Share: TypeAlias = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SelectPoint(_Request):
    """Follow what is seen at a point; shares of the image's width and height."""

    kind: Literal["select_point"]
    x: _Share
    y: _Share


class SelectBox(_Request):
    """Follow what a rectangle shows; shares of the image's width and height."""

    kind: Literal["select_box"]
    left: _Share
    top: _Share
    right: _Share
    bottom: _Share


class SelectObject(_Request):
    """Follow a numbered object, where it is now; shares of the image's width and height."""

    kind: Literal["select_object"]
    left: _Share
    top: _Share
    right: _Share
    bottom: _Share


class StopTracking(_Request):
    """Have no target any more."""

    kind: Literal["stop_tracking"]


class Consent(_Request):
    """Allow following, or allow it no longer."""

    kind: Literal["consent"]
    given: Annotated[bool, Field(strict=True)]


class Stop(_Request):
    """Stop and let go at once."""

    kind: Literal["stop"]


class Change(_Request):
    """Change one setting in flight."""

    kind: Literal["change"]
    key: Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[a-z0-9_.]+$")]
    value: Annotated[
        bool
        | Annotated[int, Field(ge=-1_000_000, le=1_000_000)]
        | Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
        | Annotated[str, Field(max_length=40)],
        Field(union_mode="smart"),
    ]


class Show(_Request):
    """Replay another flight; in a replay alone."""

    kind: Literal["show"]
    flight: Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9._-]+$")]


OperatorRequest: TypeAlias = Annotated[
    SelectPoint | SelectBox | SelectObject | StopTracking | Consent | Stop | Change | Show,
    Field(discriminator="kind"),
]
REQUESTS: TypeAdapter[OperatorRequest] = TypeAdapter(OperatorRequest)


def lets_go(request: OperatorRequest) -> bool:
    """Whether a request ends following: such a one is nobody's privilege and is never put off."""
    return isinstance(request, Stop) or (isinstance(request, Consent) and not request.given)
