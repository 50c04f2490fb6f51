"""Learns on simulated RGB-D images which pixels are floor, and asks it of real ones.

    slamsim dataset make diverse_rgbd -n 20 --out rooms
    python examples/floor_segmentation.py rooms --images desk/ --intrinsics 525,525,319.5,239.5

A network with two hidden layers, in NumPy, looks at each of some 6,000 points of an image: colour,
depth, direction of the surface, height above what is lowest, and the same of the whole image in
coarse squares. It is judged by the intersection over union with the true floor, in worlds and
textures that it has never seen, beside what needs no network: the pixels that are floor in most of
the images for training.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import slamsim.dataset
from slamsim.cameras.codecs.pictures import encode_png
from slamsim.core.randomness import random_stream
from slamsim.core.types import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.dataset.store.reader import Dataset
from slamsim.io.cameras import open_cameras

COLOUR, DEPTH, LABELS = (
    "front_color",
    "front_aligned_depth_to_color",
    "truth/front_color_instances",
)
FLOOR = 1
"""Number of the floor among the instances."""
WIDTH = 106
"""Points across an image at which the network looks."""
COARSE = 4
"""The whole image is told in so many squares by so many."""
HIDDEN = (64, 48)
POINTS = 400
"""Of each image for training."""
EPOCHS, BATCH, RATE, DECAY = 8, 1024, 2e-3, 1e-2
SHOWN = 6


@dataclass(frozen=True, slots=True, eq=False)
class Examples:
    """Of points: features (n, f), floor (n,) the truth, places (n,) the number in its image."""

    features: Float32Array
    floor: BoolArray
    places: IntArray


class Network:
    """Layers of weights with ReLU between them; the last gives a number above 0 for floor."""

    def __init__(self, features: Float32Array, random: np.random.Generator) -> None:
        self.mean, self.deviation = features.mean(axis=0), features.std(axis=0) + 1e-6
        sizes = (features.shape[1], *HIDDEN, 1)
        self.weights = [
            (random.normal(size=(a, b)) * np.sqrt(2.0 / a)).astype(np.float32)
            for a, b in pairwise(sizes)
        ]
        self.offsets = [np.zeros(b, np.float32) for b in sizes[1:]]

    def layers(self, features: Float32Array) -> list[Float32Array]:
        """What goes into each layer, and what comes out of the last: (n, 1)."""
        found = [(features - self.mean) / self.deviation]
        for weight, offset in zip(self.weights[:-1], self.offsets[:-1], strict=True):
            found.append(np.maximum(found[-1] @ weight + offset, 0.0))
        return [*found, found[-1] @ self.weights[-1] + self.offsets[-1]]

    def scores(self, features: Float32Array) -> Float32Array:
        """(n,) above 0: more likely floor than not."""
        return self.layers(features)[-1][:, 0]

    def slopes(self, features: Float32Array, floor: BoolArray) -> list[Float32Array]:
        """Of the mean log loss by each weight and then each offset."""
        layers = self.layers(features)
        chances = 1.0 / (1.0 + np.exp(-np.clip(layers[-1], -30.0, 30.0)))
        error = (chances - floor[:, None]).astype(np.float32) / np.float32(len(floor))
        by_weight, by_offset = list[Float32Array](), list[Float32Array]()
        for number in reversed(range(len(self.weights))):
            by_weight.insert(0, layers[number].T @ error)
            by_offset.insert(0, error.sum(axis=0))
            error = (error @ self.weights[number].T) * (layers[number] > 0.0)
        return [*by_weight, *by_offset]


def train(features: Float32Array, floor: BoolArray, random: np.random.Generator) -> Network:
    """By Adam with weights that decay (Loshchilov and Hutter 2019), the step falling to nothing."""
    network = Network(features, random)
    numbers = [*network.weights, *network.offsets]
    first, second = ([np.zeros_like(each) for each in numbers] for _ in range(2))
    steps = EPOCHS * (len(floor) // BATCH)
    for step in range(1, steps + 1):
        chosen = random.integers(len(floor), size=BATCH)
        rate = RATE * (1.0 - (step - 1) / steps)
        for at, slope in enumerate(network.slopes(features[chosen], floor[chosen])):
            first[at] += 0.1 * (slope - first[at])
            second[at] += 0.001 * (slope * slope - second[at])
            size = np.sqrt(second[at] / (1.0 - 0.999**step)) + 1e-8
            numbers[at] -= rate * (first[at] / (1.0 - 0.9**step) / size + DECAY * numbers[at])
    return network


def features_of(colour: NDArray[np.uint8], depth_m: Float32Array, K: FloatArray) -> Float32Array:
    """(rows, columns, f) of one image; colour, depth: of the same pixels. K: (3, 3) of them."""
    scale = WIDTH / colour.shape[1]
    rows = round(colour.shape[0] * scale)
    small = cv2.resize(colour, (WIDTH, rows), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB).astype(np.float32) / 255.0
    depths_m = np.asarray(
        cv2.resize(depth_m, (WIDTH, rows), interpolation=cv2.INTER_NEAREST), np.float32
    )
    points_m, there = _points(depths_m, scale * (K[:2] + [[0, 0, 0.5]] * 2) - [[0, 0, 0.5]] * 2)
    normals = _normals(points_m)
    rough = np.abs(lab[..., :1] - cv2.GaussianBlur(lab, (0, 0), 3.0)[..., :1])
    inverse = np.where(there, 1.0 / np.maximum(points_m[..., 2], 0.1), 0.0)[..., None]
    down = _down(normals)
    heights = -points_m @ down
    lowest = np.percentile(heights[there], 2.0) if there.any() else 0.0
    level = np.stack([np.clip(heights - lowest, 0.0, 2.0), normals @ -down, there], axis=2)
    here = np.concatenate(
        [lab, cv2.GaussianBlur(lab, (0, 0), 4.0), rough, points_m, inverse, normals, level], axis=2
    ).astype(np.float32)
    squares = (
        square.mean(axis=(0, 1))
        for band in np.array_split(here[..., 7:], COARSE)
        for square in np.array_split(band, COARSE, axis=1)
    )
    coarse = np.concatenate(list(squares))
    whole = np.broadcast_to(coarse, (*here.shape[:2], coarse.size))
    return np.concatenate([here, whole], axis=2)


def _points(depth_m: Float32Array, K: FloatArray) -> tuple[Float32Array, BoolArray]:
    """(rows, columns, 3) points, freed of some noise, and whether there is a depth."""
    there = np.isfinite(depth_m) & (depth_m < 8.0)
    weight = cv2.blur(there.astype(np.float32), (3, 3))
    smooth = cv2.blur(np.where(there, depth_m, 0.0).astype(np.float32), (3, 3))
    z = np.where(there, smooth / np.maximum(weight, 1e-3), 0.0)
    v, u = np.mgrid[0 : z.shape[0], 0 : z.shape[1]]
    x, y = (u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z
    return np.stack([x, y, z], axis=2).astype(np.float32), there


def _normals(points_m: Float32Array) -> Float32Array:
    """(rows, columns, 3) towards the camera, 0 where neighbours lack."""
    down = np.roll(points_m, -1, axis=0) - np.roll(points_m, 1, axis=0)
    right = np.roll(points_m, -1, axis=1) - np.roll(points_m, 1, axis=1)
    crossed = np.cross(down, right)
    length = np.linalg.norm(crossed, axis=2, keepdims=True)
    return np.where(length > 1e-9, crossed / np.maximum(length, 1e-9), 0.0).astype(np.float32)


def _down(normals: Float32Array) -> FloatArray:
    """(3,) down in the image, corrected by surfaces that face up, within 40 degrees: as the camera
    is held."""
    down = np.array([0.0, 1.0, 0.0])
    for _ in range(2):
        level = normals[normals @ -down > np.cos(np.radians(40.0))]
        if len(level) > 0.02 * normals[..., 0].size:
            down = -level.mean(axis=0) / np.linalg.norm(level.mean(axis=0))
    return np.asarray(down)


def labelled(dataset: Dataset, every: int) -> Iterator[tuple[Float32Array, BoolArray]]:
    """(points, f) features and (points,) truth of every ``every``-th image."""
    frames = dataset.frames(COLOUR, (DEPTH, LABELS), stride=every)
    for number in range(len(frames)):
        frame = frames[number]
        found = features_of(frame[COLOUR][0], frame[DEPTH][0], frame["K"])
        is_floor = (frame[LABELS][0] == FLOOR).astype(np.float32)
        size = found.shape[1], found.shape[0]
        floor = cv2.resize(is_floor, size, interpolation=cv2.INTER_AREA) > 0.5
        yield found.reshape(-1, found.shape[2]), floor.ravel()


def examples_of(dataset: Dataset, every: int, random: np.random.Generator) -> Examples:
    """Some points of each image."""
    parts = []
    for features, floor in labelled(dataset, every):
        chosen = random.choice(len(floor), POINTS, replace=False)
        parts.append((features[chosen], floor[chosen], chosen))
    features, floor, places = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Examples(features, floor, places)


def tested(network: Network, usual: BoolArray, dataset: Dataset, every: int) -> tuple[float, float]:
    """Intersection over union of what the network finds, and of ``usual`` (points,), with the true
    floor: of all points of all images together."""
    both, either = np.zeros(2), np.zeros(2)
    for features, floor in labelled(dataset, every):
        for at, found in enumerate((network.scores(features) > 0.0, usual)):
            both[at] += np.count_nonzero(found & floor)
            either[at] += np.count_nonzero(found | floor)
    reached, without = (both / np.maximum(either, 1.0)).tolist()
    return reached, without


def usual_floor(learnt: Examples, points: int) -> BoolArray:
    """(points,) of an image, which are floor in most images for training."""
    seen = np.bincount(learnt.places, minlength=points)
    return np.bincount(learnt.places, learnt.floor, minlength=points) > 0.5 * seen


def real_images(
    path: Path, K: FloatArray | None, most: int
) -> Iterator[tuple[NDArray[np.uint8], Float32Array, FloatArray]]:
    """Colour, depth and camera matrix of some images of a recording or folder."""
    with open_cameras(path) as cameras:
        depth = cameras.of_kind("depth")[0].topic
        colour = cameras.depth_partners()[depth]
        matrix = cameras.model(colour).K if K is None else K
        every = -(-cameras.topics[depth].messages // most)
        for number, (far, seen) in enumerate(cameras.pairs(depth, colour)):
            if number % every == 0:
                yield seen.pixels, far.pixels, matrix


def painted(colour: NDArray[np.uint8], found: BoolArray) -> NDArray[np.uint8]:
    """An image beside itself, with what was found to be floor in green."""
    size = 320, round(320 * colour.shape[0] / colour.shape[1])
    small = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(found.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    green = np.where(mask[..., None], 0.5 * small + (0.0, 127.0, 0.0), small)
    return np.concatenate([small, green.astype(np.uint8)], axis=1)


def show(network: Network, images: Iterator[Any], path: Path) -> None:
    """A PNG of images and what the network finds in them."""
    sheets = []
    for colour, depth_m, K in images:
        features = features_of(colour, depth_m, K)
        scores = network.scores(features.reshape(-1, features.shape[2]))
        sheets.append(painted(colour, scores.reshape(features.shape[:2]) > 0.0))
    path.write_bytes(encode_png(np.concatenate(sheets), level=9))
    sys.stdout.write(f"{path}: {len(sheets)} images\n")


def simulated_images(dataset: Dataset, most: int) -> Iterator[Any]:
    """As ``real_images``, of a data set."""
    frames = dataset.frames(COLOUR, (DEPTH,))
    for number in range(0, len(frames), -(-len(frames) // most)):
        frame = frames[number]
        yield frame[COLOUR][0], frame[DEPTH][0], frame["K"]


def main(arguments: Sequence[str] | None = None) -> float:
    """The whole experiment; returns the intersection over union on the test split."""
    parser = argparse.ArgumentParser(description="Learn which pixels are floor.")
    parser.add_argument("dataset", help="folder or URL of a data set of the recipe diverse_rgbd")
    parser.add_argument("--images", type=Path, help="a recording or folder with real RGB-D images")
    parser.add_argument("--intrinsics", help="FX,FY,CX,CY of its images, where nothing tells them")
    parser.add_argument("--every", default=2, type=int, help="use every N-th image")
    parser.add_argument("--out", default=Path(), type=Path, help="folder for pictures")
    given = parser.parse_args(arguments)
    whole, random = slamsim.dataset.open(given.dataset), random_stream(0, "floor")
    dataset = {split: whole.split(split) for split in ("train", "test")}
    empty = [split for split, part in dataset.items() if not len(part)]
    if empty:
        parser.error(f"{given.dataset} has no sequence in the split {empty[0]}; make more (-n 20)")
    learnt = examples_of(dataset["train"], given.every, random)
    network = train(learnt.features, learnt.floor, random)
    usual = usual_floor(learnt, len(next(labelled(dataset["test"], given.every))[1]))
    reached, without = tested(network, usual, dataset["test"], given.every)
    sys.stdout.write(
        f"{len(learnt.floor):,} points to learn from\n"
        f"intersection over union in unseen worlds: {reached:.3f}, without network {without:.3f}\n"
    )
    given.out.mkdir(parents=True, exist_ok=True)
    show(network, simulated_images(dataset["test"], SHOWN), given.out / "floor_test.png")
    if given.images:
        K = None
        if given.intrinsics:
            fx, fy, cx, cy = map(float, given.intrinsics.split(","))
            K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        show(network, real_images(given.images, K, SHOWN), given.out / "floor_real.png")
    return reached


if __name__ == "__main__":
    main()
