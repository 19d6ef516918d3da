"""The commands about how two sensors stand to each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def score(
    recording: Path,
    *,
    target: str,
    sensor: str = "",
    alignment: Path | None = None,
    frames: str = "",
    truth: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Say how well touches agree with what the target really felt of them, and which axis matters.

    Parameters
    ----------
    recording
        A recording in which both sensors took part.
    target
        Sensor to carry touches to.
    sensor
        The sensor that they come from; the recording's first otherwise.
    alignment
        The .toml to judge; what the recording or the sensor descriptions say otherwise.
    frames
        Frames such as `0,3-7`; all otherwise.
    truth
        Compare the recording's exact depth and contact, not what the depth stage makes of the pictures.
    """
    from pipeline.cli.align import show_scores
    from pipeline.translation.translate import Request

    request = Request(recording=recording, target=target, source=sensor, alignment=alignment)
    return show_scores(request, frames, truth)


def refine(
    recording: Path,
    *,
    target: str,
    out: Path,
    sensor: str = "",
    alignment: Path | None = None,
    frames: str = "",
    hold_out: float = 0.2,
    into: Literal["alignment_from_source", "target_from_alignment"] = "target_from_alignment",
    tolerance: float = 1.0,
    truth: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Fit an alignment to many touches at once, say what they do not tell, and write it.

    Parameters
    ----------
    recording
        A recording in which both sensors took part.
    target
        Sensor to carry touches to.
    out
        The .toml to write.
    sensor
        The sensor that touches come from; the recording's first otherwise.
    alignment
        The .toml to begin with; what the recording or the sensor descriptions say otherwise.
    frames
        Frames such as `0,3-7`; all otherwise.
    hold_out
        Share of the touches that are not used, only judged before and after.
    into
        Which of the two transforms takes the change.
    tolerance
        Directions that the touches tell to no better than this times 0.2 mm or 1 degree are left as they were.
    truth
        Use the recording's exact depth and contact, not what the depth stage makes of the pictures.
    """
    from pipeline.cli.align import refine_alignment
    from pipeline.translation.translate import Request

    request = Request(recording=recording, target=target, source=sensor, alignment=alignment)
    return refine_alignment(request, out, frames, hold_out=hold_out, into=into, tolerance=tolerance, exact=truth)


def fit(
    pairs: Path,
    *,
    target: str,
    out: Path | None = None,
    sensor: str = "",
    use: int = 10,
    seed: int = 0,
    frames: str = "",
    source_tiles: str = "*_gelslim.png",
    target_tiles: str = "*_bubble_gt.png",
    truth: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Find how two sensors stand to each other from a few touches that both felt, without one to begin with.

    Parameters
    ----------
    pairs
        A recording in which both sensors took part, or a folder of tiles: difference pictures and imprints.
    target
        Sensor to carry touches to.
    out
        The .toml to write, where the pairs are metric; of tiles the map is only said.
    sensor
        The sensor that touches come from; a recording's first otherwise, gelslim for tiles.
    use
        How many pairs to fit to; the others are scored.
    seed
        Draws which.
    frames
        Frames of a recording such as `0,3-7`; all otherwise.
    source_tiles
        Names of the source's tiles; the `*` is the same word in both tiles of a pair.
    target_tiles
        Names of the target's tiles.
    truth
        Use the recording's exact depth and contact, not what the depth stage makes of the pictures.
    """
    from pipeline.cli.align_fit import fit_recording, fit_tiles, is_of_tiles
    from pipeline.translation.translate import Request

    if is_of_tiles(pairs, source_tiles):
        return fit_tiles(pairs, sensor or "gelslim", target, (source_tiles, target_tiles), use, seed)
    request = Request(recording=pairs, target=target, source=sensor)
    return fit_recording(request, out, frames, use, seed, exact=truth)
