"""What can happen to the bytes on their way."""

from __future__ import annotations

from follower.faults.fault import Action, Kind
from follower.faults.groups.promise import carries_on, comes_back, lets_go

LINK = (
    carries_on(
        "link-down-0.2s",
        "link",
        "Shorter than any time-out: follows on.",
        Action(Kind.LINK_DOWN),
        for_s=0.2,
    ),
    comes_back(
        "link-down-0.7s",
        "link",
        "Hold on the wire within 0.7 s; follows again within 3 s of its return.",
        Action(Kind.LINK_DOWN),
        for_s=0.7,
    ),
    lets_go(
        "link-down-1s",
        "link",
        "Hold on the wire within 0.7 s; after a second alone the autopilot may have gone its own "
        "way, so it lets go.",
        Action(Kind.LINK_DOWN),
        for_s=1.2,
        rest_within_s=None,
        excursion_m=None,
    ),
    lets_go(
        "link-down-5s",
        "link",
        "Hold on the wire within 0.7 s, let go; does not follow again when the link is back.",
        Action(Kind.LINK_DOWN),
        for_s=5.0,
        rest_within_s=None,
        excursion_m=None,
    ),
    carries_on(
        "loss-5%", "link", "5 % of the packets lost: follows on.", Action(Kind.PACKETS_LOST, 0.05)
    ),
    carries_on(
        "loss-30%",
        "link",
        "30 % of the packets lost: follows on.",
        Action(Kind.PACKETS_LOST, 0.3),
    ),
    carries_on(
        "doubled",
        "link",
        "Every other packet twice: follows on.",
        Action(Kind.PACKETS_DOUBLED, 0.5),
    ),
    carries_on(
        "reordered",
        "link",
        "Every fifth packet behind five others: follows on.",
        Action(Kind.PACKETS_REORDERED, 0.2),
    ),
    carries_on(
        "garbage", "link", "Random bytes between the packets: follows on.", Action(Kind.GARBAGE)
    ),
    carries_on(
        "strangers",
        "link",
        "Other systems' heartbeats, attitudes and positions change nothing.",
        Action(Kind.STRANGERS),
    ),
    carries_on(
        "fuzzed",
        "link",
        "Packets with changed bytes fail their checksum: follows on.",
        Action(Kind.FUZZED),
    ),
    carries_on(
        "unsigned",
        "link",
        "On a signed link, forged packets without a signature change nothing.",
        Action(Kind.FORGED_UNSIGNED),
        signed=True,
    ),
    carries_on(
        "wrong-signature",
        "link",
        "On a signed link, forged packets with a wrong signature change nothing.",
        Action(Kind.FORGED_WRONG),
        signed=True,
    ),
    carries_on(
        "replayed",
        "link",
        "On a signed link, packets of the last seconds sent again change nothing.",
        Action(Kind.REPLAYED),
        signed=True,
    ),
)
