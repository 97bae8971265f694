"""``mesh.glb``: a textured surface, m, that is cut at depth edges.

glTF wants y up and looks along -z, so tele's frame (x right, y down, z forward) is turned half round about x. trimesh
(the extra ``mesh``) writes it. Letters: H W image; h w after thinning; N points, M triangles.
"""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from telewide.depth.formats.contents import NO_METRES, Contents, WrittenDepth, levels, positions_m, written_whole
from telewide.geometry.arrays import FloatMap, IntArray

GLB_NAME = "mesh.glb"
MESH_LONGEST_PX = 800
TEXTURE_LONGEST_PX = 2048
CUT_SHARE = 0.04
"""Corners of a triangle whose depths differ by a larger share lie on two surfaces; as MoGe cuts its meshes."""
LEAST_CUT_PX = 0.25
"""Disparities of such corners differ by so much at least, px of the mesh: far away, less than that is noise."""
_GLTF_FROM_TELE = np.array([1, -1, -1], dtype=np.float32)


def write_glb(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``mesh.glb``."""
    at_m = positions_m(contents, longest_px=MESH_LONGEST_PX)
    if at_m is None or contents.image is None:
        return contents.left_out(GLB_NAME, NO_METRES)
    triangles = surface_triangles(at_m[..., 2], px_m=_px_m(contents, at_m.shape[1]))
    if not len(triangles):
        return contents.left_out(GLB_NAME, "no three neighbours lie on one surface")
    from trimesh import Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    used, corner = np.unique(triangles, return_inverse=True)
    texture = PBRMaterial(baseColorTexture=_texture(contents.image), metallicFactor=0.0, roughnessFactor=1.0)
    mesh = Trimesh(
        vertices=at_m.reshape(-1, 3)[used] * _GLTF_FROM_TELE,
        faces=corner.reshape(triangles.shape),
        visual=TextureVisuals(uv=_texture_places(at_m.shape[:2], contents.image.shape[:2])[used], material=texture),
        process=False,
    )
    return written_whole(folder / GLB_NAME, mesh.export(file_type="glb"))


def _px_m(contents: Contents, width: int) -> float:
    """Disparity at 1 m, px of a mesh of a width; infinite where the distance of the lenses is not known."""
    result = contents.result
    if result.K is None or result.baseline_m is None:
        return math.inf
    shrinks = result.disparity.disparity_px.shape[1] / width
    return float(result.K[0, 0] * result.baseline_m / shrinks)


def surface_triangles(depth_m: FloatMap, *, px_m: float) -> IntArray:
    """Join neighbours into triangles, two a square, but for those that reach from one surface to another.

    Args:
        depth_m: (h, w), m; NaN where unknown.
        px_m: disparity at 1 m, px of this map.

    Returns:
        (M, 3) int64 flat indices, anticlockwise as the camera sees them.
    """
    index = np.arange(depth_m.size, dtype=np.int64).reshape(depth_m.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    corners_m = depth_m.ravel()[triangles]
    near_m, far_m = corners_m.min(axis=1), corners_m.max(axis=1)
    with np.errstate(invalid="ignore"):
        is_one = (far_m <= near_m * (1 + CUT_SHARE)) | (px_m * (1 / near_m - 1 / far_m) < LEAST_CUT_PX)
    return np.asarray(triangles[is_one], dtype=np.int64)


def _texture_places(hw: tuple[int, int], photo_hw: tuple[int, ...]) -> FloatMap:
    """Places (N, 2) of the thinned pixels on the texture: 0 to 1, v up; a pixel's centre lies half a pixel inside."""
    step = -(-max(photo_hw) // MESH_LONGEST_PX)
    rows, columns = (np.arange(size, dtype=np.float32) * step + step // 2 + 0.5 for size in hw)
    u, v = np.meshgrid(columns / photo_hw[1], 1 - rows / photo_hw[0])
    return np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)


def _texture(image: FloatMap) -> Image.Image:
    """The photo as a JPEG, which trimesh embeds as it is."""
    picture = Image.fromarray(levels(np.nan_to_num(image), bits=8).astype(np.uint8))
    picture.thumbnail((TEXTURE_LONGEST_PX, TEXTURE_LONGEST_PX), Image.Resampling.LANCZOS)
    stream = BytesIO()
    picture.save(stream, "JPEG", quality=92, subsampling=0)
    return Image.open(stream)
