"""Browsers that ask for video and cannot play it, or never come for it."""

from __future__ import annotations

import asyncio

import pytest
from aiortc import RTCPeerConnection, RTCRtpSender

from follower.settings.ui import VideoSettings
from follower.ui.cockpit.webrtc import OfferError, StreamTrack, WebRtcPeers
from follower.ui.video.channel import VideoChannel
from follower.ui.video.h264_encoder import AccessUnit


async def offer(codec: str) -> str:
    """Return a browser's offer that knows one codec alone."""
    browser = RTCPeerConnection()
    known = RTCRtpSender.getCapabilities("video").codecs
    transceiver = browser.addTransceiver("video", direction="recvonly")
    transceiver.setCodecPreferences([one for one in known if one.mimeType == codec])
    await browser.setLocalDescription(await browser.createOffer())
    sdp = str(browser.localDescription.sdp)
    await browser.close()
    return sdp


def test_a_browser_without_h264_is_refused_and_leaves_nothing_behind() -> None:
    async def ask() -> bool:
        channel = VideoChannel(VideoSettings(), overlay=False)
        with pytest.raises(OfferError, match="cannot be answered"):
            await WebRtcPeers(channel, local_only=True).answer(await offer("video/VP8"))
        return channel.watched

    assert not asyncio.run(ask())


def test_browsers_that_ask_at_once_do_not_get_more_places_than_there_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("follower.ui.cockpit.webrtc._MOST_PEERS", 2)

    async def ask() -> list[str]:
        peers = WebRtcPeers(VideoChannel(VideoSettings(), overlay=False), local_only=True)
        sdp = await offer("video/H264")
        answers = await asyncio.gather(
            *(peers.answer(sdp) for _ in range(4)), return_exceptions=True
        )
        await peers.close()
        return [str(one) for one in answers if isinstance(one, OfferError)]

    assert asyncio.run(ask()) == ["too many watch already"] * 2


def test_a_browser_that_leaves_while_it_is_answered_leaves_nothing_behind() -> None:
    async def ask() -> bool:
        channel = VideoChannel(VideoSettings(), overlay=False)
        sdp = await offer("video/H264")
        asking = asyncio.create_task(WebRtcPeers(channel, local_only=True).answer(sdp))
        await asyncio.sleep(0)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        return channel.watched

    assert not asyncio.run(ask())


def test_a_browser_that_never_connects_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("follower.ui.cockpit.webrtc._CONNECTS_WITHIN_S", 0.1)

    async def ask() -> tuple[bool, bool]:
        channel = VideoChannel(VideoSettings(), overlay=False)
        await WebRtcPeers(channel, local_only=True).answer(await offer("video/H264"))
        watched = channel.watched
        await asyncio.sleep(0.5)
        return watched, channel.watched

    assert asyncio.run(ask()) == (True, False)


class CountingChannel(VideoChannel):
    """Counts how often a key picture is asked for."""

    asked = 0

    def ask_for_key(self) -> None:
        self.asked += 1


def test_who_takes_nothing_does_not_make_every_picture_a_key_picture() -> None:
    async def show() -> tuple[int, list[bool]]:
        channel = CountingChannel(VideoSettings(), overlay=False)
        track = StreamTrack(channel)
        for number in range(100):
            track._take(AccessUnit(b"x", number, is_key=number == 0))
        stuck = channel.asked
        taken = [(await track.recv()).pts for _ in range(8)]
        track._take(AccessUnit(b"x", 100, is_key=False))
        track._take(AccessUnit(b"x", 101, is_key=True))
        taken.append((await track.recv()).pts)
        track.stop()
        return stuck, [channel.asked == 1, taken == [*range(8), 101]]

    assert asyncio.run(show()) == (0, [True, True])
