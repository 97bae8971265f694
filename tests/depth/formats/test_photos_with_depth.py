"""GDepth and Dynamic Depth, taken apart as their specifications say, and by exiftool."""

from __future__ import annotations

import base64
import hashlib
import io
import re
import shutil
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from depth.formats.made_depth import BOX, HW, SKY, UNMEASURED, WALL, depth_m, made_photo, made_result
from PIL import Image

from telewide.depth.export import write_depth
from telewide.depth.formats.jpeg_xmp import jpeg_with_xmp

RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
DD = "http://ns.google.com/photos/dd/1.0/"
STANDARD, EXTENDED = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"


def application_segments(jpeg: bytes) -> Iterator[bytes]:
    """Content of every APP1."""
    at = 2
    while jpeg[at] == 0xFF and jpeg[at + 1] != 0xDA:
        (length,) = struct.unpack_from(">H", jpeg, at + 2)
        if jpeg[at + 1] == 0xE1:
            yield jpeg[at + 4 : at + 2 + length]
        at += 2 + length


def attributes_of(jpeg: bytes) -> dict[str, str]:
    """Simple properties of both packets, by their names without the address."""
    segments = list(application_segments(jpeg))
    (standard,) = (s[len(STANDARD) :] for s in segments if s.startswith(STANDARD))
    chunks = [s[len(EXTENDED) :] for s in segments if s.startswith(EXTENDED)]
    extended = b"".join(chunk[40:] for chunk in chunks)
    for chunk in chunks:
        assert chunk[:32].decode() == hashlib.md5(extended).hexdigest().upper()
        assert struct.unpack(">I", chunk[32:36])[0] == len(extended)
    assert sum(len(c) - 40 for c in chunks) == len(extended)
    found: dict[str, str] = {}
    for packet in (standard, extended):
        if packet:
            text = re.sub(r"<\?xpacket.*?\?>", "", packet.decode())
            (description,) = ElementTree.fromstring(text).iter(f"{RDF}Description")
            found |= {name.split("}")[-1]: value for name, value in description.attrib.items()}
    return found


def exiftool(path: Path, *options: str) -> bytes:
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed")
    return subprocess.run(["exiftool", *options, str(path)], check=True, capture_output=True).stdout


@pytest.fixture
def gdepth(tmp_path: Path) -> Path:
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("gdepth",))
    return tmp_path / "gdepth.jpg"


@pytest.fixture
def dynamic(tmp_path: Path) -> Path:
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("dynamic",))
    return tmp_path / "dynamic_depth.jpg"


def is_depth_of_the_scene(share: np.ndarray, confidence: np.ndarray, near_m: float, far_m: float) -> None:
    """By Google's formula; black near, white far; what is not known takes its neighbour's, without confidence."""
    known = np.isfinite(depth_m())
    decoded_m = far_m * near_m / (far_m - share * (far_m - near_m))
    half_step = 0.5 / 255 if share.dtype == np.float32 else 0.5 / 65535
    np.testing.assert_allclose(1 / decoded_m[known], 1 / depth_m()[known], atol=(half_step + 0.004) / near_m)
    assert share[BOX].max() < 0.01
    assert share[WALL].min() > 0.8
    assert share[SKY].min() > 0.7
    assert confidence[SKY].max() < 0.02
    assert confidence[UNMEASURED].max() < 0.1
    np.testing.assert_allclose(confidence[BOX], 0.75, atol=0.01)


def test_gdepth_by_its_specification(gdepth: Path) -> None:
    stated = attributes_of(gdepth.read_bytes())
    assert (stated["Format"], stated["Units"], stated["Mime"]) == ("RangeInverse", "m", "image/png")
    maps = [np.asarray(Image.open(io.BytesIO(base64.b64decode(stated[n])))) for n in ("Data", "Confidence")]
    assert [one.dtype for one in maps] == [np.uint16, np.uint16]
    share, confidence = (one / 65535 for one in maps)
    is_depth_of_the_scene(share, confidence, float(stated["Near"]), float(stated["Far"]))
    decoded_m = 1 / (1 / float(stated["Near"]) - share * (1 / float(stated["Near"]) - 1 / float(stated["Far"])))
    known = np.isfinite(depth_m())
    np.testing.assert_allclose(decoded_m[known], depth_m()[known], rtol=2e-4)
    with Image.open(gdepth) as photo:
        np.testing.assert_allclose(np.asarray(photo) / 255, made_photo(), atol=0.03)


def test_gdepth_by_exiftool(gdepth: Path) -> None:
    assert b"Validate                        : OK" in exiftool(gdepth, "-validate")
    stated = attributes_of(gdepth.read_bytes())
    for tag, name in (("DepthImage", "Data"), ("Confidence", "Confidence")):
        assert exiftool(gdepth, "-b", f"-XMP-GDepth:{tag}") == base64.b64decode(stated[name])


def test_extended_packets_of_many_chunks_come_back(tmp_path: Path, rng: np.random.Generator) -> None:
    """Noise does not compress: a payload of half a megabyte, in a dozen segments."""
    stream = io.BytesIO()
    Image.fromarray(rng.integers(0, 256, (32, 32, 3), dtype=np.uint8)).save(stream, "JPEG")
    payload = rng.bytes(500_001)
    spaces = {"GDepth": "http://ns.google.com/photos/1.0/depthmap/"}
    given = {"GDepth:Software": 'a "b" <c> & d'}
    jpeg = jpeg_with_xmp(stream.getvalue(), spaces, given, large={"GDepth:Data": payload})
    assert len(list(application_segments(jpeg))) > 10
    stated = attributes_of(jpeg)
    assert base64.b64decode(stated["Data"]) == payload
    assert stated["Software"] == 'a "b" <c> & d'
    path = tmp_path / "noise.jpg"
    path.write_bytes(jpeg)
    assert exiftool(path, "-b", "-XMP-GDepth:DepthImage") == payload
    assert b"Validate                        : OK" in exiftool(path, "-validate")


def elements(path: Path) -> ElementTree.Element:
    (standard,) = (s for s in application_segments(path.read_bytes()) if s.startswith(STANDARD))
    return ElementTree.fromstring(re.sub(r"<\?xpacket.*?\?>", "", standard[len(STANDARD) :].decode()))


def texts(root: ElementTree.Element, space: str, name: str) -> list[str]:
    return [element.text or "" for element in root.iter(f"{{{DD}{space}/}}{name}")]


def test_dynamic_depth_passes_what_android_checks(dynamic: Path) -> None:
    """The checks of AOSP's ValidateAndroidDynamicDepthBuffer, item by item."""
    root, data = elements(dynamic), dynamic.read_bytes()
    (description,) = root.iter(f"{RDF}Description")
    assert {child.tag for child in description} == {f"{{{DD}device/}}{n}" for n in ("Container", "Profiles", "Cameras")}
    mimes, lengths, uris = (texts(root, "item", name) for name in ("Mime", "Length", "DataURI"))
    assert mimes == ["image/jpeg"] * 3
    assert texts(root, "profile", "Type") == ["DepthPhoto"]
    (indices,) = root.iter(f"{{{DD}profile/}}CameraIndices")
    assert [each.text for each in indices.iter(f"{RDF}li")] == ["0"]
    (depth_uri,), (confidence_uri,) = texts(root, "depthmap", "DepthURI"), texts(root, "depthmap", "ConfidenceURI")
    assert texts(root, "depthmap", "ItemSemantic") == ["Depth"]
    assert texts(root, "depthmap", "Units") == ["Meters"]
    assert texts(root, "depthmap", "Format") == ["RangeInverse"]
    near_m, far_m = (float(texts(root, "depthmap", name)[0]) for name in ("Near", "Far"))
    assert 0 <= near_m < far_m
    assert lengths[0] == "0"
    at = len(data) - sum(int(length) for length in lengths)
    assert data[at - 2 : at] == b"\xff\xd9"  # the photo ends where the first payload begins
    payloads = {}
    for uri, length in zip(uris[1:], lengths[1:], strict=True):
        payloads[uri] = data[at : at + int(length)]
        at += int(length)
    assert all(payloads[uri][:2] == b"\xff\xd8" for uri in (depth_uri, confidence_uri))
    share, confidence = (
        np.asarray(Image.open(io.BytesIO(payloads[uri])), np.float32) / np.float32(255)
        for uri in (depth_uri, confidence_uri)
    )
    assert share.shape == HW
    is_depth_of_the_scene(share, confidence, near_m, far_m)


def test_dynamic_depth_by_exiftool_and_pillow(dynamic: Path) -> None:
    assert b"Validate                        : OK" in exiftool(dynamic, "-validate")
    told = exiftool(dynamic, "-s", "-s", "-s", "-XMP-Device:CameraDepthMapUnits", "-XMP-Device:ProfileType")
    assert told.split() == [b"Meters", b"DepthPhoto"]
    with Image.open(dynamic) as photo:
        np.testing.assert_allclose(np.asarray(photo) / 255, made_photo(), atol=0.03)


@pytest.mark.parametrize(("kind", "name"), [("gdepth", "gdepth.jpg"), ("dynamic", "dynamic_depth.jpg")])
def test_without_metres_there_is_none(kind: str, name: str, tmp_path: Path) -> None:
    written = write_depth(tmp_path, made_result(has_metres=False), image=made_photo(), formats=(kind,))
    assert not (tmp_path / name).exists()
    assert f"no {name}, its depth in metres is not known" in written.notes[0]


def test_large_maps_are_thinned_out_and_stretched_to_the_photo(tmp_path: Path) -> None:
    from telewide.depth.formats.contents import thinned

    values = np.arange(4100 * 30, dtype=np.float32).reshape(30, 4100)
    small = thinned(values, longest_px=2048)
    assert small.shape == (10, 1367)
    assert np.isin(small, values).all()
    assert small[0, 0] == values[1, 1]  # the middle of its square
