"""Line drawings of the icons on a canvas of 32 pixels, without colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

CANVAS_PX = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class IconDrawing:
    """Lines of one icon, in pixels of the canvas."""

    strokes: tuple[str, ...] = ()  # corners of each: "x,y x,y ..."
    arcs: tuple[tuple[int, int, int, int, int, int], ...] = ()  # x, y, width, height, start and span in degrees
    boxes: tuple[tuple[int, int, int, int, int], ...] = ()  # x, y, width, height, corner radius
    filled: tuple[str, ...] = ()  # corners of each, as in `strokes`


_TICK = IconDrawing(strokes=("9,17 14,22 23,11",))
_STACK = IconDrawing(strokes=("10,11 22,11", "10,16 22,16", "10,21 22,21"))
_DISK = ("5,5 22,5 27,10 27,27 5,27 5,5", "10,5 10,12 20,12 20,5", "10,27 10,18 22,18 22,27")

STATE_DRAWINGS: Mapping[str, IconDrawing] = {  # of states, inside a circle
    "computed": _TICK,
    "read": _TICK,
    "cached": _STACK,
    "unchanged": IconDrawing(strokes=("10,13 22,13", "10,19 22,19")),
    "skipped": IconDrawing(strokes=("10,16 22,16",)),
    "running": IconDrawing(arcs=((10, 10, 12, 12, 90, -250),)),
    "preview": _STACK,
    "draft": _STACK,
    "warning": IconDrawing(strokes=("16,8 16,18", "16,23 16.01,23")),
    "failed": IconDrawing(strokes=("11,11 21,21", "21,11 11,21")),
    "stale": IconDrawing(strokes=("16,9 16,16 21,19",)),
    "waiting": IconDrawing(strokes=("16,16 16.01,16",)),  # a dot
}

COMMAND_DRAWINGS: Mapping[str, IconDrawing] = {
    "link": IconDrawing(arcs=((4, 11, 12, 10, 0, 360), (16, 11, 12, 10, 0, 360))),
    "reset": IconDrawing(arcs=((7, 7, 18, 18, 60, 290),), strokes=("22,3 21,9 27,10",)),
    "cube": IconDrawing(strokes=("16,4 27,10 27,22 16,28 5,22 5,10 16,4", "5,10 16,16 27,10", "16,16 16,28")),
    "target": IconDrawing(
        arcs=((8, 8, 16, 16, 0, 360),), strokes=("16,3 16,12", "16,20 16,29", "3,16 12,16", "20,16 29,16")
    ),
    "image": IconDrawing(
        boxes=((4, 7, 24, 18, 2),), strokes=("5,23 12,15 17,20 21,16 27,22",), arcs=((19, 10, 3, 3, 0, 360),)
    ),
    "table": IconDrawing(boxes=((5, 6, 22, 20, 2),), strokes=("5,13 27,13", "5,19 27,19", "13,6 13,26")),
    "sliders": IconDrawing(
        strokes=("5,9 27,9", "5,16 27,16", "5,23 27,23", "11,6 11,12", "21,13 21,19", "14,20 14,26")
    ),
    "axes": IconDrawing(strokes=("12,20 12,4", "12,20 28,20", "12,20 4,28", "9,8 12,4 15,8", "24,17 28,20 24,23")),
    "lines": IconDrawing(strokes=("5,8 27,8", "5,14 22,14", "5,20 27,20", "5,26 17,26")),
    "tick": IconDrawing(strokes=("6,17 13,24 26,8",)),
    "minus": IconDrawing(boxes=((5, 5, 22, 22, 3),), strokes=("11,12 21,12", "16,7 16,17", "11,22 21,22")),
    "wipe": IconDrawing(boxes=((4, 7, 24, 18, 2),), strokes=("16,3 16,29", "10,13 7,16 10,19", "22,13 25,16 22,19")),
    "blink": IconDrawing(arcs=((4, 9, 24, 16, 20, 140), (4, 7, 24, 16, 200, 140), (13, 12, 7, 7, 0, 360))),
    "live": IconDrawing(
        arcs=(
            (14, 14, 4, 4, 0, 360),
            (9, 9, 14, 14, -50, 100),
            (9, 9, 14, 14, 130, 100),
            (3, 3, 26, 26, -50, 100),
            (3, 3, 26, 26, 130, 100),
        )
    ),
    "sample": IconDrawing(
        arcs=((5, 5, 22, 22, -30, 240), (9, 9, 14, 16, -40, 260), (13, 13, 6, 10, -60, 300)), strokes=("16,17 16,20",)
    ),
    "magnifier": IconDrawing(arcs=((5, 5, 16, 16, 0, 360),), strokes=("19,19 27,27",)),
    "panes": IconDrawing(boxes=((4, 6, 11, 20, 2), (17, 6, 11, 20, 2))),
    "fit": IconDrawing(
        strokes=("4,11 4,5 10,5", "22,5 28,5 28,11", "28,21 28,27 22,27", "10,27 4,27 4,21"),
        boxes=((11, 12, 10, 8, 4),),
    ),
    "section": IconDrawing(strokes=("4,9 28,9", "4,27 10,27 14,18 19,18 22,23 28,23"), arcs=((2, 7, 4, 4, 0, 360),)),
    "worst": IconDrawing(strokes=("5,27 27,27", "8,27 8,20", "14,27 14,6", "20,27 20,17", "26,27 26,22")),
    "loop": IconDrawing(boxes=((5, 9, 22, 14, 7),), strokes=("13,5 18,9 13,13",)),
    "open": IconDrawing(strokes=("4,26 4,7 12,7 15,10 25,10 25,14", "4,26 9,14 29,14 25,26 4,26")),
    "folder": IconDrawing(strokes=("4,26 4,7 12,7 15,10 28,10 28,26 4,26",)),
    "file": IconDrawing(strokes=("8,4 19,4 25,10 25,28 8,28 8,4", "19,4 19,10 25,10")),
    "session": IconDrawing(boxes=((5, 5, 22, 22, 2),), strokes=("10,11 22,11", "10,16 22,16", "10,21 17,21")),
    "save": IconDrawing(strokes=_DISK),
    "close": IconDrawing(strokes=("8,8 24,24", "24,8 8,24")),
    "stop": IconDrawing(arcs=((5, 5, 22, 22, 0, 360),), strokes=("12,12 20,20", "20,12 12,20")),
    "undo": IconDrawing(strokes=("11,6 5,12 11,18", "5,12 20,12"), arcs=((13, 12, 14, 14, -90, 180),)),
    "redo": IconDrawing(strokes=("21,6 27,12 21,18", "27,12 12,12"), arcs=((5, 12, 14, 14, 90, 180),)),
    "help": IconDrawing(arcs=((10, 5, 12, 12, -60, 240),), strokes=("19,16 16,19 16,22", "16,27 16.01,27")),
    "sun": IconDrawing(
        arcs=((10, 10, 12, 12, 0, 360),),
        strokes=(
            "16,2 16,6",
            "16,26 16,30",
            "2,16 6,16",
            "26,16 30,16",
            "6,6 9,9",
            "23,23 26,26",
            "26,6 23,9",
            "9,23 6,26",
        ),
    ),
    "moon": IconDrawing(arcs=((5, 5, 22, 22, 60, 300), (12, 3, 17, 17, 110, 190))),
    "first": IconDrawing(filled=("16,16 26,8 26,24", "8,16 16,8 16,24"), strokes=("6,8 6,24",)),
    "last": IconDrawing(filled=("16,16 6,8 6,24", "24,16 16,8 16,24"), strokes=("26,8 26,24",)),
    "previous": IconDrawing(filled=("5,16 15,8 15,24", "16,16 26,8 26,24")),
    "next": IconDrawing(filled=("27,16 17,8 17,24", "16,16 6,8 6,24")),
    "play": IconDrawing(filled=("9,5 26,16 9,27",)),
    "pause": IconDrawing(filled=("8,6 13,6 13,26 8,26", "19,6 24,6 24,26 19,26")),
}
