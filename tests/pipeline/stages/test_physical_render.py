from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.errors import ShapeError
from pipeline.core.geometry import rigid
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.core.values.results import TargetDepth
from pipeline.physics import gel, optics
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.shapes.solids import make_chamfered_prism
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch.physical_render import (
    PhysicalRenderParams,
    render_touch,
    skip_without_contact,
)

SURFACE_MM = 2e-3  # the stage's solver tolerance (0.5 um) at a contact edge
# of 0.3 mm: one pixel without a value springs up by 0.065 mm between its neighbours
LEFT_OUT_MM = 0.1
SENSORS = ("gelslim", "digit", "gelsight_mini", "soft_bubble")


def view_of(spec, mask, indentation_mm):
    indentation = np.where(mask, indentation_mm, 0.0).astype(np.float32)
    return TargetDepth(
        depth_mm=np.where(mask, spec.rest_depth_mm - indentation, np.nan).astype(np.float32),
        contact=mask,
        indentation_mm=indentation,
        camera=spec.camera,
        source_index=np.where(mask, 7, -1).astype(np.int32),
        in_view=np.ones(mask.shape, bool),
    )


def corner(spec, share=0.5):
    """An L within the middle of the picture."""
    y, x = (np.abs(np.linspace(-1, 1, n)) for n in spec.camera.shape)
    upright = (x[None, :] < 0.12) & (y[:, None] < share)
    lying = (x[None, :] < share) & (y[:, None] < 0.15)
    return upright | lying


def test_a_membrane_that_is_followed_is_said_and_that_of_the_search_from_rest():
    spec = load_sensor("soft_bubble")
    last = render_touch(view_of(spec, corner(spec), 4.0), spec, PhysicalRenderParams()).pressed
    view = view_of(spec, corner(spec), 4.5)
    cold = render_touch(view, spec, PhysicalRenderParams())
    near = render_touch(view, spec, PhysicalRenderParams(), start=last)
    assert any("followed" in note for note in near.notes)
    assert not any("followed" in note for note in cold.notes)
    assert np.abs(near.membrane.depth_mm - cold.membrane.depth_mm).max() < 5 * SURFACE_MM
    assert np.array_equal(near.membrane.contact, cold.membrane.contact)


@pytest.mark.parametrize("name", SENSORS)
def test_no_contact_gives_the_reference_image(name):
    spec = load_sensor(name)
    empty = view_of(spec, np.zeros(spec.camera.shape, bool), 0.0)
    touch = render_touch(empty, spec, PhysicalRenderParams())
    wanted = (
        optics.render_reference(spec)
        if spec.kind == "gel"
        else spec.rest_depth_mm.astype(np.float32)
    )
    assert np.array_equal(touch.image, wanted)
    assert not touch.membrane.indentation_mm.any()
    assert (touch.source_index == -1).all()
    skipped = skip_without_contact(empty, spec, PhysicalRenderParams())
    assert np.array_equal(skipped.image, wanted)


@pytest.mark.parametrize("name", SENSORS)
def test_the_same_view_and_seed_give_the_same_bytes(name):
    spec = load_sensor(name)
    depth_mm = 0.5 if spec.kind == "gel" else 5.0
    view = view_of(spec, corner(spec), depth_mm)
    one, again = (
        render_touch(view, spec, PhysicalRenderParams(add_noise=True, seed=4)) for _ in range(2)
    )
    other = render_touch(view, spec, PhysicalRenderParams(add_noise=True, seed=5))
    assert one.image.tobytes() == again.image.tobytes()
    assert one.image.tobytes() != other.image.tobytes()
    assert one.image.dtype == (np.uint8 if spec.kind == "gel" else np.float32)


def test_a_true_contact_reproduces_the_true_gel_surface():
    spec = load_sensor("digit")
    y, x = np.mgrid[: spec.camera.rows, : spec.camera.cols]
    overlap = 0.5 - ((x - 110.0) ** 2 + (y - 170.0) ** 2) * spec.pixel_mm**2 / (2 * 4.0)
    true = gel.press_gel(spec.gel, spec.pixel_mm, overlap)
    touch = render_touch(
        view_of(spec, true.contact, true.indentation_mm),
        spec,
        PhysicalRenderParams(),
    )
    assert np.abs(touch.membrane.indentation_mm - true.indentation_mm).max() < SURFACE_MM
    assert (touch.membrane.contact & true.contact).sum() > 0.97 * (
        touch.membrane.contact | true.contact
    ).sum()
    assert (
        np.abs(touch.image.astype(int) - optics.render(spec, true.indentation_mm, seed=None)).max()
        <= 2
    )


@pytest.mark.parametrize("side_mm", [6.0, 9.1, 13.3])
def test_a_bubble_covers_the_object_up_to_its_edge(side_mm):
    """Compared with the simulator on the same plate: measured points end half a pixel before the
    edge.
    """
    spec = load_sensor("soft_bubble")
    half = side_mm / 2
    plate = make_chamfered_prism(
        ((-half, -half), (half, -half), (half, half), (-half, half)), 8.0, 0.05, "plate"
    )
    truth = simulate_press(plate, rigid.translation(0.4, -0.3, -4.0), spec, seed=None).truth
    vertices_mm = rigid.apply(truth.sensor_from_object, plate.vertices_mm)
    seen, _ = render_mesh(vertices_mm, plate.triangles, spec.camera)
    with np.errstate(invalid="ignore"):
        view = view_of(spec, seen < spec.rest_depth_mm, np.nan_to_num(spec.rest_depth_mm - seen))
    membrane = render_touch(view, spec, PhysicalRenderParams()).membrane
    assert (membrane.depth_mm <= np.where(view.contact, view.depth_mm, np.inf) + 1e-4).all(), (
        "through the object"
    )
    assert view.contact.sum() > 100
    assert np.abs(membrane.indentation_mm - truth.indentation_mm)[view.contact].mean() < 0.03


def test_a_bubble_is_slack_over_the_points_and_free_elsewhere():
    spec = load_sensor("soft_bubble")
    mask = corner(spec, 0.6)
    touch = render_touch(view_of(spec, mask, 6.0), spec, PhysicalRenderParams())
    between = np.zeros_like(mask)
    # in the crook of the L, 18 px from both
    between[spec.camera.rows // 2 - 18, spec.camera.cols // 2 + 18] = True
    assert 0.5 < touch.membrane.indentation_mm[between][0] < 6.0
    # rays past the sharp edge see the flank
    assert np.percentile(touch.membrane.indentation_mm[mask], 10) > 5.5
    assert touch.membrane.indentation_mm[2, 2] < 0.0  # the air bulges it out far away
    assert touch.membrane.contact.sum() > 0.3 * mask.sum()
    assert not (touch.membrane.contact & (touch.membrane.indentation_mm < 1.0)).any()


@pytest.mark.parametrize("name", SENSORS)
def test_depth_is_rest_minus_indentation_and_pixels_index_the_view(name):
    spec = load_sensor(name)
    mask = corner(spec)
    touch = render_touch(
        view_of(spec, mask, 0.4 if spec.kind == "gel" else 4.0), spec, PhysicalRenderParams()
    )
    assert (
        np.abs(spec.rest_depth_mm - touch.membrane.indentation_mm - touch.membrane.depth_mm).max()
        < 1e-4
    )  # float32 at 80 mm
    assert np.array_equal(touch.source_index >= 0, mask)
    assert touch.source_index[mask].tolist() == np.flatnonzero(mask).tolist()
    assert not touch.image.flags.writeable


def test_excessive_indentation_is_cut_with_a_warning():
    spec = load_sensor("gelslim")
    touch = render_touch(view_of(spec, corner(spec), 40.0), spec, PhysicalRenderParams())
    assert touch.membrane.indentation_mm.max() < spec.limits.indentation_max_mm + 0.01
    assert any("cut at the 1.918 mm" in note for note in touch.notes)


def test_ragged_masks_and_contacts_at_the_border_stay_finite():
    spec = load_sensor("digit")
    rng = np.random.default_rng(0)
    ragged = corner(spec) & (rng.random(spec.camera.shape) < 0.4)
    edge = np.zeros(spec.camera.shape, bool)
    edge[:, :30] = True
    everything = np.ones(spec.camera.shape, bool)
    single = np.zeros(spec.camera.shape, bool)
    single[0, 0] = True
    for mask in (ragged, edge, everything, single):
        view = view_of(spec, mask, 0.4 + 0.05 * rng.standard_normal(mask.shape))
        touch = render_touch(view, spec, PhysicalRenderParams())
        assert np.isfinite(touch.membrane.indentation_mm).all()


def test_an_object_at_the_image_border_continues_outside():
    spec = load_sensor("digit")
    band = np.zeros(spec.camera.shape, bool)
    band[140:180] = True
    surface = render_touch(
        view_of(spec, band, 0.4), spec, PhysicalRenderParams()
    ).membrane.indentation_mm
    along_edge = surface[130, [0, 120]]
    assert along_edge[0] == pytest.approx(along_edge[1], abs=0.03)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -20.0, 3e38])
@pytest.mark.parametrize("name", ["digit", "soft_bubble"])
def test_contact_without_depth_is_left_out_with_a_note(name, value):
    whole = load_sensor(name)
    camera = whole.camera.scale(0.2)
    spec = replace(whole, camera=camera, rest_depth_mm=whole.membrane.rest_depth_mm(camera))
    clean = view_of(spec, corner(spec), 0.3)
    pushed = np.array(clean.indentation_mm)
    depth = np.array(clean.depth_mm)
    row, col = (n // 2 for n in camera.shape)
    pushed[row, col] = np.nan if value == 3e38 else value
    depth[row, col] = value
    bad = replace(clean, indentation_mm=pushed, depth_mm=depth)
    touch = render_touch(bad, spec, PhysicalRenderParams())
    near = render_touch(clean, spec, PhysicalRenderParams())
    assert any("1 contact pixels" in note for note in touch.notes)
    made = touch.membrane.indentation_mm
    wanted = near.membrane.indentation_mm
    assert np.isfinite(made).all()
    off_mm = np.abs(made - wanted)
    assert 0 < off_mm[row, col] < LEFT_OUT_MM
    off_mm[row - 3 : row + 4, col - 3 : col + 4] = 0.0
    assert off_mm.max() < SURFACE_MM


def test_a_view_of_another_size_is_refused():
    spec = load_sensor("digit")
    view = view_of(spec, corner(spec), 0.4)
    with pytest.raises(ShapeError, match="digit"):
        render_touch(replace(view, contact=view.contact[:-1]), spec, PhysicalRenderParams())
