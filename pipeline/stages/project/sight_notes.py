"""What the project stage says about its view, in plain sentences."""

from __future__ import annotations

from pipeline.base.arrays import Floats
from pipeline.base.doubts import Doubt
from pipeline.geometry.camera import MIN_DEPTH_MM
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.project.drawing import Drawing

_MANY = 0.05  # of the points: fewer at the rim change little


def arrival(drawing: Drawing, n_inside: int, points_mm: Floats) -> tuple[str, ...]:
    """How much of the touch is in the target's image at all."""
    n, n_outside = len(points_mm), len(points_mm) - n_inside
    if n_outside == n:
        behind = bool((points_mm[:, 2] <= MIN_DEPTH_MM).all())
        where = "behind the target's camera; turn the alignment round" if behind else "outside the target's image"
        return (Doubt(f"nothing arrives: the whole touch lies {where}"),)
    told = f"{n_outside:,} of {n:,} points fall outside the target's image"
    notes: tuple[str, ...] = (Doubt(told) if n_outside > _MANY * n else told,) if n_outside else ()
    if not drawing.n_drawn:
        notes += (Doubt("nothing arrives: no part of the touch could be drawn"),)
    return notes


def points(n_inside: int, n_drawn: int) -> tuple[str, ...]:
    """What the splat lost."""
    if n_drawn == n_inside:
        return ()
    return (f"{n_inside - n_drawn:,} of {n_inside:,} points share a pixel with a nearer one",)


def triangles(drawing: Drawing, jump_mm: float, grazing_deg: float, n_hidden: int) -> tuple[str, ...]:
    """What the surface left out."""
    from pipeline.stages.project import desk_kernels as kernels

    counts = drawing.counts
    jump, grazing, behind = (int(counts[k]) for k in (kernels.JUMP, kernels.GRAZING, kernels.BEHIND))
    notes: list[str] = []
    if jump:
        notes.append(f"{jump:,} triangles over depth jumps above {jump_mm:g} mm were left out")
    if grazing:
        hiding = f" and hide what lies behind them in {drawing.n_veiled:,} pixels" if drawing.n_veiled else ""
        notes.append(f"{grazing:,} triangles seen at more than {grazing_deg:g} degrees were left out{hiding}")
    if behind:
        notes.append(f"{behind:,} triangles reach behind the target's camera and were left out")
    if counts[kernels.CROWDED]:
        told = (
            f"the touch lies over itself more than {kernels.LAYERS} times: {int(counts[kernels.CROWDED]):,} triangles "
            "were left out; check the depth and the alignment"
        )
        notes.append(Doubt(told))
    if counts[kernels.FLIPPED] > counts[kernels.KEPT]:
        notes.append(Doubt("the touch is seen from behind; check the rotation of the alignment"))
    if drawing.as_points:
        notes.append("the touch is smaller than a target pixel: drawn as points")
    if n_hidden:
        notes.append(f"{n_hidden:,} points hide behind nearer ones")
    return tuple(notes)


def reach(target: SensorSpec, *, n_drawn: int, n_contact: int, short_mm: float, deepest_mm: float) -> tuple[str, ...]:
    """Whether and how far what arrives pushes the target's membrane in; `short_mm` is what it lacks otherwise."""
    if n_drawn == 0:
        return ()
    if n_contact == 0:
        told = f"the touch does not reach the target's membrane by {short_mm:.2g} mm; move it closer in the alignment"
        return (Doubt(told),)
    notes: list[str] = []
    if n_contact < n_drawn:
        notes.append(f"{n_drawn - n_contact:,} of {n_drawn:,} pixels do not reach the target's membrane")
    if deepest_mm > target.limits.indentation_max_mm:
        limit_mm = target.limits.indentation_max_mm
        notes.append(Doubt(f"pushed in by up to {deepest_mm:.2f} mm, beyond the {limit_mm:g} mm of {target.name}"))
    return tuple(notes)
