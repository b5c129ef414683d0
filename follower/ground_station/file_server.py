"""One read-only file by MAVLink FTP: the camera definition.

See https://mavlink.io/en/services/ftp.html. There is one session and one file, and nothing of the
computer's file system.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.ground_station.endpoint import Endpoint

_HEAD = struct.Struct("<HBBBBBxI")
_MOST_DATA = 239
_SIZE = 251
_TERMINATE, _RESET, _OPEN, _READ, _CRC, _BURST = 1, 2, 4, 5, 14, 15
_ACK, _NAK = 128, 129
_FAIL, _INVALID_SESSION, _END_OF_FILE, _UNKNOWN_COMMAND, _NOT_FOUND = 1, 4, 6, 7, 10
_BURST_PACKETS = 8


class FileServer:
    """Answers FILE_TRANSFER_PROTOCOL messages.

    Args:
        endpoint: sends as the camera.
        path: of the one file.
        data: what is in it.
    """

    def __init__(self, endpoint: Endpoint, path: str, data: bytes) -> None:
        self._endpoint = endpoint
        self._path = path
        self._data = data
        self._sender = 0, 0

    def hear(self, message: Any) -> None:
        """Take a FILE_TRANSFER_PROTOCOL message; those for others are passed over."""
        if not self._endpoint.is_for(message):
            return
        payload = bytes(message.payload)
        sequence, session, opcode, size, _, _, offset = _HEAD.unpack_from(payload)
        text = payload[_HEAD.size : _HEAD.size + min(size, _MOST_DATA)]
        self._sender = message.get_srcSystem(), message.get_srcComponent()
        self._answer(opcode, sequence, session, size, offset, text)

    def _answer(
        self, opcode: int, sequence: int, session: int, size: int, offset: int, text: bytes
    ) -> None:
        def reply(data: bytes, error: int = 0, at: int = 0, ends: bool = False) -> None:
            """Send one answer; an error goes in place of the data."""
            nonlocal sequence
            sequence = (sequence + 1) & 0xFFFF
            body, kind = (bytes((error,)), _NAK) if error else (data, _ACK)
            head = _HEAD.pack(sequence, session, kind, len(body), opcode, ends, at)
            self._send((head + body).ljust(_SIZE, b"\0"))

        if opcode in (_TERMINATE, _RESET):
            reply(b"")
        elif opcode in (_OPEN, _CRC):
            if text.rstrip(b"\0").lstrip(b"/") != self._path.lstrip("/").encode():
                reply(b"", _NOT_FOUND)
            else:
                number = len(self._data) if opcode == _OPEN else zlib.crc32(self._data)
                reply(struct.pack("<I", number))
        elif opcode not in (_READ, _BURST):
            reply(b"", _UNKNOWN_COMMAND)
        elif offset >= len(self._data):
            reply(b"", _END_OF_FILE, offset)
        else:
            most = min(size, _MOST_DATA) or _MOST_DATA
            parts = _BURST_PACKETS if opcode == _BURST else 1
            ends = min(offset + parts * most, len(self._data))
            for at in range(offset, ends, most):
                reply(self._data[at : min(at + most, ends)], at=at, ends=at + most >= ends)

    def _send(self, payload: bytes) -> None:
        target = self._sender
        self._endpoint.send(
            mavlink.MAVLink_file_transfer_protocol_message(0, *target, list(payload))
        )
