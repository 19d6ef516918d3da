"""Format the results of `tactoscope evaluate --json` as the paper's tables in Markdown.

    python docs/make_tables.py docs/tables/*.json > docs/tables/README.md

Of several files with the same row the one of the latest date counts; poses of several methods are
merged where files are of one date. The paper's own figures are in brackets.
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
not who is better. Errors are of the target's membrane: over all pixels, and in the target's true contact, with 95 %
intervals over touches where they were stored. The last column names the file and the day that a row is from; the
latest counts.

*own sensor* does not translate: the object is registered on the source's own depth. It is what a translation has to
beat where the object's mesh is known. *object* registers the mesh on the source in the same way and presses it into
the target. Both know the mesh; no other row does.

**When translating loses to the source's own sensor, and when it wins.** On unseen tools an image network loses:
registered on the GelSlim's own depth the pose is 0.15 mm and 0.4 degrees off, on T2T's bubble 1.1 mm and 2.7 degrees,
and pegs are inserted 31 and 21 times of 32 (`../tasks.md`). *object* is as good as the source (0.06 mm, 0.4 degrees, 31
of 32), and its touch is the only generated one near the true one. It draws level where the translation knows the object and
the target sees more of it: on training objects a pose network is 0.41 mm and 1.1 degrees off by T2T's bubble, 0.45 mm
and 1.8 degrees by the GelSlim itself. It wins where a policy knows the target alone: a marble is rolled home 20 of 20
times through T2D2, 0 of 20 times untranslated. From a bubble, which sees more than a gel, the own sensor has not been
beaten. *object* of 28 November is not measured from a Mini.

Shipped weights (14 minutes on one GPU, T2D2 somewhat more), one step each. Latent diffusion of ours is not in the
table: no weights of it are shipped (see `../experiments.md`). The VQ-VAE gets the source reprojected to the target's
view, dilated convolutions over the whole square, and a position bias; ours is weak, farther off than the mean touch
over all on unseen tools, where the paper's nearly equals its T2T. As published it lost to the mean touch in both
directions, and used 58 and 3 of its 512 codes. Times were taken on two cores with other programs running and compare
rows of one file only.

The paper's FID uses Inception, which cannot be had here; ours is the Frechet distance on features of earlier pose
networks, next to the distance between two halves of the true touches. `tactoscope evaluate --inception FILE` computes
it by the weights of torchvision's `inception_v3`.

Poses are counted as in the paper: translation and rotation in the sensor plane, at the contact and up to the object's
symmetry, mean and standard deviation over touches; first by the target's pose network (the paper's in brackets), which
knows the training objects (by the source's own one for *own sensor*), then by our registration of the mesh and by
Open3D's point-to-plane ICP on the surface of the touch. A translation along an edge or bar that fills a gel's view is not observable: registered on such a touch the
mean is that of a guess.

    tactoscope evaluate --split unseen_tools --grasps 4 --poses network,signed_distances --json tools.json
    tactoscope evaluate --split unseen_grasps --grasps 2 --poses network,signed_distances --json grasps.json
    python docs/make_tables.py docs/tables/*.json > docs/tables/README.md

One direction at a time (`--direction`), rows of 28 November 2026 with `--only own --only object` and the methods named
there; the VQ-VAE needs `--weights vqvae=FILE`. Rows of 24 November are from before the contact of a bubble and the
light of a Mini became steadier; rerun, they kept their errors within 0.5 %. Samples and steps: [samples.md](samples.md).
"""
COLUMNS = (
    "transfer",
    "by",
    "PSNR, dB",
    "SSIM",
    "Frechet (floor; FID)",
    "error, mm [95 %]",
    "in contact, mm [95 %]",
    "IoU",
    "correlation without mean",
    "translation, mm",
    "rotation, deg",
    "registered: mm; deg",
    "ICP: mm; deg",
    "ms",
    "from",
)
BEGIN = ("recorded", "no_contact", "mean", "own")  # of a transfer's rows; the object is the last
SHORT = {"soft_bubble": "bubble", "gelslim": "GelSlim", "digit": "DIGIT", "gelsight_mini": "Mini"}
NAMES = {"own": "own sensor", "vqvae": "vqvae (ours is weak)"}


def main(files: list[str]) -> str:
    """The page."""
    read = [(Path(file), json.loads(Path(file).read_text("utf-8"))) for file in files]
    tables: dict[str, dict[tuple[str, str, str], Mapping[str, Any]]] = {}
    for path, table in sorted(read, key=lambda one: one[1]["date"]):
        rows = tables.setdefault(table["split"], {})
        for row in table["rows"]:
            is_source_free = row["candidate"] in BEGIN[:3]
            key = "" if is_source_free else row["source"], row["target"], row["candidate"]
            before = rows.get(key, {})
            if before.get("date") != table["date"] and row["candidate"] not in BEGIN[1:3]:
                before = {}
            elif before and row["pose_errors"].keys() <= before["pose_errors"].keys():
                continue  # the same touches once more
            place = f"[{table['date']}]({path.name})"
            rows[key] = {
                **row,
                "date": table["date"],
                "pose_errors": {**before.get("pose_errors", {}), **row["pose_errors"]},
                "set_distances": row["set_distances"] or before.get("set_distances"),
                "from": "<br>".join(dict.fromkeys([*before.get("from", "").split("<br>"), place])),
            }
    parts = [HEAD]
    for split, rows in tables.items():
        touches = max(row["n_touches"] for row in rows.values())
        parts.append(f"\n## {split.replace('_', ' ').capitalize()}: {touches} touches a transfer\n")
        parts += ["| " + " | ".join(COLUMNS) + " |", "|" + " --- |" * len(COLUMNS)]
        parts += [
            "| " + " | ".join(_cells(*key, rows[key])) + " |" for key in sorted(rows, key=_order)
        ]
    return "\n".join(parts)


def _order(key: tuple[str, str, str]) -> tuple[Any, ...]:
    source, target, candidate = key
    place = BEGIN.index(candidate) if candidate in BEGIN else len(BEGIN) + (candidate == "object")
    return target != "soft_bubble", source != "", source, place, candidate != "physics", candidate


def _cells(source: str, target: str, candidate: str, row: Mapping[str, Any]) -> list[str]:
    figures = row["metrics"]
    paper = row["paper"] or {}

    def value(name: str, region: str = "all") -> str:
        found = figures.get(name, {}).get(region)
        if found is None:
            return "-"
        spread = (row.get("intervals") or {}).get(name, {}).get(region) if "error" in name else None
        return f"{found:.3g}" + (f" [{spread[0]:.2g}, {spread[1]:.2g}]" if spread else "")

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
        row["title"] if not source else NAMES.get(candidate, candidate),
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
        row["from"].removeprefix("<br>"),
    ]


def _both(pose: Mapping[str, Any] | None) -> str:
    if pose is None:
        return "-"
    return "; ".join(
        f"{pose[name][0]:.2f} ± {pose[name][1]:.2f}" for name in ("translation_mm", "rotation_deg")
    )


if __name__ == "__main__":
    print(main(sys.argv[1:]))
