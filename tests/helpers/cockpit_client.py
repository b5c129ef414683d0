"""A client of the cockpit that says and hears JSON."""

from __future__ import annotations

import ipaddress
import json
from functools import partial
from typing import Any

import httpx
import numpy as np
from websockets.sync import client as sync_client
from websockets.sync.client import ClientConnection

from follower.ui.cockpit.requests import REQUESTS
from follower_vision.images.frame import Frame

PATIENCE_S = 60.0
LOOPBACK = ipaddress.ip_address("127.0.0.1")
TOKEN = "a token of some length"
connect = partial(sync_client.connect, open_timeout=PATIENCE_S)
get, post = (partial(one, timeout=PATIENCE_S) for one in (httpx.get, httpx.post))
CONSENT = REQUESTS.validate_python({"kind": "consent", "given": True})


def noise_frame(number: int) -> Frame:
    image = np.random.default_rng(number).integers(0, 255, (240, 320, 3), np.uint8)
    return Frame(image, number / 30, number)


def state(**values: Any) -> dict[str, Any]:
    return {"state": "idle", "reason": "no target", **values}


def ws(served: Any) -> str:
    return f"ws://127.0.0.1:{served.port}/ws"


def message(client: ClientConnection, kind: str) -> dict[str, Any]:
    while True:
        found = json.loads(client.recv(PATIENCE_S))
        if found["kind"] == kind:
            return dict(found)


def say(client: ClientConnection, **content: Any) -> None:
    client.send(json.dumps(content))
