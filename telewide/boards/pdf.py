"""A PDF of one page, written from its parts: black rectangles and lines of text, at true scale.

Page frame: metres, x right, y down, the origin at the top left of the sheet; PDF itself counts points of 1/72 inch
upwards from the bottom left. Format: ISO 32000-1, sections 7.5 (file), 8.5 (paths), 9.4 (text).
Letters: n rectangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from telewide.geometry.arrays import FloatArray

POINTS_PER_M = 72 / 0.0254


@dataclass(frozen=True)
class TextLine:
    """A line of black Helvetica.

    Attributes:
        text: printable ASCII.
        at_m: x and y of the start of its base line.
        size_m: height of the type.
    """

    text: str
    at_m: tuple[float, float]
    size_m: float = 0.003


@dataclass(frozen=True)
class Page:
    """One sheet.

    Attributes:
        wh_m: width and height.
        rectangles_m: (n, 4) x, y, width, height of what is black.
        texts: what is written.
        title: of the document.
    """

    wh_m: tuple[float, float]
    rectangles_m: FloatArray
    texts: tuple[TextLine, ...]
    title: str


def pdf_from_page(page: Page) -> bytes:
    """Write a page as a PDF file that asks to be printed at 100 %.

    Args:
        page: the sheet.

    Returns:
        Content of the file.
    """
    width_pt, height_pt = (length_m * POINTS_PER_M for length_m in page.wh_m)
    content = _content(page).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        b"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 %.4f %.4f] /Contents 4 0 R "
        b"/Resources << /Font << /F1 5 0 R >> >> >>" % (width_pt, height_pt),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        b"<< /Title (%s) /Producer (telewide) >>" % _escaped(page.title).encode("ascii"),
    ]
    return _file(objects)


def _content(page: Page) -> str:
    """Operators that draw the page. One path for everything black: no viewer then shows seams where cells touch."""
    height_m = page.wh_m[1]
    lines = ["0 g"]
    for x_m, y_m, width_m, rectangle_height_m in page.rectangles_m:
        corner_m = (x_m, height_m - y_m - rectangle_height_m)
        numbers = (length_m * POINTS_PER_M for length_m in (*corner_m, width_m, rectangle_height_m))
        lines.append(" ".join(f"{number:.4f}" for number in numbers) + " re")
    lines.append("f")
    for text in page.texts:
        x_pt, y_pt = text.at_m[0] * POINTS_PER_M, (height_m - text.at_m[1]) * POINTS_PER_M
        size_pt = text.size_m * POINTS_PER_M
        lines.append(f"BT /F1 {size_pt:.3f} Tf {x_pt:.4f} {y_pt:.4f} Td ({_escaped(text.text)}) Tj ET")
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Text fit for a PDF string: other letters than ASCII become question marks."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return plain.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)").replace("\n", " ").replace("\r", " ")


def _file(objects: Sequence[bytes]) -> bytes:
    """Number the objects, the first being the catalogue and the last the document's description."""
    data = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"
    offsets = []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    size = len(objects) + 1
    trailer = b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (size, len(objects))
    return data + b"xref\n0 %d\n0000000000 65535 f \n%s%sstartxref\n%d\n%%%%EOF\n" % (size, table, trailer, len(data))
