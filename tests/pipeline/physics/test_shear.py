import numpy as np
import pytest
from scipy.linalg import expm

from pipeline.core.errors import SettingProblem
from pipeline.physics import gel, optics, shear
from pipeline.physics.lattice import Lattice
from pipeline.physics.shear import TangentialLoad
from pipeline.sensors.parts import Gel
from pipeline.sensors.spec import load_sensor

PAD = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)
PIXEL_MM = 0.1
STICK = 0.02  # of the drag: the solve's cell and tolerance
SYMBOL = 1e-6  # relative: closed form against the matrix exponential


def pressed(depth_mm=0.6, radius_mm=4.0, n=160):
    y, x = np.mgrid[:n, :n] * PIXEL_MM - (n - 1) / 2 * PIXEL_MM
    r_sq = x * x + y * y
    overlap = np.where(
        r_sq < radius_mm**2,
        depth_mm - radius_mm + np.sqrt(np.maximum(radius_mm**2 - r_sq, 0)),
        -9.0,
    )
    return gel.press_gel(PAD, PIXEL_MM, overlap)


def plane_strain_answer(pad, q):
    """Surface motion along the wave per unit traction, from the layer's differential equations."""
    g = pad.youngs_kpa / 2 / (1 + pad.poisson)
    lame = 2 * g * pad.poisson / (1 - 2 * pad.poisson)
    stiff = lame + 2 * g
    i = 1j * q
    # State: motion along and across the layer, shear and normal stress.
    m = np.array(
        [
            [0, -i, 1 / g, 0],
            [-lame * i / stiff, 0, 0, 1 / stiff],
            [q * q * (stiff - lame**2 / stiff), 0, 0, -i * lame / stiff],
            [0, 0, -i, 0],
        ]
    )
    through = expm(m * pad.thickness_mm)
    base = np.linalg.solve(through[2:, 2:], np.array([1.0, 0.0]))
    return (through[:2, 2:] @ base)[0].real


@pytest.mark.parametrize("q", [0.05, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("poisson", [0.3, 0.45, 0.49])
def test_the_response_to_a_wave_solves_the_layer(q, poisson):
    pad = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=poisson)
    _, along = shear.compute_symbols(pad, np.array([q]))
    assert along[0] == pytest.approx(plane_strain_answer(pad, q), rel=SYMBOL)


def test_long_waves_shear_the_pad_like_a_block():
    across, along = shear.compute_symbols(PAD, np.array([1e-4]))
    block = PAD.thickness_mm * 2 * (1 + PAD.poisson) / PAD.youngs_kpa
    assert across[0] == pytest.approx(block, rel=1e-4)
    assert along[0] == pytest.approx(block, rel=1e-4)


def test_a_contact_with_enough_friction_moves_with_the_object_and_far_points_stay():
    press = pressed()
    found = shear.solve_shear(
        PAD,
        PIXEL_MM,
        press.pressure_kpa,
        TangentialLoad(displacement_mm=(0.02, 0.0), friction=10.0),
    )
    assert found.converged
    assert found.motion_mm[80, 80] == pytest.approx([0.02, 0.0], abs=STICK * 0.02)
    assert np.abs(found.motion_mm[0, 0]).max() < 0.1 * 0.02
    assert found.force_n[0] > 0
    assert abs(found.force_n[1]) < 1e-3 * found.force_n[0]


def test_a_long_drag_slips_everywhere_and_pulls_with_friction_times_the_load():
    press = pressed()
    found = shear.solve_shear(
        PAD, PIXEL_MM, press.pressure_kpa, TangentialLoad(displacement_mm=(0.0, 5.0), friction=0.5)
    )
    assert (found.motion_mm[press.contact, 1] < (1.0 - STICK) * 5.0).mean() > 0.9
    assert found.force_n[1] == pytest.approx(0.5 * press.force_n, rel=0.01)


def test_slip_begins_at_the_rim():
    press = pressed()
    found = shear.solve_shear(
        PAD, PIXEL_MM, press.pressure_kpa, TangentialLoad(displacement_mm=(0.1, 0.0), friction=0.5)
    )
    assert found.motion_mm[80, 80, 0] == pytest.approx(0.1, rel=STICK)
    assert 0.05 < (found.motion_mm[press.contact, 0] < (1.0 - STICK) * 0.1).mean() < 0.95


def test_no_load_moves_nothing_and_renders_the_same_bytes():
    press = pressed()
    still = shear.solve_shear(
        PAD, PIXEL_MM, press.pressure_kpa, TangentialLoad(displacement_mm=(0.0, 0.0))
    )
    assert not still.motion_mm.any()
    spec = load_sensor("gelslim")
    none = np.zeros((*spec.camera.shape, 2), np.float32)
    level = np.zeros(spec.camera.shape, np.float32)
    assert np.array_equal(
        optics.render(spec, level, seed=1, shear_mm=none), optics.render(spec, level, seed=1)
    )


def test_markers_are_drawn_where_the_shear_puts_them():
    spec = load_sensor("gelslim")
    moved = np.zeros((*spec.camera.shape, 2), np.float32)
    moved[..., 0] = 3 * spec.pixel_mm
    level = np.zeros(spec.camera.shape, np.float32)
    shifted = optics.render(spec, level, seed=None, shear_mm=moved).astype(int)
    still = optics.render_reference(spec).astype(int)
    dotless = optics.render_reference(load_sensor("gelslim_dotless")).astype(int)
    dark_still = dotless - still
    dark_shifted = dotless - shifted
    inner = np.s_[40:280, 60:360]
    assert (
        np.corrcoef(dark_still[:, :-3][inner].ravel(), dark_shifted[:, 3:][inner].ravel())[0, 1]
        > 0.98
    )
    move_x, _ = optics.compute_marker_motion_px(spec, level, moved)
    assert move_x == pytest.approx(3.0, abs=1e-5)


def test_a_camera_sees_the_motion_of_the_points_it_looks_at():
    spec = load_sensor("gelslim")
    margin = 10
    on = Lattice(
        x0_mm=-(spec.camera.cx_px + margin) * spec.pixel_mm,
        y0_mm=-(spec.camera.cy_px + margin) * spec.pixel_mm,
        step_mm=spec.pixel_mm,
        shape=(spec.camera.rows + 2 * margin, spec.camera.cols + 2 * margin),
    )
    # each point says where it is
    move = np.stack(np.meshgrid(on.x_mm(), on.y_mm()), axis=-1).astype(np.float32)
    lifted = spec.rest_depth_mm - 0.5
    seen = shear.sample_motion_at_pixels(spec.camera, on, move, lifted)
    assert seen == pytest.approx(
        spec.camera.back_project(lifted)[..., :2], abs=0.03 * spec.pixel_mm
    )


def test_wrong_loads_are_refused():
    with pytest.raises(SettingProblem, match="friction"):
        TangentialLoad(displacement_mm=(0.0, 0.0), friction=-1.0)
    with pytest.raises(SettingProblem, match="finite"):
        TangentialLoad(displacement_mm=(np.nan, 0.0))
