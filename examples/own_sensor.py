"""An own sensor: a TOML file that says what differs from a known one.

Lengths and units are checked.
"""

from pathlib import Path

import tactoscope as ts

Path("mine.toml").write_text(
    """
    extends = "digit"
    title = "My DIGIT"
    [gel]
    thickness = { value = 1.5, unit = "mm", from = "caliper" }
    youngs = { value = 90.0, unit = "kPa", from = "softer silicone", assumed = true }
    """
)
sensor = ts.load_sensor("mine.toml")
print(f"{sensor.title}: {sensor.camera.shape} pixels of {sensor.pixel_mm:.3f} mm")

with ts.open(
    "sample_data/recordings/first_touch.h5", target="mine.toml", source="gelslim"
) as touches:
    print(f"generated {touches[5].touch.image.shape} for {touches.target.name}")
