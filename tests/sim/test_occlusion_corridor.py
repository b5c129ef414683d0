"""What stands about a line of sight: nothing that can hide the target is left out."""

from __future__ import annotations

import numpy as np

from follower_sim.bodies.mesh import Mesh
from follower_sim.kinematics import Triple
from follower_sim.world.silhouettes import BoundingSphere, Corridor, ball_of, hides
from follower_sim.world.solid import Solid

FORWARD = BoundingSphere((10.0, 0.0, 0.0), 1.0)
EYE = (0.0, 0.0, 0.0)


def test_what_is_between_hides_and_what_is_beside_behind_or_beyond_does_not() -> None:
    assert hides(BoundingSphere((5.0, 1.5, 0.0), 1.0), FORWARD, EYE)
    assert not hides(BoundingSphere((5.0, 2.5, 0.0), 1.0), FORWARD, EYE)
    assert not hides(BoundingSphere((-3.0, 0.0, 0.0), 1.0), FORWARD, EYE)
    assert not hides(BoundingSphere((12.0, 0.0, 0.0), 1.0), FORWARD, EYE)


def test_whatever_hides_is_found_wherever_camera_and_target_have_moved() -> None:
    rng = np.random.default_rng(0)
    standing = [pole(rng) for _ in range(300)]
    corridor = Corridor(standing)
    eye, target = rng.uniform(-30, 30, (2, 3))
    found = 0
    for _ in range(400):
        eye, target = eye + rng.normal(0, 1, 3), target + rng.normal(0, 1, 3)
        ball, place = BoundingSphere(triple(target), float(rng.uniform(0.5, 3))), triple(eye)
        hiding = [solid for solid in standing if hides(ball_of(solid), ball, place)]
        about = [solid for one, solid in corridor.about(place, ball) if hides(one, ball, place)]
        assert about == hiding
        found += len(hiding)
    assert found > 100


def test_without_bodies_nothing_hides() -> None:
    assert Corridor(()).about(EYE, FORWARD) == []


def pole(rng: np.random.Generator) -> Solid:
    corners = rng.uniform(-2, 2, (4, 3))
    mesh = Mesh.of_polygons([(corners, (0, 0, 0))])
    return Solid.placed(mesh, rng.uniform(-50, 50, 3), np.eye(3), None)


def triple(place: np.ndarray) -> Triple:
    north, east, down = place.tolist()
    return north, east, down
