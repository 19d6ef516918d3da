from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration import calibration_file, slope_model
from pipeline.calibration import calibration_table as calibration
from pipeline.core.derived import DERIVED
from pipeline.core.errors import CalibrationError, FileProblem
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.illumination.light import extract_patch, look_up_slopes

# rms mm/mm inside a contact; LEDs in their own shadow cannot tell steeper slopes apart
BUILT_IN_SLOPE_TOLERANCE = 0.08


@pytest.fixture(scope="module")
def mini():
    return calibration.make_built_in(load_sensor("gelsight_mini"))


def everywhere(picture):
    return np.ones(picture.shape[:2], np.bool_)


def ball_slopes(shape, radius_px=60.0, contact_px=35.0):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    dx = x - shape[1] / 2
    dy = y - shape[0] / 2
    inside = np.hypot(dx, dy) < contact_px
    down = np.sqrt(np.maximum(radius_px**2 - dx**2 - dy**2, 1.0))
    return (
        np.where(inside, -dx / down, 0.0).astype(np.float32),
        np.where(inside, -dy / down, 0.0).astype(np.float32),
        inside,
    )


def look_up(table, seen, still):
    """Slopes (gx, gy) of a whole image by a table."""
    return slope_model.evaluate(
        table.model,
        calibration.compute_relative_change(seen, still, table.pixel_mm),
        *slope_model.compute_positions(still.shape[:2]),
        everywhere(still),
    )


@pytest.mark.parametrize("name", ["gelslim_dotless", "digit", "gelsight_mini"])
def test_the_built_in_table_inverts_the_forward_model(name):
    source = load_sensor(name)
    table = calibration.make_built_in(source)
    gx, gy, inside = ball_slopes(source.camera.shape)
    still = optics.render_reference(source)
    seen = np.clip(np.rint(still + optics.compute_colour_change(source, gx, gy)), 0, 255).astype(
        np.uint8
    )
    found_x, found_y = look_up(table, seen, still)
    core = inside & (np.hypot(gx, gy) < 0.6)  # the last pixels at the rim are blurred on purpose
    assert (
        np.sqrt(np.mean((found_x - gx)[core] ** 2 + (found_y - gy)[core] ** 2))
        < BUILT_IN_SLOPE_TOLERANCE
    )


def test_an_unchanged_picture_has_no_slope_at_all(mini):
    still = optics.render_reference(load_sensor("gelsight_mini"))
    gx, gy = look_up(mini, still, still)
    assert not gx.any()
    assert not gy.any()


def test_slopes_are_finite_and_bounded_for_any_picture(mini):
    rng = np.random.default_rng(0)
    still = optics.render_reference(load_sensor("gelsight_mini"))
    for picture in (
        np.zeros_like(still),
        np.full_like(still, 255),
        rng.integers(0, 256, still.shape, np.uint8),
    ):
        gx, gy = look_up(mini, picture, still)
        assert np.hypot(gx, gy).max() <= mini.model.slope_max * (1 + 1e-5)


def test_a_saved_calibration_is_loaded_unchanged(mini, tmp_path):
    press = calibration.BallFit(
        index=0, x_px=1.5, y_px=2.5, radius_px=20.0, residual=0.03, used=True
    )
    written = replace(mini, presses=(press,), diameter_ratio=1.25)
    calibration_file.save(written, tmp_path / "mini.npz")
    read = calibration_file.load(tmp_path / "mini.npz")
    assert np.array_equal(read.model.coefficients, written.model.coefficients)
    assert replace(read, model=written.model) == written
    assert [p.name for p in tmp_path.iterdir()] == ["mini.npz"]


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(FileProblem, match="No such file"):
        calibration_file.load(tmp_path / "none.npz")


def test_a_damaged_file_is_one_sentence(mini, tmp_path):
    path = tmp_path / "mini.npz"
    calibration_file.save(mini, path)
    whole = path.read_bytes()
    for cut in (0, 10, len(whole) // 2):
        path.write_bytes(whole[:cut])
        with pytest.raises(FileProblem, match="calibrat"):
            calibration_file.load(path)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("pixel_mm", np.nan),
        ("pixel_mm", 0.0),
        ("pixel_mm", -0.05),
        ("slope_max", np.inf),
        ("slope_max", 0.0),
    ],
)
def test_impossible_numbers_are_refused(mini, tmp_path, field, value):
    path = tmp_path / "mini.npz"
    calibration_file.save(mini, path)
    with np.load(path) as read:
        fields = dict(read)
    np.savez(path, **{**fields, field: value})
    with pytest.raises(FileProblem, match=field):
        calibration_file.load(path)


def test_a_missing_field_is_named(tmp_path):
    np.savez(tmp_path / "half.npz", version=3)
    with pytest.raises(FileProblem, match=r"it is missing.*; calibrate again"):
        calibration_file.load(tmp_path / "half.npz")


def test_a_pickled_file_is_not_opened(tmp_path):
    np.savez(tmp_path / "evil.npz", version=np.array([{}], dtype=object))
    with pytest.raises(FileProblem, match="could run code"):
        calibration_file.load(tmp_path / "evil.npz")


def test_the_slopes_of_a_part_are_those_of_the_whole(mini):
    source = load_sensor("gelsight_mini")
    gx, gy, _ = ball_slopes(source.camera.shape)
    still = optics.render_reference(source)
    seen = np.clip(np.rint(still + optics.compute_colour_change(source, gx, gy)), 0, 255).astype(
        np.uint8
    )
    part = (slice(30, 200), slice(40, 300))
    window = ImageWindow(
        rows=part[0],
        cols=part[1],
        changed=everywhere(still[part]),
        blend_weight=np.ones(still[part].shape[:2], np.float32),
    )
    patch = extract_patch(seen, still, window, calibration.SMOOTHING_PX, None, mini.pixel_mm, None)
    # smoothing and brightness reach some pixels over the cut
    inner = (slice(10, -10), slice(10, -10))
    for a, b in zip(look_up_slopes(patch, mini), look_up(mini, seen, still), strict=True):
        np.testing.assert_allclose(a[inner], b[part][inner], atol=1e-4)


def test_a_picture_of_another_size_is_refused(mini):
    with pytest.raises(CalibrationError, match="240 x 320 pixels"):
        calibration.check_calibration(mini, "gelsight_mini", np.zeros((10, 10, 3), np.uint8))


def test_a_calibration_of_another_sensor_is_refused(mini):
    with pytest.raises(CalibrationError, match="made for 'gelsight_mini'"):
        calibration.check_calibration(mini, "digit", np.zeros((320, 240, 3), np.uint8))


def test_a_bubble_has_no_calibration_table():
    with pytest.raises(CalibrationError, match="no optics"):
        calibration.make_built_in(load_sensor("soft_bubble"))


def test_the_compiled_polynomial_equals_the_fitted_one():
    rng = np.random.default_rng(1)
    u, v = slope_model.compute_positions((6, 7))
    samples = slope_model.SlopeSamples(
        change=rng.normal(0, 0.3, (42, 3)).astype(np.float32),
        u=np.tile(u, 6),
        v=np.repeat(v, 7),
        slopes=rng.normal(0, 0.3, (42, 2)).astype(np.float32),
    )
    model = slope_model.fit(samples, colour_degree=2, position_degree=1, ridge=0.01)
    gx, gy = slope_model.evaluate(
        model, samples.change.reshape(6, 7, 3), u, v, np.ones((6, 7), bool)
    )
    expected = slope_model.predict(model, samples).reshape(6, 7, 2)
    assert np.allclose(gx, expected[..., 0], atol=1e-5)  # float32 sums in another order
    assert np.allclose(gy, expected[..., 1], atol=1e-5)


def test_the_built_in_table_follows_the_rest_depth():
    near = load_sensor("digit")
    far = replace(near, rest_depth_mm=1.5 * near.rest_depth_mm)
    assert calibration.make_built_in(near).pixel_mm == near.pixel_mm
    assert calibration.make_built_in(far).pixel_mm == pytest.approx(1.5 * near.pixel_mm)


def test_the_built_in_table_is_cached_on_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    source = replace(load_sensor("digit"), name="one that was never asked for")
    first = calibration.make_built_in(source)
    DERIVED.clear()
    monkeypatch.setattr(calibration, "_invert_optics", lambda _: pytest.fail("it was cached"))
    again = calibration.make_built_in(source)
    assert np.array_equal(again.model.coefficients, first.model.coefficients)
    assert replace(again, model=first.model) == first


def test_the_optional_fields_are_loaded_unchanged(mini, tmp_path):
    expected = calibration.ExpectedError(
        diameter_share=0.08, diameter_p90=0.2, depth_share=0.07, depth_p90=0.18, n_held_out=4
    )
    still = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    covered = np.eye(5, 6) > 0
    known = replace(
        mini,
        uses_built_in=True,
        expected_error=expected,
        reference_thumbnail=still,
        coverage_map=covered,
        depth_scale_map=covered + np.float32(0.5),
    )
    calibration_file.save(known, tmp_path / "look_up.npz")
    back = calibration_file.load(tmp_path / "look_up.npz")
    assert back.expected_error == expected
    assert back.uses_built_in
    assert np.array_equal(back.reference_thumbnail, still)
    assert np.array_equal(back.coverage_map, covered)
    assert np.array_equal(back.depth_scale_map, covered + np.float32(0.5))


@pytest.mark.parametrize(
    "row", [[0.1, 0.1], [0.1, 0.2, np.nan, 0.2, 4.0], [-0.1, 0.2, 0.1, 0.2, 4.0]]
)
def test_an_invalid_expected_error_is_refused(mini, tmp_path, row):
    path = tmp_path / "look_up.npz"
    calibration_file.save(mini, path)
    np.savez(path, **{**np.load(path), "expected_error": np.array(row)})
    with pytest.raises(FileProblem, match="expected_error"):
        calibration_file.load(path)


def test_an_invalid_thumbnail_is_refused(mini, tmp_path):
    path = tmp_path / "look_up.npz"
    calibration_file.save(mini, path)
    np.savez(path, **{**np.load(path), "reference_thumbnail": np.zeros((4, 5), np.float32)})
    with pytest.raises(FileProblem, match="reference_thumbnail"):
        calibration_file.load(path)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("coverage_map", np.zeros(4, np.bool_)),
        ("depth_scale_map", np.zeros((2, 2), np.float32)),
    ],
)
def test_invalid_optional_fields_are_refused(mini, tmp_path, field, value):
    path = tmp_path / "look_up.npz"
    calibration_file.save(mini, path)
    np.savez(path, **{**np.load(path), field: np.array(value)})
    with pytest.raises(FileProblem, match=field):
        calibration_file.load(path)


def test_a_touch_is_covered_where_presses_cover_most_of_it(mini):
    left = replace(mini, coverage_map=np.array([[True, False]]))
    touch = np.ones((20, 20), np.bool_)
    assert mini.covers(touch, (0, mini.cols - 20))
    assert left.covers(touch, (50, 10))
    assert not left.covers(touch, (50, mini.cols - 30))
    assert left.covers(np.zeros((20, 20), np.bool_), (50, mini.cols - 30))


def test_depth_is_scaled_by_the_factor_where_a_surface_is_deepest(mini):
    scaled = replace(mini, depth_scale_map=np.array([[0.8, 1.2]], np.float32))
    surface = np.zeros((mini.rows, mini.cols), np.float32)
    assert scaled.compute_depth_scale(surface, (0, 0)) == 1.0
    surface[100:140, 20:60] = 0.5
    surface[100:140, -60:-20] = 0.005
    assert scaled.compute_depth_scale(surface, (0, 0)) == pytest.approx(0.8, abs=0.01)
    assert mini.compute_depth_scale(surface, (0, 0)) == 1.0
