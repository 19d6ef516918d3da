"""Physical render: the touch that the target sensor would record, by simulation.

The target depth says where the object is, but only where the source measured it. A gel is pressed
onto those points as an elastic layer and rendered by the sensor's optics; a bubble is a slack
membrane over them, observed by its depth camera. Elsewhere the membrane is free.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Floats, Image, Indices, Mask, freeze
from pipeline.core.errors import (
    AlignmentWarning,
    OutsideViewWarning,
    SettingProblem,
    ShapeError,
    StageWarning,
    UnseenObjectWarning,
    describe_no_contact,
)
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import MIN_DEPTH_MM
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import (
    GeneratedTouch,
    SealedMembrane,
    TargetDepth,
    make_depth_map,
    make_pixel_index,
)
from pipeline.physics import bubble, gel, lattice, optics
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable
from pipeline.sensors.spec import SensorSpec

_REFERENCE = "the target's reference image"
_MISSED = (
    f"{_REFERENCE}: by the alignment, the source's touch does not reach the target; "
    "correct the alignment"
)

_MAX_CLIPPED_SHARE = 0.02  # share of clipped pixels from which on there is a warning
# Of 48 held-out grasps 13 mm deep physics is worse than the mean touch on 25; these limits mark all
# of them where the source touches at all. On training objects 4 and 6 mm deep it is better wherever
# the contact leaves the view.
_DEEP_MM = 8.0  # indentation of a bubble from which on what lies outside the source's view counts
# Indentation over the radius of the contact from which on the object's flanks count: a free
# membrane of 45 to 60 mm leaves such a contact at 40 degrees (indentation over radius times the log
# of both radii's ratio); most objects are flatter. Chosen on a ball 4 mm deep; of 162 others 4 to 8
# mm deep it marks 27 of 32 that lose to the mean touch.
_NARROW_RATIO = 2.5


@frozen
class PhysicalRenderParams:
    """Settings of the simulation."""

    add_noise: bool = setting(
        False,
        "Sensor noise",
        help="add the target sensor's noise to the image",
        source="sensor description",
    )
    seed: int = setting(
        0,
        "Seed",
        low=0,
        high=2**31 - 1,
        step=1,
        help="random seed of the noise",
        source="PCG64: O'Neill 2014 (numpy)",
        sweep=tuple(range(8)),
    )
    contact_gap_mm: float = setting(
        0.1,
        "Contact gap",
        unit="mm",
        low=0.0,
        high=2.0,
        step=0.05,
        help="gap below which a bubble's membrane counts as touching; bridges depth noise",
        source="obstacle problem: Kinderlehrer and Stampacchia 1980",
    )
    tolerance_um: float = setting(
        0.5,
        "Solver tolerance",
        unit="um",
        low=0.01,
        high=50.0,
        step=0.1,
        help="tolerance of the surface in contact",
        source="truncated multigrid: Graeser and Kornhuber 2009",
    )


def render_touch(
    view: TargetDepth,
    target: SensorSpec,
    params: PhysicalRenderParams,
    progress: Progress = SILENT,
    *,
    start: SealedMembrane | None = None,
) -> GeneratedTouch:
    """Simulate what `target` would record of `view`, a bubble's membrane from a `start` near by.

    Raises ShapeError for a view of another image size.
    """
    reference_touch = skip_without_contact(view, target)
    if reference_touch is not None:
        return reference_touch
    view, gap_notes = _drop_invalid_pixels(view)
    reference_touch = skip_without_contact(view, target)
    if reference_touch is not None:
        return replace(reference_touch, notes=(*gap_notes, *reference_touch.notes))
    progress.step(0.0, "pressing the target's membrane")
    depth_limited, limit_notes = _limit_indentation(view, target)
    render = TOUCH_RENDERERS.get(target.sensor_kind)
    if render is None:
        raise SettingProblem(
            f"the physical render has no model of sensors of kind {target.kind!r} such as "
            f"{target.name}"
        )
    touch = render(view, depth_limited, target, start, params, [*gap_notes, *limit_notes])
    progress.step(1.0, "pressed")
    return touch


def skip_without_contact(
    view: TargetDepth, target: SensorSpec, *_: object
) -> GeneratedTouch | None:
    """The reference touch if the view has no contact, else None, whatever else a method reads.

    Cached per sensor.
    """
    if view.contact.shape != target.camera.shape:
        raise ShapeError(
            f"the target view must have the shape {target.camera.shape} of {target.name}, got "
            f"{view.contact.shape}"
        )
    if view.contact.any():
        return None
    touch = make_reference_touch(target)
    is_missed = any(isinstance(note, AlignmentWarning) for note in view.notes)
    notes = (_MISSED,) if is_missed else _describe_no_contact(target, view.notes)
    return replace(
        touch, in_view=view.in_view, notes=touch.notes if notes == touch.notes else notes
    )


def make_reference_touch(target: SensorSpec) -> GeneratedTouch:
    """The target's reference image as a touch."""
    shape = target.camera.shape
    rest_membrane = make_depth_map(
        target.rest_depth_mm, np.zeros(shape, np.float32), np.zeros(shape, np.bool_), target.camera
    )
    return GeneratedTouch(
        image=render_reference(target),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)),
        membrane=rest_membrane,
        notes=_describe_no_contact(target, ()),
    )


def _describe_no_contact(target: SensorSpec, notes: tuple[str, ...]) -> tuple[str, ...]:
    """The note of a touch whose source has no contact; `notes` are those of the target depth."""
    farther = "; a bubble that reaches farther than the source may touch already"
    return (
        describe_no_contact(
            _REFERENCE, notes, farther if target.sensor_kind.is_depth else " is exact"
        ),
    )


def _drop_invalid_pixels(view: TargetDepth) -> tuple[TargetDepth, list[str]]:
    """The view without invalid pixels: contact that is not indented, depth behind the camera,
    NaN.
    """
    # false for NaN as well
    usable = view.contact & (view.indentation_mm >= 0) & (view.indentation_mm < np.inf)
    surface_depth = (view.depth_mm > MIN_DEPTH_MM) & (view.depth_mm < np.inf)
    n_lost = int(np.count_nonzero(view.contact) - np.count_nonzero(usable))
    if not n_lost and not (np.isfinite(view.depth_mm) & ~surface_depth).any():
        return view, []
    depth: Floats = np.where(surface_depth, view.depth_mm, np.float32(np.nan))
    indentation: Floats = np.where(usable, view.indentation_mm, np.float32(0.0))
    notes = (
        [f"{n_lost:,} contact pixels of the target depth have no valid depth and were left out"]
        if n_lost
        else []
    )
    return replace(
        view, contact=usable, depth_mm=freeze(depth), indentation_mm=freeze(indentation)
    ), notes


def _limit_indentation(view: TargetDepth, target: SensorSpec) -> tuple[Floats, list[str]]:
    """The view's indentation limited to the sensor's maximum, with a warning."""
    limit = target.limits.indentation_max_mm
    too_deep = view.contact & (view.indentation_mm > limit)
    if not too_deep.any():
        return view.indentation_mm, []
    deepest = float(view.indentation_mm[too_deep].max())
    note = StageWarning(
        f"{int(too_deep.sum())} of {int(view.contact.sum())} contact pixels lie up to "
        f"{deepest:.2f} mm deep and were "
        f"cut at the {limit:g} mm that {target.title} can be pressed"
    )
    return np.minimum(view.indentation_mm, np.float32(limit)), [note]


def render_gel_touch(
    view: TargetDepth,
    indentation_mm: Floats,
    target: SensorSpec,
    _start: SealedMembrane | None,
    params: PhysicalRenderParams,
    notes: list[str],
) -> GeneratedTouch:
    """Simulate a gel pressed by the view, its image and membrane."""
    if target.gel is None:
        raise SettingProblem(f"{target.name} has no gel: its description lacks [gel]")
    # An object at the image border continues outside: the pad is larger than the camera's view.
    is_cut = view.contact[[0, -1]].any() or view.contact[:, [0, -1]].any()
    margin = int(np.ceil(target.gel.thickness_mm / target.pixel_mm)) if is_cut else 0
    mask = np.pad(view.contact, margin, mode="edge")
    padded = np.pad(indentation_mm, margin, mode="edge")
    solution = gel.press_gel(
        target.gel,
        target.pixel_mm,
        np.where(mask, padded, -np.inf),
        tolerance_mm=1e-3 * params.tolerance_um,
    )
    rows, cols = target.camera.shape
    inner = (slice(margin, margin + rows), slice(margin, margin + cols))
    surface: Floats = np.ascontiguousarray(solution.indentation_mm[inner])
    if not solution.converged:
        text = (
            "the gel solver did not converge: the surface is only accurate to "
            f"{1e3 * solution.residual_mm:.1f} um"
        )
        notes.append(StageWarning(text))
    image: Image = optics.render(target, surface, seed=params.seed if params.add_noise else None)
    clipped = float(((image == 0) | (image == 255)).any(axis=2).mean())
    if clipped > _MAX_CLIPPED_SHARE:
        notes.append(
            StageWarning(
                f"{clipped:.0%} of the image is clipped: its true brightness is outside the "
                "camera's range"
            )
        )
    contact: Mask = np.ascontiguousarray(solution.contact[inner])
    return _make_touch(view, target, image, surface, contact, notes)


def render_bubble_touch(
    view: TargetDepth,
    indentation_mm: Floats,
    target: SensorSpec,
    start: SealedMembrane | None,
    params: PhysicalRenderParams,
    notes: list[str],
) -> GeneratedTouch:
    """Simulate a bubble pressed by the view, its depth image and membrane."""
    if target.bubble is None:
        raise SettingProblem(f"{target.name} has no membrane: its description lacks [bubble]")
    on = bubble.make_lattice(target.bubble)
    surface_depth = np.where(view.contact, target.rest_depth_mm - indentation_mm, view.depth_mm)
    ceiling = bubble.compute_ceiling_from_depth(target, surface_depth, on)
    solution = bubble.press_bubble(
        target.bubble, ceiling, on, tolerance_mm=1e-3 * params.tolerance_um, start=start
    )
    if solution.is_followed:
        notes.append("the membrane is followed from the previous touch's")
    if not solution.converged:
        notes.append(
            StageWarning(
                "the bubble's air pressure did not converge: the shape outside the contact is "
                "inaccurate"
            )
        )
    # Lattice cells end at the centres of the object's outermost pixels, so the membrane falls off
    # half a pixel early: it is nowhere behind the measured surface.
    depth = bubble.compute_depth_from_deviation(target, solution.deviation_mm, on)
    depth = np.where(view.contact, np.minimum(depth, surface_depth), depth)
    touching = lattice.sample_mask_at_pixels(target.camera, solution.contact, on, depth)
    # On a noisy surface the contact force acts on noise peaks only: pixels within the gap are
    # added.
    with np.errstate(invalid="ignore"):
        contact = touching | (view.contact & (surface_depth - depth <= params.contact_gap_mm))
    notes.append(
        f"air pressure {target.bubble.pressure_kpa:.2f} -> {solution.pressure_kpa:.2f} kPa"
    )
    notes.extend(warn_of_unseen_object(view, target))
    image = bubble.simulate_depth_frame(target, depth, params.seed if params.add_noise else None)
    surface = (target.rest_depth_mm - depth).astype(np.float32)
    touch = _make_touch(view, target, image, surface, contact, notes)
    near = freeze(solution.deviation_mm.astype(np.float32))  # half the memory
    return replace(touch, pressed=replace(solution.sealed, deviation_mm=near))


def warn_of_unseen_object(view: TargetDepth, target: SensorSpec) -> tuple[UnseenObjectWarning, ...]:
    """Warnings where a bubble touches more of the object than the source measured.

    A deep touch that leaves the source's view goes on outside; behind a narrow contact the object
    is wider.
    """
    deepest_mm = float(view.indentation_mm.max(initial=0.0))
    pressed = f"{target.title} is pressed in by {deepest_mm:.0f} mm"
    warnings: list[UnseenObjectWarning] = []
    if deepest_mm > _DEEP_MM and _reaches_edge(view.contact, view.in_view):
        warnings.append(
            OutsideViewWarning(
                f"the touch leaves the source's view, and {pressed}: what it touches outside is "
                "missing, errors there "
                "are several mm; use T2D2 or T2T"
            )
        )
    radius_mm = float(np.sqrt(view.contact.sum() / np.pi)) * target.pixel_mm
    if deepest_mm > _NARROW_RATIO * radius_mm:
        warnings.append(
            UnseenObjectWarning(
                f"the contact is {2.0 * radius_mm:.1f} mm wide, and {pressed}: the object behind "
                "the contact is not "
                "measured, errors in contact are up to several mm"
            )
        )
    return tuple(warnings)


def _reaches_edge(contact: Mask, in_view: Mask) -> bool:
    """Whether a contact ends at the edge of the view inside the target's image."""
    import cv2

    outside = cv2.dilate((~in_view).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return bool((contact & outside).any())


def trace_source_pixels(view: TargetDepth) -> Indices:
    """(rows, cols) -> pixel of the target depth where the source measured something, else -1."""
    own = make_pixel_index(view.contact.shape)
    return freeze(np.where(view.source_index >= 0, own, np.int32(-1)))


def _make_touch(
    view: TargetDepth,
    target: SensorSpec,
    image: Image | Floats,
    surface: Floats,
    contact: Mask,
    notes: list[str],
) -> GeneratedTouch:
    membrane = make_depth_map(target.rest_depth_mm, surface, contact, target.camera)
    return GeneratedTouch(
        image=image,
        camera=target.camera,
        source_index=trace_source_pixels(view),
        in_view=view.in_view,
        membrane=replace(membrane, error=view.error),
        notes=tuple(notes),
    )


# (target depth, its indentation_mm within the sensor's limit, target, start, parameters, notes so
# far) -> touch
RenderTouch = Callable[
    [TargetDepth, Floats, SensorSpec, SealedMembrane | None, PhysicalRenderParams, list[str]],
    GeneratedTouch,
]
TOUCH_RENDERERS: KindTable[RenderTouch] = KindTable(
    {GelSensor: render_gel_touch, BubbleSensor: render_bubble_touch}
)
