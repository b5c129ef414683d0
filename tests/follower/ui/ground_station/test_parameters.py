"""Gains and limits as MAVLink parameters: all of them arrive, and nothing bad is taken."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.target.request import RequestRefusedError
from follower.settings.live import live_keys, value_at
from follower.settings.settings import load_settings
from follower.ui.ground_station.parameters import NONE, by_name, float32, parameters, shortest
from follower_control.servo.settings import FollowMode

MakeRig = Callable[..., Any]
REAL, UINT = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_UINT32
COMPANION = 191
KP = "SRV_AZ_KP"


def put(peer: Any, name: str, value: float, kind: int = REAL, component: int = COMPANION) -> None:
    peer.send(mavlink.MAVLink_param_set_message(1, component, name.encode(), value, kind))


def read(peer: Any, name: str = "", index: int = -1, component: int = COMPANION) -> None:
    peer.send(mavlink.MAVLink_param_request_read_message(1, component, name.encode(), index))


def ask_for_all(peer: Any, component: int = COMPANION) -> None:
    peer.send(mavlink.MAVLink_param_request_list_message(1, component))


def told(peer: Any) -> dict[str, float]:
    return {one.param_id: one.param_value for one in peer.of("PARAM_VALUE", COMPANION)}


def test_every_live_setting_has_a_name_of_its_own_that_fits() -> None:
    names = [one.name for one in parameters()]
    assert [one.live for one in parameters()] == list(live_keys())
    assert len(set(names)) == len(names)
    assert all(0 < len(name) <= 16 and name.isascii() for name in names)
    assert {name.partition("_")[0] for name in names} == {"SRV", "SRCH", "ENV", "SUP"}


@pytest.mark.parametrize("base", [{}, {"servo": {"target_size_m": 1.7, "mode": "orbit"}}])
def test_a_value_survives_the_way_there_and_back(base: dict[str, Any]) -> None:
    settings = load_settings(base=base)
    for one in parameters():
        value = one.value(one.number(settings))
        assert value == value_at(settings, one.live.key)
        assert type(value) is type(value_at(settings, one.live.key))


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_shortest_decimal_is_the_same_32_bit_number(number: float) -> None:
    assert float32(shortest(number)) == number


def test_a_round_decimal_stays_round() -> None:
    assert [shortest(float32(x)) for x in (0.1, 1.3, 12.34, 100.0)] == [0.1, 1.3, 12.34, 100.0]


class QGroundControl:
    """Its way to fetch a companion's parameters: by index, ten at a time, five tries each."""

    BATCH, MOST_TRIES, TIMEOUT_S = 10, 5, 3.0

    def __init__(self, peer: Any) -> None:
        self.peer = peer
        self.tries: dict[int, int] = {}
        self.asked: set[int] = set()
        self.quiet_since_s = 0.0
        self.heard = 0

    @property
    def missing(self) -> list[int]:
        values = self.peer.of("PARAM_VALUE", COMPANION)
        if not values:
            return []
        return sorted(set(range(values[0].param_count)) - {one.param_index for one in values})

    def step(self, now_s: float) -> None:
        self.peer.say_hello(now_s)
        heard = len(self.peer.of("PARAM_VALUE", COMPANION))
        if heard != self.heard:
            self.heard, self.quiet_since_s = heard, now_s
        if self.asked & set(self.missing) and now_s - self.quiet_since_s < self.TIMEOUT_S:
            return
        tries = [index for index in self.missing if self.tries.get(index, 0) < self.MOST_TRIES]
        self.asked, self.quiet_since_s = set(tries[: self.BATCH]), now_s
        for index in self.asked:
            self.tries[index] = self.tries.get(index, 0) + 1
            read(self.peer, index=index)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_every_parameter_that_is_announced_arrives_though_packets_are_lost(
    rig: Any, seed: int
) -> None:
    qgc = QGroundControl(rig.station_peer(loss=0.3, seed=seed))
    rig.run(60.0, qgc.step)
    values = qgc.peer.of("PARAM_VALUE", COMPANION)
    assert {one.param_count for one in values} == {len(parameters())}
    assert qgc.missing == []
    wanted = {one.name: one.number(rig.settings) for one in parameters()}
    assert told(qgc.peer) == pytest.approx(wanted)


@pytest.mark.parametrize("component", [COMPANION, 0])
def test_a_list_brings_all_of_them_soon(rig: Any, qgc: Any, component: int) -> None:
    ask_for_all(qgc, component)
    rig.run(2.0)
    assert set(told(qgc)) == {one.name for one in parameters()}
    assert all(one.param_type == REAL for one in qgc.of("PARAM_VALUE"))


def test_a_list_that_is_asked_for_again_and_again_comes_to_its_end(rig: Any, qgc: Any) -> None:
    for _ in range(8):
        qgc.send(mavlink.MAVLink_param_request_list_message(1, 191))
        rig.run(0.5)
    names = {one.param_id for one in qgc.of("PARAM_VALUE", 191)}
    assert names == {one.name for one in parameters()}


def test_it_is_announced_after_a_ground_station_was_heard_and_not_for_ever(rig: Any) -> None:
    peer = rig.peer(1, 154)  # a component of the vehicle is no ground station
    rig.everybody.append(peer)
    rig.run(3.0)
    qgc = rig.station_peer()
    rig.run(100.0, qgc.say_hello)
    announced = qgc.of("PARAM_VALUE", COMPANION)
    assert 10 <= len(announced) <= 12
    assert {(one.param_index, one.param_count) for one in announced} == {(0, len(parameters()))}


def test_without_parameters_nothing_is_announced_or_answered(make_rig: MakeRig) -> None:
    rig = make_rig(parameters=False)
    peer = rig.station_peer()
    ask_for_all(peer)
    rig.run(3.0, peer.say_hello)
    assert not peer.of("PARAM_VALUE")


def test_a_gain_is_set_told_and_taken_by_control(rig: Any, qgc: Any) -> None:
    put(qgc, KP, 0.7)
    rig.run(0.1)
    assert told(qgc)[KP] == float32(0.7)
    taken = rig.requests.take()
    assert taken.settings.servo.azimuth.kp == 0.7, "the decimal, not its neighbour of 32 bits"
    assert "255" in taken.notes[0]
    put(qgc, KP, 0.7)
    rig.run(0.1)
    assert rig.requests.take().settings is None, "said twice, done once"
    assert len(qgc.of("PARAM_VALUE")) >= 2


def test_a_mode_is_a_number(rig: Any, qgc: Any) -> None:
    put(qgc, "SRV_MODE", list(FollowMode).index(FollowMode.ORBIT))
    rig.run(0.1)
    assert rig.requests.settings.servo.mode is FollowMode.ORBIT


def test_none_is_a_number_too(rig: Any, qgc: Any) -> None:
    put(qgc, "SRV_EL", -15.0)
    rig.run(0.1)
    assert rig.requests.settings.servo.elevation_deg == -15.0
    put(qgc, "SRV_EL", NONE)
    rig.run(0.1)
    assert rig.requests.settings.servo.elevation_deg is None


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [
        (KP, -1.0, REAL),
        (KP, math.nan, REAL),
        (KP, math.inf, REAL),
        (KP, 1.0, UINT),
        ("SRV_DIST", 1e9, REAL),
        ("SRV_MODE", 1.5, REAL),
        ("SRV_MODE", 99.0, REAL),
        ("SRV_HOLDHGT", 2.0, REAL),
        ("ENV_MAXSPD", 11.0, REAL),
        ("ENV_MINHGT", 1.0, REAL),
        ("ENV_CEIL", NONE, REAL),
        ("SRV_DIST", NONE, REAL),
    ],
)
def test_a_bad_value_is_refused_with_the_old_one(
    rig: Any, qgc: Any, name: str, value: float, kind: int
) -> None:
    put(qgc, name, value, kind)
    rig.run(0.1)
    old = by_name()[name].number(rig.settings)
    assert [one.param_value for one in qgc.of("PARAM_VALUE") if one.param_id == name][-1] == old
    (error,) = qgc.of("PARAM_ERROR")
    assert (error.param_id, error.target_system) == (name, 255)
    assert error.error == mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
    assert qgc.of("STATUSTEXT")
    assert rig.requests.settings == rig.settings


@pytest.mark.parametrize("ask", ["read", "set", "index"])
def test_what_is_not_there_is_said_not_to_be(rig: Any, qgc: Any, ask: str) -> None:
    if ask == "read":
        read(qgc, "MPC_XY_VEL_MAX")
    elif ask == "set":
        put(qgc, "MPC_XY_VEL_MAX", 1.0)
    else:
        read(qgc, index=500)
    rig.run(0.1)
    assert qgc.of("PARAM_ERROR")[0].error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST


def test_what_is_asked_of_others_is_left_to_them(rig: Any, qgc: Any) -> None:
    before = len(qgc.messages)
    put(qgc, KP, 0.7, component=1)
    read(qgc, "MPC_XY_VEL_MAX", component=0)
    ask_for_all(qgc, 1)
    rig.run(0.5)
    assert not [one for one in qgc.messages[before:] if one.get_type().startswith("PARAM")]
    assert rig.requests.settings == rig.settings


def test_what_another_front_end_changes_is_told(rig: Any, qgc: Any) -> None:
    rig.requests.change("servo.azimuth.kp", 0.9, "a web page")
    rig.run(0.1)
    assert told(qgc)[KP] == float32(0.9)


@pytest.mark.parametrize("full", [False, True])
def test_settings_are_saved_on_request_or_it_is_refused(make_rig: MakeRig, full: bool) -> None:
    saved: list[int] = []

    def save() -> str:
        saved.append(1)
        if full:
            raise RequestRefusedError("the disk is full")
        return "saved to mine.yaml"

    rig = make_rig(save=save)
    peer = rig.station_peer()
    put(peer, "CFG_SAVE", 1.0)
    rig.run(0.1)
    assert told(peer)["CFG_SAVE"] == float(not full)
    assert ("disk is full" if full else "mine.yaml") in peer.of("STATUSTEXT")[0].text
    assert len(saved) == 1


def test_a_number_beyond_32_bits_is_infinite() -> None:
    assert float32(1e300) == math.inf
    assert float32(-1e300) == -math.inf
