"""What keeps a generated touch from being the true one: parts of it replaced by the truth, and what is left then.

    python benchmarks/touch_limits.py gelslim | soft_bubble [TOUCHES]

To a GelSlim from a bubble's reading: the physical render, smoothed, with the truth's coarse or fine part, or pressed on
nothing but what is really touched; and T2D2. To a bubble from a GelSlim's picture: T2T in one step as it is and falling
back to physics, with the truth in contact, near it, beyond it, in the source's view, beyond it, or at the border; the
truth itself shows what the depth camera's noise costs. Touches are those of unseen grasps and unseen tools; nothing is
chosen by them here.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.image_similarity import compute_similarity
from benchmarks.residual_diffusion import _described, _felt
from pipeline.engine.graph import Skipped
from pipeline.networks.network_factory import load_network
from pipeline.physics import bubble_camera, optics
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.sensors import alignment
from pipeline.simulation import shapes
from pipeline.stages.touch import physical_render, t2d2, t2t
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from pipeline.training.touch_pairs import place_nominal_sensors, simulate_touch_pair
from pipeline.values.frames import TactileFrame

SPLITS = {"unseen_grasps": ("training", 2), "unseen_tools": ("unseen", 4)}
NEAR_MM, BORDER_MM, COARSE_MM = 5.0, 6.0, 3.0


def measure(target: str = "gelslim", touches: str = "12") -> BenchmarkResult:
    ask = _to_gel if target == "gelslim" else _to_bubble
    notes = []
    for split in SPLITS:
        rows = ask(split, int(touches))
        notes.append(f"{split}: PSNR in dB, SSIM, error in contact and over all in mm")
        notes += [f"  {name}: " + _told(np.array(found)) for name, found in rows.items()]
    return BenchmarkResult(title=f"limits of touches of {target}", unit="mm", rows=(), notes=tuple(notes))


def _told(found: np.ndarray) -> str:
    squared, alike, contact, every = found.mean(0)
    return f"{-10 * math.log10(squared):.2f}, {alike:.4f}, {contact:.4f}, {every:.4f}"


def _smoothed(field, by_mm: float, pixel_mm: float):
    import cv2

    return np.asarray(cv2.GaussianBlur(np.asarray(field, np.float32), (0, 0), by_mm / pixel_mm), np.float32)


def _to_gel(split: str, touches: int) -> dict[str, list]:
    target, (group, grasps) = _described("gelslim"), SPLITS[split]
    net, px = load_network(t2d2.select_weights(target, target, None)), target.pixel_mm
    names = list(enumerate(shapes.list_shapes(group) * grasps))
    rows: dict[str, list] = {}
    for k, name in names[:: max(1, len(names) // touches)][:touches]:
        one = _felt("soft_bubble", "gelslim", name, k)
        if one is None:
            continue
        true, physics = (
            one.truth_mm,
            physical_render.render_touch(
                one.view, target, physical_render.PhysicalRenderParams()
            ).membrane.indentation_mm,
        )
        exact = replace(one.view, contact=one.view.contact & one.contact)
        made = {"untouched": 0 * true, "physics": physics}
        made |= {f"physics, smoothed by {s} mm": _smoothed(physics, s, px) for s in (0.2, 0.4, 0.8)}
        made |= {
            f"physics, the truth above {s} mm": physics + _smoothed(true - physics, s, px) for s in (0.4, 0.8, 1.6)
        }
        made |= {f"the truth, smoothed by {s} mm": _smoothed(true, s, px) for s in (0.2, 0.4, 0.8)}
        made["pressed where it is really touched"] = (
            physical_render.render_touch(exact, target, physical_render.PhysicalRenderParams()).membrane.indentation_mm
        )  # fmt: skip
        made["T2D2"] = t2d2.generate_touch(one.view, target, net, DiffusionParams()).membrane.indentation_mm
        for what, surface in made.items():
            picture = optics.render(target, np.ascontiguousarray(surface, np.float32), seed=None)
            _add(rows, what, picture, one.image, 255.0, surface, true, one.contact)
    return rows


def _to_bubble(split: str, touches: int) -> dict[str, list]:
    import cv2

    net, rows = None, {}
    for k in range(touches):
        touch = simulate_touch_pair(split, 7, k)
        if touch is None:
            continue
        gel, bubble = place_nominal_sensors(float(touch.deeper_mm[0]))
        net = net or load_network(t2t.select_weights(gel, bubble, None))
        still, between = optics.render_reference(gel), alignment.resolve_alignment(gel, bubble)
        image = np.clip(np.rint(still + touch.change_grey), 0, 255).astype(np.uint8)
        frame = TactileFrame(sensor=gel.name, image=image, reference=still)
        reads = frame, gel, None, between, bubble
        physical = t2t.render_from_frame(*reads, physical_render.PhysicalRenderParams())
        physical = physical.output if isinstance(physical, Skipped) else physical
        bold, careful = (
            t2t.generate_touch(*reads, net, DiffusionParams(confidence_weighting=c)).membrane.indentation_mm
            for c in (0.0, 1.0)
        )
        true, contact, known, px = touch.bubble_mm, touch.bubble_contact, physical.in_view, bubble.pixel_mm
        about = 2 * round(NEAR_MM / px) + 1
        near = cv2.dilate(contact.astype(np.uint8), np.ones((about, about), np.uint8)) > 0
        edge, wide = np.ones_like(contact), round(BORDER_MM / px)
        edge[wide:-wide, wide:-wide] = False
        made = {"physics": physical.membrane.indentation_mm, "T2T, caution 0": bold, "T2T": careful}
        parts = {"in contact": contact, f"within {NEAR_MM:g} mm of contact": near, "beyond that": ~near,
                 "in the view": known, "beyond the view": ~known, "at the border": edge}  # fmt: skip
        made |= {f"T2T, caution 0, the truth {name}": np.where(part, true, bold) for name, part in parts.items()}
        made[f"T2T, caution 0, the truth above {COARSE_MM:g} mm"] = bold + _smoothed(true - bold, COARSE_MM, px)
        made["the truth itself"] = true
        rest = bubble.rest_depth_mm
        reading = rest - bubble_camera.simulate_depth_frame(bubble, (rest - true).astype(np.float32), 2 * k)
        for name, surface in made.items():
            _add(rows, name, surface, reading, 22.5, surface, true, contact)
    return rows


def _add(rows, name, picture, recorded, span, surface, true, contact) -> None:
    one, other = np.asarray(picture, float), np.asarray(recorded, float)
    off = np.abs(surface - true)
    inside = off[contact].mean() if contact.any() else 0.0
    rows.setdefault(name, []).append(
        (((one - other) ** 2).mean() / span**2, compute_similarity(one, other, span), inside, off.mean())
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
