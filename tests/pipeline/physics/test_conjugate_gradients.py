from itertools import islice, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.gel import compute_dot, generate_steps


def draw_problem(seed, n):
    """A symmetric positive matrix, its right side, and a preconditioner near its inverse that is
    not symmetric.
    """
    rng = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(rng.normal(size=(n, n)))
    matrix = basis * np.geomspace(1.0, 1e3, n) @ basis.T
    return matrix, rng.normal(size=n), np.linalg.inv(matrix) + 2e-5 * rng.normal(size=(n, n))


@given(st.integers(0, 10_000), st.integers(1, 30))
def test_as_many_steps_as_unknowns_give_the_dense_solution(seed, n):
    matrix, right, _ = draw_problem(seed, n)
    residual = right.copy()
    solution = sum(
        (
            step.copy()
            for step in islice(generate_steps(residual, matrix.__matmul__, np.copy), 2 * n)
        ),
        0.0,
    )
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(solution, expected, atol=1e-8 * np.abs(expected).max())
    np.testing.assert_allclose(residual, right - matrix @ solution, atol=1e-9 * np.abs(right).max())


@pytest.mark.parametrize("seed", range(5))
def test_an_unsymmetric_preconditioner_near_the_inverse_needs_few_steps(seed):
    matrix, right, near_inverse = draw_problem(seed, 60)
    residual = right.copy()
    errors = []
    for _ in islice(generate_steps(residual, matrix.__matmul__, near_inverse.__matmul__), 8):
        errors.append(np.linalg.norm(residual))
    assert errors[-1] < 1e-6 * np.linalg.norm(right)


def test_each_direction_is_conjugate_to_the_one_before():
    matrix, right, _ = draw_problem(3, 20)
    steps = [
        step.copy() for step in islice(generate_steps(right.copy(), matrix.__matmul__, np.copy), 6)
    ]
    for one, two in pairwise(steps):
        assert abs(one @ matrix @ two) < 1e-9 * np.sqrt((one @ matrix @ one) * (two @ matrix @ two))


def test_buffers_that_are_written_again_give_the_same_steps():
    matrix, right, _ = draw_problem(4, 12)
    moved = np.empty(12)
    guided = np.empty(12)
    fresh = [s.copy() for s in islice(generate_steps(right.copy(), matrix.__matmul__, np.copy), 5)]
    reused = generate_steps(
        right.copy(), lambda x: np.matmul(matrix, x, out=moved), lambda r: np.add(r, 0, out=guided)
    )
    np.testing.assert_array_equal([s.copy() for s in islice(reused, 5)], fresh)


def test_nothing_left_and_a_matrix_that_is_not_positive_end_it():
    assert not list(generate_steps(np.zeros(4), np.copy, np.copy))
    assert not list(generate_steps(np.ones(4), np.negative, np.copy))


def test_single_precision_stays_so_and_its_dot_product_does_not():
    field = np.full((300, 400), 1.1, np.float32)
    assert compute_dot(field, field) == pytest.approx(
        120_000 * float(np.float32(1.1)) ** 2, rel=1e-12
    )
    assert next(generate_steps(field.copy(), np.copy, np.copy)).dtype == np.float32
