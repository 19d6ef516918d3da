"""The commands about how two sensors stand to each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import Parameter

from pipeline.cli.translation_options import Flag

if TYPE_CHECKING:
    from pipeline.translation.translate import Request


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PairedTouchOptions:
    """Touches of a recording in which both sensors took part.

    Parameters
    ----------
    target
        Sensor to carry touches to.
    sensor
        The sensor that they come from; the recording's first otherwise, gelslim for tiles.
    frames
        Frames of a recording such as `0,3-7`; all otherwise.
    truth
        Use the recording's exact depth and contact, not what the depth stage makes of the pictures.
    """

    target: str
    sensor: str = ""
    frames: str = ""
    truth: Flag = False

    def build_request(self, recording: Path, alignment: Path | None = None) -> Request:
        """The recording, from sensor to target."""
        from pipeline.translation.translate import Request

        return Request(recording=recording, target=self.target, source=self.sensor, alignment=alignment)


def score(
    recording: Path,
    *,
    touches: PairedTouchOptions,
    alignment: Path | None = None,
) -> int:
    """Say how well touches agree with what the target really felt of them, and which axis matters.

    Parameters
    ----------
    recording
        A recording in which both sensors took part.
    alignment
        The .toml to judge; what the recording or the sensor descriptions say otherwise.
    """
    from pipeline.cli.align import show_scores

    return show_scores(touches.build_request(recording, alignment), touches.frames, touches.truth)


def refine(
    recording: Path,
    *,
    touches: PairedTouchOptions,
    out: Path,
    alignment: Path | None = None,
    hold_out: float = 0.2,
    into: Literal["alignment_from_source", "target_from_alignment"] = "target_from_alignment",
    tolerance: float = 1.0,
) -> int:
    """Fit an alignment to many touches at once, say what they do not tell, and write it.

    Parameters
    ----------
    recording
        A recording in which both sensors took part.
    out
        The .toml to write.
    alignment
        The .toml to begin with; what the recording or the sensor descriptions say otherwise.
    hold_out
        Share of the touches that are not used, only judged before and after.
    into
        Which of the two transforms takes the change.
    tolerance
        Directions that the touches tell to no better than this times 0.2 mm or 1 degree are left as they were.
    """
    from pipeline.cli.align import run_refinement

    request = touches.build_request(recording, alignment)
    return run_refinement(
        request, out, touches.frames, hold_out=hold_out, into=into, tolerance=tolerance, exact=touches.truth
    )


def fit(
    pairs: Path,
    *,
    touches: PairedTouchOptions,
    out: Path | None = None,
    use: int = 10,
    seed: int = 0,
    source_tiles: str = "*_gelslim.png",
    target_tiles: str = "*_bubble_gt.png",
) -> int:
    """Find how two sensors stand to each other from a few touches that both felt, without one to begin with.

    Parameters
    ----------
    pairs
        A recording in which both sensors took part, or a folder of tiles: difference pictures and imprints.
    out
        The .toml to write, where the pairs are metric; of tiles the map is only said.
    use
        How many pairs to fit to; the others are scored.
    seed
        Draws which.
    source_tiles
        Names of the source's tiles; the `*` is the same word in both tiles of a pair.
    target_tiles
        Names of the target's tiles.
    """
    from pipeline.cli.align_fit import fit_recording, fit_tiles, has_tiles

    if has_tiles(pairs, source_tiles):
        return fit_tiles(pairs, touches.sensor or "gelslim", touches.target, (source_tiles, target_tiles), use, seed)
    return fit_recording(touches.build_request(pairs), out, touches.frames, use, seed, exact=touches.truth)
