"""What can be followed: car, person, boat and quadrotor, at their real sizes."""

import math
from dataclasses import replace
from typing import Literal

from follower_sim.bodies.mesh import (
    Colour,
    Mesh,
    Outline,
    Point,
    ball,
    box,
    convex,
    disc,
    panel,
    prism,
    rectangle,
    wheel,
)
from follower_vision.geometry.line_of_sight import rotation

TargetKind = Literal["person", "car", "boat", "quadrotor"]

HEIGHTS_M: dict[TargetKind, float] = {"person": 1.75, "car": 1.5, "boat": 2.1, "quadrotor": 0.35}
"""Height of each kind above its reference point; its centre is half as high."""

_GLASS: Colour = (72, 58, 48)
_DARK: Colour = (38, 36, 36)
_SKIN: Colour = (140, 172, 215)


def darker(colour: Colour, share: float) -> Colour:
    """Return the colour multiplied by `share`."""
    b, g, r = (min(255, round(c * share)) for c in colour)
    return b, g, r


def target_mesh(kind: TargetKind, colour: Colour, travelled_m: float = 0.0) -> Mesh:
    """Return the body of a target; `travelled_m` moves a person's legs."""
    if kind == "person":
        return person(colour, travelled_m)
    return {"car": car, "boat": boat, "quadrotor": quadrotor}[kind](colour)


def car(colour: Colour) -> Mesh:
    """Make a hatchback, 4.5 m long, 1.8 m wide, 1.5 m high."""
    body = _extruded(
        [(2.25, 0.35), (2.25, 0.68), (0.95, 0.92), (-2.1, 0.98), (-2.25, 0.8), (-2.25, 0.35)],
        0.9,
        colour,
    )
    low, high = _trapezium(1.15, -2.05, 0.84, 0.9, 0.96), _trapezium(0.3, -1.55, 0.66, 1.5, 1.5)
    cabin = prism(low, high, colour, darker(colour, 0.93), layer=3)
    wheels = [wheel(0.34, (f, 0.905 * s, 0.34), s, layer=1) for f in (1.4, -1.4) for s in (1, -1)]
    return Mesh.joined([body, *wheels, cabin, *_car_windows(low, high), *_car_lights()])


def _trapezium(
    front: float, rear: float, half_width: float, front_up: float, rear_up: float
) -> list[Point]:
    """Return the four corners of a cabin's floor or roof, from the right front, metres."""
    f, r, w = front, rear, half_width
    return [(f, w, front_up), (f, -w, front_up), (r, -w, rear_up), (r, w, rear_up)]


def _extruded(profile: list[tuple[float, float]], half_width: float, colour: Colour) -> Mesh:
    """Make a convex body from its side view, (forward, up) corners."""
    right = [(f, half_width, u) for f, u in profile]
    left = [(f, -half_width, u) for f, u in profile]
    return prism(left, right, colour)


def _car_windows(low: Outline, high: Outline) -> list[Mesh]:
    centre: Point = (-0.4, 0.0, 1.0)
    sides = [(0, 1, 0.08), (1, 2, 0.1), (2, 3, 0.1), (3, 0, 0.1)]
    windows = []
    for i, j, edge in sides:
        face = [low[i], low[j], high[j], high[i]]
        spans = [(edge, 1 - edge)] if i in (0, 2) else [(0.12, 0.47), (0.53, 0.9)]
        windows += [panel(face, span, (0.18, 0.88), _GLASS, centre, 4) for span in spans]
    return windows


def _car_lights() -> list[Mesh]:
    centre: Point = (0.0, 0.0, 0.5)
    rear = [(-2.26, 0.9, 0.35), (-2.26, -0.9, 0.35), (-2.26, -0.9, 0.8), (-2.26, 0.9, 0.8)]
    front = [(2.26, 0.9, 0.35), (2.26, -0.9, 0.35), (2.26, -0.9, 0.68), (2.26, 0.9, 0.68)]
    red, white, plate = (40, 30, 150), (225, 240, 245), (215, 220, 220)
    return [
        panel(rear, (0.03, 0.2), (0.55, 0.9), red, centre, 2),
        panel(rear, (0.8, 0.97), (0.55, 0.9), red, centre, 2),
        panel(rear, (0.36, 0.64), (0.45, 0.72), plate, centre, 2),
        panel(rear, (0.0, 1.0), (0.0, 0.3), _DARK, centre, 2),
        panel(front, (0.03, 0.22), (0.5, 0.9), white, centre, 2),
        panel(front, (0.78, 0.97), (0.5, 0.9), white, centre, 2),
        panel(front, (0.3, 0.7), (0.3, 0.8), _DARK, centre, 2),
        panel(front, (0.0, 1.0), (0.0, 0.25), _DARK, centre, 2),
    ]


def person(colour: Colour, travelled_m: float = 0.0) -> Mesh:
    """Make a walker 1.75 m tall in a jacket of `colour`."""
    swing = 0.5 * math.sin(2 * math.pi * travelled_m / 1.5) if travelled_m else 0.0
    trousers, shoe = (92, 66, 48), _DARK
    torso = box((0.26, 0.46, 0.62), colour, (0, 0, 0.83))
    head = ball(0.125, (0, 0, 1.6), _SKIN)
    hair = box((0.2, 0.2, 0.06), (30, 42, 58), (-0.02, 0, 1.69))
    legs = [_limb((0.17, 0.17, 0.85), trousers, (0, s * 0.12, 0.85), s * swing) for s in (1, -1)]
    feet = [_foot(shoe, s * 0.12, s * swing) for s in (1, -1)]
    arms = [
        _limb((0.12, 0.12, 0.6), darker(colour, 0.85), (0, s * 0.3, 1.42), -s * swing)
        for s in (1, -1)
    ]
    return Mesh.joined([*feet, *legs, torso, *arms, head, hair])


def _limb(size: Point, colour: Colour, joint: Point, swing_rad: float) -> Mesh:
    """Make a limb that hangs from a joint and swings forward and back."""
    hanging = box(size, colour, (0, 0, -size[2]))
    turned = hanging.turned(rotation(0, swing_rad, 0))
    return turned.moved(joint[0], joint[1], -joint[2])


def _foot(colour: Colour, right: float, swing_rad: float) -> Mesh:
    foot = box((0.28, 0.13, 0.08), colour, (0.05, 0, -0.85)).turned(rotation(0, swing_rad, 0))
    return foot.moved(0, right, -0.85)


def boat(colour: Colour) -> Mesh:
    """Make a motor boat 6.4 m long with a hull of `colour` and a white cabin."""
    deck: Outline = [
        (3.4, 0, 0.85),
        (1.8, 1.0, 0.75),
        (-3, 1.05, 0.7),
        (-3, -1.05, 0.7),
        (1.8, -1.0, 0.75),
    ]
    keel: Outline = [(2.6, 0, 0.0), (1.4, 0.75, 0), (-3, 0.85, 0), (-3, -0.85, 0), (1.4, -0.75, 0)]
    hull = prism(keel, deck, colour, darker(colour, 0.9))
    low: Outline = [(1.1, 0.7, 0.78), (1.1, -0.7, 0.78), (-1.0, -0.75, 0.74), (-1.0, 0.75, 0.74)]
    high: Outline = [(0.5, 0.6, 1.9), (0.5, -0.6, 1.9), (-1.0, -0.65, 1.9), (-1.0, 0.65, 1.9)]
    cabin = prism(low, high, (228, 232, 232), colour, layer=1)
    centre: Point = (-0.2, 0.0, 1.2)
    faces = [[low[i], low[j], high[j], high[i]] for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
    windows = [panel(f, (0.1, 0.9), (0.45, 0.85), _GLASS, centre, 2) for f in faces]
    cockpit = convex([(rectangle(1.6, 1.5, 0.74, (-1.95, 0)), (160, 190, 205))], 1, (-1.95, 0, 0))
    engine = box((0.45, 0.5, 0.7), _DARK, (-3.1, 0, 0.4), layer=1)
    mast = box((0.08, 0.08, 0.2), _DARK, (-0.5, 0, 1.9), layer=3)
    return Mesh.joined([hull, cockpit, engine, cabin, *windows, mast])


def quadrotor(colour: Colour) -> Mesh:
    """Make a large quadrotor, 1.2 m from motor to motor, body of `colour`."""
    reach = 0.42
    corners = [(f * reach, r * reach) for f in (1, -1) for r in (1, -1)]
    arms = [_arm(f, r, colour) for f, r in corners]
    motors = [box((0.12, 0.12, 0.13), colour, (f, r, 0.17)) for f, r in corners]
    legs = [box((0.04, 0.04, 0.17), _DARK, (f * 0.4, r * 0.4, 0)) for f, r in corners]
    body = box((0.5, 0.26, 0.13), colour, (0, 0, 0.16), darker(colour, 0.95))
    front = [(0.252, s * 0.08, up) for s, up in ((-1, 0.18), (1, 0.18), (1, 0.26), (-1, 0.26))]
    nose = convex([(front, (235, 235, 235))], 1, (0, 0, 0.22))
    rotors = [disc(0.27, (f, r, 0.31), (128, 126, 124), 10, 2) for f, r in corners]
    rotors += [_underside(rotor) for rotor in rotors]
    hubs = [disc(0.04, (f, r, 0.33), colour, 6, 3) for f, r in corners]
    return Mesh.joined([*legs, *arms, *motors, body, nose, *rotors, *hubs])


def _underside(disc_above: Mesh) -> Mesh:
    """Return the same faces seen from the other side."""
    return replace(disc_above, faces=disc_above.faces[:, ::-1], layers=disc_above.layers * 0)


def _arm(forward: float, right: float, colour: Colour) -> Mesh:
    length = math.hypot(forward, right)
    arm = box((length, 0.07, 0.07), colour, (length / 2, 0, 0.19))
    return arm.turned(rotation(0, 0, math.atan2(right, forward)))
