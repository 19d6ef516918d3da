"""Which streams of a container are a sensor's: by their names, their sizes, and what the user
says.
"""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from pipeline.core.errors import FileProblem, SettingProblem, UnknownSensor
from pipeline.io import open_recording
from pipeline.io.gel_streams import names_touch
from pipeline.io.inspection.recording_report import inspect_recording
from pipeline.translation.translate import Request, open_translation
from tests.pipeline.io.mcap_files import raw, write_ros

# rows and columns
DIGIT = (320, 240)
GELSLIM = (320, 427)
WEBCAM = (480, 640)


def write(path, **topics):
    """Three images of a size per topic."""

    def messages(shape):
        ramp = np.linspace(40, 200, shape[1])[None, :, None] * np.array([1.0, 0.7, 0.5])
        image = np.broadcast_to(ramp, (*shape, 3)).astype(np.uint8)
        return [(10**9 + k * 10**8, raw(image, 10**9 + k * 10**8)) for k in range(3)]

    return write_ros(path, {f"/{name}": messages(shape) for name, shape in topics.items()})


def list_sensors(path, **options):
    with closing(open_recording(path, **options)) as recording:
        return {s.name: s.sensor for s in recording.streams}


def open_stream(path, **request):
    with closing(
        open_translation(Request(recording=path, target="soft_bubble", **request))
    ) as opened:
        return opened.stream.name, opened.source.name, opened.stream.frame(0).sensor


def test_a_stated_sensor_selects_its_stream_and_renames_no_other(tmp_path):
    path = write(tmp_path / "a.mcap", digit=DIGIT, gelslim=GELSLIM)
    assert list_sensors(path, sensor="gelslim") == {"digit": "digit", "gelslim": "gelslim"}
    assert open_stream(path, source="gelslim") == ("gelslim", "gelslim", "gelslim")
    assert open_stream(path, source="digit") == ("digit", "digit", "digit")
    with pytest.raises(
        SettingProblem, match=r"no stream 'gelsight_mini'.*'digit' of digit, 'gelslim' of gelslim"
    ):
        open_stream(path, source="gelsight_mini")


def test_a_stated_sensor_names_those_of_its_size_that_name_none(tmp_path):
    path = write(tmp_path / "a.mcap", tactile_left=GELSLIM, tactile_right=DIGIT)
    assert open_stream(path, source="gelslim_dotless") == (
        "tactile_left",
        "gelslim_dotless",
        "gelslim_dotless",
    )
    assert list_sensors(path, sensor="gelslim_dotless")["tactile_right"] == "digit"


def test_a_named_stream_is_of_the_sensor_that_the_user_says(tmp_path):
    path = write(tmp_path / "a.mcap", digit=DIGIT, camera=GELSLIM)
    assert open_stream(path, source="gelslim", stream="/camera") == ("camera", "gelslim", "gelslim")
    assert list_sensors(path, sensor="gelslim", stream="digit")["digit"] == "gelslim"


def test_a_camera_without_touch_is_never_taken_by_default(tmp_path):
    path = write(tmp_path / "a.mcap", camera=GELSLIM, digit=DIGIT)
    assert list_sensors(path) == {"digit": "digit"}
    assert open_stream(path) == ("digit", "digit", "digit")
    lone = write(tmp_path / "b.mcap", camera=GELSLIM)
    with pytest.raises(UnknownSensor):
        open_stream(lone)
    assert open_stream(lone, source="gelslim")[1] == "gelslim"
    cameras = write(tmp_path / "c.mcap", camera_a=WEBCAM, camera_b=WEBCAM)
    with pytest.raises(SettingProblem, match="--stream"):
        open_stream(cameras, source="gelslim")
    assert open_stream(cameras, source="gelslim", stream="camera_b")[:2] == ("camera_b", "gelslim")


@pytest.mark.parametrize(
    ("name", "is_touch"),
    [
        ("observation.images.tactile_left", True),
        ("leftTactile", True),
        ("digit2", True),
        ("left/gelL", True),
        ("gelsight_mini/image", True),
        ("rightDigit", True),
        ("touch", True),
        ("bubble/depth", True),
        ("soft_bubble", True),
        ("angel/image", False),
        ("digital_camera", False),
        ("touchscreen", False),
        ("wrist", False),
        ("top", False),
        ("camera/color/image_raw", False),
    ],
)
def test_names_of_touch(name, is_touch):
    assert names_touch(name) == is_touch


def test_previews_of_earlier_versions_are_no_sensors(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="tactoscope previews")
        writer.finish()
    with pytest.raises(FileProblem, match="previews"):
        open_recording(tmp_path / "a.mcap")


def test_inspect_reports_the_stream_that_is_named(tmp_path):
    path = write(tmp_path / "a.mcap", digit=DIGIT, gelslim=GELSLIM)
    assert [s.name for s in inspect_recording(path, stream="gelslim").streams] == ["gelslim"]
