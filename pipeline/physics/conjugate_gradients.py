"""Conjugate gradients for A x = b, preconditioned; the one loop of all linear problems on fields.

The flexible form (Notay 2000): a direction is made orthogonal to the last one by A itself, so that the preconditioner
may be unsymmetric or inexact, such as one cycle of multigrid.
"""

from collections.abc import Callable, Generator
from typing import TypeVar

import numpy as np

from pipeline.base.arrays import Doubles, Floats

Field = TypeVar("Field", Doubles, Floats)


def generate_steps(
    residual: Field, apply: Callable[[Field], Field], precondition: Callable[[Field], Field]
) -> Generator[Field]:
    """Yield the steps whose sum solves A x = b; the caller adds them up and stops.

    `residual` is b at first, and b - A x in place after each step. `apply` is x -> A x, symmetric and positive on the
    directions that `precondition` gives. Both may return buffers of their own: a step is valid until the next one, and
    no array is allocated in it. Ends where no step reduces the residual any more.
    """
    direction, moved, reduced = np.zeros_like(residual), np.zeros_like(residual), 1.0
    while True:
        guided = precondition(residual)
        direction *= -compute_dot(guided, moved) / reduced
        direction += guided
        moved = apply(direction)
        reduced, curvature = compute_dot(direction, residual), compute_dot(direction, moved)
        if not (reduced > 0.0 and curvature > 0.0):
            return
        moved *= reduced / curvature
        residual -= moved
        np.multiply(direction, reduced / curvature, out=guided)
        yield guided


def compute_dot(a: Doubles | Floats, b: Doubles | Floats) -> float:
    """The dot product of two fields in double precision and in a fixed order; BLAS distributes it over threads."""
    return float(np.einsum("i,i->", a.ravel(), b.ravel(), dtype=np.float64))
