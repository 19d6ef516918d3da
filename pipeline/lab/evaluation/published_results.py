"""The paper's two result tables, row for row, measured on real recordings of its own sensors."""

from collections.abc import Mapping
from typing import Literal

from pipeline.core.frozen import frozen

Split = Literal["unseen_grasps", "unseen_tools"]
MeanStd = tuple[float, float]  # mean and standard deviation

COMPARISON_NOTE = (
    "the paper's results are of real recordings, ours of simulated ones: they show what is hard, "
    "not who is better; its FID uses Inception, our Frechet distance our own encoder unless "
    "--inception gives that network, "
    "with the distance of two halves of the recorded touches as floor"
)


@frozen
class PaperRow:
    """One row; source "" = the target's recorded touches."""

    source: str
    target: str
    model: str  # "T2T", "T2D2" or ""
    psnr_db: float | None = None
    ssim: float | None = None
    fid: float | None = None
    translation_mm: MeanStd
    rotation_deg: MeanStd


def _rows(
    *cells: tuple[str, str, str, tuple[float, float, float] | None, MeanStd, MeanStd],
) -> tuple[PaperRow, ...]:
    names = ("psnr_db", "ssim", "fid")
    return tuple(
        PaperRow(
            source=source,
            target=target,
            model=model,
            translation_mm=translation_mm,
            rotation_deg=rotation_deg,
            **dict(zip(names, image or (), strict=False)),
        )
        for source, target, model, image, translation_mm, rotation_deg in cells
    )


PAPER_ROWS: Mapping[Split, tuple[PaperRow, ...]] = {
    "unseen_grasps": _rows(
        ("", "soft_bubble", "", None, (0.22, 0.12), (0.51, 0.41)),
        ("gelslim", "soft_bubble", "T2T", (25.85, 0.59, 135.66), (0.92, 0.58), (1.87, 1.23)),
        ("gelslim", "soft_bubble", "T2D2", (20.51, 0.52, 122.06), (3.23, 1.73), (11.53, 9.09)),
        ("digit", "soft_bubble", "T2D2", (20.53, 0.48, 111.77), (3.38, 1.86), (9.85, 8.10)),
        ("", "gelslim", "", None, (0.29, 0.17), (0.83, 0.59)),
        ("soft_bubble", "gelslim", "T2T", (30.92, 0.93, 33.25), (0.40, 0.29), (1.27, 0.97)),
        ("soft_bubble", "gelslim", "T2D2", (21.69, 0.83, 53.99), (2.63, 1.93), (8.47, 6.82)),
        ("digit", "gelslim", "T2D2", (17.73, 0.72, 65.97), (4.10, 1.93), (17.67, 11.47)),
    ),
    "unseen_tools": _rows(
        ("", "soft_bubble", "", None, (0.42, 0.26), (1.03, 0.90)),
        ("gelslim", "soft_bubble", "T2T", (21.77, 0.48, 167.72), (3.40, 1.82), (14.00, 8.13)),
        ("gelslim", "soft_bubble", "T2D2", (18.70, 0.45, 134.74), (4.40, 2.14), (12.71, 9.57)),
        ("digit", "soft_bubble", "T2D2", (18.91, 0.46, 129.30), (3.63, 2.29), (14.75, 13.83)),
        ("", "gelslim", "", None, (0.78, 0.52), (1.71, 1.95)),
        ("soft_bubble", "gelslim", "T2T", (21.50, 0.81, 62.38), (2.53, 1.56), (6.35, 8.43)),
        ("soft_bubble", "gelslim", "T2D2", (18.33, 0.73, 68.67), (3.58, 1.90), (9.99, 8.08)),
        ("digit", "gelslim", "T2D2", (17.37, 0.68, 105.30), (4.87, 2.18), (13.07, 9.73)),
    ),
}
PAPER_DIRECTIONS: tuple[tuple[str, str], ...] = (
    ("gelslim", "soft_bubble"),
    ("digit", "soft_bubble"),
    ("soft_bubble", "gelslim"),
    ("digit", "gelslim"),
)
PAPER_MODELS: Mapping[str, str] = {
    "t2t": "T2T",
    "latent": "T2T",
    "t2d2": "T2D2",
    "latent_t2d2": "T2D2",
}  # touch method -> the paper's model


def find_paper_row(split: Split, source: str, target: str, model: str) -> PaperRow | None:
    """The paper's row of a transfer and model; None if it has none."""
    return next(
        (r for r in PAPER_ROWS[split] if (r.source, r.target, r.model) == (source, target, model)),
        None,
    )
