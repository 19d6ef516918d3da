"""Format the results of `tactoscope evaluate --json` as the paper's tables in Markdown.

    python docs/make_tables.py FILE.json... > docs/tables/README.md

Of several files with the same row the later one counts; poses of several methods are merged.
The paper's own figures are in brackets.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

HEAD = """# The paper's tables

Simulated touches outside the training set. The source is another sensor instance than the described one; the target
is as described. Numbers in brackets are the paper's, from real recordings of its own sensors: they show what is hard,
not who is better. The paper's FID uses Inception; ours is the Frechet distance on features of earlier pose networks,
next to the distance between two halves of the true touches. Errors are of the target's membrane: over all pixels, and
in the target's true contact. Shipped weights (14 minutes on one GPU, T2D2 somewhat more); one step each, latent
diffusion 200 steps at 2.54. Times were taken on two cores with other programs running and compare rows of one
transfer only.

Poses are counted as in the paper: translation and rotation in the sensor plane, at the contact and up to the object's
symmetry, mean and standard deviation over touches; first by the pose network (the paper's in brackets), then by our
registration and by Open3D's point-to-plane ICP on the surface of the touch. A translation along an edge or bar that
fills a gel's view is not observable.

The VQ-VAE gets the source reprojected to the target's view, dilated convolutions over the whole square, and a
position bias. As published it lost to the mean touch in both directions, and used 58 and 3 of its 512 codes.

    tactoscope evaluate --split unseen_tools --grasps 4 --poses network --json tools.json
    tactoscope evaluate --split unseen_grasps --grasps 2 --poses network --json grasps.json
    tactoscope evaluate --split unseen_grasps --grasps 2 --poses signed_distances,icp --json registered.json
    python docs/make_tables.py registered.json tools.json grasps.json > docs/tables/README.md

The JSON files in this folder were made so, one direction at a time (`--direction`), with one version of program and
weights (24 November 2026), times and the VQ-VAE before that. Rerun before the contact of a bubble and the light of a
Mini became steadier, all other rows kept their errors within 0.5 %; the VQ-VAE needs `--weights vqvae=FILE`. From a
bubble to a GelSlim all was run again on 27 November 2026, after the bubble's network was trained further and T2D2 and
T2T onto a gel kept their edges; so were poses registered on a bubble in grasps, with the search that finds wide
contacts. Rows of T2D2 from a DIGIT and a Mini, and poses registered on a bubble in tools, are from before that.
Rows of T2T are from before it answered alone (28 November 2026): see samples.md.
Samples and steps: [samples.md](samples.md).
"""
COLUMNS = (
    "transfer",
    "by",
    "PSNR, dB",
    "SSIM",
    "Frechet (floor; FID)",
    "error, mm",
    "in contact, mm",
    "IoU",
    "correlation without mean",
    "translation, mm",
    "rotation, deg",
    "registered: mm; deg",
    "ICP: mm; deg",
    "ms",
)
SHORT = {"soft_bubble": "bubble", "gelslim": "GelSlim", "digit": "DIGIT", "gelsight_mini": "Mini"}


def main(files: list[str]) -> str:
    """The page."""
    tables: dict[str, dict[tuple[str, str, str], Mapping[str, Any]]] = {}
    for file in files:
        table = json.loads(Path(file).read_text("utf-8"))
        rows = tables.setdefault(table["split"], {})
        for row in table["rows"]:
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
        ordered = sorted(
            rows.items(),
            key=lambda item: (item[0][1] != "soft_bubble", item[0][0] != "", item[0][0]),
        )
        parts += ["| " + " | ".join(_cells(*key, row)) + " |" for key, row in ordered]
    return "\n".join(parts)


def _cells(source: str, target: str, candidate: str, row: Mapping[str, Any]) -> list[str]:
    figures = row["metrics"]
    paper = row["paper"] or {}

    def value(name: str, region: str = "all") -> str:
        found = figures.get(name, {}).get(region)
        return "-" if found is None else f"{found:.3g}"

    def format_with_paper(ours: str, theirs: str, digits: int = 2) -> str:
        known = paper.get(theirs)
        return ours if known is None else f"{ours} ({known:.{digits}f})"

    sets = row["set_distances"]
    pose = row["pose_errors"].get("network")
    frechet = "-" if not sets else f"{sets['frechet']:.3g} ({sets['frechet_floor']:.3g}"
    if sets:
        frechet += f"; {paper['fid']:.0f})" if paper.get("fid") is not None else ")"
    shift, turn = (
        "-" if pose is None else f"{pose[name][0]:.2f} ± {pose[name][1]:.2f}"
        for name in ("translation_mm", "rotation_deg")
    )
    if paper:
        shift = f"{shift} ({paper['translation_mm'][0]:.2f})"
        turn = f"{turn} ({paper['rotation_deg'][0]:.2f})"
    others = (_both(row["pose_errors"].get(name)) for name in ("signed_distances", "icp"))
    way = SHORT[target] if not source else f"{SHORT[source]} > {SHORT[target]}"
    return [
        way,
        row["title"] if not source else candidate,
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
    return "; ".join(
        f"{pose[name][0]:.2f} ± {pose[name][1]:.2f}" for name in ("translation_mm", "rotation_deg")
    )


if __name__ == "__main__":
    print(main(sys.argv[1:]))
