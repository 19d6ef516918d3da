"""Page of the *Track* layout: how the touched object moves over the frames, and its fused
surface in 3D.
"""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QLabel, QWidget

from pipeline.lab.tracking.track_record import MOTION, TrackRecord, TrackRow
from widgets.style.base import ChoiceBox
from widgets.style.plots import Strip, StripPlot
from widgets.style.run_bar import StartBar
from widgets.style.styling import (
    make_bold,
    make_column,
    make_command_button,
    make_row,
    make_splitter,
    make_text,
    name_widget,
)
from widgets.views.view_3d_panel import View3DPanel

_PLOT_SIZE = 620  # of 1000
_STRIPS = (  # title, curves (field of a row, and its name), least span: noise does not fill a strip
    ("translation, mm", tuple(zip(MOTION[:3], "xyz", strict=True)), 0.1),
    ("rotation, °", tuple(zip(MOTION[3:], "xyz", strict=True)), 0.5),
    ("predicted uncertainty, mm", (("std_mm", ""),), 0.1),
    ("", (("agreement", "inliers"), ("overlap", "overlap")), 1.0),
)


class TrackPlot(StripPlot):
    """One strip per quantity over the frames.

    A click, a drag of the cursor or an arrow key chooses a frame.
    """

    preferred_px = (560, 380)
    across = "frame"

    def __init__(self) -> None:
        super().__init__("track_plot", "motion of the object over the frames")
        self.setToolTip(
            "Motion since the first frame; red: lost, grey: no contact, triangles: key frames"
        )
        self.rows: tuple[TrackRow, ...] = ()

    def show_track(self, rows: Sequence[TrackRow], key_frames: Sequence[int]) -> None:
        """Show these frames, and which are key frames."""
        self.rows = tuple(rows)
        strips = [
            Strip(
                title=title,
                curves=[(name, [getattr(row, field) for row in rows]) for field, name in curves],
                has_axis_colours=len(curves) == 3,
                least_span=span,
            )
            for title, curves, span in _STRIPS
        ]
        self.show_strips(
            strips if rows else (),
            [str(row.frame) for row in rows],
            marks=[k for k, row in enumerate(rows) if row.frame in key_frames],
            bands=[
                (k, k, row.state == "lost") for k, row in enumerate(rows) if row.state != "tracked"
            ],
        )


class TrackPage(QWidget):
    """Stage and start over a sentence over plot and surface."""

    def __init__(self) -> None:
        super().__init__()
        self.stage_box = ChoiceBox("tracked_stage", "touch to follow")
        self.run_bar = StartBar("track", "Track")
        self.plot = TrackPlot()
        self.scene = View3DPanel()
        self.sentence = make_bold(make_text())
        self.stage_box.setToolTip(
            "Membrane to follow: the source's, or that of the generated touch"
        )
        self.sentence.setTextFormat(Qt.TextFormat.PlainText)
        self.scene.view.setAccessibleName("touched surface")
        self.scene.view.setMinimumSize(220, 160)
        self.scene.caption.set_texts("sensor frame of the first frame, mm")
        self._head = make_row(6, QLabel("follow"), self.stage_box, self.run_bar, 1)
        split = make_splitter(Qt.Orientation.Horizontal, (self.plot, 1), (self.scene, 1))
        name_widget(split, "track_split")
        split.setSizes([_PLOT_SIZE, 1000 - _PLOT_SIZE])
        make_column(4, self._head, self.sentence, (split, 1), around_px=(6, 4, 6, 2), on=self)
        self.clear("")

    def add_command(self, action: QAction) -> None:
        """Add a command to the controls."""
        self._head.addWidget(make_command_button(action))

    def offer_stages(self, stages: Mapping[str, str]) -> None:
        """Offer name -> title of the stages whose membrane can be followed."""
        self.run_bar.start_button.setEnabled(bool(stages))
        self.stage_box.offer(stages)

    def show_record(self, record: TrackRecord, name: str) -> None:
        """Show a track and its summary."""
        self.plot.show_track(record.rows, record.key_frames)
        self.sentence.setText(f"{name}: {describe_record(record)}")
        self.scene.legend.setText(
            "fused surface and the sensor's path on it" if record.patch is not None else ""
        )
        self.scene.setVisible(record.patch is not None)

    def clear(self, text: str) -> None:
        """Show no track, and why."""
        self.plot.show_track((), ())
        self.sentence.setText(text)
        self.scene.hide()


def describe_record(record: TrackRecord) -> str:
    """Return the counts of a track, its drift, and what was not measured."""
    counts = [
        f"{record.count('tracked')} of {len(record.rows)} frames tracked",
        f"{record.count('lost')} lost",
        f"{record.count('no contact')} without contact",
    ]
    counts += [f"{len(record.problems)} not read"] if record.problems else []
    counts += [f"{record.n_parts} parts"] if record.n_parts > 1 else []
    counts += [f"key frames: {len(record.key_frames)}", f"closed loops: {record.n_loops}"]
    text = ", ".join(counts)
    if record.error is not None:
        text += (
            f"; largest error {record.error.drift_mm:.3f} mm and {record.error.drift_deg:.2f}° "
            "over "
            f"{record.error.path_mm:.1f} mm and {record.error.turned_deg:.0f}°"
        )
    if record.weak_directions:
        text += f"; not measured in some frames: {', '.join(record.weak_directions[:3])}"
    return text
