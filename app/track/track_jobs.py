"""Tracks for the window, on a background thread: from a session or a folder to rows and 3D
layers.
"""

import time
from pathlib import Path

import numpy as np

from app.document.requests import apply_session, make_request, open_request
from app.session.state import Session
from app.window.jobs import JobReporter
from pipeline.core.arrays import Doubles, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.lab.tracking.track_record import TrackRecord, TrackRow, read_record
from pipeline.lab.tracking.track_recording import track_recording
from pipeline.translation.catalogue import Catalogue
from pipeline.views.colours import OBJECT_COLOUR, REGISTERED_POINT_COLOUR, repeat_colour
from pipeline.views.layers import Layer, ViewBounds, make_lines_layer, make_mesh_layer
from pipeline.views.view import to_xyz

_REPORT_INTERVAL_S = 0.3  # between deliveries of the rows so far
_MARGIN = 1.1
_LEAST_RADIUS_MM = 1.0


@frozen
class TrackView:
    """A track, and how its surface and path look in 3D."""

    record: TrackRecord
    layers: tuple[Layer, ...]
    bounds: ViewBounds | None  # None where there is nothing to see
    path_mm: Doubles  # (frames, 3) of the sensor on the object, NaN where unknown


def track_session(
    session: Session, stage: str, catalogue: Catalogue, report: JobReporter
) -> TrackView:
    """Track a session's recording by the depth of a stage, delivering the rows so far.

    Raises TouchError.
    """
    rows: list[TrackRow] = []
    delivered_s = time.monotonic()

    def add_row(row: TrackRow) -> None:
        nonlocal delivered_s
        rows.append(row)
        if time.monotonic() - delivered_s >= _REPORT_INTERVAL_S:
            delivered_s = time.monotonic()
            report.deliver(tuple(rows))

    report.step(0.0, "opening the recording")
    with open_request(make_request(session), catalogue) as opened:
        return make_view(
            track_recording(
                apply_session(session, opened), stage, range(opened.n_frames), report, add_row
            )
        )


def read_track(folder: Path) -> TrackView:
    """Read a track from the folder that it was written to; raises FileProblem."""
    return make_view(read_record(folder))


def make_view(record: TrackRecord) -> TrackView:
    """Return the fused surface, and the path of the sensor's axis on it, of the first part of a
    track.
    """
    patch = record.patch
    depth_mm = 0.0 if patch is None else float(np.median(patch.vertices_mm[:, 2]))
    path = np.full((len(record.rows), 3), np.nan)
    for k, row in enumerate(record.rows):
        pose = row.sensor_from_start if row.part == 0 else None
        if pose is not None:
            path[k] = rigid.apply(rigid.invert(pose), (0.0, 0.0, depth_mm))
    layers = () if patch is None else (make_mesh_layer("patch", patch, OBJECT_COLOUR),)
    ends = np.stack([path[:-1], path[1:]], axis=1)
    ends = ends[np.isfinite(ends).all(axis=(1, 2))]
    if len(ends):
        colours = repeat_colour(REGISTERED_POINT_COLOUR, len(ends))
        layers += (make_lines_layer("path", ends.astype(np.float32), colours),)
    known = path[np.isfinite(path).all(axis=1)]
    points = known if patch is None else np.concatenate([known, patch.vertices_mm])
    bounds = None
    if len(points):
        low, high = points.min(axis=0), points.max(axis=0)
        radius = max(_LEAST_RADIUS_MM, 0.5 * _MARGIN * float(np.linalg.norm(high - low)))
        bounds = ViewBounds(centre_mm=to_xyz(0.5 * (low + high)), radius_mm=radius, frame="track")
    return TrackView(record=record, layers=layers, bounds=bounds, path_mm=freeze(path))
