"""`tactoscope attribute`: which stage the error of each frame comes from."""

import statistics
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    StageSettings,
    TargetName,
    TranslationOptions,
)
from pipeline.core.errors import SettingProblem
from pipeline.core.files import check_folder_for, write_json
from pipeline.core.frame_lists import parse_frames
from pipeline.core.progress import SubProgress
from pipeline.translation.error_attribution import DEFAULT_METRIC, ErrorAttribution, attribute_error
from pipeline.translation.translate import open_translation

_CACHE_BYTES = 64 * 1024 * 1024  # one frame's stages, with and without ground truth in their place


def attribute(
    recording: Path,
    *,
    target: TargetName,
    options: TranslationOptions = DEFAULT_OPTIONS,
    metric: str = DEFAULT_METRIC,
    frame: int | None = None,
    json: Path | None = None,
    settings: StageSettings = (),
) -> int:
    """Print every frame's error as a sum of shares, worst frame first, and the medians.

    Args:
        recording: File or folder of any known format with ground truth, such as a simulated
            recording.
        metric: Error to attribute, `stage.name` as in the report of `tactoscope translate`.
        frame: The only frame to analyse; default: all frames.
        json: File for the shares of every frame.
    """
    request = options.build_request(recording, target)
    with open_translation(request, settings=settings, cache_bytes=_CACHE_BYTES) as translation:
        if json is not None:
            check_folder_for(json)
        listed = "" if frame is None else str(translation.check_index(frame))
        indices = parse_frames(listed, translation.n_frames)
        with open_progress_bar() as progress:
            results: list[ErrorAttribution] = []
            for k, index in enumerate(indices):
                part = SubProgress(progress, k / len(indices), 1.0 / len(indices), f"frame {index}")
                result = attribute_error(translation, index, metric, part)
                if result is not None:
                    results.append(result)
    if not results:
        name = translation.target.name
        remedy = (
            f"the source is {name} too: choose another --target or --sensor"
            if translation.source.name == name
            else f"use a recording that also holds {name}'s own frames of the same touches"
        )
        raise SettingProblem(f"{metric} is not known for any of these frames; {remedy}")
    results.sort(key=lambda result: result.total, reverse=True)
    _print_table(results)
    if json is not None:
        write_json(json, [asdict(result) for result in results])
    return 0


def _print_table(results: Sequence[ErrorAttribution]) -> None:
    titles = list(dict.fromkeys(part.title for result in results for part in result.shares))
    rows = [
        (str(r.frame), r.total, {part.title: part.share for part in r.shares}, r.remainder)
        for r in results
    ]
    if len(rows) > 1:
        total = statistics.median(r.total for r in results)
        remainder = statistics.median(r.remainder for r in results)
        medians = {
            title: statistics.median(shares[title] for _, _, shares, _ in rows if title in shares)
            for title in titles
        }
        rows.append(("median", total, medians, remainder))
    print_table(
        ("frame", f"{results[0].metric}, {results[0].unit}", *titles, "remainder"),
        (
            (
                name,
                f"{total:.3f}",
                *(f"{shares[title]:+.3f}" if title in shares else "" for title in titles),
                f"{remainder:+.3f}",
            )
            for name, total, shares, remainder in rows
        ),
    )
    print_line(f"frame {results[0].frame} is the worst: {results[0].summary}")
