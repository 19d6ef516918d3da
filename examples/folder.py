"""A folder of images: every touch in it, with what may be wrong."""

import sys
from pathlib import Path

import cv2

import tactoscope as ts

FOLDER = "touches"  # with image files, and one without contact whose name says "reference"

if not Path(FOLDER).is_dir():
    sys.exit(f"put images of a DIGIT into the folder {FOLDER!r} first, one of them reference.png")
with ts.open(FOLDER, "gelslim", source="digit") as touches:
    for note in touches.notes:
        print(f"note: {note}")
    for frame in touches:
        print(f"{frame.source.origin}: {frame.depth.contact.mean():.1%} of the pixels touch")
        pixels = frame.preview("touch").pixels  # RGB; frame.touch.image of a bubble is in mm
        cv2.imwrite(f"{FOLDER}_{frame.index:04}.png", pixels[..., ::-1])
    written = len(touches)
