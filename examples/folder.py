"""A folder of images: every touch in it, with what may be wrong."""

import cv2

import tactoscope as ts

FOLDER = "touches"  # with image files, and one without contact whose name says "reference"

with ts.open(FOLDER, "gelslim", source="digit") as touches:
    for note in touches.notes:
        print(f"note: {note}")
    for frame in touches:
        print(f"{frame.source.origin}: {frame.depth.contact.mean():.1%} of the pixels touch")
        cv2.imwrite(f"{FOLDER}_{frame.index:04}.png", frame.touch.image[..., ::-1])
    written = len(touches)
