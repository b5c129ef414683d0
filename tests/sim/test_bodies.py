"""The low-poly bodies have their real sizes and are closed and turned outward."""

import numpy as np
import pytest

from follower_sim.bodies.mesh import Mesh, ball, box, prism, ring
from follower_sim.bodies.targets import HEIGHTS_M, TargetKind, target_mesh
from follower_sim.world.scenery import (
    DISTANT_KINDS,
    SIZES_M,
    SceneryKind,
    distant_mesh,
    scenery_mesh,
)
from follower_sim.world.solid import Solid

RED = (30, 40, 220)


def volume(mesh: Mesh) -> float:
    """Return the volume by the divergence theorem; positive if the faces look outward."""
    total = 0.0
    for face in mesh.faces:
        a, b, c, d = mesh.vertices[face]
        total += float(np.dot(a, np.cross(b, c)) + np.dot(a, np.cross(c, d))) / 6
    return total


@pytest.mark.parametrize(
    ("kind", "length", "width"),
    [("car", 4.5, 1.8), ("person", 0.3, 0.72), ("boat", 6.7, 2.1), ("quadrotor", 1.38, 1.38)],
)
def test_targets_have_their_real_sizes(kind: TargetKind, length: float, width: float) -> None:
    vertices = target_mesh(kind, RED).vertices
    size = vertices.max(axis=0) - vertices.min(axis=0)
    assert size[0] == pytest.approx(length, abs=0.05)
    assert size[1] == pytest.approx(width, abs=0.05)
    assert -vertices[:, 2].min() == pytest.approx(HEIGHTS_M[kind], abs=0.03)
    assert vertices[:, 2].max() == pytest.approx(0, abs=0.01)


def test_a_walkers_legs_swing_with_the_way() -> None:
    still, striding = (target_mesh("person", RED, way).vertices for way in (0.0, 0.375))
    assert np.ptp(striding[:, 0]) > np.ptp(still[:, 0]) + 0.4
    assert target_mesh("person", RED, 0.375).vertices == pytest.approx(
        target_mesh("person", RED, 0.375 + 1.5).vertices
    )


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box((2, 3, 4), RED), 24.0),
        (prism(ring(6, 1, 0), ring(6, 1, 2), RED), 2 * 3 * np.sqrt(3) / 2),
        (ball(1, (0, 0, 0), RED), 2.536),
    ],
)
def test_shapes_are_closed_and_face_outward(mesh: Mesh, expected: float) -> None:
    assert volume(mesh) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("kind", SIZES_M)
def test_scenery_stands_on_the_ground_and_is_as_large_as_asked(kind: SceneryKind) -> None:
    size = SIZES_M[kind][1]
    for make in (scenery_mesh, distant_mesh) if kind in DISTANT_KINDS else (scenery_mesh,):
        vertices = make(kind, size, np.random.default_rng(3)).vertices
        assert np.ptp(vertices, axis=0).max() > 0.8 * size
        assert -0.15 * size < vertices[:, 2].max() < 0.75 * size
        assert vertices[:, 2].min() < 0


def test_faces_towards_the_sun_are_brighter() -> None:
    sun = np.array([-0.6, 0.0, -0.8])
    solid = Solid.placed(box((1, 1, 1), (100, 100, 100)), (0, 0, 0), np.eye(3), sun)
    brightness = {
        tuple(n.round(3) + 0.0): c[0] for n, c in zip(solid.normals, solid.colours, strict=True)
    }
    assert brightness[(0, 0, -1)] > brightness[(-1, 0, 0)] > brightness[(1, 0, 0)]


def test_a_shadow_falls_away_from_the_sun_as_long_as_the_sun_is_low() -> None:
    sun = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5)])
    pole = Solid.placed(box((0.1, 0.1, 3), RED), (0, 0, 0), np.eye(3), sun)
    shadow = pole.shadow(sun)
    assert shadow[:, 0].min() == pytest.approx(-3.05)
    assert shadow[:, 0].max() == pytest.approx(0.05)
