"""What every result promises, whatever came in."""

from __future__ import annotations

import warnings

import numpy as np

from pipeline.core.errors import TouchError
from pipeline.core.geometry import rigid
from pipeline.core.graph import Fallback
from tests.stability.rows import count_answer


def outcome(stage, *inputs):
    """(result, "") or (None, the sentence of a TouchError).

    Any other exception is a finding and goes on.

    Sentences are counted, those of a fallback too: a row bounds their share. numpy's warnings are
    let pass, as in the app: what counts is what comes out.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            result = stage(*inputs)
    except TouchError as error:
        count_answer(refused=True)
        message = str(error)
        assert message
        assert "\n" not in message
        return None, message
    is_fallback = isinstance(result, Fallback)
    assert not is_fallback or result.reason
    count_answer(refused=is_fallback)
    return result, ""


def sound(result) -> None:
    """Assert what the type of `result` promises of its values."""
    {
        "DepthMap": _depth_map,
        "Cloud": _cloud,
        "TargetDepth": _view,
        "GeneratedTouch": _touch,
        "ObjectPose": _pose,
    }[type(result).__name__](result)
    assert all(isinstance(note, str) and "nan" not in note.lower().split() for note in result.notes)


def _depth_map(d) -> None:
    shape = d.camera.shape
    assert (
        d.indentation_mm.shape
        == d.depth_mm.shape
        == d.contact.shape
        == d.source_index.shape
        == shape
    )
    assert d.indentation_mm.dtype == d.depth_mm.dtype == np.float32
    known = np.isfinite(d.depth_mm)
    assert not np.isinf(d.depth_mm).any()
    assert not np.isinf(d.indentation_mm).any()
    assert (known[d.contact]).all(), "contact where there is no depth"
    assert np.isfinite(d.indentation_mm[d.contact]).all(), "contact where there is no indentation"
    assert (np.isfinite(d.indentation_mm) | ~known).all(), "depth without indentation"


def _cloud(c) -> None:
    n = len(c.points_mm)
    assert c.points_mm.shape == (n, 3)
    assert c.points_mm.dtype == np.float32
    assert np.isfinite(c.points_mm).all(), "a point that is nowhere"
    assert np.isfinite(c.field_of_view_mm).all(), "a window without corners"
    assert c.source_index.shape == (n,)
    assert (np.diff(c.source_index) > 0).all()
    assert (
        n == 0 or 0 <= c.source_index[0] <= c.source_index[-1] < c.grid_shape[0] * c.grid_shape[1]
    )


def _view(v) -> None:
    shape = v.camera.shape
    assert (
        v.depth_mm.shape
        == v.contact.shape
        == v.indentation_mm.shape
        == v.source_index.shape
        == v.in_view.shape
        == shape
    )
    assert v.depth_mm.dtype == v.indentation_mm.dtype == np.float32
    seen = v.source_index >= 0
    assert np.array_equal(np.isfinite(v.depth_mm), seen), (
        "depth where no source is, or none where one is"
    )
    assert not np.isinf(v.depth_mm).any()
    assert (v.depth_mm[seen] > 0).all(), "something behind the camera"
    assert (seen[v.contact]).all(), "contact where nothing is seen"
    assert np.isfinite(v.indentation_mm).all()
    assert (v.indentation_mm >= 0).all()
    assert not v.indentation_mm[~v.contact].any()


def _touch(t) -> None:
    shape = t.camera.shape
    m = t.membrane
    assert (
        t.image.shape[:2]
        == m.indentation_mm.shape
        == m.depth_mm.shape
        == m.contact.shape
        == t.in_view.shape
        == shape
    )
    assert np.isfinite(m.indentation_mm).all(), "a membrane without a place"
    assert np.isfinite(m.depth_mm).all()
    assert t.image.dtype == np.uint8 if t.image.ndim == 3 else not np.isinf(t.image).any()


def _pose(p) -> None:
    assert np.isfinite(p.scene_mm).all()
    assert p.scene_mm.shape == (len(p.source_index), 3)
    if p.sensor_from_object is None:
        assert p.notes, "no pose, and no word of why"
        assert p.covariance is None
        assert p.observable is None
        return
    rigid.validate_rigid(p.sensor_from_object, "the pose")
    if p.covariance is None:  # a network and ICP say nothing of it
        assert p.observable is None
        return
    assert np.isfinite(p.covariance).all()
    assert np.linalg.eigvalsh(0.5 * (p.covariance + p.covariance.T)).min() > 0
    assert np.abs(p.observable @ p.observable - p.observable).max() < 1e-6 * (
        1 + np.abs(p.observable).max() ** 2
    )
    assert 0 <= p.fitness <= 1
    assert np.isfinite(p.rmse_mm)
