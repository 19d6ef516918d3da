"""Generation: the touch that the target sensor would have felt, by physics.

The target view says where the object is, and only where the source felt it. A gel is pressed onto those points as an
elastic layer and photographed by the sensor's optics; a bubble is a slack membrane over them, watched by its depth
camera. Nothing is claimed of the object beyond the points: there the membrane is free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, assert_never

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image, Indices, Mask, freeze
from pipeline.base.entry_points import load_reference
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.base.memo import Memo
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.base.stage_warnings import StageWarning
from pipeline.engine.digests import compute_cached_digest
from pipeline.geometry.camera import MIN_DEPTH_MM
from pipeline.physics import bubble, bubble_camera, gel, lattice, optics
from pipeline.sensors.spec import SensorSpec
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import DepthMap, GeneratedTouch, TargetDepth

GelSurfaceMode = Literal["press", "follow"]

NO_CONTACT = "no contact: the target's untouched reading is the exact answer"

_TELL_CLIPPED = 0.02  # of the pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class PhysicalRenderParams:
    """How the target's touch is made."""

    surface: GelSurfaceMode = setting(
        "press",
        "Gel surface",
        choices=GelSurfaceMode,
        help="press: the gel rests on the object and may lift off dents of the depth; follow: it takes every value",
        source="contact of a bonded layer: Johnson 1985, Polonsky and Keer 1999",
    )
    add_noise: bool = setting(
        False, "Sensor noise", help="add the target sensor's own noise to the reading",
        source="measured or assumed, in the sensor's description",
    )  # fmt: skip
    seed: int = setting(
        0, "Seed", low=0, high=2**31 - 1, step=1, help="of the noise", source="PCG64: O'Neill 2014, as numpy has it"
    )  # fmt: skip
    contact_gap_mm: float = setting(
        0.1, "Contact gap", unit="mm", low=0.0, high=2.0, step=0.05,
        help="a bubble's membrane this close to the object counts as touching it: it bridges the depth's own noise",
        source="obstacle problem: Kinderlehrer and Stampacchia 1980",
    )  # fmt: skip
    tolerance_um: float = setting(
        0.5, "Solver tolerance", unit="um", low=0.01, high=50.0, step=0.1, help="of the surface where it touches",
        source="truncated multigrid: Graeser and Kornhuber 2009",
    )  # fmt: skip


def render_touch(
    view: TargetDepth, target: SensorSpec, params: PhysicalRenderParams, progress: Progress = SILENT
) -> GeneratedTouch:
    """What `target` would have recorded of `view`; raises ShapeError when the view is of another image size."""
    exact = skip_without_contact(view, target, params)
    if exact is not None:
        return exact
    view, left_out = _without_gaps(view)
    exact = skip_without_contact(view, target, params)
    if exact is not None:
        return replace(exact, notes=(*left_out, *exact.notes))
    progress.step(0.0, "pressing the target's membrane")
    depth_limited, cut = _within_limits(view, target)
    renderer = target.sensor_kind.touch_renderer
    if not renderer:
        raise SettingProblem(
            f"the physical render has no model of sensors of kind {target.kind!r} such as {target.name}"
        )
    touch = load_reference(renderer)(view, depth_limited, target, params, [*left_out, *cut])
    progress.step(1.0, "pressed")
    return touch


def skip_without_contact(view: TargetDepth, target: SensorSpec, params: PhysicalRenderParams) -> GeneratedTouch | None:  # noqa: ARG001 - the stage contract
    """The target's untouched reading when the view has no contact, else None; kept per sensor, so it costs nothing."""
    if view.contact.shape != target.camera.shape:
        raise ShapeError(
            f"the target view must have the shape {target.camera.shape} of {target.name}, got {view.contact.shape}"
        )
    if view.contact.any():
        return None
    return replace(make_reference_touch(target), in_view=view.in_view)


def make_reference_touch(target: SensorSpec) -> GeneratedTouch:
    """The target's untouched reading; kept per sensor."""
    return _untouched_touches.get_or_make(compute_cached_digest(target), lambda: _untouched(target))


_untouched_touches: Memo[str, GeneratedTouch] = Memo(8)


def _untouched(target: SensorSpec) -> GeneratedTouch:
    shape = target.camera.shape
    at_rest = _membrane(target, np.zeros(shape, np.float32), np.zeros(shape, np.bool_))
    return GeneratedTouch(
        image=target.render_reference(),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)),
        membrane=at_rest,
        notes=(NO_CONTACT,),
    )


def _without_gaps(view: TargetDepth) -> tuple[TargetDepth, list[str]]:
    """The view without what is no surface: contact that is not pushed in, depth that no camera sees, no numbers."""
    usable = view.contact & (view.indentation_mm >= 0) & (view.indentation_mm < np.inf)  # false for NaN as well
    seen = (view.depth_mm > MIN_DEPTH_MM) & (view.depth_mm < np.inf)
    n_lost = int(np.count_nonzero(view.contact) - np.count_nonzero(usable))
    if not n_lost and not (np.isfinite(view.depth_mm) & ~seen).any():
        return view, []
    depth: Floats = np.where(seen, view.depth_mm, np.float32(np.nan))
    indentation: Floats = np.where(usable, view.indentation_mm, np.float32(0.0))
    notes = [f"{n_lost:,} contact pixels of the target view have no value and were left out"] if n_lost else []
    return replace(view, contact=usable, depth_mm=freeze(depth), indentation_mm=freeze(indentation)), notes


def _within_limits(view: TargetDepth, target: SensorSpec) -> tuple[Floats, list[str]]:
    """The view's indentation, nowhere deeper than the sensor can go; a note says how much was cut."""
    limit = target.limits.indentation_max_mm
    deeper = view.contact & (view.indentation_mm > limit)
    if not deeper.any():
        return view.indentation_mm, []
    deepest = float(view.indentation_mm[deeper].max())
    note = StageWarning(
        f"{int(deeper.sum())} of {int(view.contact.sum())} contact pixels lie up to {deepest:.2f} mm deep and were "
        f"cut at the {limit:g} mm that {target.title} can be pressed"
    )
    return np.minimum(view.indentation_mm, np.float32(limit)), [note]


def render_gel_touch(
    view: TargetDepth, indentation_mm: Floats, target: SensorSpec, params: PhysicalRenderParams, notes: list[str]
) -> GeneratedTouch:
    """The image of a gel pressed by the view, and its surface."""
    if target.gel is None:
        raise SettingProblem(f"{target.name} has no gel to press; its description lacks [gel]")
    # Where the object leaves the picture it goes on beyond it: the pad does not end at the camera's view.
    margin = int(np.ceil(target.gel.thickness_mm / target.pixel_mm)) if _at_border(view.contact) else 0
    mask = np.pad(view.contact, margin, mode="edge")
    wanted = np.pad(indentation_mm, margin, mode="edge")
    tolerance_mm = 1e-3 * params.tolerance_um
    if params.surface == "follow":
        answer = gel.relax_gel(target.gel, target.pixel_mm, wanted, mask, tolerance_mm=tolerance_mm)
    elif params.surface == "press":
        answer = gel.press_gel(target.gel, target.pixel_mm, np.where(mask, wanted, -np.inf), tolerance_mm=tolerance_mm)
    else:
        assert_never(params.surface)
    rows, cols = target.camera.shape
    inner = (slice(margin, margin + rows), slice(margin, margin + cols))
    surface: Floats = np.ascontiguousarray(answer.indentation_mm[inner])
    if not answer.converged:
        told = f"the gel's surface is only known to {1e3 * answer.residual_mm:.1f} um: its solve ran out of steps"
        notes.append(StageWarning(told))
    image: Image = optics.render(target, surface, seed=params.seed if params.add_noise else None)
    clipped = float(((image == 0) | (image == 255)).any(axis=2).mean())
    if clipped > _TELL_CLIPPED:
        notes.append(
            StageWarning(f"{clipped:.0%} of the picture's colours are clipped: it is brighter or darker than shown")
        )
    contact: Mask = np.ascontiguousarray(answer.contact[inner])
    if params.surface == "follow":
        contact = view.contact.copy()
    return _touch(view, target, image, surface, contact, notes)


def render_bubble_touch(
    view: TargetDepth, indentation_mm: Floats, target: SensorSpec, params: PhysicalRenderParams, notes: list[str]
) -> GeneratedTouch:
    """The depth image of a bubble pressed by the view, and its membrane."""
    if target.bubble is None:
        raise SettingProblem(f"{target.name} has no membrane to press; its description lacks [bubble]")
    on = bubble.make_lattice(target.bubble)
    seen = np.where(view.contact, target.rest_depth_mm - indentation_mm, view.depth_mm)
    ceiling = bubble_camera.compute_ceiling_from_depth(target, seen, on)
    answer = bubble.press_bubble(target.bubble, ceiling, on, tolerance_mm=1e-3 * params.tolerance_um)
    if not answer.converged:
        notes.append(StageWarning("the air pressure of the bubble was not settled; its bulge is doubtful"))
    depth = _in_front_of(view, seen, bubble_camera.compute_depth_from_deviation(target, answer.deviation_mm, on))
    pressed = lattice.sample_mask_at_pixels(target.camera, answer.contact, on, depth)
    # A membrane bridges every dent of an estimated surface, so that its force sits on the bumps of the noise alone.
    with np.errstate(invalid="ignore"):
        contact = pressed | (view.contact & (seen - depth <= params.contact_gap_mm))
    notes.append(f"air pressure {target.bubble.pressure_kpa:.2f} -> {answer.pressure_kpa:.2f} kPa")
    image = bubble_camera.simulate_depth_frame(target, depth, params.seed if params.add_noise else None)
    return _touch(view, target, image, (target.rest_depth_mm - depth).astype(np.float32), contact, notes)


def _in_front_of(view: TargetDepth, seen: Floats, depth: Doubles) -> Doubles:
    """The membrane's depth, nowhere behind the surface that is felt.

    The lattice's cells end at the middles of the outermost pixels that show the object: the membrane falls away from
    there, half a pixel before the object's edge.
    """
    return np.where(view.contact, np.minimum(depth, seen), depth)


def _touch(
    view: TargetDepth, target: SensorSpec, image: Image | Floats, surface: Floats, contact: Mask, notes: list[str]
) -> GeneratedTouch:
    here = np.arange(contact.size, dtype=np.int32).reshape(contact.shape)
    source: Indices = np.where(view.source_index >= 0, here, np.int32(-1))
    return GeneratedTouch(
        image=image, camera=target.camera, source_index=freeze(source), in_view=view.in_view,
        membrane=replace(_membrane(target, surface, contact), error=view.error), notes=tuple(notes),
    )  # fmt: skip


def _membrane(target: SensorSpec, surface: Floats, contact: Mask) -> DepthMap:
    return DepthMap(
        indentation_mm=freeze(surface),
        depth_mm=freeze((target.rest_depth_mm - surface).astype(np.float32)),
        contact=freeze(contact),
        camera=target.camera,
        source_index=make_pixel_index(contact.shape),
    )


def _at_border(mask: Mask) -> bool:
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())
