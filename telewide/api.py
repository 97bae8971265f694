"""The public interface for notebooks and other programs: photos, rigs and depth as arrays and frozen dataclasses.

    rig = telewide.calibrate("boards/", square_m=0.025)          # or telewide.load_rig("rig.yaml")
    photos = telewide.read_pair("captures/000")
    depth = telewide.estimate_depth(photos, rig=rig)             # depth.depth_m, depth.disparity
    picture = telewide.render_bokeh(photos.tele, depth)

Photos are (H, W, 3) float32 RGB in [0, 1], maps are (H, W) on the tele photo as it was taken; what is unknown is NaN.
The stages of a run go through the same functions for all captures of a folder: they keep corrected pairs as pictures,
and search one window in all. Examples start in a checkout of telewide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from telewide.assets import BOX_WEIGHTS
from telewide.bokeh.aperture import DISK, Aperture
from telewide.bokeh.focus import find_focus
from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.calibration.rig_file import StoredRig, read_rig, stored_rig, write_stored_rig
from telewide.capture.facts import CaptureFacts
from telewide.capture.pair import PhotoPair, find_captures, pair_from_photos, read_photos
from telewide.cores import Device
from telewide.depth.result import DepthResult
from telewide.errors import QualityError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.matching.matcher import Matcher
from telewide.matching.methods import Method
from telewide.matching.window import Window, within_width
from telewide.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from telewide.stages.align import ShotFacts, align_photos, shot_precision
from telewide.stages.calibrate import CalibrateOptions, calibrate_shots
from telewide.stages.match import read_matcher
from telewide.stages.observer import Observer, Silent
from telewide.stages.pairs import window_to_search
from telewide.stages.photo_depth import ShotGeometry, depth_on_photo
from telewide.stages.prepare import CorrectedShot, at_working_size, correct_shot

if TYPE_CHECKING:
    from telewide.stages.train import TrainOutcome

AnyPath = str | PathLike[str]


def read_pair(capture: AnyPath) -> PhotoPair:
    """Read the two photos of one capture as they were taken.

    Args:
        capture: folder that holds ``tele`` and ``wide`` in any format that telewide reads.

    Returns:
        The photos; ``tele`` is (h, w, 3) float32 RGB in [0, 1], ``wide`` likewise, of its own size.

    Raises:
        UsageError: no such folder, or more than one capture in it.
        InputError: a photo cannot be read.

    Example:
        >>> import telewide
        >>> telewide.read_pair("examples/captures/000").tele.dtype
        dtype('float32')
    """
    found = find_captures(Path(capture)).captures
    if len(found) != 1:
        raise UsageError(f"{capture} holds {len(found)} captures; the folder of one was expected")
    return read_photos(found[0])


def load_rig(path: AnyPath) -> StoredRig:
    """Read a ``rig.yaml``.

    Args:
        path: the file.

    Returns:
        The two cameras (``.rig``), how sure each number is, and what the rig is worth (``.quality``).

    Raises:
        UsageError: no such file.
        InputError: it is no rig.

    Example:
        >>> import telewide
        >>> telewide.load_rig("calib/rigs/example_phone.yaml").quality.verdict
        'usable'
    """
    return read_rig(Path(path))


def save_rig(path: AnyPath, rig: StoredRig) -> None:
    """Write a ``rig.yaml``, whole or not at all.

    Args:
        path: the file to write or to replace.
        rig: of :func:`calibrate` or :func:`load_rig`.

    Raises:
        UsageError: the place cannot be written.

    Example:
        >>> import telewide
        >>> telewide.save_rig("/tmp/rig.yaml", telewide.load_rig("calib/rigs/example_phone.yaml"))
    """
    write_stored_rig(Path(path), rig)


def calibrate(
    boards: AnyPath,
    *,
    board: str | None = None,
    square_m: float | None = None,
    seed: int = 0,
    observer: Observer | None = None,
) -> StoredRig:
    """Calibrate two lenses from photos of a board; nothing is written.

    Args:
        boards: folder of the photos, one folder a shot.
        board: name or file of the board; None looks for the known ones.
        square_m: measured side of a square, m; None takes the board's nominal one.
        seed: of the choice of photos that are held out.
        observer: is told of the progress; None for silence.

    Returns:
        The rig, of any verdict: see ``.quality``.

    Raises:
        UsageError: no such folder or board.
        InputError: no photo shows the board, the lenses are exchanged, or no rig explains the photos.

    Example:
        >>> import telewide
        >>> telewide.calibrate("examples/phone/boards", square_m=0.025).rig.baseline_m
        0.01...
    """
    options = CalibrateOptions(board=board, square_m=square_m, seed=seed)
    solved = calibrate_shots(Path(boards), options=options, observer=observer or Silent())
    return stored_rig(solved.calibration, facts=solved.facts)


def rectify(
    photos: PhotoPair,
    *,
    rig: StoredRig | None = None,
    facts: CaptureFacts | None = None,
    recipe: Recipe | None = None,
    seconds_between: float | None = None,
) -> CorrectedShot:
    """Make the two views of one shot comparable: rectified, rows and colours fitted, judged.

    Args:
        photos: as taken.
        rig: of the two lenses; None for photos that are rectified.
        facts: what is known of the photos besides.
        recipe: working width, what is corrected, seed; None for the default recipe.
        seconds_between: between the two exposures; None where nobody knows.

    Returns:
        The corrected pair (``.corrected.pair``), its report and its geometry to the photos (``.alignment``).

    Raises:
        InputError: the photos do not fit the rig or one another.

    Example:
        >>> import telewide
        >>> shot = telewide.rectify(telewide.read_pair("examples/captures/000"))
        >>> shot.report.verdict
        'good'
    """
    recipe = recipe or load_recipe(DEFAULT_RECIPE)
    facts = facts or CaptureFacts(rectified=True)
    if rig is None:
        pair, scale = at_working_size(pair_from_photos(photos, facts=facts), recipe.working_width_px)
        return correct_shot(pair, None, facts=facts, recipe=recipe, scale=scale)
    rectified, alignment = align_photos(
        photos,
        rig=rig.as_held(photos.orientations, tele_hw=photos.tele.shape[:2]),
        working_width_px=recipe.working_width_px,
        facts=ShotFacts(seconds_between),
        seed=recipe.seed,
    )
    return correct_shot(rectified.pair, alignment, facts=facts, recipe=recipe)


def estimate_depth(
    photos: PhotoPair,
    *,
    rig: StoredRig | None = None,
    weights: AnyPath | None = None,
    method: Method = "network",
    device: Device = "auto",
    facts: CaptureFacts | None = None,
    recipe: Recipe | None = None,
) -> DepthResult:
    """Estimate the depth of one shot, on its tele photo.

    Args:
        photos: as taken.
        rig: of the two lenses; None for photos that are rectified.
        weights: of a trained network; None takes the one that comes with telewide.
        method: "network", or "sgm" for semi-global matching.
        device: of the network.
        facts: what is known of the photos besides, such as focal length and baseline where there is no rig.
        recipe: working width, window, corrections, seed; None for the default recipe.

    Returns:
        Disparity with its confidence; metres and their standard deviation where rig or facts state the scale.

    Raises:
        UsageError: the weights that are named do not exist.
        InputError: the photos do not fit the rig or one another, or too few of their points match.
        QualityError: the pair is not fit for depth.

    Example:
        >>> import telewide
        >>> depth = telewide.estimate_depth(telewide.read_pair("examples/captures/000"))
        >>> depth.disparity.disparity_px.shape == telewide.read_pair("examples/captures/000").tele.shape[:2]
        True
    """
    recipe = recipe or load_recipe(DEFAULT_RECIPE)
    facts = facts or CaptureFacts(rectified=True if rig is None else None)
    shot = rectify(photos, rig=rig, facts=facts, recipe=recipe)
    if shot.report.verdict == "refused":
        raise QualityError(f"{photos.name}: {'; '.join(shot.report.reasons)}")
    matcher = read_matcher(Path(weights or BOX_WEIGHTS), method=method, device=device)
    views = shot.corrected.pair
    window = _window(shot, recipe, matcher)
    disparity = matcher.match(views.tele, views.wide, window=window, valid=views.valid)
    geometry = _geometry(shot, rig, matcher=matcher)
    facts = facts.model_copy(update={"wide_side": shot.wide_side})
    return depth_on_photo(disparity, photos.tele, name=photos.name, facts=facts, shot=geometry)[0]


def _window(shot: CorrectedShot, recipe: Recipe, matcher: Matcher) -> Window:
    window = window_to_search([shot.report.disparity_range_px], stated=recipe.window_px, former=matcher.window)
    return within_width(window, shot.corrected.pair.tele.shape[1])


def _geometry(shot: CorrectedShot, rig: StoredRig | None, *, matcher: Matcher) -> ShotGeometry | None:
    if shot.alignment is None or rig is None:
        return None
    precision = shot_precision(shot.alignment, of_set=[shot.alignment], rig=rig)
    precision = replace(precision, confidence_std=matcher.confidence_std)
    return ShotGeometry(shot.alignment.geometry, precision, shot.alignment.moved)


def render_bokeh(
    photo: FloatMap,
    depth: DepthResult,
    *,
    focus: str | tuple[float, float] = "auto",
    strength_px: float | None = None,
    f_number: float | None = None,
    equiv_focal_mm: float = 50.0,
    aperture: Aperture = DISK,
    highlights: float = 1.0,
) -> FloatMap:
    """Blur a photo as a wide-open lens would.

    Args:
        photo: (H, W, 3) float32 sRGB in [0, 1], the tele photo.
        depth: of :func:`estimate_depth`.
        focus: a point (x, y) or "X,Y" in px of the photo, a distance such as "2.5m", near, far or auto.
        strength_px: radius of the strongest blur, px; None for 1.2 % of the longer side.
        f_number: of an imitated lens instead; needs a rig or facts that state the baseline.
        equiv_focal_mm: focal length of that lens on 35 mm film.
        aperture: shape of the opening: a disk or blades.
        highlights: how many times as bright as white small clipped lights are taken to have been.

    Returns:
        (H, W, 3) float32 sRGB; above 1 where highlights are.

    Raises:
        UsageError: an f-number without the baseline, metres that are not known, or a focus outside of the photo.

    Example:
        >>> import telewide
        >>> photos = telewide.read_pair("examples/captures/000")
        >>> picture = telewide.render_bokeh(photos.tele, telewide.estimate_depth(photos), focus="near")
        >>> picture.shape == photos.tele.shape
        True
    """
    focus = focus if isinstance(focus, str) else "{},{}".format(*focus)
    options = BokehOptions(
        focus=focus,
        strength_px=strength_px,
        f_number=f_number,
        equiv_focal_mm=equiv_focal_mm,
        aperture=aperture,
        highlights=highlights,
    )
    maps = depth.disparity
    found = find_focus(
        maps.disparity_px, maps.confidence, focus=focus, disparity_at_m=depth.disparity_at, valid=maps.valid
    )
    return bokeh_picture(lambda: photo, maps, options=options, baseline_m=depth.baseline_m, focus=found)


def train(
    captures: AnyPath,
    *,
    run: AnyPath | None = None,
    recipe: str | Recipe = DEFAULT_RECIPE,
    settings: Sequence[str] = (),
    seed: int | None = None,
    rig: AnyPath | None = None,
    device: Device = "auto",
    fresh: bool = False,
    minutes: float | None = None,
    observer: Observer | None = None,
) -> TrainOutcome:
    """Train a network on a folder of captures, without labels, or continue a training.

    Args:
        captures: their folder.
        run: run folder; None for the one that belongs to the captures.
        recipe: a name, a YAML file, or a resolved recipe.
        settings: dotted overrides such as ``"train.rehearsal.steps=300"``.
        seed: replaces the recipe's, where given.
        rig: rig file; None for the one that lies by the captures.
        device: to compute on.
        fresh: start over where a training lies in the run folder.
        minutes: stop after so many, with a checkpoint that the next call goes on from; None for no such end.
        observer: is told of the progress; None for silence.

    Returns:
        What was reached, to its end or not (``.is_finished``); ``.weights`` is the file for :func:`estimate_depth`.

    Raises:
        TelewideError: no capture can be used, or the training that lies there was begun with another recipe.

    Example:
        >>> import telewide
        >>> telewide.train("examples/captures", run="/tmp/run", recipe="quick", minutes=0.1, fresh=True).is_finished
        False
    """
    from telewide.pipeline import train_captures

    return train_captures(
        Path(captures),
        run=None if run is None else Path(run),
        recipe=recipe if isinstance(recipe, Recipe) else load_recipe(recipe, settings=settings, seed=seed),
        fresh=fresh,
        device=device,
        minutes=minutes,
        observer=observer or Silent(),
        rig=None if rig is None else Path(rig),
    )
