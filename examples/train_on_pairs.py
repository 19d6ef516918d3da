"""Train on pairs: fine-tune a network on touches that both sensors recorded, and use its
weights.
"""

import tactoscope as ts

# a recording or a folder of them; a lab's own has hundreds of touches
PAIRS = "sample_data/recordings/first_touch.h5"

# some hundred steps in earnest: minutes on a GPU
weights = ts.train("t2t", out="run", pairs=PAIRS, steps=2)
print(f"trained: {weights}")

with ts.open(
    PAIRS, "soft_bubble", source="gelslim", methods={"touch": "t2t"}, weights={"touch": weights}
) as touches:
    result = touches[5].result("touch")
    print(result.answered_by, *result.notes, sep="\n- ")
