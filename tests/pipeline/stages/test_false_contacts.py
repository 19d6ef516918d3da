from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.stages.depth.gel import contact
from pipeline.stages.depth.gel.settings import CONTACT


def remove_false_contacts(
    touched, surface_mm, pixel_mm, border=False, changed=True, change_grey=None
):
    """The contact that stays; by default of a change that tells nothing, away from any border."""
    border, changed = (np.broadcast_to(mask, touched.shape) for mask in (border, changed))
    if change_grey is None:
        change_grey = np.zeros((*touched.shape, 3), np.float32)
    weights = np.ones_like(change_grey)
    return contact.remove_false_contacts(
        touched, surface_mm, pixel_mm, border, changed, (change_grey, weights), CONTACT
    )


def test_a_shallow_plate_is_removed_and_a_second_touch_stays():
    y, x = np.mgrid[:120, :200].astype(np.float32)
    balls = [
        np.maximum(d - ((x - c) ** 2 + (y - 60) ** 2) / 2000, 0) for d, c in ((0.5, 40), (0.2, 100))
    ]
    plate = 0.1 * np.exp(-(((x - 170) / 25) ** 2 + ((y - 60) / 25) ** 2))
    surface = (balls[0] + balls[1] + plate).astype(np.float32)
    touched = (balls[0] > 0) | (balls[1] > 0) | (plate > 0.08)
    remaining = remove_false_contacts(touched, surface, 0.05)
    assert remaining[60, 40]
    assert remaining[60, 100]
    assert not remaining[60, 170]


def test_a_step_at_the_end_of_the_changed_region_is_removed():
    y, x = np.mgrid[:120, :200].astype(np.float32)
    ball = np.maximum(0.5 - ((x - 40) ** 2 + (y - 60) ** 2) / 2000, 0)
    changed = np.broadcast_to(x < 150, x.shape)
    raised = (
        0.15
        * np.where(changed, np.clip((x - 110) / 40, 0, 1), 0.0)
        * np.exp(-(((y - 60) / 40) ** 2))
    )
    surface = (ball + cv2.GaussianBlur(raised, (0, 0), 1.0)).astype(np.float32)
    touched = (ball > 0) | (raised > 0.06)
    assert remove_false_contacts(touched, surface, 0.05)[60, 140]
    remaining = remove_false_contacts(touched, surface, 0.05, changed=changed)
    assert remaining[60, 40]
    assert not remaining[60, 140]


@pytest.mark.parametrize(("around_mm", "remains"), [(0.02, True), (0.14, False)])
def test_a_bump_on_raised_gel_is_removed_and_a_light_touch_stays(around_mm, remains):
    y, x = np.mgrid[:120, :240].astype(np.float32)
    ball = np.maximum(0.9 - ((x - 50) ** 2 + (y - 60) ** 2) / 1000, 0)
    bump = np.maximum(0.08 - ((x - 180) ** 2 + (y - 60) ** 2) / 1000, 0)
    high = around_mm * np.exp(-(((x - 180) / 40) ** 4) - ((y - 60) / 40) ** 4)
    remaining = remove_false_contacts(
        (ball > 0) | (bump > 0), (ball + bump + high).astype(np.float32), 0.05
    )
    assert remaining[60, 50]
    assert remaining[60, 180] == remains


def test_parts_of_a_light_touch_stay_without_steep_flanks():
    y, x = np.mgrid[:120, :200]
    balls = [
        np.clip(0.5 - np.hypot(x - cx, y - 60) / 60.0, 0.0, 1.0) * depth
        for cx, depth in ((50, 0.06), (130, 0.05))
    ]
    surface = (balls[0] + balls[1]).astype(np.float32)
    remaining = remove_false_contacts(surface > 0, surface, 0.05)
    assert remaining[60, 50]
    assert remaining[60, 130]


@pytest.mark.parametrize(
    ("centre", "share", "remains"), [(4, 0.3, False), (4, 0.5, True), (60, 0.3, True)]
)
def test_a_region_at_the_border_has_a_good_part_of_the_deepest_depth(centre, share, remains):
    y, x = np.mgrid[:120, :200].astype(np.float32)
    deep = np.maximum(0.6 - ((x - 140) ** 2 + (y - 60) ** 2) / 1000, 0)
    other = np.maximum(share * 0.6 - ((x - centre) ** 2 + (y - 60) ** 2) / 1000, 0)
    border = np.pad(np.zeros((118, 198), np.bool_), 1, constant_values=True)
    surface = (deep + other).astype(np.float32)
    touched = (deep > 0) | (other > 0)
    remaining = remove_false_contacts(touched, surface, 0.05, border)
    assert remaining[60, 140]
    assert remaining[60, centre] == remains
    # only the border tells
    assert remove_false_contacts(touched, surface, 0.05)[60, centre]


@pytest.mark.parametrize("colours", ["of a dent", "of a spot of light"])
def test_a_region_whose_colours_all_rise_is_light(colours):
    y, x = np.mgrid[:120, :200].astype(np.float32)
    balls = [
        np.maximum(d - ((x - c) ** 2 + (y - 60) ** 2) / 1000, 0) for d, c in ((0.6, 140), (0.4, 50))
    ]
    surface = (balls[0] + balls[1]).astype(np.float32)
    change = np.repeat(np.gradient(surface, axis=1)[..., None], 3, axis=2)
    if colours == "of a spot of light":
        change[:, :95] = surface[:, :95, None]
    remaining = remove_false_contacts(
        surface > 0, surface, 0.05, change_grey=change.astype(np.float32)
    )
    assert remaining[60, 140]
    assert remaining[60, 50] == (colours == "of a dent")
