"""Photograph a room with a ray tracer: the light on the sensor, the exact depth, and the blur of a real aperture.

A photo with lens distortion is looked up in a finer pinhole view that is a little larger. Depth is asked ray by ray,
one through the centre of every pixel. Light is (H, W, 3) float32, linear sRGB primaries, in the unit of the lights.
Only the ``scalar_rgb`` variant of mitsuba is used: it needs neither LLVM nor a GPU. Letters: H W photo; N points.
"""

from __future__ import annotations

import importlib
import math
import os
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.errors import MissingPartError, extra_hint
from telewide.geometry.arrays import FloatArray, FloatImage, FloatMap
from telewide.geometry.grids import dense_map
from telewide.geometry.rig import Camera, StereoRig
from telewide.simulate.room_scene import Light, Room, Solid
from telewide.srgb import linear_from_srgb

_FINENESS = 1.25
"""Pinhole pixels per photo pixel, along each axis; where the photo is looked up, it is twice as fine as in the end."""
_LOOKUP = 2
_BORDER_PX = 4
_LATHE_STEPS = 64
_SAME_SURFACE = 1e-3
"""A share of the distance; rays are single precision."""
_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Mitsuba's camera looks along z with x to the left and y up."""


@dataclass(frozen=True)
class ApertureSetting:
    """A lens with an opening.

    Attributes:
        radius_m: of the opening.
        focus_distance_m: z of what is sharp.
    """

    radius_m: float
    focus_distance_m: float


@dataclass(frozen=True)
class _PinholeView:
    """A view without distortion: focal length, principal point in the middle, px."""

    hw: tuple[int, int]
    f_px: float

    def pixels(self, normalised: FloatArray) -> FloatArray:
        return normalised * self.f_px + (np.array([self.hw[1], self.hw[0]]) - 1) / 2


class RoomTracer:
    """A room as the ray tracer holds it.

    Args:
        room: what is photographed.

    Raises:
        MissingPartError: mitsuba is not installed.
    """

    def __init__(self, room: Room) -> None:
        self._mi = _load_mitsuba()
        self._lit = [self._mi.load_dict(_lit_scene(self._mi, room, lamp)) for lamp in room.lights]
        self._glow = self._mi.load_dict(_glow_scene(self._mi, room))

    def photo(
        self,
        camera: Camera,
        world_from_camera: FloatArray,
        *,
        samples: int,
        seed: int,
        aperture: ApertureSetting | None = None,
    ) -> FloatImage:
        """Light on the sensor.

        Args:
            camera: with its distortion.
            world_from_camera: (4, 4), m.
            samples: rays per pixel of the photo, to each light.
            seed: the same seed, the same noise.
            aperture: None for a pinhole, all sharp.

        Returns:
            (H, W, 3) float32, linear.
        """
        view = _pinhole_view(camera)
        sensor = self._mi.load_dict(_sensor(self._mi, view, world_from_camera, aperture=aperture))
        spp = max(1, round(samples / _FINENESS**2))
        layers = [self._mi.render(scene, sensor=sensor, spp=spp, seed=seed) for scene in (*self._lit, self._glow)]
        return _seen_by(camera, view, np.sum([np.array(layer, np.float32)[..., :3] for layer in layers], axis=0))

    def depth_m(self, camera: Camera, world_from_camera: FloatArray) -> FloatMap:
        """Exact z of what the centre of every pixel sees.

        Args:
            camera: with its distortion.
            world_from_camera: (4, 4), m.

        Returns:
            (H, W) float32, m; NaN where a ray leaves the room.
        """
        rays = _rays(camera) @ world_from_camera[:3, :3].T
        origin, trace = self._mi.Point3f(*world_from_camera[:3, 3]), self._glow.ray_intersect_preliminary
        # With a direction whose z is 1 in the camera's frame, the length along it is z itself.
        ray, vector = self._mi.Ray3f, self._mi.Vector3f
        depths = [trace(ray(origin, vector(*direction)), True).t for direction in rays.tolist()]
        found = np.array(depths, dtype=np.float32).reshape(camera.hw)
        return np.where(np.isfinite(found), found, np.float32(np.nan)).astype(np.float32)

    def is_hidden(self, rig: StereoRig, world_from_tele: FloatArray, *, depth_m: FloatMap) -> NDArray[np.bool_]:
        """Mask of what tele sees and wide does not: something stands before it, or its photo ends.

        Args:
            rig: both cameras.
            world_from_tele: (4, 4), m.
            depth_m: (H, W) of the tele photo, as `depth_m` gives it.

        Returns:
            (H, W) of the tele photo.
        """
        seen_m = (_rays(rig.tele) * depth_m.reshape(-1, 1)).astype(np.float64)
        in_wide_m = seen_m @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3]
        wide_px = rig.wide.project(in_wide_m)
        last_px = np.array([rig.wide.hw[1], rig.wide.hw[0]]) - 1
        is_outside = np.any((wide_px < 0) | (wide_px > last_px), axis=1)
        tele_from_wide = np.linalg.inv(rig.wide_from_tele)
        world_from_wide = world_from_tele @ tele_from_wide
        rays = in_wide_m @ world_from_wide[:3, :3].T
        origin, trace = self._mi.Point3f(*world_from_wide[:3, 3]), self._glow.ray_intersect_preliminary
        ray, vector = self._mi.Ray3f, self._mi.Vector3f
        # With a direction that ends at what tele sees, something nearer is met before 1.
        met_at = np.array([trace(ray(origin, vector(*direction)), True).t for direction in rays.tolist()])
        return np.asarray(is_outside | (met_at < 1 - _SAME_SURFACE)).reshape(depth_m.shape)


def _load_mitsuba() -> Any:
    """The ray tracer; its functions exist only once a variant is chosen, so that it has no types."""
    try:
        mitsuba = importlib.import_module("mitsuba")
        drjit = importlib.import_module("drjit")
    except ImportError as error:
        raise MissingPartError(
            "rooms are rendered with mitsuba, which is not installed", hint=extra_hint("simulate")
        ) from error
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    threads = os.environ.get("OMP_NUM_THREADS", "")
    if threads.isdecimal() and int(threads) > 0:
        drjit.set_thread_count(int(threads))
    return mitsuba


def _rays(camera: Camera) -> FloatArray:
    """(H * W, 3) through the centres of all pixels, z 1."""
    y_px, x_px = np.indices(camera.hw, dtype=np.float64)
    normalised = camera.normalised(np.column_stack([x_px.ravel(), y_px.ravel()]))
    return np.column_stack([normalised, np.ones(len(normalised))])


def _pinhole_view(camera: Camera) -> _PinholeView:
    """The smallest centred view that holds all a photo sees."""
    height, width = camera.hw
    along_x, along_y = np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)
    border = [(x, y) for x in along_x for y in (-1.0, float(height))]
    border += [(x, y) for y in along_y for x in (-1.0, float(width))]
    reach = np.abs(camera.normalised(np.array(border))).max(axis=0)
    f_px = float(max(camera.K[0, 0], camera.K[1, 1])) * _FINENESS
    half = np.ceil(reach * f_px).astype(int) + _BORDER_PX
    return _PinholeView((2 * int(half[1]), 2 * int(half[0])), f_px)


def _seen_by(camera: Camera, view: _PinholeView, light: FloatImage) -> FloatImage:
    """Look the photo up in the pinhole view, finely, and average as the pixels of a sensor do."""
    fine = camera.resized((camera.hw[0] * _LOOKUP, camera.hw[1] * _LOOKUP))
    map_x, map_y = dense_map(lambda points_px: view.pixels(fine.normalised(points_px)), hw=fine.hw)
    samples = cv2.remap(light, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    small = cv2.resize(samples, (camera.hw[1], camera.hw[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(np.maximum(small, 0), np.float32)


def _sensor(
    mi: Any, view: _PinholeView, world_from_camera: FloatArray, *, aperture: ApertureSetting | None
) -> dict[str, object]:
    height, width = view.hw
    lens: dict[str, object] = {"type": "perspective"}
    if aperture is not None:
        lens = {
            "type": "thinlens",
            "aperture_radius": aperture.radius_m,
            "focus_distance": aperture.focus_distance_m,
        }
    return {
        **lens,
        "fov": math.degrees(2 * math.atan(width / 2 / view.f_px)),
        "fov_axis": "x",
        "near_clip": 0.01,
        "far_clip": 100.0,
        "to_world": mi.ScalarTransform4f((world_from_camera @ _AXES).tolist()),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter"},
    }


def _lit_scene(mi: Any, room: Room, lamp: Light) -> dict[str, object]:
    """Light that comes straight from one lamp, with its shadows; lamps chosen by chance would be noise."""
    integrator = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    scene: dict[str, object] = {"type": "scene", "integrator": integrator}
    scene |= {f"solid{n}": _shape(mi, solid, {"bsdf": _surface(mi, solid)}) for n, solid in enumerate(room.solids)}
    return scene | {"lamp": _lamp(mi, lamp)}


def _glow_scene(mi: Any, room: Room) -> dict[str, object]:
    """The light that the walls throw back, as if every surface shone by itself: seen without noise in a few rays."""
    scene: dict[str, object] = {"type": "scene", "integrator": {"type": "path", "max_depth": 1}}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    for number, solid in enumerate(room.solids):
        radiance = linear_from_srgb(solid.texture) * np.array(room.ambient, np.float32)
        glowing = {"type": "area", "radiance": _colour(mi, radiance, solid)}
        scene[f"solid{number}"] = _shape(mi, solid, {"bsdf": black, "emitter": glowing})
    return scene


def _lamp(mi: Any, lamp: Light) -> dict[str, object]:
    radiance = {"type": "rgb", "value": list(lamp.radiance)}
    to_world = mi.ScalarTransform4f(lamp.world_from_light.tolist())
    return {"type": "rectangle", "to_world": to_world, "emitter": {"type": "area", "radiance": radiance}}


def _shape(mi: Any, solid: Solid, surface: dict[str, object]) -> object:
    placement = solid.world_from_solid
    if solid.shape == "lathe":
        return _lathe(mi, solid, surface)
    if solid.shape == "cylinder":
        ends = {"p0": placement[:3, 3].tolist(), "p1": (placement[:3, 3] + placement[:3, 2]).tolist()}
        return {"type": "cylinder", **ends, "radius": float(np.linalg.norm(placement[:3, 0])), **surface}
    return {"type": solid.shape, "to_world": mi.ScalarTransform4f(placement.tolist()), **surface}


def _surface(mi: Any, solid: Solid) -> dict[str, object]:
    colour = _colour(mi, linear_from_srgb(solid.texture), solid)
    inner: dict[str, object] = {"type": "diffuse", "reflectance": colour}
    if solid.is_shiny:
        inner = {"type": "roughplastic", "diffuse_reflectance": colour, "alpha": 0.25}
    return {"type": "twosided", "bsdf": inner}


def _colour(mi: Any, light: FloatImage, solid: Solid) -> dict[str, object]:
    if light.shape[:2] == (1, 1):
        return {"type": "rgb", "value": light[0, 0].tolist()}
    bitmap = mi.Bitmap(np.ascontiguousarray(light), mi.Bitmap.PixelFormat.RGB)
    return {"type": "bitmap", "bitmap": bitmap, "filter_type": "nearest" if solid.has_hard_edges else "bilinear"}


def _lathe(mi: Any, solid: Solid, surface: dict[str, object]) -> object:
    """A mesh of the profile turned about z."""
    around = np.linspace(0.0, 2 * math.pi, _LATHE_STEPS + 1)
    radius, height = solid.profile[:, :1], solid.profile[:, 1:]
    local = np.stack([radius * np.cos(around), radius * np.sin(around), height + 0 * around], axis=-1)
    points = local.reshape(-1, 3) @ solid.world_from_solid[:3, :3].T + solid.world_from_solid[:3, 3]
    rows, columns = local.shape[:2]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + columns], 1),
            np.stack([corner + 1, corner + columns + 1, corner + columns], 1),
        ]
    )
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    properties = mi.Properties()
    for name, part in surface.items():
        properties[name] = mi.load_dict(part)
    mesh = mi.Mesh(
        "lathe",
        vertex_count=len(points),
        face_count=len(faces),
        has_vertex_texcoords=True,
        has_vertex_normals=True,
        props=properties,
    )
    buffers = mi.traverse(mesh)
    buffers["vertex_positions"] = points.ravel().astype(np.float32)
    buffers["vertex_texcoords"] = np.stack([u, v], -1).ravel().astype(np.float32)
    buffers["faces"] = faces.ravel().astype(np.uint32)
    buffers.update()
    mesh.recompute_vertex_normals()
    return mesh
