"""Depth by Depth Anything V2: what becomes of a network's answers, whichever network it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.core.graph import Skipped
from pipeline.core.progress import SILENT
from pipeline.stages.depth import photometric
from pipeline.stages.depth.depth_anything import DepthAnythingParams, estimate_depth
from pipeline.stages.networks.depth_anything import DepthAnything
from pipeline.translation.translate import Request, open_translation

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
TOUCH = 5


class KnownAnswer:
    """Answers by what a function says of the picture; keeps what it was shown."""

    answer = "metric"
    largest_mm = 1.6
    side = 56
    image_content = "image"

    def __init__(self, says, contact=None):
        self._says = says
        self._contact = contact
        self.shown = []

    def __call__(self, picture, whole, sense):
        self.shown.append((tuple(picture.shape), whole, sense))
        contact = None if self._contact is None else self._contact(picture)
        return self._says(picture), contact


@pytest.fixture(scope="module")
def opened():
    made = open_translation(Request(recording=SAMPLE, source="digit", target="gelslim"))
    yield made
    made.recording.close()


@pytest.fixture(scope="module")
def frame(opened):
    return opened.stream.frame(TOUCH)


@pytest.fixture(scope="module")
def physical(opened, frame):
    return photometric.estimate_depth(frame, opened.source, None, photometric.DepthParams())


def asked(opened, frame, network, **params):
    return estimate_depth(
        frame, opened.source, None, network, DepthAnythingParams(**params), SILENT
    )


def half(picture):
    return torch.full((1, *picture.shape[-2:]), 0.5)


def test_a_metric_output_becomes_an_indentation_on_the_frames_pixels(opened, frame, physical):
    network = KnownAnswer(half, contact=lambda picture: half(picture) - 0.25)
    found = asked(opened, frame, network)
    assert found.indentation_mm.shape == frame.image.shape[:2]
    np.testing.assert_allclose(found.indentation_mm, 0.8, atol=1e-6)
    np.testing.assert_allclose(
        found.depth_mm + found.indentation_mm,
        physical.depth_mm + physical.indentation_mm,
        atol=1e-5,
    )
    assert found.contact.all()
    rows, cols = frame.image.shape[:2]
    shape, _, sense = network.shown[0]
    assert min(shape[2:]) == 56
    assert shape[2] / shape[3] == pytest.approx(rows / cols, rel=0.13)
    assert sense == "metric"
    assert asked(opened, frame, network, largest_mm=3.0).indentation_mm.max() == pytest.approx(1.5)
    asked(opened, frame, network, shorter_side_px=84)
    assert min(network.shown[-1][0][2:]) == 84


def test_without_a_contact_head_the_sensors_limit_defines_contact(opened, frame):
    found = asked(
        opened,
        frame,
        KnownAnswer(lambda p: torch.linspace(0, 1, p.shape[-1]).expand(1, *p.shape[-2:])),
    )
    assert np.array_equal(found.contact, found.indentation_mm > opened.source.limits.contact_min_mm)
    assert any("predict no contact" in note for note in found.notes)


def test_a_relative_output_is_fitted_to_the_physical_estimate(opened, frame, physical):
    small = torch.nn.functional.interpolate(
        torch.from_numpy(physical.indentation_mm.copy())[None, None], (70, 56)
    )[0]

    def predict_ramp(picture, sign=1.0):
        return torch.nn.functional.interpolate(
            7.0 + sign * 30.0 * small[None], picture.shape[-2:], mode="bilinear"
        )[0]

    network = KnownAnswer(predict_ramp)
    network.answer = "relative"
    found = asked(opened, frame, network)
    off = np.abs(found.indentation_mm - physical.indentation_mm)
    assert off[physical.contact].mean() < 0.15 * physical.indentation_mm[physical.contact].mean()
    assert any("no unit" in note for note in found.notes)
    turned = KnownAnswer(lambda picture: predict_ramp(picture, -1.0))
    against = asked(opened, frame, turned, output_kind="relative")
    assert turned.shown[0][2] == "relative"
    assert not against.indentation_mm.any()
    assert any("decreases" in note for note in against.notes)


def test_an_untouched_frame_is_skipped(opened, frame):
    network = KnownAnswer(half)
    still = asked(opened, replace(frame, image=frame.reference), network)
    assert isinstance(still, Skipped)
    assert not network.shown


def test_a_users_file_is_loaded_and_a_foreign_one_gives_the_reason(opened, tmp_path):
    torch.manual_seed(0)
    net = DepthAnything(encoder="vits", contact=False)
    torch.save(net.half().state_dict(), tmp_path / "depth_anything_v2_vits.pth")

    def first(file):
        request = Request(
            recording=SAMPLE,
            source="digit",
            target="gelslim",
            methods=(("depth", "depth_anything"),),
            weights=() if file is None else (("", file),),
        )
        made = open_translation(request)
        try:
            return made.with_(stage="depth", shorter_side_px=28)[TOUCH].result("depth").notes[0]
        finally:
            made.recording.close()

    assert first(tmp_path / "depth_anything_v2_vits.pth").startswith(
        "Depth Anything V2 saw 42x28 pixels, 6 patches"
    )
    assert "weights of Depth Anything V2 are shipped" in first(None)
    (tmp_path / "x.pth").write_bytes(b"nothing")
    assert first(tmp_path / "x.pth").startswith("physics: no network for this sensor; ")
