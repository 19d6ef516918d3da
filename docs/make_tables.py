"""The paper's tables as Markdown, from what `tactoscope evaluate --json` wrote: one file a split, or one a direction.

    python docs/make_tables.py FILE.json... > docs/tables/README.md

Of several files the later one counts where both have a row; poses by several methods come together from all of them,
distances of sets from the last that has any.
The paper's own figures stand in brackets.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

HEAD = """# The paper's tables

Simulated touches that nothing was taught on; the source is another unit than the described one, the target is as
described. In brackets what the paper tells of real recordings of its own sensors: it shows what is hard, not who is
better. Its FID is Inception's; ours is the Frechet distance on the features of earlier pose networks, kept for it,
beside the distance of two halves of the true touches. Errors are of the target's membrane: over all, and where the
target is really touched. Weights as they come along (fourteen minutes on a card, T2D2's some more); one step each,
latent diffusion by 200 steps at 2.54; one machine of two cores, with several other programs at work, so that
times compare rows of one transfer alone.

Poses are counted as the paper does: shift and turn in the sensor's plane, here at the contact and up to the object's
own symmetry, mean and deviation over touches. The first two columns are by the network, in brackets the paper's; then
by our registration and by point-to-plane ICP of Open3D on the touch's own surface, where they were taken. What a gel's
picture does not hold nobody tells: a shift along an edge, a bar or a curve that fills it leaves it as it is.

The VQ-VAE is shown the source where the target looks, reaches over the whole square and knows its place. As published
(50 of 128 pixels around each place, squares of different size taken for each other) it lost to the mean touch in both
directions, and used 58 and 3 of its 512 codes.

    tactoscope evaluate --split unseen_tools --grasps 4 --poses network --json tools.json
    tactoscope evaluate --split unseen_grasps --grasps 2 --poses network --json grasps.json
    tactoscope evaluate --split unseen_grasps --grasps 2 --poses signed_distances,icp --json registered.json
    python docs/make_tables.py registered.json tools.json grasps.json > docs/tables/README.md

The files beside this page were made so, one direction after the other (`--direction`), all by the program and the
weights of one day, but for the rows of latent diffusion and the VQ-VAE, a day older and not changed.
What samples, steps and a few real pairs give is told in [samples.md](samples.md).
"""
COLUMNS = (
    "transfer", "by", "PSNR, dB", "SSIM", "Frechet (floor; FID)", "error, mm", "in contact, mm", "IoU",
    "corr. less mean", "shift, mm", "turn, deg", "registered: shift, mm; turn, deg", "ICP: shift, mm; turn, deg", "ms",
)  # fmt: skip
SHORT = {"soft_bubble": "bubble", "gelslim": "GelSlim", "digit": "DIGIT", "gelsight_mini": "Mini"}


def main(files: list[str]) -> str:
    """The page."""
    tables: dict[str, dict[tuple[str, str, str], Mapping[str, Any]]] = {}
    for file in files:
        told = json.loads(Path(file).read_text("utf-8"))
        rows = tables.setdefault(told["split"], {})
        for row in told["rows"]:
            own = row["candidate"] in ("recorded", "no_contact", "mean")
            key = "" if own else row["source"], row["target"], row["candidate"]
            before = rows.get(key, {})
            rows[key] = {
                **row,
                "pose_errors": {**before.get("pose_errors", {}), **row["pose_errors"]},
                "set_distances": row["set_distances"] or before.get("set_distances"),
            }
    parts = [HEAD]
    for split, rows in tables.items():
        touches = max(row["n_touches"] for row in rows.values())
        parts.append(f"\n## {split.replace('_', ' ').capitalize()}: {touches} touches a transfer\n")
        parts += ["| " + " | ".join(COLUMNS) + " |", "|" + " --- |" * len(COLUMNS)]
        ordered = sorted(rows.items(), key=lambda item: (item[0][1] != "soft_bubble", item[0][0] != "", item[0][0]))
        parts += ["| " + " | ".join(_cells(*key, row)) + " |" for key, row in ordered]
    return "\n".join(parts)


def _cells(source: str, target: str, contender: str, row: Mapping[str, Any]) -> list[str]:
    figures, paper = row["metrics"], row["paper"] or {}

    def value(name: str, region: str = "all") -> str:
        found = figures.get(name, {}).get(region)
        return "-" if found is None else f"{found:.3g}"

    def format_with_paper(ours: str, theirs: str, digits: int = 2) -> str:
        known = paper.get(theirs)
        return ours if known is None else f"{ours} ({known:.{digits}f})"

    sets, pose = row["set_distances"], row["pose_errors"].get("network")
    frechet = "-" if not sets else f"{sets['frechet']:.3g} ({sets['frechet_floor']:.3g}"
    if sets:
        frechet += f"; {paper['fid']:.0f})" if paper.get("fid") is not None else ")"
    shift, turn = (
        "-" if pose is None else f"{pose[name][0]:.2f} ± {pose[name][1]:.2f}"
        for name in ("translation_mm", "rotation_deg")
    )
    if paper:
        shift, turn = f"{shift} ({paper['shift_mm'][0]:.2f})", f"{turn} ({paper['turn_deg'][0]:.2f})"
    others = (_both(row["pose_errors"].get(name)) for name in ("signed_distances", "icp"))
    way = SHORT[target] if not source else f"{SHORT[source]} > {SHORT[target]}"
    return [
        way,
        row["title"] if not source else contender,
        format_with_paper(value("psnr_db"), "psnr_db"),
        format_with_paper(value("ssim"), "ssim"),
        frechet,
        value("error_mm"),
        value("error_mm", "contact"),
        value("iou"),
        value("correlation"),
        shift,
        turn,
        *others,
        f"{row['ms']:.0f}" if row["ms"] else "-",
    ]


def _both(pose: Mapping[str, Any] | None) -> str:
    if pose is None:
        return "-"
    return "; ".join(f"{pose[name][0]:.2f} ± {pose[name][1]:.2f}" for name in ("translation_mm", "rotation_deg"))


if __name__ == "__main__":
    print(main(sys.argv[1:]))
