"""``dynamic_depth.jpg``: the photo as Android's Dynamic Depth 1.0, its depth and confidence behind it in the file.

Black is near, white far (RangeInverse), metres. Its parts are JPEGs, the map one of 8 bits, as Android demands; they
follow the photo in the order of the directory in its XMP. Unknown pixels take their neighbour's value, and a confidence
of 0.
"""

from __future__ import annotations

from pathlib import Path

from telewide.depth.formats.contents import NO_METRES, Contents, InverseDepth, WrittenDepth, inverse_depth
from telewide.depth.formats.jpeg_xmp import grey_jpeg, jpeg_with_packet, photo_jpeg, xmp_meta
from telewide.files import replacing

DYNAMIC_DEPTH_NAME = "dynamic_depth.jpg"
MAP_LONGEST_PX = 2048
_DEPTH_URI, _CONFIDENCE_URI, _PRIMARY_URI = "android/depthmap", "android/confidencemap", "primary_image"
_SPACES = {
    prefix: f"http://ns.google.com/photos/dd/1.0/{address}/"
    for prefix, address in (
        ("Device", "device"),
        ("Container", "container"),
        ("Item", "item"),
        ("Profile", "profile"),
        ("Camera", "camera"),
        ("DepthMap", "depthmap"),
        ("Image", "image"),
    )
}
_DIRECTORY = (
    '<Device:Container rdf:parseType="Resource"><Container:Directory><rdf:Seq>{}</rdf:Seq></Container:Directory>'
    "</Device:Container>"
)
_ITEM = (
    '<rdf:li rdf:parseType="Resource"><Container:Item rdf:parseType="Resource"><Item:Mime>image/jpeg</Item:Mime>'
    "<Item:Length>{length}</Item:Length><Item:DataURI>{uri}</Item:DataURI></Container:Item></rdf:li>"
)
_PROFILES = (
    '<Device:Profiles><rdf:Seq><rdf:li rdf:parseType="Resource"><Device:Profile rdf:parseType="Resource">'
    "<Profile:Type>DepthPhoto</Profile:Type><Profile:CameraIndices><rdf:Seq><rdf:li>0</rdf:li></rdf:Seq>"
    "</Profile:CameraIndices></Device:Profile></rdf:li></rdf:Seq></Device:Profiles>"
)
_CAMERAS = (
    '<Device:Cameras><rdf:Seq><rdf:li rdf:parseType="Resource"><Device:Camera rdf:parseType="Resource">'
    '<Camera:DepthMap rdf:parseType="Resource">{}</Camera:DepthMap>'
    '<Camera:Image rdf:parseType="Resource"><Image:ItemSemantic>Primary</Image:ItemSemantic>'
    f"<Image:ItemURI>{_PRIMARY_URI}</Image:ItemURI></Camera:Image>"
    "</Device:Camera></rdf:li></rdf:Seq></Device:Cameras>"
)


def write_dynamic_depth(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``dynamic_depth.jpg``."""
    depth = inverse_depth(contents, longest_px=MAP_LONGEST_PX)
    if depth is None or contents.image is None:
        return contents.left_out(DYNAMIC_DEPTH_NAME, NO_METRES)
    parts = {_DEPTH_URI: grey_jpeg(depth.share), _CONFIDENCE_URI: grey_jpeg(depth.confidence)}
    lengths = {_PRIMARY_URI: 0} | {uri: len(data) for uri, data in parts.items()}
    items = "".join(_ITEM.format(length=length, uri=uri) for uri, length in lengths.items())
    inner = _DIRECTORY.format(items) + _PROFILES + _CAMERAS.format(_depth_map(depth))
    photo = jpeg_with_packet(
        photo_jpeg(contents.image, exif=contents.exif_without_place), xmp_meta(_SPACES, {}, inner=inner)
    )
    with replacing(folder / DYNAMIC_DEPTH_NAME) as temporary:
        temporary.write_bytes(b"".join([photo, *parts.values()]))
    return WrittenDepth((folder / DYNAMIC_DEPTH_NAME,))


def _depth_map(depth: InverseDepth) -> str:
    return _elements(
        "DepthMap",
        {
            "ItemSemantic": "Depth",
            "Format": "RangeInverse",
            "Units": "Meters",
            "Near": f"{depth.near_m:.6g}",
            "Far": f"{depth.far_m:.6g}",
            "DepthURI": _DEPTH_URI,
            "ConfidenceURI": _CONFIDENCE_URI,
            "MeasureType": "OpticalAxis",
            "Software": "telewide",
        },
    )


def _elements(prefix: str, values: dict[str, str]) -> str:
    return "".join(f"<{prefix}:{name}>{value}</{prefix}:{name}>" for name, value in values.items())
