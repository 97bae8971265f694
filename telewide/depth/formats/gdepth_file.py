"""``gdepth.jpg``: the photo with Google's older depth map in its XMP (developers.google.com/depthmap-metadata).

Black is near, white far (RangeInverse), metres along the optical axis; the map is a PNG of 16 bits. It has no code for
unknown: such pixels take their neighbour's value, and a confidence of 0.
"""

from __future__ import annotations

from pathlib import Path

from telewide.depth.formats.contents import NO_METRES, Contents, WrittenDepth, inverse_depth
from telewide.depth.formats.jpeg_xmp import grey_png16, jpeg_with_xmp, photo_jpeg
from telewide.files import replacing

GDEPTH_NAME = "gdepth.jpg"
MAP_LONGEST_PX = 2048
_NAMESPACE = "http://ns.google.com/photos/1.0/depthmap/"


def write_gdepth(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``gdepth.jpg``."""
    depth = inverse_depth(contents, longest_px=MAP_LONGEST_PX)
    if depth is None or contents.image is None:
        return contents.left_out(GDEPTH_NAME, NO_METRES)
    height, width = contents.image.shape[:2]
    properties = {
        "GDepth:Format": "RangeInverse",
        "GDepth:Near": f"{depth.near_m:.6g}",
        "GDepth:Far": f"{depth.far_m:.6g}",
        "GDepth:Units": "m",
        "GDepth:MeasureType": "OpticalAxis",
        "GDepth:Mime": "image/png",
        "GDepth:ConfidenceMime": "image/png",
        "GDepth:ImageWidth": str(width),
        "GDepth:ImageHeight": str(height),
        "GDepth:Software": "telewide",
    }
    large = {"GDepth:Data": grey_png16(depth.share), "GDepth:Confidence": grey_png16(depth.confidence)}
    with replacing(folder / GDEPTH_NAME) as temporary:
        temporary.write_bytes(
            jpeg_with_xmp(
                photo_jpeg(contents.image, exif=contents.exif_without_place),
                {"GDepth": _NAMESPACE},
                properties,
                large=large,
            )
        )
    return WrittenDepth((folder / GDEPTH_NAME,))
