"""What mends a recording that does not open, or a touch that misses the target: buttons with the
error or warning.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from app.align.ball_calibration import BallCalibrationController
from app.document.evaluator import EvaluatedFrame
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import Session
from app.session.undo import list_sessions
from app.window import dialogs
from app.window.actions import REFERENCE_COMMANDS
from pipeline.core.errors import (
    AlignmentWarning,
    CalibrationWarning,
    FileProblem,
    MissingReference,
    SensorMismatch,
    TouchError,
    UnknownSensor,
)
from pipeline.core.geometry.meshes import UnitProblem
from pipeline.core.values.results import Cloud, DepthMap
from pipeline.sensors.alignment import AlignmentMismatch
from pipeline.sensors.spec import list_sensor_titles, load_sensor
from pipeline.translation.translate import Translation
from widgets.style.notification_bar import Choice, NotificationBar


class MendingController(Feature):
    """Finds what mends an error or a warning, and offers what else a recording holds."""

    def __init__(
        self, controller: SessionController, calibration: BallCalibrationController
    ) -> None:
        super().__init__(controller)
        self._calibration = calibration
        self.notification = NotificationBar("mending_notification")
        self._window.add_notification(self.notification)
        self._offered: Translation | None = None  # whose offers were made
        self._shown: set[Path | None] = set()  # recordings of which a frame was on screen
        controller.find_remedies = self.find_remedies
        # alignment of other sensors that is not used any more
        self._dropped: AlignmentMismatch | None = None
        controller.opening_cancelled.connect(self._offer_opening)
        controller.alignment_dropped.connect(self._remember_dropped)
        controller.frame_shown.connect(self._show_frame)

    def find_remedies(self, error: BaseException) -> tuple[Choice, ...]:
        """Buttons that mend an error.

        () where only the file itself can be mended and nothing else was open.
        """
        remedies: list[Choice] = []
        if isinstance(error, UnknownSensor | SensorMismatch):
            remedies.append(("Choose sensor…", self._list_sensors()))
        if isinstance(error, MissingReference):
            choices = [self._window.actions_by_name[command.name] for command in REFERENCE_COMMANDS]
            remedies.append(
                (
                    "Choose reference…",
                    tuple((a.text(), a.trigger) for a in choices if a.isEnabled()),
                )
            )
        if isinstance(error, UnitProblem):
            open_in = partial(self._controller.open_mesh, error.path)
            remedies += [
                (f"Open in {dialogs.UNIT_NAMES[unit]}", partial(open_in, unit))
                for unit in error.fits
            ]
        failed = self._controller.failed_session
        if isinstance(error, AlignmentMismatch) and error.field == "target":
            with_target = replace(failed, target=error.target)
            remedies.append(
                (
                    f"Target {load_sensor(error.target).title}",
                    self._restore("choose target", with_target),
                )
            )
        if (
            isinstance(error, FileProblem)
            and failed.alignment is not None
            and error.path == failed.alignment
        ):
            without = failed.with_updates(alignment=None)
            remedies.append(("Without this alignment", self._restore("use no alignment", without)))
        if isinstance(error, TouchError) and _are_meshes(error.alternatives):
            remedies.append(self._offer_meshes(error.alternatives))
        if isinstance(error, TouchError) and self._controller.views.translation is None:
            remedies += self._offer_return()
        return tuple(remedies)

    def show_session(self, session: Session) -> None:
        """Drop the offers for another recording."""
        if session.alignment is not None:
            self._dropped = None
        if self._offered is not None and self._offered.request.recording != session.recording:
            self._offered = None
            self.notification.hide()

    def _restore(self, text: str, session: Session) -> Callable[[], None]:
        return lambda: self._controller.push_session(session, text)

    def _remember_dropped(self, dropped: AlignmentMismatch) -> None:
        """Say at the next frame on screen that an alignment is not used."""
        self._dropped = dropped
        self._offered = None

    def _offer_opening(self) -> None:
        """Offer to go on with an opening that was cancelled."""
        recording = self._controller.session.recording
        if recording is not None:
            choices: list[Choice] = [
                ("Open again", self._controller.refresh),
                *self._offer_return(),
            ]
            self.notification.show_notification(
                f"the opening of {recording.name} was cancelled", choices, stays=True
            )

    def _list_sensors(self) -> tuple[tuple[str, Callable[[], object]], ...]:
        change = self._controller.change
        return tuple(
            (title, partial(change, "choose source", source=name, stream=""))
            for name, title in list_sensor_titles().items()
        )

    def _offer_meshes(self, paths: tuple[Path, ...]) -> Choice:
        return f"Which of {len(paths)} meshes", tuple(
            (p.name, partial(self._open_mesh, p)) for p in paths
        )

    def _open_mesh(self, path: Path) -> None:
        """Open a mesh for the recording that was open before the folder of meshes, or for the
        next one.
        """
        before = self._find_previous()
        if before is None:
            self._controller.change("open mesh", recording=None, mesh=path, mesh_unit="auto")
        else:
            self._controller.undo_stack.setIndex(before[0])
            self._controller.open_mesh(path)

    def _offer_return(self) -> list[Choice]:
        """Offer the last recording that was open before the one that does not open."""
        before = self._find_previous()
        if before is None:
            return []
        index, recording = before
        return [
            (f"Return to {recording.name}", partial(self._controller.undo_stack.setIndex, index))
        ]

    def _find_previous(self) -> tuple[int, Path] | None:
        """Return undo index and recording of the last session with another recording that was on
        screen.
        """
        stack = self._controller.undo_stack
        now = self._controller.session.recording
        for index, session in reversed(list(enumerate(list_sessions(stack)[: stack.index()]))):
            if session.recording is not None and session.recording in self._shown - {now}:
                return index, session.recording
        return None

    def _show_frame(self, _index: int) -> None:
        """Offer remedies for the warnings of the frame on screen, and once what else its
        recording holds.
        """
        opened = self._controller.views.translation
        latest = self._controller.latest_frame
        if opened is None or latest is None:
            return
        warnings = [warning for result in latest.results.values() for warning in result.warnings]
        remedies: list[Choice] = []
        if any(isinstance(warning, AlignmentWarning) for warning in warnings):
            remedies.append(("Centre the touch", self.centre_touch))
        if any(isinstance(warning, CalibrationWarning) for warning in warnings):
            remedies.append(("Calibrate here…", self._calibration.ask))
        self._controller.remedies = remedies
        self._controller.remedies_changed.emit()
        if self._offered is None or self._offered.request.recording != opened.request.recording:
            self._offered = opened
            self._shown.add(opened.request.recording)
            self._offer_contents(opened)

    def _offer_contents(self, opened: Translation) -> None:
        """Offer the targets that the recording holds, and the one before."""
        choices: list[Choice] = []
        sentences: list[str] = []
        name = opened.target.name
        own = [
            s.sensor for s in opened.recording.streams if s.sensor not in ("", opened.source.name)
        ]
        if own and name not in own:
            titles = [load_sensor(sensor).title for sensor in own]
            sentences.append(
                f"the recording holds touches of {' and '.join(titles)}, the target is "
                f"{opened.target.title}"
            )
            choices += [
                (f"Target {title}", self._make_change("choose target", target=sensor))
                for sensor, title in zip(own, titles, strict=True)
            ]
        old = self._controller.previous_target
        if old not in ("", name, opened.source.name) and old not in own:
            sentences.append(f"the target is {opened.target.title} now")
            choices.append(
                (f"Target {load_sensor(old).title}", self._make_change("choose target", target=old))
            )
        self._controller.previous_target = ""
        if self._dropped is not None:
            sentences.append(
                f"the alignment {self._dropped.path.name} is of other sensors and not used"
            )
            choices += self._offer_dropped(self._dropped, opened)
        if sentences:
            self.notification.show_notification(
                "; ".join(sentences), choices, stays=self._dropped is not None
            )

    def _offer_dropped(self, dropped: AlignmentMismatch, opened: Translation) -> list[Choice]:
        """Offer the alignment where the recording holds its source."""
        fields: dict[str, Any] = {"alignment": dropped.path, "target": dropped.target}
        if dropped.source != opened.source.name:
            if dropped.source not in {stream.sensor for stream in opened.recording.streams}:
                return []
            fields |= {"source": dropped.source, "stream": ""}
        return [("Use it again", self._make_change("use alignment", **fields))]

    def _make_change(self, text: str, **fields: Any) -> Callable[[], None]:
        return lambda: self._controller.change(text, **fields)

    def centre_touch(self) -> None:
        """Move the alignment so that the touch of the frame on screen lies in the middle of the
        target.
        """
        from pipeline.translation.alignment.nudge import compute_centring_offset_mm

        opened = self._controller.views.translation
        latest = self._controller.latest_frame
        cloud, indentation_mm = _get_touch(latest)
        if opened is None or cloud is None:
            return
        offsets = self._controller.session.offsets
        moved = (
            compute_centring_offset_mm(cloud, indentation_mm, opened.target)
            + offsets.translation_mm
        )
        x, y, z = (float(value) for value in moved)
        self._controller.change("centre touch", offsets=replace(offsets, translation_mm=(x, y, z)))


def _are_meshes(paths: tuple[Path, ...]) -> bool:
    return bool(paths) and all(path.suffix.lower() in dialogs.MESH_SUFFIXES for path in paths)


def _get_touch(latest: EvaluatedFrame | None) -> tuple[Cloud | None, float]:
    """Return the cloud of a frame, None without one, and how far the source was pushed in, mm."""
    results = {} if latest is None else latest.results
    cloud, depth = (
        results[name].output if name in results else None for name in ("cloud", "depth")
    )
    if not isinstance(cloud, Cloud) or not isinstance(depth, DepthMap) or not depth.contact.any():
        return None, 0.0
    return cloud, float(depth.indentation_mm[depth.contact].max())
