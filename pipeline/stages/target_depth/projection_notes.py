"""Notes and warnings of the target depth stage."""

from pipeline.core.arrays import Floats
from pipeline.core.errors import AlignmentWarning, StageWarning
from pipeline.core.geometry.camera import MIN_DEPTH_MM
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.target_depth.rasterisation import Rasterisation

_MANY = 0.05  # share of points outside the image from which on it is a warning


def note_visibility(
    rasterisation: Rasterisation, n_inside: int, points_mm: Floats
) -> tuple[str, ...]:
    """How much of the touch is inside the target's image."""
    n = len(points_mm)
    n_outside = len(points_mm) - n_inside
    if n_outside == n:
        behind = bool((points_mm[:, 2] <= MIN_DEPTH_MM).all())
        where = (
            "behind the target's camera; check the rotation of the alignment"
            if behind
            else "outside the target's image"
        )
        return (AlignmentWarning(f"the target depth is empty: the whole touch lies {where}"),)
    text = f"{n_outside:,} of {n:,} points fall outside the target's image"
    notes: tuple[str, ...] = (
        (StageWarning(text) if n_outside > _MANY * n else text,) if n_outside else ()
    )
    if not rasterisation.n_drawn_px:
        notes += (
            StageWarning(
                "the target depth is empty: no part of the touch could be drawn; check the depth "
                "limits"
            ),
        )
    return notes


def note_shared_pixels(n_inside: int, n_drawn: int) -> tuple[str, ...]:
    """Points that the splat lost to nearer ones."""
    if n_drawn == n_inside:
        return ()
    return (f"{n_inside - n_drawn:,} of {n_inside:,} points share a pixel with a nearer one",)


def note_omitted_triangles(
    rasterisation: Rasterisation, jump_mm: float, grazing_deg: float, n_hidden: int
) -> tuple[str, ...]:
    """What the surface omits."""
    from pipeline.stages.target_depth import triangle_batch_kernels as kernels

    counts = rasterisation.triangle_counts
    jump, grazing, behind = (
        int(counts[k]) for k in (kernels.JUMP, kernels.GRAZING, kernels.BEHIND)
    )
    notes: list[str] = []
    if jump:
        notes.append(f"{jump:,} triangles across depth jumps above {jump_mm:g} mm were omitted")
    if grazing:
        hiding = (
            f" and hide what lies behind them in {rasterisation.n_veiled_px:,} pixels"
            if rasterisation.n_veiled_px
            else ""
        )
        notes.append(
            f"{grazing:,} triangles seen at more than {grazing_deg:g} degrees were omitted{hiding}"
        )
    if behind:
        notes.append(f"{behind:,} triangles reach behind the target's camera and were omitted")
    if counts[kernels.OVERFULL]:
        text = (
            f"the surface overlaps itself more than {kernels.MAX_LAYERS} times: "
            f"{int(counts[kernels.OVERFULL]):,} "
            "triangles were omitted; check the depth and the alignment"
        )
        notes.append(StageWarning(text))
    if counts[kernels.FLIPPED] > counts[kernels.DRAWN]:
        notes.append(
            StageWarning("the surface is seen from behind; check the rotation of the alignment")
        )
    if rasterisation.is_point_splat:
        notes.append("the touch is smaller than a target pixel: drawn as points")
    if n_hidden:
        notes.append(f"{n_hidden:,} points are hidden behind nearer ones")
    return tuple(notes)


def note_contact(
    target: SensorSpec, *, n_drawn: int, n_contact: int, gap_mm: float, deepest_mm: float
) -> tuple[str, ...]:
    """Whether and how far the touch indents the target's membrane.

    `gap_mm` is the distance without contact.
    """
    if n_drawn == 0:
        return ()
    if n_contact == 0:
        text = (
            f"the touch ends {gap_mm:.2g} mm before the target's membrane: there is no "
            "contact; correct the alignment"
        )
        return (AlignmentWarning(text),)
    notes: list[str] = []
    if n_contact < n_drawn:
        notes.append(
            f"{n_drawn - n_contact:,} of {n_drawn:,} pixels do not reach the target's membrane"
        )
    if deepest_mm > target.limits.indentation_max_mm:
        limit_mm = target.limits.indentation_max_mm
        notes.append(
            StageWarning(
                f"pushed in by up to {deepest_mm:.2f} mm, beyond the {limit_mm:g} mm of "
                f"{target.name}"
            )
        )
    return tuple(notes)
