"""Who gets into the cockpit: names, origins, tokens, TLS."""

from __future__ import annotations

import asyncio
import json
import ssl
from pathlib import Path
from typing import Any

import httpx
import pytest
from certificates import make_certificate
from cockpit_client import (
    PATIENCE_S,
    TOKEN,
    connect,
    get,
    message,
    post,
    ws,
)
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import InvalidStatus


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "localhost.evil.example", ""]
)
def test_it_answers_to_no_foreign_name(served: Any, host: str) -> None:
    for path in ("/", "/api/state", "/video.mjpeg"):
        assert get(served.url + path, headers={"host": host}).status_code in (400, 421)


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "192.168.7.7:99"])
def test_it_answers_to_addresses_and_localhost(served: Any, host: str) -> None:
    assert get(served.url, headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://", "http://["]
)
def test_another_sites_page_gets_nothing(served: Any, origin: str) -> None:
    headers = {"origin": origin}
    assert get(f"{served.url}/api/state", headers=headers).status_code == 403
    answer = post(f"{served.url}/api/request", json={"kind": "stop"}, headers=headers)
    assert answer.status_code == 403
    with pytest.raises(InvalidStatus) as refusal, connect(ws(served), origin=origin):
        pass  # pragma: no cover
    assert refusal.value.response.status_code == 403


def test_another_sites_form_or_picture_gets_nothing(served: Any) -> None:
    """A browser sends these without asking first; they carry no origin of ours and no JSON."""
    headers = {"sec-fetch-site": "cross-site"}
    assert get(f"{served.url}/video.mjpeg", headers=headers).status_code == 403
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
        answer = post(
            f"{served.url}/api/request",
            content=b'{"kind": "stop"}',
            headers={"content-type": kind},
        )
        assert answer.status_code == 415


def test_no_other_page_may_ask_frame_or_read(served: Any) -> None:
    answer = get(served.url)
    assert "access-control-allow-origin" not in answer.headers
    assert answer.headers["x-frame-options"] == "DENY"
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    asked = httpx.options(
        f"{served.url}/api/request", headers={"origin": "http://evil.example"}, timeout=PATIENCE_S
    )
    assert asked.status_code == 403


def test_the_page_needs_nothing_from_elsewhere(served: Any) -> None:
    page = get(served.url).text
    assert "NONCE" not in page
    for word in ("https://", "http://", "@import", "//cdn"):
        assert word not in page.replace("http://www.w3.org/2000/svg", "")


@pytest.fixture(scope="session")
def guarded(serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("token") / "token"
    path.write_text(TOKEN + "\n", "utf-8")
    return serve(f"cockpit.token_file={path}")


@pytest.mark.slow
def test_without_the_token_there_is_a_page_and_nothing_behind_it(guarded: Any) -> None:
    assert get(guarded.url).status_code == 200
    for path in ("/api/state", "/api/page", "/api/flights", "/video.mjpeg"):
        assert get(guarded.url + path).status_code == 401
    asked = post(f"{guarded.url}/api/request", json={"kind": "stop"})
    assert asked.status_code == 401
    with pytest.raises(InvalidStatus), connect(ws(guarded)):
        pass  # pragma: no cover
    for wrong in ("", "a token of some lengti", "ü" * 20):
        answer = post(f"{guarded.url}/api/session", json={"token": wrong})
        assert answer.status_code == 401
    name = f"follower_cockpit_{guarded.port}"
    bad = {"cookie": f"{name}=guessed", "authorization": "Bearer guessed"}
    assert get(f"{guarded.url}/api/state", headers=bad).status_code == 401


def test_the_token_opens_it_once_by_cookie_and_each_time_by_header(guarded: Any) -> None:
    with httpx.Client(timeout=PATIENCE_S, base_url=guarded.url) as client:
        answer = client.post("/api/session", json={"token": TOKEN})
        assert answer.status_code == 204
        cookie = answer.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        assert client.get("/api/state").status_code == 200
        ((name, value),) = client.cookies.items()
    with connect(ws(guarded), additional_headers={"cookie": f"{name}={value}"}) as one:
        assert message(one, "hello")["client"]
    bearer = {"authorization": f"Bearer {TOKEN}"}
    assert get(f"{guarded.url}/api/state", headers=bearer).status_code == 200


@pytest.mark.slow
def test_cockpits_on_two_ports_leave_each_other_their_sessions(
    guarded: Any, serve: Any, tmp_path: Path
) -> None:
    (tmp_path / "token").write_text(TOKEN, "utf-8")
    other = serve(f"cockpit.token_file={tmp_path / 'token'}")
    # A browser keeps a host's cookies for all its ports.
    with httpx.Client(timeout=PATIENCE_S) as browser:
        for cockpit in (guarded, other):
            opened = browser.post(f"{cockpit.url}/api/session", json={"token": TOKEN})
            assert opened.status_code == 204
        for cockpit in (guarded, other):
            assert browser.get(f"{cockpit.url}/api/state").status_code == 200


@pytest.mark.slow
def test_off_loopback_there_is_a_token_and_a_warning(serve: Any) -> None:
    served = serve("cockpit.host=0.0.0.0")
    assert any("not encrypted" in line for line in served.said)
    address = next(line for line in served.said if line.startswith("Cockpit"))
    token = address.partition("/#")[2]
    assert len(token) >= 20
    assert get(f"{served.url}/api/state").status_code == 401
    bearer = {"authorization": f"Bearer {token}"}
    assert get(f"{served.url}/api/state", headers=bearer).status_code == 200


@pytest.mark.slow
def test_it_speaks_tls(serve: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("tls")
    certificate, key = make_certificate(folder)
    served = serve(f"cockpit.tls_cert={certificate}", f"cockpit.tls_key={key}")
    trust = ssl.create_default_context(cafile=str(certificate))
    url = served.url.replace("http", "https")
    with httpx.Client(timeout=PATIENCE_S, verify=trust, base_url=url) as client:
        assert client.get("/api/state").status_code == 200
        cookie = client.post("/api/session", json={"token": ""}).headers["set-cookie"]
        assert "secure" in cookie.lower()
    # websockets' threaded client reads and writes its TLS connection from two threads at once,
    # which CPython's ssl module does not allow for: it ended with "EOF" now and then.
    address = ws(served).replace("ws:", "wss:")

    async def greeting() -> dict[str, Any]:
        async with connect_async(address, ssl=trust, origin=url, open_timeout=PATIENCE_S) as one:
            return dict(json.loads(await asyncio.wait_for(one.recv(), PATIENCE_S)))

    assert asyncio.run(greeting())["client"]
