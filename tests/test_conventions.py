"""One test for each line of CONVENTIONS.md.

A line about names is checked by walking the source; such a check is first shown a line that breaks the rule, so that it
cannot pass by finding nothing. A line about numbers is checked against OpenCV, torch or a closed form.
"""

from __future__ import annotations

import ast
import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image
from rigs import in_wide, phone, points_in_view
from source import Module, at, calls, functions, identifiers, module_from_text, modules, parameters

from telewide.capture.images import read_image, resize_bicubic, write_image
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.depth.unrectify import disparity_on_tele
from telewide.geometry.camera import scaled_intrinsics, scaled_points
from telewide.geometry.rectification import rectified_geometry
from telewide.geometry.rig import StereoRig
from telewide.geometry.stereo import DisparityMap, depth_from_disparity, resize_disparity
from telewide.simulate.degrade import shrink_and_enlarge

Check = Callable[[Module], Iterator[str]]


def holds(check: Check, *, broken_by: tuple[str, ...]) -> None:
    """A rule finds nothing in the package, and something in each of the lines that break it."""
    for text in broken_by:
        assert list(check(module_from_text(text))), f"the check does not see what is wrong with: {text}"
    assert [finding for module in modules() for finding in check(module)] == []


def words(name: str) -> list[str]:
    """Lower-case words of an identifier; the letters of the axes stay together."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+|[0-9]+", name)]


# Frames


def test_convention_views_are_tele_and_wide() -> None:
    def check(module: Module) -> Iterator[str]:
        if module.name.startswith("benchmark.datasets"):  # published data sets say left and right
            return
        sided = [(a.arg, a.lineno) for f in functions(module) for a in parameters(f) if a.arg in {"left", "right"}]
        for name, line in identifiers(module):
            is_sided = {"left", "right"} & set(words(name)) and VIEWS & set(words(name))
            if is_sided or re.fullmatch(r"(im|img|image|cam|camera|view|photo|lens)_?[0-9]", name):
                sided.append((name, line))
        yield from (at(module, line, name) for name, line in sided)

    # A rectangle has a left side too; what is not called so is a view and what was measured in one.
    VIEWS = {"image", "img", "view", "camera", "cam", "photo", "lens", "disparity", "depth", "features", "eye", "hw"}
    sided = ("def f(left, right): ...", "f(right_image=x)", "left_disparity_px = 1")
    holds(check, broken_by=(*sided, "cam0 = a", "a.img_1"))


def test_convention_ref_is_the_view_the_depth_is_for() -> None:
    def check(module: Module) -> Iterator[str]:
        for function in functions(module):
            names = [a.arg for a in parameters(function)]
            for prefix in ("", "tele_", "image_"):
                order = [n for n in names if re.fullmatch(rf"{prefix}(ref|src)(_[A-Z]+|_px)?", n)]
                if order and "src" in order[0] and any("ref" in n for n in order):
                    yield at(module, function.lineno, f"{function.name} takes {order}")

    holds(check, broken_by=("def match(src, ref): ...", "def warp(src_BCHW, ref_BCHW): ..."))
    from telewide.capture.facts import CaptureFacts

    assert CaptureFacts().reference == "tele"


# Transforms


def test_convention_transforms_chain_by_name() -> None:
    def check(module: Module) -> Iterator[str]:
        for function in functions(module):
            first, _, second = function.name.strip("_").partition("_to_")
            if FRAMES & set(words(first)[-1:]) and FRAMES & set(words(second)[:1]):
                yield at(module, function.lineno, f"{function.name}: call a converter a_from_b")
        for node in ast.walk(module.tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
                first, second = (_last_name(side) for side in (_rightmost(node.left), node.right))
                if "_from_" in first and "_from_" in second:
                    inner, outer = first.partition("_from_")[2], second.partition("_from_")[0]
                    if inner.removesuffix("_3x3") != outer:
                        yield at(module, node.lineno, f"{first} @ {second}")

    FRAMES = {"tele", "wide", "ref", "src", "rect", "camera", "world", "px", "m", "deg", "rad", "hw", "wh", "xy"} | {
        *{"linear", "srgb", "rgb", "bgr", "grey", "image", "points", "pixels", "depth", "disparity"}
    }
    chains = ("tele_from_wide @ tele_from_wide", "a_from_b @ b_from_c @ b_from_d")
    holds(check, broken_by=("def tele_to_wide(x): ...", *chains))
    assert list(check(module_from_text("a_from_b @ b_from_c @ c_from_d @ p_d"))) == []


def _rightmost(node: ast.expr) -> ast.expr:
    return _rightmost(node.right) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult) else node


def _last_name(node: ast.expr) -> str:
    return ast.unparse(node).rpartition(".")[2]


# Axes


def test_convention_points_are_x_y() -> None:
    scaled = scaled_points(np.array([10.0, 20.0]), scale_xy=(2.0, 1.0))
    np.testing.assert_allclose(scaled, [20.5, 20.0])
    # A detector of ours and one of OpenCV's place a spot at column 90, row 30 alike.
    from telewide.points.matches import Matches

    fields = Matches(ref_px=np.array([[90.0, 30.0]]), src_px=np.array([[80.0, 29.0]]))
    np.testing.assert_allclose(fields.disparity_px, [10.0])
    np.testing.assert_allclose(fields.vertical_px, [1.0])


def test_convention_points_count_on_the_upright_photo(tmp_path: Path) -> None:
    from telewide.bokeh.picture import BokehOptions, check_bokeh
    from telewide.capture.pair import find_captures
    from telewide.errors import UsageError

    stored = np.zeros((40, 60, 3), np.uint8)
    stored[:8, 52:] = 255  # top right; turned clockwise it comes to the bottom right
    turned_clockwise = Image.Exif()
    turned_clockwise[0x0112] = 6
    for name, levels in (("tele", stored), ("wide", 255 - stored)):
        (tmp_path / "one").mkdir(exist_ok=True)
        Image.fromarray(levels).save(tmp_path / "one" / f"{name}.jpg", exif=turned_clockwise, quality=95)
    (tmp_path / "captures.yaml").write_text("rotated_deg: 90\n")
    captures = find_captures(tmp_path)
    photo = read_image(captures.captures[0].tele_path)
    assert photo.shape == (60, 40, 3)
    np.testing.assert_allclose(photo[56, 36], 1.0, atol=0.02)
    check_bokeh(BokehOptions(focus="59,39"), captures)
    with pytest.raises(UsageError, match="outside the tele photo of 60 x 40 px"):
        check_bokeh(BokehOptions(focus="39,59"), captures)
    check_bokeh(BokehOptions(focus="39,59"), captures, has_rig=True)


def test_convention_rotated_deg_is_counter_clockwise(tmp_path: Path, rng: np.random.Generator) -> None:
    from telewide.capture.facts import read_facts
    from telewide.depth.export import write_depth
    from telewide.depth.result import depth_result

    photo = rng.random((48, 64, 3)).astype(np.float32)
    disparity_px = np.linspace(2, 9, 48 * 64, dtype=np.float32).reshape(48, 64)
    for folder, turn in (("0", lambda image: image), ("90", lambda image: cv2.rotate(image, 2))):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "captures.yaml").write_text(f"rotated_deg: {folder}\n")
        given_px, known = turn(disparity_px), np.ones(turn(disparity_px).shape, np.bool_)
        disparity = DisparityMap(given_px, known.astype(np.float32), known)
        result = depth_result("shot", disparity, facts=read_facts(tmp_path / folder / "captures.yaml"))
        write_depth(tmp_path / folder, result, image=turn(photo))
        np.testing.assert_array_equal(read_pfm(tmp_path / folder / "disparity.pfm"), disparity_px)
    assert cv2.ROTATE_90_COUNTERCLOCKWISE == 2
    upright, turned_back = (read_image(tmp_path / folder / "preview.png") for folder in ("0", "90"))
    np.testing.assert_allclose(turned_back, upright, atol=0.01)


def test_convention_sizes_are_hw_or_wh() -> None:
    def check(module: Module) -> Iterator[str]:
        for name, line, annotation in _annotated(module):
            if annotation == "tuple[int, int]" and words(name)[-1] in {"size", "shape", "resolution", "dims"}:
                yield at(module, line, f"{name}: {annotation}")

    holds(check, broken_by=("def f(size: tuple[int, int]): ...", "class A:\n    image_shape: tuple[int, int]"))
    assert resize_bicubic(np.zeros((20, 40, 3), np.float32), wh=(10, 30)).shape == (30, 10, 3)


def test_convention_images_are_rgb_float(tmp_path: Path) -> None:
    image = np.zeros((40, 50, 3), np.float32)
    image[..., 0] = 1.0
    write_image(tmp_path / "red.png", image)
    assert cv2.imread(str(tmp_path / "red.png"))[7, 5].tolist() == [0, 0, 255]  # OpenCV reads BGR
    again = read_image(tmp_path / "red.png")
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, image)


def test_convention_value_space_in_the_name() -> None:
    def check(module: Module) -> Iterator[str]:
        for function in functions(module):
            called = {name for name, _ in calls(Module("", module.path, ast.Module([function], [])))}
            if not called & {"linear_from_srgb", "srgb_from_linear"} and "_linear" not in function.name:
                continue
            bare = [a.arg for a in parameters(function) if a.arg in {"image", "tele", "wide", "ref", "src", "photo"}]
            if bare:
                yield at(module, function.lineno, f"{function.name} takes {bare}, encoded or linear?")

    holds(check, broken_by=("def blur(image):\n    return linear_from_srgb(image)",))


# Pixels


def centroid_xy(image: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(columns * image).sum(), (rows * image).sum()]) / image.sum()


def spot(hw: tuple[int, int], *, at_xy: tuple[float, float], sigma_px: float = 6.0) -> NDArray[np.float32]:
    rows, columns = np.mgrid[: hw[0], : hw[1]]
    square = (columns - at_xy[0]) ** 2 + (rows - at_xy[1]) ** 2
    return np.exp(-square / (2 * sigma_px**2)).astype(np.float32)


@pytest.mark.parametrize("scale", [0.5, 2.0, 3.0])
def test_convention_pixel_zero_is_a_centre(scale: float) -> None:
    import torch

    image = spot((64, 96), at_xy=(41.3, 30.6))
    expected = scaled_points(np.array([41.3, 30.6]), scale_xy=(scale, scale))
    by_opencv = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(centroid_xy(by_opencv), expected, atol=0.01)
    by_torch = torch.nn.functional.interpolate(
        torch.from_numpy(image)[None, None], scale_factor=scale, mode="bilinear", align_corners=False
    )[0, 0].numpy()
    np.testing.assert_allclose(centroid_xy(by_torch), expected, atol=0.01)


def test_convention_principal_point_scales_like_a_point() -> None:
    K = np.array([[900.0, 0.0, 321.0], [0.0, 900.0, 243.0], [0.0, 0.0, 1.0]])
    scaled = scaled_intrinsics(K, scale_xy=(0.5, 0.25))
    np.testing.assert_allclose(scaled[:2, 2], scaled_points(K[:2, 2], scale_xy=(0.5, 0.25)))
    np.testing.assert_allclose(np.diag(scaled), [450.0, 225.0, 1.0])
    # A point at infinity is seen at both principal points. Tele and wide are scaled by 1 and 3 here: the naive cx * s
    # leaves (s_tele - s_wide) / 2 in the disparity.
    s_tele, s_wide = 1.0, 3.0
    tele, wide = (scaled_intrinsics(K, scale_xy=(s, s)) for s in (s_tele, s_wide))
    naive_px = K[0, 2] * s_tele - K[0, 2] * s_wide
    assert (tele[0, 2] - wide[0, 2]) - naive_px == pytest.approx((s_tele - s_wide) / 2)


def test_convention_align_corners_is_false() -> None:
    def check(module: Module) -> Iterator[str]:
        for name, call in calls(module):
            if name not in {"interpolate", "grid_sample", "affine_grid", "Upsample"}:
                continue
            given = {k.arg: ast.unparse(k.value) for k in call.keywords}
            takes_none = given.get("mode", "'nearest'").strip("'\"").startswith(("nearest", "area"))
            if given.get("align_corners") != "False" and not (name in {"interpolate", "Upsample"} and takes_none):
                yield at(module, call.lineno, f"{name} without align_corners=False")

    holds(
        check,
        broken_by=(
            "F.grid_sample(a, b)",
            "F.interpolate(a, mode='bilinear', align_corners=True)",
            "F.interpolate(a, scale_factor=2, mode='trilinear')",
        ),
    )


@pytest.mark.parametrize("factor", [2.0, 3.0, 3.7])
def test_convention_enlarging_keeps_things_in_place(factor: float) -> None:
    image = np.repeat(spot((90, 120), at_xy=(51.4, 40.8), sigma_px=7.0)[..., None], 3, axis=2)
    there_and_back = shrink_and_enlarge(image, factor=factor)
    assert there_and_back.shape == image.shape
    np.testing.assert_allclose(centroid_xy(there_and_back[..., 0]), [51.4, 40.8], atol=0.02)
    enlarged = resize_bicubic(image, wh=(360, 270))
    expected = scaled_points(np.array([51.4, 40.8]), scale_xy=(3.0, 3.0))
    np.testing.assert_allclose(centroid_xy(enlarged[..., 0]), expected, atol=0.02)


# Units

QUANTITIES = {"baseline", "depth", "disparity", "distance", "radius", "angle", "offset", "focal", "sigma", "duration"}
UNITS = {"px", "m", "mm", "deg", "rad", "s", "ev", "db", "xy"}


def test_convention_units_are_in_the_name() -> None:
    def check(module: Module) -> Iterator[str]:
        for name, line, annotation in _annotated(module):
            is_number = re.fullmatch(r"(tuple\[)?float(, float|, \.\.\.)*\]?( \| None)?", annotation)
            if is_number and QUANTITIES & set(words(name)) and not UNITS & set(words(name)):
                yield at(module, line, f"{name}: {annotation} without a unit")
            if "mm" in words(name) and not {"focal", "f35", "tele", "wide"} & {*words(name), name.partition("_")[0]}:
                yield at(module, line, f"{name}: metres only")

    holds(
        check,
        broken_by=(
            "def f(*, baseline: float): ...",
            "class A:\n    blur_sigma: tuple[float, float]",
            "class A:\n    baseline_mm: float | None",
        ),
    )


def test_convention_boards_are_in_metres(repo: Path) -> None:
    boards = sorted((repo / "calib/boards").glob("*.yaml"))
    assert boards
    for path in boards:
        lengths = {k: v for k, v in yaml.safe_load(path.read_text()).items() if k in {"square_m", "marker_m"}}
        assert lengths, path
        assert all(0.001 < length_m <= 0.2 for length_m in lengths.values()), path


# Disparity


def shifted_pair(disparity_px: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A plane that faces the cameras: what ref sees at x, src sees at x - d."""
    noise = np.random.default_rng(3).random((96, 240, 3)).astype(np.float32)
    wide_strip = cv2.GaussianBlur(noise, (0, 0), 1.5)
    wide_strip = (wide_strip - wide_strip.min()) / np.ptp(wide_strip)
    return wide_strip[:, 40:200], wide_strip[:, 40 + disparity_px : 200 + disparity_px]


def matchers() -> dict[str, Callable[..., DisparityMap]]:
    from telewide.matching.semiglobal import match_semiglobal

    return {"semiglobal": match_semiglobal}


def test_convention_disparity_is_ref_minus_src() -> None:
    from telewide.simulate.layers import Layer, LayeredScene, render_pair

    texture = cv2.GaussianBlur(np.random.default_rng(1).random((60, 140, 3)).astype(np.float32), (0, 0), 1.0)
    plane = Layer(texture=texture, alpha=None, origin_xy=(-20, 0), plane_px=(7.0, 0.0, 0.0))
    pair = render_pair(LayeredScene(layers=(plane,), hw=(60, 100)))
    np.testing.assert_allclose(pair.disparity_px, 7.0)
    np.testing.assert_allclose(pair.src[:, : 100 - 7], pair.ref[:, 7:], atol=0.01)  # x_src = x_ref - 7


@pytest.mark.parametrize("disparity_px", [-17, 0, 17])
def test_convention_matchers_take_any_window(disparity_px: int) -> None:
    ref, src = shifted_pair(disparity_px)
    for name, match in matchers().items():
        found = match(ref, src, window=(-32, 32))
        assert np.median(found.disparity_px) == pytest.approx(disparity_px, abs=0.3), name
        assert not np.isnan(found.disparity_px).any(), name


@pytest.mark.parametrize("place_of_wide", ["horizontal", "reversed", "vertical", "vertical, reversed"])
def test_convention_rectifying_fixes_the_sign(place_of_wide: str, rng: np.random.Generator) -> None:
    rig = phone(place_of_wide)
    geometry = rectified_geometry(rig)
    points_m = points_in_view(rig, rng, n=20)
    ref_px = geometry.ref_from_tele(rig.tele.project(points_m))
    src_px = geometry.src_from_wide(rig.wide.project(in_wide(rig, points_m)))
    np.testing.assert_allclose(ref_px[:, 1], src_px[:, 1], atol=1e-6)
    assert np.all(ref_px[:, 0] - src_px[:, 0] + geometry.doffs_px > 0)
    # Counter-clockwise is what numpy calls a positive turn: the photo's right border comes to the top.
    along_x = np.diff(geometry.ref_from_tele(np.array([[1000.0, 1500.0], [3000.0, 1500.0]])), axis=0)[0]
    if place_of_wide.startswith("vertical"):
        assert along_x[1] < -1900
    else:
        assert np.sign(along_x[0]) == (-1 if place_of_wide == "reversed" else 1)
    assert (np.linalg.det(geometry.rect_from_tele) < 0) == place_of_wide.endswith("reversed")


def test_convention_resizing_scales_disparity(rng: np.random.Generator) -> None:
    disparity_px = rng.uniform(-9, 60, (24, 36)).astype(np.float32)
    np.testing.assert_allclose(resize_disparity(disparity_px, wh=(72, 24))[:, ::2], 2 * disparity_px, rtol=1e-6)

    def check(module: Module) -> Iterator[str]:
        for name, call in calls(module):
            is_resize = name in {"resize", "resize_bicubic", "interpolate"}
            if is_resize and call.args and re.search("disparit", ast.unparse(call.args[0])):
                inside = [f.name for f in functions(module) if f.lineno <= call.lineno <= (f.end_lineno or 0)]
                if "resize_disparity" not in inside:
                    yield at(module, call.lineno, ast.unparse(call))

    holds(check, broken_by=("def f(disparity_px):\n    return cv2.resize(disparity_px, wh)",))


# Depth


def test_convention_depth_is_z_of_ref(rng: np.random.Generator) -> None:
    # Two pinholes side by side, with different principal points; src stands baseline_m to ref's positive x.
    f_px, baseline_m, cx_ref, cx_src = 1200.0, 0.012, 640.0, 655.5
    points_m = rng.uniform([-1, -1, 0.5], [1, 1, 8], (40, 3))
    x_ref = f_px * points_m[:, 0] / points_m[:, 2] + cx_ref
    x_src = f_px * (points_m[:, 0] - baseline_m) / points_m[:, 2] + cx_src
    disparity_px = (x_ref - x_src)[None].astype(np.float32)
    depth_m = depth_from_disparity(disparity_px, f_px=f_px, baseline_m=baseline_m, doffs_px=cx_src - cx_ref)
    np.testing.assert_allclose(depth_m[0], points_m[:, 2], rtol=2e-4)


def test_convention_depth_of_a_photo_is_along_its_own_axis() -> None:
    rig = phone("one farther back", shrink=20)  # the rectified axis is turned by 18 degrees here
    geometry = rectified_geometry(rig)
    rows, columns = np.mgrid[: geometry.hw[0], : geometry.hw[1]]
    rays = np.stack([columns, rows], axis=-1) - geometry.ref_centre_px
    # A wall that faces tele, 2 m away.
    rect_depth_m = 2.0 / (np.dstack([rays / geometry.f_px, np.ones(geometry.hw)]) @ geometry.rect_from_tele[:, 2])
    disparity_px = (geometry.f_px * rig.baseline_m / rect_depth_m).astype(np.float32)
    assert np.ptp(disparity_px) > 0.05 * disparity_px.mean()
    known = np.ones(geometry.hw, np.bool_)
    on_tele = disparity_on_tele(DisparityMap(disparity_px, known.astype(np.float32), known), geometry=geometry)
    depth_m = rig.tele.K[0, 0] * rig.baseline_m / on_tele.disparity_px
    np.testing.assert_allclose(depth_m[1:-1, 1:-1], 2.0, rtol=1e-3)


def test_convention_truth_is_disparity_on_the_tele_photo(tmp_path: Path) -> None:
    from telewide.capture.pair import find_captures, read_truth
    from telewide.simulate.captures import write_captures
    from telewide.simulate.phone import write_phone

    write_captures(tmp_path / "pairs", count=1, seed=4, hw=(160, 240), factor=2)
    rig = write_phone(tmp_path, captures=1, boards=0, seed=4, width=480, moves=False, cast=False)
    places = {"pairs": lambda x, y, d_px: (x - d_px, y), "captures": lambda x, y, d_px: _seen_by_wide(x, y, d_px, rig)}
    for folder, place_in_wide in places.items():
        (capture,) = find_captures(tmp_path / folder).captures
        tele, wide = read_image(capture.tele_path), read_image(capture.wide_path)
        if folder == "pairs":
            wide = resize_bicubic(wide, wh=(tele.shape[1], tele.shape[0]))
        truth_px = read_truth(capture, hw=tele.shape[:2])
        assert truth_px is not None
        rows, columns = np.indices(truth_px.shape).astype(np.float32)
        soft = cv2.GaussianBlur(tele, (0, 0), 2.0)  # about as soft as wide
        missed = []
        for share in (1.0, 0.8, 1.2):
            x, y = place_in_wide(columns, rows, share * truth_px)
            seen = cv2.remap(wide, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
            missed.append(float(np.mean(np.abs(seen - soft))))
        assert missed[0] < 0.8 * min(missed[1:]), folder
        truth_px[3, 5] = np.nan
        write_pfm(tmp_path / folder / capture.name / "truth.pfm", truth_px)
        np.testing.assert_array_equal(read_truth(capture), truth_px)


def _seen_by_wide(
    x: NDArray[np.float32], y: NDArray[np.float32], disparity_px: NDArray[np.float32], rig: StereoRig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where wide sees what tele sees at (x, y), by the depth that a disparity on the tele photo stands for."""
    depth_m = rig.tele.K[0, 0] * rig.baseline_m / disparity_px.astype(np.float64)
    rays = rig.tele.normalised(np.column_stack([x.ravel(), y.ravel()]))
    points_m = np.column_stack([rays, np.ones(len(rays))]) * depth_m.reshape(-1, 1)
    seen_px = rig.wide.project(in_wide(rig, points_m))
    return seen_px[:, 0].reshape(x.shape), seen_px[:, 1].reshape(x.shape)


def test_convention_in_front_is_positive() -> None:
    disparity_px = np.array([[-3.0, -2.0, -1.0, 5.0]], np.float32)
    depth_m = depth_from_disparity(disparity_px, f_px=100.0, baseline_m=0.1, doffs_px=2.0)
    np.testing.assert_array_equal(np.isnan(depth_m), [[True, True, False, False]])
    assert np.all(depth_m[~np.isnan(depth_m)] > 0)


# Unknown values


def test_convention_unknown_is_nan(tmp_path: Path) -> None:
    disparity_px = np.array([[1.0, np.nan], [-1.0, 0.0]], np.float32)
    np.testing.assert_array_equal(np.isnan(resize_disparity(disparity_px, wh=(4, 4))[::2, ::2]), np.isnan(disparity_px))
    depth_m = depth_from_disparity(disparity_px, f_px=100.0, baseline_m=0.1)
    np.testing.assert_array_equal(np.isnan(depth_m), [[False, True], [True, True]])
    assert not np.isinf(depth_m).any()
    write_pfm(tmp_path / "map.pfm", disparity_px)
    np.testing.assert_array_equal(read_pfm(tmp_path / "map.pfm"), disparity_px)


def test_convention_files_use_their_own_code(tmp_path: Path) -> None:
    disparity_px = np.array([[1.0, np.nan], [2.0, 3.0]], np.float32)
    write_pfm(tmp_path / "map.pfm", disparity_px)
    values = struct.unpack("<4f", (tmp_path / "map.pfm").read_bytes()[-16:])
    assert values == (2.0, 3.0, 1.0, np.inf)  # bottom row first

    from telewide.depth.export import write_depth
    from telewide.depth.result import depth_result

    known = ~np.isnan(disparity_px)
    result = depth_result("shot", DisparityMap(disparity_px, known.astype(np.float32), known))
    write_depth(tmp_path / "shot", result)
    levels = cv2.imread(str(tmp_path / "shot/disparity.png"), cv2.IMREAD_UNCHANGED)
    assert levels.tolist() == [[256, 0], [512, 768]]


# Asymmetry


def test_convention_asymmetry_is_at_least_one(tmp_path: Path) -> None:
    from telewide.capture.facts import read_facts
    from telewide.errors import InputError

    sheet = tmp_path / "captures.yaml"
    sheet.write_text("format: 1\nasymmetry: 3.0\n")
    assert read_facts(sheet).asymmetry == 3.0
    sheet.write_text("format: 1\nasymmetry: 0.33\n")
    with pytest.raises(InputError, match="asymmetry"):
        read_facts(sheet)


# Letters and names


NAMES_OF_COLOUR_SCIENCE = {"matrix_RGB_to_XYZ", "XYZ_to_Lab", "delta_E_CIE2000"}


def test_convention_volumes_carry_their_letters() -> None:
    def check(module: Module) -> Iterator[str]:
        known = set("BCDHWN") | set(re.findall(r"\b[A-Z]\b", ast.get_docstring(module.tree) or ""))
        for name, line in identifiers(module):
            letters = re.sub(r"[0-9]", "", name.rpartition("_")[2])
            if not letters.isupper() or len(letters) < 2 or name.isupper() or name in NAMES_OF_COLOUR_SCIENCE:
                continue
            if not set(letters) <= known:
                yield at(module, line, f"{name}: the module's docstring does not say what {letters} are")
            elif "B" in letters and letters != "".join(k for k in "BCGDNHW" if k in letters):
                yield at(module, line, f"{name}: torch keeps batch, channels, planes, rows, columns")
        for name, line, annotation in _annotated(module):
            if annotation == "Tensor" and words(name)[-1] in {"cost", "volume"}:
                yield at(module, line, f"{name} without its letters")

    holds(check, broken_by=("cost_BDCHW = 1", "cost_BXHW = 1", "def f(cost: Tensor): ..."))


def test_convention_booleans_are_is_or_has() -> None:
    def check(module: Module) -> Iterator[str]:
        for function in functions(module):
            answers = function.returns is not None and ast.unparse(function.returns) == "bool"
            if answers and words(function.name)[0] not in {"is", "has", "needs"} and not function.name.startswith("__"):
                yield at(module, function.lineno, f"{function.name} -> bool")

    holds(check, broken_by=("def check_rows(a) -> bool: ...",))


def _annotated(module: Module) -> Iterator[tuple[str, int, str]]:
    """(name, line, annotation) of every parameter and every field."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.arg) and node.annotation is not None:
            yield node.arg, node.lineno, ast.unparse(node.annotation)
        elif isinstance(node, ast.AnnAssign):
            yield ast.unparse(node.target), node.lineno, ast.unparse(node.annotation)


def test_every_line_has_its_test_and_every_test_its_line(repo: Path) -> None:
    lines = re.findall(r"^- `(\w+)`:", (repo / "CONVENTIONS.md").read_text(), flags=re.MULTILINE)
    tests = [name.removeprefix("test_convention_") for name in globals() if name.startswith("test_convention_")]
    assert lines == tests
    bullets = re.findall(r"^- ", (repo / "CONVENTIONS.md").read_text(), flags=re.MULTILINE)
    assert len(bullets) == len(lines)
