"""Images from outside: the same pixels as OpenCV sees, and a size that is known beforehand."""

from __future__ import annotations

import random
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from fault_corpus_images import png as packed_png
from limited_child import run_limited
from lowered_limits import lowered
from numpy.typing import NDArray

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.pictures import read_gray_image


def png(width: int, height: int, pixels: bytes, depth: int = 8, colour: int = 0) -> bytes:
    return packed_png(width, height, zlib.compress(pixels), depth, colour)


def some_image(rows: int, columns: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (rows, columns), dtype=np.uint8)


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("seed", range(20))
def test_pixels_are_those_of_opencv(tmp_path: Path, seed: int) -> None:
    rows, columns = np.random.default_rng(seed).integers(1, 40, 2)
    image = some_image(rows, columns, seed)
    encodings = [
        cv2.imencode(".png", image)[1].tobytes(),
        cv2.imencode(".png", cv2.merge([image, image, image]))[1].tobytes(),
        cv2.imencode(".pgm", image)[1].tobytes(),
        cv2.imencode(".pgm", image, [cv2.IMWRITE_PXM_BINARY, 0])[1].tobytes(),
    ]
    for data in encodings:
        np.testing.assert_array_equal(read_gray_image(written(tmp_path / "map", data)), image)


def test_the_suffix_does_not_matter(tmp_path: Path) -> None:
    image = some_image(3, 4)
    path = written(tmp_path / "map.pgm", cv2.imencode(".png", image)[1].tobytes())
    np.testing.assert_array_equal(read_gray_image(path), image)


def test_comments_and_odd_maxima_of_pgm(tmp_path: Path) -> None:
    path = written(
        tmp_path / "a.pgm", b"P5 # CREATOR: map_saver\n# more\n2\n#x\n 2 100\n\0\x32\x64\x19"
    )
    np.testing.assert_array_equal(read_gray_image(path), [[0, 128], [255, 64]])
    written(path, b"P2\n2 1\n65535\n65535 # full\n32768\n")
    np.testing.assert_array_equal(read_gray_image(path), [[255, 128]])
    written(path, b"P5 1 1 65535 \xff\xff")
    np.testing.assert_array_equal(read_gray_image(path), [[255]])


def test_sixteen_bit_and_transparent_png(tmp_path: Path) -> None:
    deep = np.array([[0, 65535]], np.uint16)
    path = written(tmp_path / "a.png", cv2.imencode(".png", deep)[1].tobytes())
    np.testing.assert_array_equal(read_gray_image(path), [[0, 255]])
    clear = np.array([[[9, 9, 9, 0], [200, 200, 200, 255]]], np.uint8)
    written(path, cv2.imencode(".png", clear)[1].tobytes())
    np.testing.assert_array_equal(read_gray_image(path), [[9, 200]])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"GIF89a", "not an image of the kinds PGM"),
        (b"P6 1 1 255 abc", "not an image of the kinds PGM"),
        (b"P5", "header"),
        (b"P5 -3 2 255 ", "header"),
        (b"P5 0 2 255 ", "0 x 2 pixels is empty"),
        (b"P5 3 2 0 ", "maximum is 0"),
        (b"P5 3 2 70000 ", "maximum is 70000"),
        (b"P5 3 2 255 abcde", "cut off: 5 of 6"),
        (b"P5 1 1 100 \xc8", "a pixel is 200"),
        (b"P2 3 1 255 1 2", "cut off"),
        (b"P2 3 1 255 1 2 x", "not a number"),
        (b"P2 3 1 255 1 2 -3", "pixels reach from -3"),
        (b"P2 2 1 100 1 200", "to 200"),
        (b"P5 100000 100000 255 x", "100000 x 100000 pixels"),
        (png(30_000, 30_000, b""), "30000 x 30000 pixels"),
        (png(0, 5, b""), "0 x 5 pixels is empty"),
        (png(8000, 7999, b"", 16, 6), "8000 x 7999 pixels"),
        (png(5, 5, b"", 8, 7), "header is damaged"),
        (png(2, 2, b"\0ab\0cd")[:-12], "cut off"),
        (png(2, 2, b"\0ab\0cd")[:40], "cut off"),
        (png(2, 2, b"\0ab\0cd")[:8], "cut off"),
    ],
)
def test_what_is_refused_says_why(tmp_path: Path, data: bytes, words: str) -> None:
    with pytest.raises(InputRefused) as caught:
        read_gray_image(written(tmp_path / "map", data))
    assert words in str(caught.value)


def test_other_files_and_limits(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        read_gray_image(tmp_path / "absent.png")
    with pytest.raises(InputRefused, match="folder"):
        read_gray_image(tmp_path)
    path = written(tmp_path / "a.png", cv2.imencode(".png", some_image(9, 9))[1].tobytes())
    with pytest.raises(InputRefused, match="9 x 9 pixels, at most 80"), lowered(image_pixels=80):
        read_gray_image(path)


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
def test_a_cut_image_never_gives_pixels(tmp_path: Path, suffix: str) -> None:
    data = cv2.imencode(suffix, some_image(30, 40))[1].tobytes()
    for end in range(0, len(data), 17):
        with pytest.raises(InputRefused):
            read_gray_image(written(tmp_path / "map", data[:end]))


def test_no_changed_byte_of_a_png_goes_unseen(tmp_path: Path) -> None:
    image = some_image(30, 40)
    data = cv2.imencode(".png", image)[1].tobytes()
    dice = random.Random(3)
    for _ in range(200):
        broken = bytearray(data)
        broken[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        with pytest.raises(InputRefused):
            read_gray_image(written(tmp_path / "map", bytes(broken)))


def test_bombs_are_refused_in_little_memory(tmp_path: Path) -> None:
    rows = zlib.compress(bytes(30_001) * 1000)
    (tmp_path / "bomb.png").write_bytes(png(30_000, 30_000, rows))
    (tmp_path / "comment.pgm").write_bytes(b"P5\n#" + b"x" * 50_000_000 + b"\n1 1 255 a")
    (tmp_path / "comments.pgm").write_bytes(b"P5\n" + b"#\n" * 10_000_000 + b"1 1 255 a")
    (tmp_path / "spaces.pgm").write_bytes(b"P2\n" + b" " * 50_000_000 + b"1 1 255 1")
    # Fewer pixels inside than the header says, and more.
    (tmp_path / "short.png").write_bytes(png(2000, 2000, b"\0" * 5000))
    (tmp_path / "more.png").write_bytes(png(2, 2, b"\0" * 50_000_000))
    done = run_limited(
        """
        import sys
        from pathlib import Path
        from slamsim.guard.errors import InputRefused
        from slamsim.guard.pictures import read_gray_image
        for path in sorted(Path(sys.argv[1]).iterdir()):
            try:
                print(path.name, read_gray_image(path).shape)
            except InputRefused:
                print(path.name, "refused")
        """,
        str(tmp_path),
        memory_bytes=2 << 30,
        seconds=20,
    )
    assert len(done.stdout.splitlines()) == 6
    assert "bomb.png refused" in done.stdout
