"""The pictures that the pages of ``examples/manual`` show: those of the examples, made small enough to commit."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

from .contents import EXAMPLES

PICTURES = EXAMPLES / "pictures"
LARGEST = 100_000  # bytes


def shown() -> list[str]:
    """Return the names of the pictures that the pages and the index of the examples show."""
    pages = [EXAMPLES / "README.md", *sorted((EXAMPLES / "manual").glob("*.md"))]
    return sorted(
        {
            name
            for page in pages
            for name in re.findall(r"pictures/(\w+)\.png", page.read_text("utf-8"))
        }
    )


def small(picture: Path) -> bytes:
    """Return a picture of 256 colours, narrowed until it fits."""
    image = Image.open(picture).convert("RGB")
    while True:
        written = io.BytesIO()
        image.quantize(256, dither=Image.Dither.NONE).save(written, "PNG", optimize=True)
        if len(written.getvalue()) <= LARGEST:
            return written.getvalue()
        image = image.resize(
            (round(0.9 * image.width), round(0.9 * image.height)), Image.Resampling.LANCZOS
        )


def keep(folder: Path) -> Iterator[str]:
    """Put what the examples drew beside the pages; yield the names."""
    for name in shown():
        if (drawn := folder / "examples" / f"{name}.png").exists():
            (PICTURES / f"{name}.png").write_bytes(small(drawn))
            yield f"examples/pictures/{name}.png"
