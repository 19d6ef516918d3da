"""What mends a recording that does not open, or a touch that misses the target: buttons with the
error or warning.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from app.align.ball_calibration import ask_calibration
from app.document.evaluator import EvaluatedFrame
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.export.export import ExportController
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
from pipeline.views.view import to_xyz
from widgets.style.notification_bar import Choice, NotificationBar


class MendingController(Feature):
    """Finds what mends an error or a warning, and offers what else a recording holds."""

    def __init__(self, controller: SessionController, export: ExportController) -> None:
        super().__init__(controller)
        self._export = export
        self.notification = NotificationBar("mending_notification")
        self._window.add_notification(self.notification)
        self._offered: Translation | None = None  # whose offers were made
        self._shown: set[Path | None] = set()  # recordings of which a frame was on screen
        controller.find_remedies = self.find_remedies
        # alignment of other sensors that is not used any more
        self._dropped: AlignmentMismatch | None = None
        controller.opening_cancelled.connect(self._offer_opening)
        controller.alignment_dropped.connect(self._remember_dropped)

    def find_remedies(self, error: BaseException) -> tuple[Choice, ...]:
        """Buttons that mend an error.

        () where only the file itself can be mended and nothing else was open.
        """
        if not isinstance(error, TouchError):
            return ()
        controller = self._controller
        remedies: list[Choice] = []
        if isinstance(error, UnknownSensor | SensorMismatch):
            choose = partial(controller.change, "choose source", stream="")
            sensors = list_sensor_titles().items()
            entries = [(title, partial(choose, source=name)) for name, title in sensors]
            remedies.append(("Choose sensor…", entries))
        if isinstance(error, MissingReference):
            actions = [self._actions[command.name] for command in REFERENCE_COMMANDS]
            entries = [(one.text(), one.trigger) for one in actions if one.isEnabled()]
            remedies.append(("Choose reference…", entries))
        if isinstance(error, UnitProblem):
            remedies += [
                (
                    f"Open in {dialogs.UNIT_NAMES[unit]}",
                    partial(controller.open_mesh, error.path, unit),
                )
                for unit in error.fits
            ]
        failed = controller.failed_session
        if isinstance(error, AlignmentMismatch) and error.field == "target":
            with_target = replace(failed, target=error.target)
            back = partial(controller.push_session, with_target, "choose target")
            remedies.append((f"Target {load_sensor(error.target).title}", back))
        if isinstance(error, FileProblem) and error.path == failed.alignment is not None:
            without = failed.with_updates(alignment=None)
            back = partial(controller.push_session, without, "use no alignment")
            remedies.append(("Without this alignment", back))
        meshes = error.alternatives
        if meshes and all(path.suffix.lower() in dialogs.MESH_SUFFIXES for path in meshes):
            entries = [(path.name, partial(self._open_mesh, path)) for path in meshes]
            remedies.append((f"Which of {len(meshes)} meshes", entries))
        if self._translation is None:
            remedies += self._offer_return()
        return tuple(remedies)

    def show_session(self) -> None:
        """Drop the offers for another recording."""
        if self._session.alignment is not None:
            self._dropped = None
        if self._offered is not None and self._offered.request.recording != self._session.recording:
            self._offered = None
            self.notification.hide()

    def _remember_dropped(self, dropped: AlignmentMismatch) -> None:
        """Say at the next frame on screen that an alignment is not used."""
        self._dropped = dropped
        self._offered = None

    def _offer_opening(self) -> None:
        """Offer to go on with an opening that was cancelled."""
        recording = self._session.recording
        if recording is not None:
            again: Choice = "Open again", self._controller.refresh
            self.notification.show_notification(
                f"the opening of {recording.name} was cancelled",
                (again, *self._offer_return()),
                stays=True,
            )

    def _open_mesh(self, path: Path) -> None:
        """Open a mesh for the recording that was open before the folder of meshes, or for the
        next one.
        """
        before = self._find_previous()
        if before is None:
            self._change("open mesh", recording=None, mesh=path, mesh_unit="auto")
        else:
            self._controller.undo_stack.setIndex(before[0])
            self._controller.open_mesh(path)

    def _offer_return(self) -> list[Choice]:
        """Offer the last recording that was open before the one that does not open."""
        before = self._find_previous()
        go_back = self._controller.undo_stack.setIndex
        return [(f"Return to {before[1].name}", partial(go_back, before[0]))] if before else []

    def _find_previous(self) -> tuple[int, Path] | None:
        """Return undo index and recording of the last session with another recording that was on
        screen.
        """
        stack = self._controller.undo_stack
        sessions = list_sessions(stack)
        for index in range(stack.index() - 1, -1, -1):
            recording = sessions[index].recording
            if recording in self._shown - {self._session.recording} and recording is not None:
                return index, recording
        return None

    def show_frame(self) -> None:
        """Offer remedies for the warnings of the frame on screen, and once what else its
        recording holds.
        """
        opened = self._translation
        latest = self._controller.latest_frame
        if opened is None or latest is None:
            return
        warnings = [warning for result in latest.results.values() for warning in result.warnings]
        remedies: list[Choice] = []
        if any(isinstance(warning, AlignmentWarning) for warning in warnings):
            remedies.append(("Centre the touch", self.centre_touch))
        if any(isinstance(warning, CalibrationWarning) for warning in warnings):
            ask = partial(ask_calibration, self._controller, self._export)
            remedies.append(("Calibrate here…", ask))
        self._controller.remedies = remedies
        self._controller.remedies_changed.emit()
        if self._offered is None or self._offered.request.recording != opened.request.recording:
            self._offered = opened
            self._shown.add(opened.request.recording)
            self._offer_contents(opened)

    def _offer_contents(self, opened: Translation) -> None:
        """Offer the targets that the recording holds, and the one before."""
        sentences: list[str] = []
        offered: list[str] = []  # targets
        source, target = opened.source.name, opened.target
        held = [stream.sensor for stream in opened.recording.streams]
        own = [sensor for sensor in held if sensor not in ("", source)]
        if own and target.name not in own:
            titles = " and ".join(load_sensor(sensor).title for sensor in own)
            sentences.append(
                f"the recording holds touches of {titles}, the target is {target.title}"
            )
            offered += own
        old = self._controller.previous_target
        if old not in ("", target.name, source, *own):
            sentences.append(f"the target is {target.title} now")
            offered.append(old)
        self._controller.previous_target = ""
        change = self._controller.change
        choices: list[Choice] = [
            (f"Target {load_sensor(name).title}", partial(change, "choose target", target=name))
            for name in offered
        ]
        dropped = self._dropped
        if dropped is not None:
            sentences.append(f"the alignment {dropped.path.name} is of other sensors and not used")
            use = partial(change, "use alignment", alignment=dropped.path, target=dropped.target)
            if dropped.source == source:
                choices.append(("Use it again", use))
            elif dropped.source in held:
                use = partial(use, source=dropped.source, stream="")
                choices.append(("Use it again", use))
        if sentences:
            self.notification.show_notification(
                "; ".join(sentences), choices, stays=dropped is not None
            )

    def centre_touch(self) -> None:
        """Move the alignment so that the touch of the frame on screen lies in the middle of the
        target.
        """
        from pipeline.translation.alignment.nudge import compute_centring_offset_mm

        opened = self._translation
        latest = self._controller.latest_frame
        cloud, indentation_mm = _get_touch(latest)
        if opened is None or cloud is None:
            return
        offsets = self._session.offsets
        by_mm = compute_centring_offset_mm(cloud, indentation_mm, opened.target)
        moved = replace(offsets, translation_mm=to_xyz(by_mm + offsets.translation_mm))
        self._change("centre touch", offsets=moved)


def _get_touch(latest: EvaluatedFrame | None) -> tuple[Cloud | None, float]:
    """Return the cloud of a frame, None without one, and how far the source was pushed in, mm."""
    outputs = {} if latest is None else {n: r.output for n, r in latest.results.items()}
    cloud, depth = outputs.get("cloud"), outputs.get("depth")
    if isinstance(cloud, Cloud) and isinstance(depth, DepthMap) and depth.contact.any():
        return cloud, float(depth.indentation_mm[depth.contact].max())
    return None, 0.0
