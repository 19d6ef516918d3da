"""A small recording with a touch in it, and a window on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PyQt6.QtWidgets import QApplication

from app.main import prepare_environment
from pipeline.core.arrays import freeze
from pipeline.core.values.frames import TactileFrame
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.sensors.spec import load_sensor

prepare_environment()

from app.document.session_controller import SessionController  # noqa: E402 - the environment comes first
from app.frames import frame_ranking  # noqa: E402
from app.main import show_window  # noqa: E402
from app.session.state import Session  # noqa: E402
from app.shell.tour import wait_until_shown  # noqa: E402
from widgets.style.theme import use_palette  # noqa: E402

N_FRAMES = 3
RANKING_DELAY_MS = frame_ranking._DELAY_MS


def bubble_frames() -> list[TactileFrame]:
    """A bubble untouched, then pressed by a ball of 15 mm radius, deeper and deeper."""
    spec = load_sensor("soft_bubble")
    rest = spec.rest_depth_mm
    points = spec.camera.back_project(rest)
    from_axis_mm = np.hypot(points[..., 0], points[..., 1])
    frames: list[TactileFrame] = []
    for index in range(N_FRAMES):
        ball = (
            float(rest.max())
            - 4.0 * index
            + 15.0
            - np.sqrt(np.maximum(15.0**2 - from_axis_mm**2, 0.0))
        )
        pressed = np.where(from_axis_mm < 15.0, np.minimum(rest, ball), rest) if index else rest
        frames.append(
            TactileFrame(
                sensor="soft_bubble",
                image=freeze(pressed.astype(np.float32)),
                reference=freeze(rest.astype(np.float32)),
                index=index,
                time_s=0.1 * index,
            )
        )
    return frames


@pytest.fixture(scope="session")
def touch_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording as a file."""
    path = tmp_path_factory.mktemp("recording") / "pressed.h5"
    with RecordingWriter(path) as writer:
        for frame in bubble_frames():
            writer.append("bubble", frame)
    return path


@pytest.fixture(scope="session")
def ball_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball of 15 mm radius as .obj, in mm: a twenty-sided one is enough where its pose is not
    judged.
    """
    import pyvista as pv

    path = tmp_path_factory.mktemp("mesh") / "ball.obj"
    ball = pv.Icosahedron(radius=15.0)
    corners = [f"v {x} {y} {z}" for x, y, z in ball.points]
    sides = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in ball.regular_faces]
    path.write_text("\n".join([*corners, *sides, ""]))
    return path


@pytest.fixture(scope="module", autouse=True)
def frames_computed_once(request: pytest.FixtureRequest) -> Iterator[None]:
    """Frames that many windows show are computed once, and those that none shows not at all.

    A module with `AS_USERS_HAVE_IT` has windows that do and hold everything.
    """
    if getattr(request.module, "AS_USERS_HAVE_IT", False):
        yield
        return
    request.getfixturevalue("shared_results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame_ranking, "_DELAY_MS", 10**8)
        yield


@pytest.fixture(autouse=True)
def ranking_where_asked(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of tests marked `ranks_frames` compute all frames of a recording, as they do."""
    if request.node.get_closest_marker("ranks_frames") is not None:
        monkeypatch.setattr(frame_ranking, "_DELAY_MS", RANKING_DELAY_MS)


@pytest.fixture(autouse=True)
def remembered_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the program remembers between two starts, of its own for every test."""
    from PyQt6.QtCore import QSettings

    folder = tmp_path / "remembered"
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    QSettings.setPath(QSettings.Format.IniFormat, QSettings.Scope.UserScope, str(folder))
    return folder


@pytest.fixture
def open_window(qtbot) -> Iterator[Callable[..., SessionController]]:
    """Opens windows without 3D unless asked, and closes them."""
    made: list[SessionController] = []

    def open_one(
        recording: Path | None = None, *, gl: bool = False, **session
    ) -> SessionController:
        controller = show_window(Session(recording=recording, **session), with_scene=gl)
        made.append(controller)
        # asks about nothing then
        qtbot.addWidget(controller.window, before_close_func=lambda _: controller.close())
        return controller

    font = QApplication.font()
    yield open_one
    for controller in made:
        controller.close()
        controller.window.close()
    use_palette(dark=False)  # of other tests
    QApplication.setFont(font)


@pytest.fixture
def bubble_window(open_window, touch_file) -> SessionController:
    """A window on frame 2 of the recording, through all stages."""
    controller = open_window(touch_file, target="gelslim", frame=2)
    assert wait_until_shown(controller, 240), controller.window.banner.text
    return controller
