"""A toy method, a toy stage and a toy route, made from outside: nothing of the project names
them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import Floats, Indices, freeze
from pipeline.core.graph import Method, Skipped
from pipeline.core.params import NoParams, setting
from pipeline.core.values.results import GeneratedTouch, make_pixel_index
from pipeline.stages.stage import Stage
from pipeline.translation.catalogue import BUILT_IN, VIEWS, Catalogue, Route
from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.layers import make_grid_layer
from pipeline.views.preview import Preview
from pipeline.views.view import ProbePoint, View


@dataclass(frozen=True, slots=True, kw_only=True)
class Brightness:
    """The toy stage's value."""

    share: Floats  # (rows, cols) 0..1
    source_index: Indices
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class MeltParams:
    """The toy method's parameters."""

    gain: float = setting(1.0, "Gain", low=0.0, high=2.0)


def brightness(frame, params, progress):
    share = (
        np.asarray(frame.image, np.float32).reshape(*frame.image.shape[:2], -1).mean(axis=-1)
        / 255.0
    )
    made = Brightness(share=freeze(share), source_index=make_pixel_index(share.shape))
    return Skipped(output=made, reason="it was dark") if not share.any() else made


def melt(brightness, target, params, progress):
    """A gel's picture that is as bright as the source's, which knows no membrane."""
    progress.step(0.5, "melting")
    rows, cols = target.camera.shape
    level = np.uint8(min(255.0, 255.0 * params.gain * float(brightness.share.mean())))
    return GeneratedTouch(
        image=freeze(np.full((rows, cols, 3), level, np.uint8)),
        camera=target.camera,
        source_index=freeze(np.full((rows, cols), -1, np.int32)),
        in_view=freeze(np.ones((rows, cols), bool)),
        notes=("melted",),
    )


_SCALE = ColourScale(colour_map="viridis", low=0.0, high=1.0, unit="", quantity="brightness")


def _picture(value, seen):
    return Preview(
        pixels=apply_colour_map(value.share, _SCALE),
        values=value.share,
        scale=_SCALE,
        frame_name=f"{seen.source.name} frame",
        caption="toy brightness",
    )


def _layers(value, seen, picture):
    rows, cols = np.indices(value.share.shape)
    return (
        make_grid_layer(
            "toy", np.stack([cols, rows, 9 * value.share], axis=-1).astype(np.float32), picture
        ),
    )


def _follow(value, before):
    row, col = divmod(before.index, value.share.shape[1])
    return ProbePoint(
        stage="brightness",
        index=before.index,
        row=row,
        col=col,
        text=f"{value.share[row, col]:.2f} bright",
    )


BRIGHTNESS = Stage(
    name="brightness",
    title="Brightness",
    sensor_role="source",
    methods=(
        Method(
            stage="brightness",
            name="mean",
            title="Mean",
            run=brightness,
            params=NoParams,
            reads=("frame",),
        ),
    ),
    compute_metrics=lambda value, facts: (
        {"contact_mae_mm": 0.0} if facts.source_truth is not None else {}
    ),
)
MELT = Method(
    stage="touch",
    name="melt",
    title="Melt",
    run=melt,
    params=MeltParams,
    reads=("brightness", "target"),
)
TOUCH = replace(BUILT_IN.stage("touch"), methods=(*BUILT_IN.stage("touch").methods, MELT))
SLOTS = [TOUCH if column.name == "touch" else column for column in BUILT_IN.stages]
TOYS = Catalogue(
    views={
        **VIEWS,
        "brightness": View(
            legend="a hill of light",
            make_preview=_picture,
            make_layers=_layers,
            trace_point=_follow,
        ),
    },
    stages=(SLOTS[0], BRIGHTNESS, *SLOTS[1:]),
    routes=(
        *BUILT_IN.routes,
        Route(
            name="toy",
            title="through brightness",
            methods={
                "brightness": "mean",
                "touch": "melt",
                "touch_depth": "from_image",
                "pose": "signed_distances",
            },
        ),
    ),
)
