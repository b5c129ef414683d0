"""Small matrices, against LAPACK."""

import numpy as np
import pytest

from follower_control.common.small_matrix import (
    inverse_of_covariance,
    largest_eigenvalue,
    length,
    product,
    quadratic_form,
    transformed,
)


def covariances(seed: int):
    """Long, flat, round and tiny ones."""
    rng = np.random.default_rng(seed)
    for deviations in ((3, 0.1, 0.1), (2, 2, 0.01), (1, 1, 1), (1e-4, 2e-4, 3e-4), (5, 2, 0.5)):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        spread = turn @ np.diag(np.square(deviations)) @ turn.T
        yield (spread + spread.T) / 2


@pytest.mark.parametrize("shapes", [((3, 3), (3, 3)), ((7, 3), (3, 7)), ((3, 3), (3, 20))])
def test_a_product_is_that_of_numpy(shapes):
    a, b = (np.random.default_rng(1).normal(size=shape) for shape in shapes)
    np.testing.assert_allclose(product(a, b), a @ b, atol=1e-14)


def test_a_vector_is_turned_measured_and_weighted_as_by_numpy():
    rng = np.random.default_rng(2)
    matrix, vector = rng.normal(size=(3, 3)), rng.normal(size=3)
    np.testing.assert_allclose(transformed(matrix, vector), matrix @ vector, atol=1e-14)
    assert length(vector) == pytest.approx(np.linalg.norm(vector), rel=1e-15)
    assert quadratic_form(matrix, vector) == pytest.approx(vector @ matrix @ vector, abs=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_a_covariance_is_inverted(seed):
    for matrix in covariances(seed):
        np.testing.assert_allclose(inverse_of_covariance(matrix) @ matrix, np.eye(3), atol=1e-9)


def test_a_singular_covariance_is_an_error():
    with pytest.raises(ZeroDivisionError):
        inverse_of_covariance(np.diag([1.0, 0.0, 1.0]))


@pytest.mark.parametrize("seed", range(5))
def test_the_largest_eigenvalue_is_that_of_lapack(seed):
    for matrix in covariances(seed):
        for part in (matrix, matrix[:2, :2]):
            expected = np.linalg.eigvalsh(part)[-1]
            assert largest_eigenvalue(part) == pytest.approx(expected, rel=1e-13)


def test_a_diagonal_matrix_has_its_eigenvalues_at_once():
    assert largest_eigenvalue(np.diag([1.0, 4.0, 2.0])) == 4.0
    assert largest_eigenvalue(np.zeros((3, 3))) == 0.0
