"""Describe unobservable motions one by one: translations, rotations about an axis, and screws."""

from collections.abc import Callable, Iterator

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry.rigid import cross_matrix

SLIDE_ROTATION_LIMIT = 0.05  # share of rotation in a unit motion below which it is a translation
# share of rotation that also counts where the pure translation is not observable either
_LOOSE_ROTATION_LIMIT = 0.2
# cosine of 2 degrees, for translations: farther off, the object leaves the sensor's plane
_TRANSLATION_COSINE = 0.9994
_AXIS_COSINE = 0.995  # cosine of 6 degrees, within which a direction is named after an axis
_MIN_TRANSLATION = 0.15  # share of translation in a rotation that is not described
_PITCH = 0.05  # of translation in a rotation: error of normals that are off by 3 degrees
# change of a motion, in radii per radius that its axis moves: error of such normals
_MIN_AXIS_SHIFT = 0.05
_CENTRE_DISTANCE = 0.1  # an axis this near the contact's centre, in its radii, goes through it
_AXES = ("x", "y", "z")


def describe_motions(
    lost: Doubles, about_mm: Doubles, radius_mm: float, is_lost: Callable[[Doubles], bool]
) -> list[tuple[str, Doubles]]:
    """Describe the motions that span the orthonormal columns (6, k), each with its motion (6,) of
    unit size.

    Columns are (rotation times `radius_mm`, translation at `about_mm`). Translations come first,
    then rotations, about one common centre where there is one. Axes of the sensor are preferred;
    other directions are given by components, an axis that misses the contact's centre by its
    nearest point in mm. A rotation whose translation along its own axis cannot be left out, by
    `is_lost` of the rest, is described as a screw.
    """
    if lost.shape[1] == 0:
        return []
    _, turning, mix = np.linalg.svd(lost[:3], full_matrices=True)
    turning = np.concatenate([turning, np.zeros(mix.shape[0] - len(turning))])
    basis = lost @ mix.T
    straight = turning <= SLIDE_ROTATION_LIMIT
    for k in np.flatnonzero(~straight & (turning <= _LOOSE_ROTATION_LIMIT)):
        alone = np.concatenate([np.zeros(3), basis[3:, k] / np.linalg.norm(basis[3:, k])])
        if is_lost(alone):
            basis[:, k] = alone
            straight[k] = True
    sliding = basis[:, straight]
    rest = basis[:, ~straight]
    slides, _ = np.linalg.qr(sliding[3:])
    named = [
        (f"moves along {describe_direction(a, _TRANSLATION_COSINE)}", _closest(sliding, 3, a))
        for a in _axes_in(slides)
    ]
    turns = _turns(rest, slides)
    centre_mm = _common_centre(turns, slides, radius_mm)
    kept = np.eye(3) - slides @ slides.T
    return named + [
        (_describe_rotation(t, kept, centre_mm, about_mm, radius_mm, is_lost), t) for t in turns
    ]


def describe_direction(vector: Doubles, pure: float = _AXIS_COSINE) -> str:
    """Describe a direction: the sensor's axis within a cosine of `pure`, or components."""
    unit = vector / np.linalg.norm(vector)
    k = int(np.argmax(np.abs(unit)))
    if abs(unit[k]) > pure:
        return _AXES[k]
    return "({:.2f}, {:.2f}, {:.2f})".format(*(np.round(unit * np.sign(unit[k]), 2) + 0.0))


def _axes_in(span: Doubles) -> Iterator[Doubles]:
    """Return orthonormal directions that span the columns (3, k), along the sensor's axes as far
    as possible.
    """
    while span.shape[1]:
        length = np.linalg.norm(span, axis=1)
        axis = int(np.argmax(np.round(length, 3)))
        direction = span @ span[axis] / length[axis]
        yield direction
        kept = np.linalg.svd((span.T @ direction)[None, :])[2][1:]
        span = span @ kept.T


def _closest(basis: Doubles, first: int, direction: Doubles) -> Doubles:
    """Return the unit motion in `basis` whose rotation (`first` 0) or translation (3) is along
    `direction`.
    """
    weights = np.linalg.lstsq(basis[first : first + 3], direction, rcond=None)[0]
    motion = basis @ weights
    return np.asarray(motion / np.linalg.norm(motion), dtype=np.float64)


def _turns(basis: Doubles, slides: Doubles) -> list[Doubles]:
    """Return motions whose rotations are along preferred axes, less what the translations
    compensate.
    """
    axes, _ = np.linalg.qr(basis[:3])
    found: list[Doubles] = []
    for axis in _axes_in(axes):
        motion = _closest(basis, 0, axis)
        motion[3:] -= slides @ (slides.T @ motion[3:])
        found.append(motion / np.linalg.norm(motion))
    return found


def _common_centre(turns: list[Doubles], slides: Doubles, radius_mm: float) -> Doubles:
    """Return the point (3,) mm from the contact's centre that the rotations move least.

    The nearest such point.
    """
    if not turns:
        return np.zeros(3)
    free = np.eye(3) - slides @ slides.T
    rows = np.concatenate([free @ cross_matrix(turn[:3] / radius_mm) for turn in turns])
    wanted = np.concatenate([-free @ turn[3:] for turn in turns])
    u, size, vt = np.linalg.svd(rows, full_matrices=False)
    is_significant = (
        size > _MIN_AXIS_SHIFT / radius_mm
    )  # where translations undo every shift of the axis, it goes through the centre
    return vt[is_significant].T @ ((u[:, is_significant].T @ wanted) / size[is_significant])


def _describe_rotation(
    turn: Doubles,
    kept: Doubles,
    centre_mm: Doubles,
    about_mm: Doubles,
    radius_mm: float,
    is_lost: Callable[[Doubles], bool],
) -> str:
    words = f"rotates about {describe_direction(turn[:3])}"
    # less what the translations compensate
    left = kept @ (turn[3:] + np.cross(turn[:3] / radius_mm, centre_mm))
    if np.linalg.norm(left) > _MIN_TRANSLATION:
        return f"{words} while moving along {describe_direction(turn[3:])}"
    along = turn[:3] * float(left @ turn[:3]) / float(turn[:3] @ turn[:3])
    if np.linalg.norm(along) > _PITCH * np.linalg.norm(turn[:3]) and not is_lost(
        turn - np.concatenate([np.zeros(3), along])
    ):
        words += f" while moving along {describe_direction(turn[:3])}"
    if np.linalg.norm(centre_mm) <= _CENTRE_DISTANCE * radius_mm:
        return words
    return words + " with its axis at ({:.1f}, {:.1f}, {:.1f}) mm".format(
        *(np.round(about_mm + centre_mm, 1) + 0.0)
    )
