"""Makes streams of the pictures, on a thread of its own, for as long as somebody watches."""

import contextlib
import threading
from collections.abc import Callable

from follower.settings.ui import Address, VideoSettings
from follower.ui.ipc.messages import TRACKS, Message
from follower.ui.video.channel import Picture, VideoChannel
from follower.ui.video.h264_encoder import EncoderError
from follower.ui.video.rtp import RtpSender
from follower.ui.video.rtsp_push import RtspPush
from follower_vision.images.frame import Image
from follower_vision.mailbox import Mailbox


class VideoPipeline:
    """Two streams: one for ground stations, one without anything drawn in for the page.

    Without an overlay both are the same, encoded once.

    Attributes:
        ground: the stream for RTSP and UDP.
        page: the stream for the cockpit.
        newest: the newest picture, None before the first.
        on_picture: is shown each picture, on the pipeline's thread.
    """

    def __init__(self, settings: VideoSettings) -> None:
        self._settings = settings
        self.ground = VideoChannel(settings, settings.overlay)
        self.page = VideoChannel(settings, overlay=False) if settings.overlay else self.ground
        self.newest: Picture | None = None
        self.on_picture: Callable[[Picture], None] | None = None
        self._tasks: Mailbox[tuple[Picture, Callable[[], None]]] = Mailbox()
        self._say: Callable[[str], None] = print
        self._silent = False
        threading.Thread(target=self._run, name="studio", daemon=True).start()

    def start_senders(self, say: Callable[[str], None]) -> None:
        """Begin to send by UDP and to push, as set; `say` shows a line to the user."""
        self._say = say
        if self._settings.udp is not None:
            try:
                self.ground.watch(RtpSender(Address.parse(self._settings.udp)))
                say(f"Video: RTP to {self._settings.udp}")
            except OSError as error:
                say(f"No video by UDP: {self._settings.udp}: {error.strerror}")
        if self._settings.push is not None:
            self.ground.watch(RtspPush(self._settings.push, say))
            say(f"Video: pushed to {self._settings.push}")

    def take(self, message: Message, image: Image, done: Callable[[], None]) -> None:
        """Take a picture; `done` is called when the next may come."""
        picture = Picture(
            image,
            message["sequence"],
            message["captured_s"],
            TRACKS.validate_python(message["tracks"]),
            tuple(message["lines"]),
        )
        self._tasks.put((picture, done))

    def _run(self) -> None:
        try:
            while (task := self._tasks.wait()) is not None:
                self._show(*task)
        finally:  # only an error ends it: the process has no other end than the flight's
            self._say("No video any more: an error in the station")

    def _show(self, picture: Picture, done: Callable[[], None]) -> None:
        self.newest = picture
        if self.on_picture is not None:
            self.on_picture(picture)
        self._encode(picture)
        with contextlib.suppress(OSError):  # the flight is over
            done()

    def _encode(self, picture: Picture) -> None:
        if self._silent:
            return
        try:
            self.ground.show(picture)
            if self.page is not self.ground:
                self.page.show(picture)
        except EncoderError as error:
            self._silent = True
            self._say(f"No H.264: {error}")
