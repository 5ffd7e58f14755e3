"""Case folders, clouds, rigid motions and errors, as the Rust side has them (`experiments/src/cases.rs`)."""
import os

import numpy as np


def find(root, levels=(), count=None):
    """Folder and meta of each case that is wanted, in order; of each level at most `count`."""
    seen = {}
    for folder, folders, files in os.walk(root):
        folders.sort()
        if "gt.txt" not in files:
            continue
        with open(os.path.join(folder, "meta.txt")) as file:
            meta = dict(line.strip().split("=", 1) for line in file if "=" in line)
        key = (meta["exp"], meta["level"])
        if levels and meta["level"] not in levels:
            continue
        seen[key] = seen.get(key, 0) + 1
        if count is None or seen[key] <= count:
            yield folder, meta


def cloud_path(path):
    """A tiny file that holds a relative path stands for the file there."""
    if os.path.getsize(path) < 200:
        with open(path) as file:
            return cloud_path(os.path.join(os.path.dirname(path), file.read().strip()))
    return path


def points(path):
    """The points of a binary PLY of x y z."""
    with open(cloud_path(path), "rb") as file:
        header = b""
        while not header.endswith(b"end_header\n"):
            header += file.readline()
        line = next(line for line in header.split(b"\n") if line.startswith(b"element vertex"))
        count = int(line.split()[2])
        return np.frombuffer(file.read(count * 12), "<f4").reshape(count, 3).astype(np.float64)


def errors(source, meta, truth, estimate):
    """Success, rotation (deg) and translation (eq. 11 and 12 of the paper), and the RMSE over the source points."""
    difference = estimate - truth
    rotation = np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(difference[:3, :3]) / 8**0.5)))
    translation = np.linalg.norm(difference[:3, 3])
    tolerance = 0.01 * float(meta["diag"]) / 2 if "diag" in meta else 0.02
    success = rotation < 2 and translation < tolerance
    return int(success), rotation, translation, rmse(source, estimate, truth)


def rmse(cloud, a, b):
    """Between where two motions bring the points."""
    difference = a - b
    moved = cloud @ difference[:3, :3].T + difference[:3, 3]
    return np.sqrt((moved**2).sum(1).mean())


def motion(a, b):
    """The rigid motion that lays a on b, by least squares."""
    here, there = a.mean(0), b.mean(0)
    u, _, vt = np.linalg.svd((b - there).T @ (a - here))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return matrix(rotation, there - rotation @ here)


def matrix(rotation, translation):
    found = np.eye(4)
    found[:3, :3] = rotation
    found[:3, 3] = np.ravel(translation)
    return found


def placed(cloud, pose):
    return cloud @ pose[:3, :3].T + pose[:3, 3]
