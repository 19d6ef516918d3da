"""Plot the successes of a task over slip, tilt and alignment error.

    python docs/make_disturbance_plot.py FILE.json... --out docs/disturbances.png

The files are of `tactoscope task --json` with one `--disturb` each, and of one run without; bars are
95 % intervals. Prints the same as a table.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from scipy.stats import binomtest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from pipeline.core.figures import make_figure, save_figure
from pipeline.core.params import list_settings
from pipeline.lab.tasks.task import Disturbance

STYLES = {"object": "o-", "own": "s--", "t2t": "^-.", "t2d2": "v:", "true": "D-"}


def main(files: Sequence[Path], out: Path, tolerance_mm: float) -> None:
    """Draw one panel a disturbance."""
    outcomes: dict[tuple[str, float, str], list[bool]] = defaultdict(list)
    for file in files:
        read = json.loads(file.read_text("utf-8"))
        size = read["disturbance"]
        changed = [name for name, value in size.items() if value]
        for name in changed if len(changed) == 1 else () if changed else size:
            for one in read["rollouts"]:
                if one["tolerance_mm"] == tolerance_mm:
                    outcomes[name, size[name], one["touch"]].append(one["succeeds"])
    figure = make_figure(figsize=(10, 3.2), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for panel, (name, (_, rule)) in zip(panels, list_settings(Disturbance()).items(), strict=True):
        for k, touch in enumerate(dict.fromkeys(touch for _, _, touch in outcomes)):
            values = sorted(value for one, value, by in outcomes if (one, by) == (name, touch))
            tried = [outcomes[name, value, touch] for value in values]
            share = [sum(one) / len(one) for one in tried]
            low, high = zip(
                *(binomtest(sum(one), len(one)).proportion_ci(method="wilson") for one in tried),
                strict=True,
            )
            print(
                f"{name:9} {touch:7}",
                *(f"{v:g}: {sum(o)}/{len(o)}" for v, o in zip(values, tried, strict=True)),
            )
            step = 0.012 * max(values) * (k - 1.5)  # side by side
            panel.errorbar(
                [value + step for value in values],
                share,
                yerr=[
                    [s - edge for s, edge in zip(share, low, strict=True)],
                    [edge - s for s, edge in zip(share, high, strict=True)],
                ],
                fmt=STYLES.get(touch, "x-"),
                capsize=2,
                label=touch,
            )
        panel.set_xlabel(f"{rule.label.lower()}, {rule.unit}")
        panel.set_ylim(-0.03, 1.03)
    panels[0].set_ylabel(f"successes at {tolerance_mm:g} mm")
    panels[-1].legend(fontsize=8)
    save_figure(figure, out, "the figure")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tolerance-mm", type=float, default=1.0)
    given = parser.parse_args()
    main(given.files, given.out, given.tolerance_mm)
