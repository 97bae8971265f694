"""Depth into files other programs read: which formats there are, and all files of one capture.

Each format is a file of `telewide.depth.formats`; what 0 and white mean in each is in ``docs/formats.md``. The files
hold the filled map; ``valid`` in the npz says which of it was measured.
Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from telewide.capture.images import write_image
from telewide.capture.pictures import PictureFacts
from telewide.depth.formats.contents import Contents, WrittenDepth
from telewide.depth.formats.depth_png_file import MM_NAME, write_depth_png
from telewide.depth.formats.disparity_png_file import PNG_NAME, write_disparity_png
from telewide.depth.formats.dynamic_depth_file import DYNAMIC_DEPTH_NAME, write_dynamic_depth
from telewide.depth.formats.exr_file import EXR_NAME, write_exr
from telewide.depth.formats.gdepth_file import GDEPTH_NAME, write_gdepth
from telewide.depth.formats.glb_file import GLB_NAME, write_glb
from telewide.depth.formats.grey_files import GREY16_NAME, GREY_NAME, PHOTO_NAME, write_grey
from telewide.depth.formats.heif_file import HEIC_NAME, write_heic
from telewide.depth.formats.numpy_archive import NPZ_NAME, write_npz
from telewide.depth.formats.pfm_file import PFM_NAME, write_pfm_file
from telewide.depth.formats.ply_file import PLY_NAME, write_ply
from telewide.depth.formats.tiff_file import DEPTH_TIFF_NAME, DISPARITY_TIFF_NAME, write_tiff
from telewide.depth.preview import preview
from telewide.depth.result import DepthResult, stood_upright
from telewide.drawing import upright
from telewide.errors import MissingPartError, extra_hint, unknown_name
from telewide.geometry.arrays import FloatMap

PREVIEW_NAME = "preview.png"
ALL = "all"


@dataclass(frozen=True)
class DepthFormat:
    """One kind of file.

    Attributes:
        write: writes it into a folder, or says why it cannot be made.
        names: of the files it may write.
        module: that it needs beyond what telewide always has; None for none.
        extra: of ``pyproject.toml`` that brings the module.
    """

    write: Callable[[Path, Contents], WrittenDepth]
    names: tuple[str, ...]
    module: str | None = None
    extra: str = ""

    @property
    def is_installed(self) -> bool:
        """Whether it can be written here."""
        return self.module is None or find_spec(self.module) is not None


FORMATS = {
    "pfm": DepthFormat(write_pfm_file, (PFM_NAME,)),
    "png": DepthFormat(write_disparity_png, (PNG_NAME,)),
    "npz": DepthFormat(write_npz, (NPZ_NAME,)),
    "mm": DepthFormat(write_depth_png, (MM_NAME,)),
    "tiff": DepthFormat(write_tiff, (DEPTH_TIFF_NAME, DISPARITY_TIFF_NAME)),
    "grey": DepthFormat(write_grey, (PHOTO_NAME, GREY_NAME, GREY16_NAME)),
    "gdepth": DepthFormat(write_gdepth, (GDEPTH_NAME,)),
    "dynamic": DepthFormat(write_dynamic_depth, (DYNAMIC_DEPTH_NAME,)),
    "ply": DepthFormat(write_ply, (PLY_NAME,), module="trimesh", extra="mesh"),
    "glb": DepthFormat(write_glb, (GLB_NAME,), module="trimesh", extra="mesh"),
    "exr": DepthFormat(write_exr, (EXR_NAME,), module="OpenEXR", extra="exr"),
    "heic": DepthFormat(write_heic, (HEIC_NAME,), module="pillow_heif", extra="heif"),
}
WITH_FACTS = frozenset({"grey", "gdepth", "dynamic", "exr", "heic"})
"""Formats that say when and with what the photo was taken."""
IN_OWN_COLOURS = frozenset({"heic"})
"""Formats that hold the photo in the colours of its profile."""
DEFAULT_FORMATS = ("pfm", "png", "npz")
ALWAYS = "npz"
"""Files that telewide reads again, and so always writes."""


def file_names(formats: Iterable[str]) -> tuple[str, ...]:
    """Names of the files that formats may write, and of the preview."""
    return (*(name for each in formats for name in FORMATS[each].names), PREVIEW_NAME)


def chosen_formats(words: Iterable[str]) -> tuple[str, ...]:
    """Turn names of formats into those to write, in the order of the table.

    Args:
        words: names, several of them with commas between if wanted; ``all`` for every format that can be written here.

    Returns:
        The names, with that of ``depth.npz``, which is always written; the usual three where no word is given.

    Raises:
        UsageError: nothing has that name.
        MissingPartError: an extra is not installed.
    """
    named = [name.strip().lower() for word in words for name in word.split(",") if name.strip()]
    for name in named:
        if name != ALL and name not in FORMATS:
            raise unknown_name("format", name, (*FORMATS, ALL))
        if name != ALL and not FORMATS[name].is_installed:
            raise MissingPartError(
                f"the format {name} needs {FORMATS[name].module}, which is not installed",
                hint=extra_hint(FORMATS[name].extra),
            )
    wanted = {*(named or DEFAULT_FORMATS), ALWAYS}
    return tuple(name for name, each in FORMATS.items() if name in wanted or (ALL in wanted and each.is_installed))


def missing_formats(words: Iterable[str]) -> tuple[str, ...]:
    """Say which formats ``all`` leaves out because their extra is not installed, one sentence each.

    Args:
        words: as for `chosen_formats`.
    """
    if ALL not in (name.strip().lower() for word in words for name in word.split(",")):
        return ()
    return tuple(
        f"no {' or '.join(each.names)}: {each.module} is not installed; {extra_hint(each.extra)}"
        for each in FORMATS.values()
        if not each.is_installed
    )


def write_depth(
    folder: Path,
    result: DepthResult,
    *,
    image: FloatMap | None = None,
    formats: Iterable[str] = DEFAULT_FORMATS,
    facts: PictureFacts | None = None,
    own_colours: FloatMap | None = None,
) -> WrittenDepth:
    """Write the depth of one capture upright, each file atomically.

    Args:
        folder: is made if it is not there.
        result: of one capture.
        image: (H, W, 3) the ref photo, RGB in [0, 1], turned as the result is, for the preview and for files that hold
            the photo; without it none of these is written.
        formats: names in `FORMATS`.
        facts: of the photo and the files, for those `WITH_FACTS`; None says nothing.
        own_colours: the ref photo, turned likewise, in the colours of its profile where those are others than sRGB's.

    Returns:
        The paths and what to know about them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    turned, own = (None if i is None else upright(i, rotated_deg=result.rotated_deg) for i in (image, own_colours))
    contents = Contents(stood_upright(result), turned, facts, own_colours=own)
    paths: list[Path] = []
    notes: list[str] = []
    for name in formats:
        written = FORMATS[name].write(folder, contents)
        paths += written.paths
        notes += written.notes
        for left_out in {folder / each for each in FORMATS[name].names}.difference(written.paths):
            left_out.unlink(missing_ok=True)  # one of an earlier run would belong to another map
    if image is not None:
        paths.append(folder / PREVIEW_NAME)
        write_image(paths[-1], preview(image, result))
    return WrittenDepth(paths=tuple(paths), notes=tuple(notes))
