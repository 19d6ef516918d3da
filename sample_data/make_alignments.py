"""Write the exact alignments of sample recordings: `python -m sample_data.make_alignments`,
after `make_samples`.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.sensors.alignment import AlignmentFile, save_alignment
from pipeline.translation.translate import Request, open_translation
from sample_data.make_samples import RECORDINGS_FOLDER as RECORDINGS

ALIGNMENTS_FOLDER = Path(__file__).parent / "alignments"
RECORDED_PAIRS = (("first_touch", "gelslim", "soft_bubble"), ("digit_gelslim", "digit", "gelslim"))


def alignment_path(source: str, target: str) -> Path:
    """The file of the alignment of two sensors."""
    return ALIGNMENTS_FOLDER / f"{source}_to_{target}.toml"


def read_exact_alignment(recording: str, source: str, target: str) -> AlignmentFile:
    """The exact alignment of two streams of a sample recording."""
    opened = open_translation(
        Request(recording=RECORDINGS / f"{recording}.h5", source=source, target=target)
    )
    try:
        origin = f"exact: what {recording}.h5 was simulated with"
        return AlignmentFile(
            alignment=opened.alignment, source=source, target=target, origin=origin
        )
    finally:
        opened.recording.close()


def main() -> None:
    """Write the alignment of every pair."""
    for recording, source, target in RECORDED_PAIRS:
        save_alignment(
            alignment_path(source, target), read_exact_alignment(recording, source, target)
        )


if __name__ == "__main__":
    main()
