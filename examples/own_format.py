"""An own file format: a reader of a few lines, and files of it open like all others."""

from pathlib import Path

import numpy as np

import tactoscope as ts


def read(path: Path) -> ts.Recording:
    """Frames of 320 x 240 RGB bytes one after the other; the first is without contact."""
    images = np.fromfile(path, np.uint8).reshape(-1, 320, 240, 3)
    return ts.make_recording(images[1:], images[0], ts.load_sensor("digit"), path=path)


words = {"key": "bytes", "title": "Bytes"}
ts.register_format(ts.RecordingFormat(**words, suffixes=(".rgb",), reader=read))
frame = ts.open_recording("sample_data/recordings/first_touch.h5").stream("digit").frame(5)
Path("touch.rgb").write_bytes(frame.reference.tobytes() + frame.image.tobytes())
with ts.open("touch.rgb", target="gelslim") as touches:
    print(len(touches), touches.source.title, touches[0].depth.contact.sum(), "px in contact")
