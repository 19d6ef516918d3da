"""`tactoscope compare`: variants of one frame, as the window's Compare shows them."""

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import DEFAULT_OPTIONS, TargetName, TranslationOptions
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import replace_value, split_assignment
from pipeline.lab.evaluation.comparison_tiles import Comparison, check_tiles_folder, write_tiles
from pipeline.lab.evaluation.grid_comparison import GridPlan, compare_grid, parse_axis
from pipeline.lab.evaluation.method_comparison import SortOrder, compare_methods
from pipeline.lab.evaluation.variant_comparison import compare_pair
from pipeline.lab.evaluation.variants import Variant, VariantRunner
from pipeline.stages.metrics.stage_metrics import METRICS
from pipeline.translation.catalogue import BUILT_IN
from pipeline.translation.colour_limits import fit_display
from pipeline.translation.error_attribution import DEFAULT_METRIC
from pipeline.translation.translate import Translation, open_translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Tile

_DISPLAY = "display"
_OptionText = Annotated[str, Parameter(allow_leading_hyphen=True)]
_Settings = Annotated[tuple[str, ...], Parameter(name="--set", negative="")]


@frozen
class _VariantOptions:
    """Options inside `--variant "..."`."""

    recording: Path | None
    target: str
    options: TranslationOptions
    settings: tuple[str, ...]


def compare(
    recording: Path,
    *,
    target: TargetName,
    out: Path,
    options: TranslationOptions = DEFAULT_OPTIONS,
    frame: int = 0,
    order: SortOrder = "worst first",
    stage: str = "touch_depth",
    variant: _OptionText = "",
    across: str = "",
    down: str = "",
    metric: str = DEFAULT_METRIC,
    settings: _Settings = (),
) -> int:
    """Write one comparison's images and metrics, and print the metrics.

    Args:
        recording: File or folder of any known format.
        out: Folder for the images (PNG) and the metrics (compare.json); an earlier comparison there
            is replaced.
        frame: Frame to compare.
        order: Order of the methods by their error in contact.
        stage: Stage to compare with that of the variant, or `all`.
        variant: The variant as options of this command, such as `--method target_depth=paper`.
            Without a recording of its own it is this translation with these options added; with
            one, it is what these options say alone.
        across: What the columns of a grid try, such as `depth.certainty=0.2,0.4,0.8`,
            `touch.seed=0,1,2`, `touch.method=physics,t2d2` or
            `touch.weights=one.safetensors,other.safetensors`.
        down: What its rows try, if anything.
        metric: Metric of the grid's cells, if ground truth is known; empty for images alone.
        settings: `stage.parameter=value`, or `stage/method.parameter=value` of a method that is not
            in use, or `display.parameter=value`; repeatable.
    """
    runner = VariantRunner()
    with ExitStack() as stack:
        translation = stack.enter_context(
            open_translation(options.build_request(recording, target))
        )
        progress = stack.enter_context(open_progress_bar())
        # a damaged one leaves nothing to compare
        translation.stream.frame(translation.check_index(frame))
        params, display = _parse_settings(translation, settings)
        display = fit_display(translation, display, progress)
        check_tiles_folder(out)
        steps: Iterator[Comparison]
        if across or down:
            plan = _parse_plan(
                Variant(label="", translation=translation, params=params), across, down, metric
            )
            steps = compare_grid(runner, translation, frame, params, display, plan, progress)
        elif variant:
            other = _parse_variant(variant)
            if other.recording is None:
                other = _with_base(other, recording, options, settings)
            assert other.recording is not None
            request = other.options.build_request(other.recording, other.target or target)
            opened = stack.enter_context(open_translation(request))
            other_params, _ = _parse_settings(opened, other.settings)
            first = Variant(label="A", translation=translation, params=params)
            second = Variant(label="B", translation=opened, params=other_params)
            shown = "" if stage == "all" else stage
            steps = compare_pair(
                runner, first, lambda: second, frame, display, shown, variant, progress
            )
        else:
            steps = compare_methods(runner, translation, frame, params, display, order, progress)
        *_, comparison = steps
    write_tiles(out, comparison.tiles)
    _print_metrics(comparison.tiles)
    print_line(f"{comparison.summary}; written to {os.fspath(out)}")
    return 0


def _parse_plan(base: Variant, across: str, down: str, metric: str) -> GridPlan:
    """Both axes and the metric of a grid; raises SettingProblem."""
    stage, _, name = metric.partition(".")
    if metric and (name not in METRICS or stage not in base.translation.stages):
        raise SettingProblem(
            f"no metric {metric!r} on this route; give one such as {DEFAULT_METRIC}"
        )
    rows = parse_axis(base, down) if down else None
    return GridPlan(across=parse_axis(base, across), down=rows, metric=metric)


def _parse_settings(
    translation: Translation, settings: Sequence[str]
) -> tuple[dict[str, object], DisplayParams]:
    """(method key -> parameters, display parameters) of `--set` lines; raises SettingProblem."""
    params: dict[str, object] = {}
    display = DisplayParams()
    methods = {method.stage: method for method in translation.methods}
    for line in settings:
        what = "a setting is written stage.parameter=value"
        name, value = split_assignment(line, what)
        key, _, parameter = name.rpartition(".")
        if not key:
            raise SettingProblem(f"{what}, got {line!r}")
        if key == _DISPLAY:
            display = replace_value(display, parameter, value)
            continue
        stage, slash, method_name = key.partition("/")
        method = BUILT_IN.method(stage, method_name) if slash else methods.get(stage)
        if method is None:
            raise SettingProblem(
                f"no stage {stage!r} on this route; there are {', '.join(methods)}"
            )
        params[method.key] = replace_value(
            params.get(method.key, method.params()), parameter, value
        )
    return params, display


def _parse_variant(text: str) -> _VariantOptions:
    """The options in `--variant`; raises SettingProblem."""

    def read(
        recording: Path | None = None,
        *,
        target: str = "",
        options: TranslationOptions = DEFAULT_OPTIONS,
        settings: _Settings = (),
    ) -> _VariantOptions:
        return _VariantOptions(
            recording=recording, target=target, options=options, settings=settings
        )

    app = App(name="--variant", help_flags=[], version_flags=[])
    app.default(read)
    try:
        command, bound, _ = app.parse_args(
            shlex.split(text), print_error=False, exit_on_error=False
        )
    except (CycloptsError, ValueError) as error:
        raise SettingProblem(f"--variant takes options of this command; {error}") from error
    return command(*bound.args, **bound.kwargs)


def _with_base(
    variant: _VariantOptions, recording: Path, base: TranslationOptions, settings: Sequence[str]
) -> _VariantOptions:
    """The base translation with the variant's options in place of its own."""
    changed = {
        field.name: value
        for field in fields(TranslationOptions)
        if (value := getattr(variant.options, field.name)) != field.default
    }
    changed["methods"] = (*base.methods, *variant.options.methods)
    return replace(
        variant,
        recording=recording,
        options=replace(base, **changed),
        settings=(*settings, *variant.settings),
    )


def _print_metrics(tiles: Sequence[Tile]) -> None:
    names = list(dict.fromkeys(name for tile in tiles for name in tile.metrics))
    print_table(
        ("", *names, ""),
        (
            (
                tile.title,
                *(f"{tile.metrics[name]:.4g}" if name in tile.metrics else "" for name in names),
                tile.problem,
            )
            for tile in tiles
        ),
    )
