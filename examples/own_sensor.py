"""An own sensor: a TOML file that says what differs from a known one, each number with its unit."""

from pathlib import Path

import tactoscope as ts

Path("mine.toml").write_text(
    """
    extends = "digit"
    title = "My gel"
    [image]
    rows = { value = 480, unit = "px", from = "camera" }
    cols = { value = 640, unit = "px", from = "camera" }
    [camera]
    fx = { value = 540.0, unit = "px", from = "640 px see 26 mm of the gel, 22 mm away" }
    fy = { value = 540.0, unit = "px", from = "square pixels" }
    cx = { value = 319.5, unit = "px", from = "image centre" }
    cy = { value = 239.5, unit = "px", from = "image centre" }
    [gel]
    thickness = { value = 1.5, unit = "mm", from = "caliper" }
    """
)
with ts.open("sample_data/recordings/first_touch.h5", "mine.toml", source="gelslim") as touches:
    sensor = touches.target
    print(f"{sensor.title}: {touches[5].touch.image.shape}, pixels of {sensor.pixel_mm:.3f} mm")
