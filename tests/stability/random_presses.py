"""Random shapes, poses and depths pressed into every sensor, classified by outcome.

Images are an eighth to a third of each sensor's own size, so that ten thousand presses take
minutes. A press fails when it raises anything but a TouchError, returns a value that is not finite,
contradicts itself, or ends short of its tolerance without saying so.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from functools import lru_cache

import numpy as np

from pipeline.core.arrays import freeze
from pipeline.core.errors import TouchError
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import SimulatedPress, simulate_press
from pipeline.sensors.spec import SensorSpec, list_sensor_names, load_sensor

_SHARES = (0.125, 0.2, 0.33)  # of the sensor's own pixels along each side
DEPTHS_MM = {
    "miss": (-20.0, -0.5),
    "grazing": (-1e-3, 1e-3),
    "zero": (0.0, 0.0),
    "usual": (0.05, 3.0),
    "deep": (3.0, 15.0),
    "absurd": (50.0, 1e6),
}
_SHARE_OF_DEPTH = (0.12, 0.08, 0.05, 0.5, 0.15, 0.1)


def run(n: int, seed: int) -> tuple[Counter[str], dict[str, tuple[int, float]], float, list[str]]:
    """(outcomes, per sensor (presses, seconds), seconds in all, one line for each that failed or
    did not converge).
    """
    counts: Counter[str] = Counter()
    by_sensor: dict[str, tuple[int, float]] = {}
    bad: list[str] = []
    began = time.perf_counter()
    for k in range(n):
        rng = np.random.default_rng((seed, k))
        spec = small_sensor(
            list_sensor_names()[k % len(list_sensor_names())],
            _SHARES[int(rng.integers(len(_SHARES)))],
        )
        thing, pose, kind = random_press(rng)
        started = time.perf_counter()
        outcome = outcome_of(thing, pose, spec, int(rng.integers(2**31)))
        done, seconds = by_sensor.get(spec.name, (0, 0.0))
        by_sensor[spec.name] = done + 1, seconds + time.perf_counter() - started
        counts[
            f"{outcome} ({kind}, {spec.kind})" if outcome.startswith("not conv") else outcome
        ] += 1
        if outcome.startswith(("FAILED", "not converged")):
            bad.append(
                f"--seed {seed}, press {k}: {thing.name}, {kind}, {spec.name} "
                f"{spec.camera.shape}: {outcome}"
            )
    return counts, by_sensor, time.perf_counter() - began, bad


@lru_cache(maxsize=64)
def small_sensor(name: str, share: float) -> SensorSpec:
    """A sensor with fewer pixels over the same view."""
    whole = load_sensor(name)
    camera = whole.camera.scale(share)
    return replace(whole, camera=camera, rest_depth_mm=whole.membrane.rest_depth_mm(camera))


def outcome_of(thing: Mesh, pose: np.ndarray, spec: SensorSpec, seed: int) -> str:
    """What became of one press, in a few words; those that must not be begin with FAILED."""
    try:
        pressed = simulate_press(thing, pose, spec, seed=seed)
    except TouchError as error:
        return f"refused: {type(error).__name__}"
    except Exception as error:  # noqa: BLE001 - any other exception is a failure
        return f"FAILED: {type(error).__name__}: {error}"[:90]
    wrong = contradiction(pressed, spec)
    if wrong:
        return f"FAILED: {wrong}"
    if not pressed.converged:
        return "not converged, and says so"
    return (
        "touched"
        if pressed.truth.contact is not None and pressed.truth.contact.any()
        else "not touched"
    )


def contradiction(pressed: SimulatedPress, spec: SensorSpec) -> str:
    """What of a press cannot be true; empty = nothing."""
    moved = pressed.truth.indentation_mm
    contact = pressed.truth.contact
    if moved is None or contact is None:
        return "no truth"
    hit = bool(contact.any())
    findings = {
        "a truth that is not finite": not (
            np.isfinite(moved).all() and np.isfinite(pressed.force_n)
        ),
        "an infinite reading": bool(pressed.image.ndim == 2 and np.isinf(pressed.image).any()),
        "an array of another shape": {pressed.image.shape[:2], moved.shape, contact.shape}
        != {spec.camera.shape},
        "a pulling force": pressed.force_n < 0,
        "contact without force": hit and pressed.force_n == 0,
        # it may be outward: a bulge meets the object too
        "contact without any motion": hit and not moved.any(),
        "indentation without force": pressed.force_n == 0 and bool(moved.any()),
    }
    return next((name for name, found in findings.items() if found), "")


def random_press(rng: np.random.Generator) -> tuple[Mesh, np.ndarray, str]:
    """(object, alignment_from_object, kind of depth)."""
    makers = catalogue() if rng.random() < 0.6 else (_plate, _ball, _spike, _prism, _rubble)
    maker = makers[int(rng.integers(len(makers)))]
    thing = maker if isinstance(maker, Mesh) else maker(rng)
    if rng.random() < 0.3:
        turn = _any_turn(rng)
    else:
        lean = np.deg2rad(rng.uniform(-45, 45, 3)) * (rng.random(3) < 0.5)
        turn = rigid.rotation(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])) @ rigid.rotation(
            lean
        )
    wide = 60.0 if rng.random() < 0.15 else 8.0
    kinds = list(DEPTHS_MM)
    kind = kinds[int(rng.choice(len(kinds), p=_SHARE_OF_DEPTH))]
    low, high = DEPTHS_MM[kind]
    depth = (
        np.exp(rng.uniform(np.log(low), np.log(high)))
        if kind == "absurd"
        else rng.uniform(low, high)
    )
    turned = rigid.apply(turn, thing.vertices_mm)
    # the depth is that of the foremost point, and most often that is aimed
    tip = turned[int(turned[:, 2].argmin())]
    x, y = rng.uniform(-wide, wide, 2) - (tip[:2] if rng.random() < 0.6 else 0.0)
    return thing, rigid.translation(x, y, -depth - float(tip[2])) @ turn, kind


@lru_cache(maxsize=1)
def catalogue() -> tuple[Mesh, ...]:
    """The shapes that come with the project."""
    return tuple(shapes.make_shape(name).mesh for name in shapes.list_shapes())


def _any_turn(rng: np.random.Generator) -> np.ndarray:
    axis = rng.standard_normal(3)
    return rigid.rotation(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))


def _mesh(vertices: np.ndarray, triangles: np.ndarray, name: str) -> Mesh:
    return Mesh(
        vertices_mm=freeze(vertices.astype(np.float64)),
        triangles=freeze(triangles.astype(np.int32)),
        name=name,
    )


def _plate(_rng: np.random.Generator) -> Mesh:
    """Covers every sensor."""
    corners = np.array([[-200, -200, 0], [200, -200, 0], [200, 200, 0], [-200, 200, 0]])
    return _mesh(corners, np.array([[0, 2, 1], [0, 3, 2]]), "plate")


def _ball(rng: np.random.Generator) -> Mesh:
    radius = np.exp(rng.uniform(np.log(0.2), np.log(60.0)))
    n = 24
    m = 12
    polar = np.linspace(0, np.pi, m + 1)[:, None]
    around = np.arange(n)[None, :] * 2 * np.pi / n
    points = np.stack(
        [
            np.sin(polar) * np.cos(around),
            np.sin(polar) * np.sin(around),
            -np.cos(polar) + 0 * around,
        ],
        -1,
    )
    k = np.arange(m)[:, None] * n + np.arange(n)[None, :]
    right = np.arange(m)[:, None] * n + (np.arange(n)[None, :] + 1) % n
    faces = np.concatenate(
        [np.stack([k, right, k + n], -1), np.stack([right, right + n, k + n], -1)]
    )
    return _mesh(radius * points.reshape(-1, 3), faces.reshape(-1, 3), "ball")


def _spike(rng: np.random.Generator) -> Mesh:
    """A needle, thinner than a pixel as often as not."""
    width = np.exp(rng.uniform(np.log(1e-3), np.log(3.0)))
    length = 20.0
    corners = np.array(
        [[0, 0, 0], [width, 0, length], [-width, width, length], [-width, -width, length]]
    )
    return _mesh(corners, np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]), "spike")


def _prism(rng: np.random.Generator) -> Mesh:
    n = int(rng.integers(3, 9))
    angle = np.arange(n) * 2 * np.pi / n
    radius = rng.uniform(0.5, 20.0)
    outline = [(radius * np.cos(a), radius * np.sin(a)) for a in angle]
    return shapes.make_chamfered_prism(outline, 8.0, min(0.5, 0.1 * radius), f"{n}-sided prism")


def _rubble(rng: np.random.Generator) -> Mesh:
    """Loose triangles, slivers and points among them: no body at all."""
    corners = rng.uniform(-10, 10, (30, 3)) * (1, 1, 0.2)
    corners[:3] = corners[0]
    return _mesh(corners, rng.integers(0, 30, (20, 3)), "rubble")
