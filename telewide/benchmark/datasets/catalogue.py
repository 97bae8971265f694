"""The data sets by name: where to get them, under which licence, and how they are read.

A set lies below one data folder under its own name, or under one that begins so: ``DATA/hci``, ``DATA/hci_antinous``.
None of them is fetched, and none is part of telewide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from telewide.benchmark.datasets import kitti, light_fields, middlebury
from telewide.benchmark.datasets.own_captures import captures_with_truth, read_capture_with_truth
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.errors import InputError, UsageError, unknown_name
from telewide.files import is_folder

Views = tuple[int, int]
"""Numbers of the left and the right view, where a set has more than two."""

_FULL_HEIGHT_2006_PX = 1110
_HEIGHT_TOLERANCE = 0.1
_MIDDLEBURY_TERMS = "free to use and publish; its authors ask to cite the paper"
_KITTI_TERMS = "CC BY-NC-SA 3.0"
_SIZES = {"third": 3, "half": 2, "full": 1}
"""Of the pictures of Middlebury 2005 and 2006: the full one divided by so much."""
_KITTI_PAGES = {2012: "eval_stereo_flow.php", 2015: "eval_scene_flow.php"}


@dataclass(frozen=True)
class DataSet:
    """One published set.

    Attributes:
        name: of the set, and of its folder.
        source: where to get it.
        licence: what its makers state.
        layout: what the folder holds.
        scenes: root to the names of its scenes.
        read: (root, scene, views) to the pair and its truth.
        views: numbers of the pair that is read unless others are asked for; None where there is one pair only.
    """

    name: str
    source: str
    licence: str
    layout: str
    scenes: Callable[[Path], tuple[str, ...]]
    read: Callable[[Path, str, Views], StereoTruth]
    views: Views | None = None

    @property
    def origin(self) -> str:
        """Name of what was published, whatever the size of its pictures: of one origin and name is one scene."""
        stem, _, size = self.name.rpartition("_")
        return stem if size in _SIZES else self.name


def _one_pair(read: Callable[[Path], StereoTruth]) -> Callable[[Path, str, Views], StereoTruth]:
    """A reader of scene folders for sets of one pair a scene."""
    return lambda root, scene, _views: read(root / scene)


def _middlebury_2006(year: int, size: str, denominator: int) -> DataSet:
    def read(root: Path, scene: str, views: Views) -> StereoTruth:
        if views[0] != 1:
            raise UsageError(f"view {views[0]} as the left one: Middlebury {year} knows the disparity of view 1")
        truth = middlebury.read_middlebury_2006(root / scene, scale_denominator=denominator, right_view=views[1])
        height, expected = truth.left.shape[0], _FULL_HEIGHT_2006_PX / denominator
        if abs(height / expected - 1) > _HEIGHT_TOLERANCE:
            raise InputError(f"{root / scene} is {height} px high; {size}-size scenes have about {expected:.0f}")
        return truth

    return DataSet(
        name=f"middlebury_{year}_{size}",
        source=f"https://vision.middlebury.edu/stereo/data/scenes{year}/ ({size} size)",
        licence=_MIDDLEBURY_TERMS,
        layout="<scene>/view1.png, view5.png, disp1.png, disp5.png",
        scenes=middlebury.middlebury_2006_scenes,
        read=read,
        views=(1, 5),
    )


def _kitti(year: int, layout: kitti.KittiLayout) -> DataSet:
    return DataSet(
        name=f"kitti_{year}",
        source=f"https://www.cvlibs.net/datasets/kitti/{_KITTI_PAGES[year]}?benchmark=stereo",
        licence=_KITTI_TERMS,
        layout=f"training/{layout.views[0][0]}, {layout.views[0][1]}, {layout.all_known}, {layout.visible}",
        scenes=lambda root: kitti.kitti_frames(root, layout),
        read=lambda root, frame, _views: kitti.read_kitti(root, frame, layout=layout),
    )


_SETS = (
    DataSet(
        name="middlebury_2001",
        source="https://vision.middlebury.edu/stereo/data/scenes2001/",
        licence=_MIDDLEBURY_TERMS,
        layout="<scene>/im2.ppm, im6.ppm, disp2.pgm, disp6.pgm; Tsukuba with scene1.row3.col3.ppm, col4 and truedisp",
        scenes=middlebury.scenes_2001,
        read=_one_pair(middlebury.read_middlebury_2001),
    ),
    DataSet(
        name="middlebury_2003",
        source="https://vision.middlebury.edu/stereo/data/scenes2003/",
        licence=_MIDDLEBURY_TERMS,
        layout="<scene>/im2, im6, disp2, disp6 and, where there is one, occl; .png, .ppm or .pgm",
        scenes=middlebury.scenes_2003,
        read=_one_pair(middlebury.read_middlebury_2003),
    ),
    *(_middlebury_2006(year, size, denominator) for year in (2005, 2006) for size, denominator in _SIZES.items()),
    DataSet(
        name="middlebury_2014",
        source="https://vision.middlebury.edu/stereo/data/scenes2014/",
        licence=_MIDDLEBURY_TERMS,
        layout="<scene>/im0.png, im1.png, disp0.pfm or disp0GT.pfm, mask0nocc.png or disp1.pfm",
        scenes=middlebury.scenes_2014,
        read=_one_pair(middlebury.read_middlebury_2014),
    ),
    _kitti(2012, kitti.KITTI_2012),
    _kitti(2015, kitti.KITTI_2015),
    DataSet(
        name="kitti_one_frame",
        source="a frame of KITTI 2015 as examples of stereo matching carry it",
        licence=_KITTI_TERMS,
        layout="reference.png, target.png, ground-truth.png in whole px",
        scenes=kitti.whole_px_frame,
        read=lambda root, _frame, _views: kitti.read_whole_px_frame(root),
    ),
    DataSet(
        name="hci",
        source="https://lightfield-analysis.uni-konstanz.de",
        licence="CC BY-NC-SA 4.0",
        layout="<scene>/input_Cam000.png to input_Cam080.png, gt_disp_lowres.pfm; or one folder deeper",
        scenes=light_fields.hci_scenes,
        read=lambda root, scene, views: light_fields.read_hci(root, scene, views=views),
        views=(40, 44),
    ),
    DataSet(
        name="inria_slfd",
        source="http://clim.inria.fr/Datasets/InriaSynLF/index.html",
        licence="none stated; its authors ask to cite the paper",
        layout="<scene>/lf_1_1.png to lf_9_9.png, disparity_1_1.npy to disparity_9_9.npy",
        scenes=light_fields.inria_scenes,
        read=lambda root, scene, views: light_fields.read_inria(root, scene, views=views),
        views=(40, 41),
    ),
    DataSet(
        name="captures",
        source="your own photos, or `telewide simulate`",
        licence="your own",
        layout="<capture>/tele.png, wide.png, truth.pfm",
        scenes=captures_with_truth,
        read=lambda root, scene, _views: read_capture_with_truth(root, scene),
    ),
)
DATA_SETS: dict[str, DataSet] = {data_set.name: data_set for data_set in _SETS}


def find_data_set(name: str) -> DataSet:
    """Find a data set by its name.

    Args:
        name: one of `DATA_SETS`.

    Raises:
        UsageError: there is no such set; the nearest name is told.
    """
    if name not in DATA_SETS:
        raise unknown_name("data set", name, DATA_SETS)
    return DATA_SETS[name]


def locate(data_set: DataSet, data_root: Path) -> Path | None:
    """Find where a set lies below the data folder; None where it does not, or holds no scene.

    Args:
        data_set: which set.
        data_root: the data folder.

    Raises:
        UsageError: there is no data folder.
    """
    if not is_folder(data_root):
        raise UsageError(f"{data_root} is no folder; the folder that holds the data sets was expected")
    longer = sorted(path for path in data_root.glob(f"{data_set.name}_*") if path.name not in DATA_SETS)
    return next((path for path in (data_root / data_set.name, *longer) if _has_scenes(data_set, path)), None)


def missing_note(data_set: DataSet, data_root: Path) -> str:
    """Say that a set is left out, where to get it, under which licence and where it should lie."""
    return (
        f"{data_set.name} is left out: it is not in {data_root}. Get it at {data_set.source} (licence: "
        f"{data_set.licence}) and unpack it to {data_root / data_set.name}: {data_set.layout}"
    )


def _has_scenes(data_set: DataSet, root: Path) -> bool:
    try:
        return is_folder(root) and bool(data_set.scenes(root))
    except InputError:
        return False
