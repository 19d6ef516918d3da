"""Which sensor a picture comes from, when the file does not say: by its size."""

from __future__ import annotations

from pipeline.sensors.spec import load_sensor as sensor_spec

# Sizes that only one of the described sensors has. A DIGIT held sideways looks like a Mini; its own driver turns it.
_BY_SIZE = {
    (320, 427): "gelslim", (320, 240): "digit", (240, 320): "gelsight_mini",
    (640, 480): "digit", (2464, 3280): "gelsight_mini",  # VGA as DIGIT's driver turns it; the Mini's whole camera
}  # fmt: skip
_ONE_OF = {(480, 640): "gelsight_mini, or digit on its side"}


def resolve_sensor_name(said: str, shape: tuple[int, int], *, is_depth: bool) -> tuple[str, tuple[str, ...]]:
    """(sensor, notes): `said` when it is a known sensor, else a guess from the image size, "" when nothing fits.

    Raises SettingProblem when `said` is not a sensor.
    """
    if said:
        return sensor_spec(said).name, ()
    rows, cols = shape
    if is_depth:
        why = "only the soft bubble records depth" if shape != (140, 175) else f"depth of {cols} x {rows} px"
        return "soft_bubble", (f"the file does not name its sensor; taken to be soft_bubble ({why})",)
    guess = _BY_SIZE.get(shape, "")
    if guess:
        return guess, (f"the file does not name its sensor; taken to be {guess} by its size of {cols} x {rows} px",)
    fits = f"may be {_ONE_OF[shape]}" if shape in _ONE_OF else "fits none"
    return "", (f"the file does not name its sensor, and {cols} x {rows} px {fits}; say which with --sensor",)
