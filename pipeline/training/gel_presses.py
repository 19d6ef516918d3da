"""Presses of random things on gels of random thickness, and how one press becomes many.

Half of them are things drawn on the lattice (`reliefs`), half meshes: objects to train with, and random bodies.

Solving a contact takes tens of milliseconds, so that a worker keeps its presses. Each is seen anew every time it is
drawn: turned, moved, mirrored, nearer or farther, and deeper or shallower. All of these are exact: the mechanics know
no direction and no unit of length, and the surface of a linear layer under a thing that is stretched along its normal
is stretched alike, its contact the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.geometry import rigid
from pipeline.physics import gel, lattice
from pipeline.physics.lattice import Lattice
from pipeline.sensors.parts import Gel
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation.reliefs import make_random_relief
from pipeline.training.target_touches import sample_object_mesh

_SIDE = 208  # lattice steps: any turn of a picture fits into it, nearly
_ALONG = 160  # steps to the longer side of a picture, before it is seen nearer or farther
_VIEW = 140.0  # steps of it that a picture sees, more or less
_THICKNESS = 14.0, 30.0  # steps; the project's gels are 18 to 24 pixels of a small picture thick
_DEEPEST = 14.0
_NOWHERE = 1e6  # above everything: the thing is not there
_TOLERANCE, _MOST_STEPS = 4e-3, 80
_MOST_OF_IT = 0.9  # of a picture: what lies beyond its border on all sides cannot be told from nothing
_STEP_MM = 0.085, 0.16  # of the lattice under a mesh: a picture's longer side is 14 to 26 mm
_ASIDE_MM = 3.5
_UPRIGHT, _LEAN_DEG = 0.75, 8.0  # share of the meshes that touch with the side made for it, and how far it leans
_KEPT = 4096  # presses a worker remembers, some 200 kB each


@dataclass(frozen=True, slots=True, kw_only=True)
class GelPress:
    """A gel's surface (rows, cols) on a sensor's own pixels."""

    indentation_mm: Floats
    contact: Mask


def sample_gel_press(rng: np.random.Generator, pool: tuple[int, int], source: SensorSpec, *, mesh: bool) -> GelPress:
    """A press of the pool (its seed, how many of each sort) as one picture of a sensor sees it; of a mesh or not."""
    while True:
        seen = _drawn(rng, pool, source, mesh)
        if seen.contact.mean() < _MOST_OF_IT:
            return seen


def _drawn(rng: np.random.Generator, pool: tuple[int, int], source: SensorSpec, mesh: bool) -> GelPress:
    seed, count = pool
    surface, touched = _simulate_press(seed, int(rng.integers(count)), mesh)
    deepest = float(surface.max())
    zoom = math.exp(rng.uniform(math.log(0.8), math.log(1.45)))
    # Depths from a fiftieth of a millimetre to one and a half, at steps of an eighth.
    least, most = 0.18 / (deepest * zoom), min(1.3, _DEEPEST / (deepest * zoom))
    if rng.random() < 0.5:
        deeper = rng.uniform(max(least, 0.35), max(most, 0.4))
    else:
        deeper = math.exp(rng.uniform(math.log(max(least, 0.35)), math.log(max(most, 0.4))))
    if rng.random() < 0.1:
        deeper = max(least, 0.03) * math.exp(rng.uniform(0.0, 1.2))
    shape = source.camera.shape
    view = _view(rng, zoom * max(shape) / _ALONG, shape)
    step_mm = source.pixel_mm * max(shape) / _ALONG
    return GelPress(
        indentation_mm=_resample_to_sensor(surface, view, shape) * np.float32(zoom * deeper * step_mm),
        contact=_resample_to_sensor(touched, view, shape) > np.float32(0.5),
    )


def _view(rng: np.random.Generator, zoom: float, shape: tuple[int, int]) -> Floats:
    """From a picture's pixels to the lattice's nodes (2, 3): a turn, a zoom, a shift, perhaps a mirror."""
    angle, mirror = rng.uniform(0.0, 2.0 * math.pi), float(rng.choice((-1.0, 1.0)))
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]) / zoom
    turn[:, 0] *= mirror
    aside = np.clip(rng.normal(0.0, 0.12, 2), -0.3, 0.3) * shape[::-1]
    middle = 0.5 * (np.array(shape[::-1]) - 1.0) + aside
    shift = 0.5 * (_SIDE - 1) - turn @ middle
    return np.column_stack([turn, shift]).astype(np.float32)


def _resample_to_sensor(field: Floats, view: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    seen = cv2.warpAffine(field, view, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.float32)


@lru_cache(maxsize=_KEPT)
def _simulate_press(seed: int, number: int, mesh: bool) -> tuple[Floats, Floats]:
    """Indentation in steps and contact (0 or 1) of one press of a pool; one that touches enough to be seen."""
    rng = np.random.default_rng([seed, number, 1] if mesh else [seed, number])
    while True:
        thickness = math.exp(rng.uniform(math.log(_THICKNESS[0]), math.log(_THICKNESS[1])))
        layer = Gel(thickness_mm=thickness, youngs_kpa=1.0, poisson=float(rng.uniform(0.45, 0.49)))
        depth = math.exp(rng.uniform(math.log(2.5), math.log(min(_DEEPEST, 0.55 * thickness))))
        overlap = np.float32(depth) - (_of_mesh(rng) if mesh else make_random_relief(rng, _SIDE, _VIEW))
        found = gel.press_gel(layer, 1.0, overlap, tolerance_mm=_TOLERANCE, max_steps=_MOST_STEPS)
        if found.converged and np.count_nonzero(found.contact[30:-30, 30:-30]) > 12:
            return found.indentation_mm, freeze(found.contact.astype(np.float32))


def _of_mesh(rng: np.random.Generator) -> Floats:
    """How far, in steps, a mesh's underside is above its lowest point over the lattice; far where there is none."""
    while True:
        thing, step_mm = sample_object_mesh("learned", rng, 0), math.exp(rng.uniform(*np.log(_STEP_MM)))
        lean = math.radians(_LEAN_DEG) * rng.normal(0.0, 0.4, 2) * (rng.random() < 0.5)
        pose = rigid.rotation((*lean, 0.0)) @ rigid.rotation((0.0, 0.0, rng.uniform(-math.pi, math.pi)))
        if rng.random() > _UPRIGHT:
            pose = pose @ rigid.rotation(rng.normal(0.0, 1.2, 3))
        vertices = rigid.apply(pose, thing.vertices_mm)
        foremost = vertices[np.argmin(vertices[:, 2])]
        # Tall things touch with a tip far from their middle: what touches is brought into view, roughly.
        vertices[:, :2] += rng.uniform(-_ASIDE_MM, _ASIDE_MM, 2) - np.where(rng.random() < 0.5, foremost[:2], 0.0)
        first = -0.5 * (_SIDE - 1) * step_mm
        on = Lattice(x0_mm=first, y0_mm=first, step_mm=step_mm, shape=(_SIDE, _SIDE))
        height = lattice.rasterise_mesh(vertices, thing.triangles, on)
        if np.isfinite(height).any():
            return np.asarray(np.minimum((height - height.min()) / step_mm, _NOWHERE), np.float32)
