"""MAVLink 2 signing: against pymavlink's own, and against who would get around it."""

import hashlib
import logging
import pickle
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packet_parser import MavlinkPacket, PacketReader
from follower.links.pymavlink_link import MavlinkLink
from follower.links.signing import SignatureRefusal, Signer, SigningKey, SigningKeyError
from follower.recording import FlightConfig
from follower.settings.link import LinkSettings
from follower.settings.settings import Settings
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.setpoint import VelocitySetpoint

SECRET = bytes(range(100, 132))
YEAR_2026_NS = 1_790_000_000 * 10**9
STAMP_2026 = (1_790_000_000 - 1_420_070_400) * 100_000


def _key_file(folder: Path, data: bytes, mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(data)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    ("data", "secret"),
    [
        (b"\x00\xff" * 16, b"\x00\xff" * 16),
        (b"0f" * 32 + b"\n", b"\x0f" * 32),
        (b"correct horse\n", hashlib.sha256(b"correct horse").digest()),
        (
            b"thirty-one letters and a newlin\n",
            hashlib.sha256(b"thirty-one letters and a newlin").digest(),
        ),
    ],
)
def test_a_key_is_raw_or_hexadecimal_or_a_passphrase(
    tmp_path: Path, data: bytes, secret: bytes
) -> None:
    assert SigningKey.from_file(_key_file(tmp_path, data)).secret == secret


@pytest.mark.parametrize("data", [b"", b"\n", b"\x00\xff" * 15, b"a" * 5000])
def test_a_file_without_a_key_is_refused(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(SigningKeyError, match="32 raw bytes, 64 hexadecimal digits or a pass"):
        SigningKey.from_file(_key_file(tmp_path, data))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_a_key_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(SigningKeyError, match="chmod 600"):
        SigningKey.from_file(_key_file(tmp_path, SECRET, mode))


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    with pytest.raises(SigningKeyError, match=r"nowhere: No such file"):
        SigningKey.from_file(tmp_path / "nowhere")


def test_the_key_is_never_shown(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    path = _key_file(tmp_path, SECRET)
    key = SigningKey.from_file(path)
    signer = Signer(key, YEAR_2026_NS)
    settings = Settings(link=LinkSettings(signing_key_file=str(path)))
    recorded = FlightConfig.of("real", settings).to_yaml()
    for text in (repr(key), str(key), repr(signer), repr(vars(signer)), recorded, caplog.text):
        assert SECRET.hex() not in text
        assert repr(SECRET)[2:12] not in text
    assert str(path) not in recorded
    with pytest.raises(TypeError, match="not written"):
        pickle.dumps(key)


def _plain(number: int = 0, system: int = 1, component: int = 1) -> bytes:
    codec = mavlink.MAVLink(None, system, component)
    codec.seq = number
    return bytes(mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3).pack(codec))


def _packet(data: bytes) -> MavlinkPacket:
    (packet,) = PacketReader().feed(data)
    return packet


def _theirs(secret: bytes = SECRET, stamp: int = STAMP_2026, system: int = 1) -> Any:
    codec = mavlink.MAVLink(None, system, 1)
    codec.signing.secret_key = secret
    codec.signing.timestamp = stamp
    codec.signing.sign_outgoing = True
    return codec


def _signed_by_pymavlink(codec: Any) -> bytes:
    return bytes(mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3).pack(codec))


def _signer() -> Signer:
    return Signer(SigningKey(SECRET), YEAR_2026_NS)


def test_pymavlink_believes_what_we_sign() -> None:
    signer, codec = _signer(), _theirs()
    for number in range(5):
        message = codec.decode(bytearray(signer.sign(_plain(number), 10.0)))
        assert message.get_type() == "HEARTBEAT"
    assert codec.signing.goodsig_count == 5


def test_we_believe_what_pymavlink_signs() -> None:
    signer, codec = _signer(), _theirs()
    for _ in range(5):
        assert signer.refusal(_packet(_signed_by_pymavlink(codec)), 1.0) is None


def test_what_is_not_signed_or_wrongly_or_again_or_long_ago_is_refused() -> None:
    signer, codec = _signer(), _theirs()
    good = _signed_by_pymavlink(codec)
    assert signer.refusal(_packet(_plain()), 1.0) is SignatureRefusal.UNSIGNED
    other = _signed_by_pymavlink(_theirs(secret=bytes(32)))
    assert signer.refusal(_packet(other), 1.0) is SignatureRefusal.WRONG
    assert signer.refusal(_packet(good), 1.0) is None
    assert signer.refusal(_packet(good), 1.0) is SignatureRefusal.REPLAYED
    old = _signed_by_pymavlink(_theirs(stamp=STAMP_2026 - 61 * 100_000, system=2))
    assert signer.refusal(_packet(old), 0.0) is SignatureRefusal.OLD


def test_a_forged_packet_from_the_future_does_not_shut_out_the_true_sender() -> None:
    signer, codec = _signer(), _theirs()
    assert signer.refusal(_packet(_signed_by_pymavlink(codec)), 1.0) is None
    forged = _signed_by_pymavlink(_theirs(secret=bytes(32), stamp=(1 << 48) - 2))
    assert signer.refusal(_packet(forged), 1.0) is SignatureRefusal.WRONG
    assert signer.refusal(_packet(_signed_by_pymavlink(codec)), 1.0) is None


def _stamp(packet: bytes) -> int:
    return int.from_bytes(packet[-12:-6], "little")


def test_time_stamps_rise_also_when_the_clock_stands_still_or_goes_back() -> None:
    signer = _signer()
    stamps = [_stamp(signer.sign(_plain(), now_s)) for now_s in (5.0, 5.0, 4.0, 5.0, 6.0)]
    assert stamps[0] == STAMP_2026 + 500_000
    assert stamps == sorted(set(stamps))
    assert stamps[-1] == STAMP_2026 + 600_000


def test_a_computer_without_a_calendar_learns_the_time_from_the_autopilot() -> None:
    signer = Signer(SigningKey(SECRET), epoch_ns=0)
    assert signer.refusal(_packet(_signed_by_pymavlink(_theirs())), 1.0) is None
    assert _stamp(signer.sign(_plain(), 1.0)) == STAMP_2026 + 1


def test_a_signed_link_hears_the_vehicle_counts_the_rest_and_signs_all_it_sends() -> None:
    ours, theirs = MemoryTransport.pair()
    link = MavlinkLink(ours, LinkSettings(vehicle_id=1), _signer())
    theirs.send(_plain())
    link.poll(1.0)
    assert not link.connected
    assert link.status(1.0).refused == {"not signed": 1}
    assert "1 refused: not signed" in link.status(1.0).line()
    codec = _theirs()
    theirs.send(_signed_by_pymavlink(codec))
    theirs.send(_signed_by_pymavlink(_theirs(secret=bytes(32))))
    link.poll(1.1)
    assert link.connected
    link.send(VelocitySetpoint(1.0))
    heard = PacketReader().feed(theirs.receive())
    assert 84 in [packet.message_id for packet in heard]
    checker = _signer()
    assert [checker.refusal(packet, 1.1) for packet in heard] == [None] * len(heard)
    before = link.state
    theirs.send(_plain(1))  # a takeover by somebody without the key
    link.poll(5.0)
    assert link.state == before
    assert link.status(5.0).refused == {"not signed": 2, "wrong signature": 1}
