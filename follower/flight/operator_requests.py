"""Where every front end puts what its operator wants, and vision and control take it from.

The MAVLink camera, MAVLink parameters and the web cockpit all call the same few methods, from any
thread. Nothing here waits for the flight, and the flight never waits for a front end:

- what can be judged at once is refused at once, by `RequestRefusedError` with a line to show;
- vision takes the newest selection of a target with its next frame and settles the `TargetRequest`,
  whose `outcome` or `wait` tells what became of it;
- control takes orders and changed settings at the beginning of its next step.

What is taken is recorded where it takes effect (selections, situations, control steps), so that a
replay needs no front end. A chosen target renews consent after a release, as
docs/reference/supervisor.md says, unless somebody pressed stop: then consent has to be given.
Nothing here can move the vehicle past the supervisor and the envelope; limits of both can be
tightened in flight alone.
"""

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.target.request import (
    BoxSelection,
    ClearSelection,
    ObjectSelection,
    PointSelection,
    RequestOutcome,
    RequestRefusedError,
    TargetRequest,
    TargetSelection,
)
from follower.settings.live import SettingChange, changed, live_keys, value_at
from follower.settings.save import save_settings
from follower.settings.settings import Settings
from follower.settings.supervisor import Way
from follower_control.common.strict_config import SettingsError

_MOST_WAITING = 64
_RELEASED = RequestOutcome(False, "the vehicle was released meanwhile: choose again")
_REPLACED = RequestOutcome(False, "another target was asked for before a frame came")


@dataclass(frozen=True, slots=True)
class ControlRequests:
    """What control is to take at the beginning of a step.

    Attributes:
        stop: somebody pressed stop; it overrules the orders.
        orders: consent given or withdrawn, in their order.
        changes: of settings, in their order.
        settings: with these changes; None if there are none.
        notes: all that in words, for the log.
    """

    stop: bool = False
    orders: Sequence[ConsentRequest] = ()
    changes: tuple[SettingChange, ...] = ()
    settings: Settings | None = None
    notes: Sequence[str] = ()


NOTHING = ControlRequests()


class OperatorRequests:
    """Takes requests from front ends and keeps them until the stages take them.

    Args:
        settings: those that the flight begins with.

    Attributes:
        settings: the newest ones, with all changes accepted so far.
    """

    def __init__(self, settings: Settings) -> None:
        self._began = self.settings = settings
        self._checking, self._lock = threading.Lock(), threading.Lock()
        self._target: TargetRequest | None = None
        self._taken: TargetRequest | None = None
        self._stop = False
        self._orders: list[ConsentRequest] = []
        self._changes: list[SettingChange] = []
        self._changed: set[str] = set()
        self._notes: list[str] = []
        self._waiting = False

    @property
    def changed(self) -> Mapping[str, Any]:
        """The values in force of all settings that were changed since the beginning, by path.

        A loop's come together: what a file says of a loop stands for all of it.
        """
        with self._checking:
            loops = {key.rpartition(".")[0] for key in self._changed if key.count(".") > 1}
            keys = [one.key for one in live_keys()]
            wanted = [k for k in keys if k in self._changed or k.rpartition(".")[0] in loops]
            return {key: value_at(self.settings, key) for key in wanted}

    def save(self, path: Path | None) -> str:
        """Write the changed settings into their file, whose comments stay; return what was done.

        Raises:
            RequestRefusedError: there is no file, or it cannot be written.
        """
        if path is None:
            raise RequestRefusedError("no settings file was given (-c): nothing to save to")
        values = {key: SettingChange.of(key, one).plain for key, one in self.changed.items()}
        try:
            save_settings(path, values)
        except SettingsError as error:
            raise RequestRefusedError(str(error)) from None
        return f"{len(self._changed)} changed settings saved to {path.name}"

    def select_point(self, x: float, y: float, by: str) -> TargetRequest:
        """Follow what is seen at a point: the detection there, else a box segmented around it.

        Args:
            x: share of the image's width, 0 at the left.
            y: share of its height, 0 at the top.
            by: who asks, such as "ground station 255".

        Raises:
            RequestRefusedError: that is no point in the image.
        """
        return self._ask(PointSelection(x, y), by)

    def select_rectangle(
        self, left: float, top: float, right: float, bottom: float, by: str
    ) -> TargetRequest:
        """Follow what a rectangle shows; shares of the image's width and height.

        Raises:
            RequestRefusedError: that is no rectangle in the image.
        """
        return self._ask(BoxSelection(left, top, right, bottom), by)

    def select_object(
        self, left: float, top: float, right: float, bottom: float, by: str
    ) -> TargetRequest:
        """Follow a detected object that was seen in a rectangle just before, where it is now.

        Raises:
            RequestRefusedError: that is no rectangle in the image.
        """
        return self._ask(ObjectSelection(left, top, right, bottom), by)

    def stop_tracking(self, by: str) -> TargetRequest:
        """Have no target any more; a vehicle that follows holds, then releases the vehicle."""
        return self._ask(ClearSelection(), by)

    def give_consent(self, way: Way, by: str) -> None:
        """Allow following, also again after a release; the pilot's mode still has to.

        Raises:
            RequestRefusedError: `consent.kind` takes it in another way alone.
        """
        consent = self.settings.consent
        if not consent.takes_orders_by(way):
            raise RequestRefusedError(f"consent is given by {consent.kind} alone")
        self._order(ConsentRequest.GIVE, by)

    def withdraw_consent(self, by: str) -> None:
        """Allow following no longer: the vehicle brakes, holds, and is released."""
        self._order(ConsentRequest.WITHDRAW, by)

    def stop(self, by: str) -> None:
        """Release the vehicle now: it brakes and holds until consent is given."""
        with self._lock:
            self._stop = True
            self._note(f"stop, by {by}")

    def change(self, key: str, value: Any, by: str) -> Settings:
        """Change one setting; see `change_all`."""
        return self.change_all({key: value}, by)

    def change_all(self, values: Mapping[str, Any], by: str) -> Settings:
        """Change settings in flight, checked together, and return the new ones.

        Args:
            values: by path, such as {"servo.azimuth.kp": 1.2}; see `live_keys`.
            by: who asks.

        Raises:
            RequestRefusedError: one may not be changed in flight or cannot be used; then none is.
        """
        # Checking takes milliseconds, for which control must not have to wait.
        with self._checking:
            settings, wanted = self._checked(values)
            with self._lock:
                if len(self._changes) + len(wanted) > _MOST_WAITING:
                    raise RequestRefusedError("control has not taken the last changes yet")
                self._changes += wanted
                self._changed.update(values)
                for one in wanted:
                    before = value_at(self.settings, one.key)
                    self._note(f"{one.key}: {before} -> {one.value}, by {by}")
                self.settings = settings
        return settings

    def _checked(self, values: Mapping[str, Any]) -> tuple[Settings, list[SettingChange]]:
        try:
            wanted = [SettingChange.of(key, value) for key, value in values.items()]
            return changed(self.settings, wanted, self._began), wanted
        except SettingsError as error:
            raise RequestRefusedError(str(error).removeprefix("in flight: ")) from None

    @property
    def target_waits(self) -> bool:
        """Whether somebody wants another target, or none, and nobody has seen to it yet."""
        return self._target is not None

    def take_target(self) -> TargetRequest | None:
        """Return the newest selection of a target, once; for vision."""
        if self._target is None:
            return None
        with self._lock:
            target, self._target = self._target, None
            self._taken = target
            return target

    def on_release(self) -> None:
        """Refuse the wishes for a target on which nothing has come yet; for control.

        The vehicle was released: what was selected before that is no consent to begin anew.
        """
        with self._lock:
            for request in (self._target, self._taken):
                if request is not None and not isinstance(request.selection, ClearSelection):
                    request.settle(_RELEASED)

    def take(self) -> ControlRequests:
        """Return what came since the last call; for control."""
        if not self._waiting:
            return NOTHING
        with self._lock:
            taken = ControlRequests(
                self._stop,
                self._orders,
                tuple(self._changes),
                self.settings if self._changes else None,
                self._notes,
            )
            self._stop = self._waiting = False
            self._orders, self._changes, self._notes = [], [], []
            return taken

    def note(self, texts: Iterable[str]) -> None:
        """Have these lines written into the log with the next control step."""
        with self._lock:
            for text in texts:
                self._note(text)

    def _ask(self, selection: TargetSelection, by: str) -> TargetRequest:
        request = TargetRequest(selection, by)
        with self._lock:
            before, self._target = self._target, request
        if before is not None:
            before.settle(_REPLACED)
        return request

    def _order(self, order: ConsentRequest, by: str) -> None:
        with self._lock:
            if len(self._orders) < _MOST_WAITING:
                self._orders.append(order)
            elif order is ConsentRequest.WITHDRAW:
                self._orders[-1] = order
            self._note(f"consent: {order}, by {by}")

    def _note(self, text: str) -> None:
        if len(self._notes) < _MOST_WAITING:
            self._notes.append(text)
        self._waiting = True
