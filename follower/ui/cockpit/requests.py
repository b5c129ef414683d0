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


class _BoxRequest(_Request):
    left: _Share
    top: _Share
    right: _Share
    bottom: _Share

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom; shares of the image's width and height."""
        return self.left, self.top, self.right, self.bottom


class SelectBox(_BoxRequest):
    """Follow what a rectangle shows; shares of the image's width and height."""

    kind: Literal["select_box"]


class SelectObject(_BoxRequest):
    """Follow a numbered object, where it is now; shares of the image's width and height."""

    kind: Literal["select_object"]


class StopTracking(_Request):
    """Clear the target."""

    kind: Literal["stop_tracking"]


class ConsentCommand(_Request):
    """Allow following, or allow it no longer."""

    kind: Literal["consent"]
    given: Annotated[bool, Field(strict=True)]


class StopCommand(_Request):
    """Stop following and release at once."""

    kind: Literal["stop"]


class SettingCommand(_Request):
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


class ShowRecording(_Request):
    """Replay another flight; in a replay alone."""

    kind: Literal["show"]
    flight: Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9._-]+$")]


OperatorRequest: TypeAlias = Annotated[
    SelectPoint
    | SelectBox
    | SelectObject
    | StopTracking
    | ConsentCommand
    | StopCommand
    | SettingCommand
    | ShowRecording,
    Field(discriminator="kind"),
]
REQUESTS: TypeAdapter[OperatorRequest] = TypeAdapter(OperatorRequest)


def is_release(request: OperatorRequest) -> bool:
    """Whether a request ends following: such a one is nobody's privilege and is never put off."""
    return isinstance(request, StopCommand) or (
        isinstance(request, ConsentCommand) and not request.given
    )
