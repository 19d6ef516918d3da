"""The sensor of an image, guessed from its size or the names of the files where these do not
state it.
"""

import re
from collections.abc import Sequence

from pipeline.core.arrays import describe_size
from pipeline.sensors.spec import list_sensor_names, load_sensor

# (rows, cols) of only one described sensor. A DIGIT on its side looks like a Mini; its driver
# rotates the image.
_BY_SIZE = {
    (320, 427): "gelslim",
    (320, 240): "digit",
    (240, 320): "gelsight_mini",
    # VGA as DIGIT's driver rotates it; the Mini's full image
    (640, 480): "digit",
    (2464, 3280): "gelsight_mini",
}
_AMBIGUOUS = {(480, 640): "gelsight_mini, or digit on its side"}


def resolve_sensor_name(
    sensor: str, shape: tuple[int, int], *, is_depth: bool, file_names: Sequence[str] = ()
) -> tuple[str, tuple[str, ...]]:
    """(sensor, notes): `sensor` if stated, else a guess, "" where none fits.

    The guess is by the image size (rows, cols), else by a sensor's name as a word in all
    `file_names`. Raises SettingProblem for an unknown sensor.
    """
    if sensor:
        return load_sensor(sensor).name, ()
    size = describe_size(shape)
    unnamed = "the file does not name its sensor"
    if is_depth:
        why = f"depth of {size}" if shape == (140, 175) else "only the soft bubble records depth"
        return "soft_bubble", (f"{unnamed}; taken to be soft_bubble ({why})",)
    guess = _BY_SIZE.get(shape, "")
    if guess:
        return guess, (f"{unnamed}; taken to be {guess} by its size of {size}",)
    named = find_named_sensor(file_names)
    if named:
        return named, (f"taken to be {named}, which the names of the files hold",)
    fits = f"may be {_AMBIGUOUS[shape]}" if shape in _AMBIGUOUS else "fits none"
    return "", (f"{unnamed}, and {size} {fits}; say which with --sensor",)


def find_named_sensor(file_names: Sequence[str]) -> str:
    """The sensor whose name is a word of all file names, the longest where several are.

    "" for none.
    """
    words = {
        name: re.compile(rf"(?<![a-z0-9]){re.escape(name)}(?![a-z0-9])", re.IGNORECASE)
        for name in list_sensor_names()
    }
    named = [
        name
        for name, word in words.items()
        if file_names and all(word.search(one) for one in file_names)
    ]
    return max(named, key=len, default="")
