#!/usr/bin/env python3
"""Registers case folders by programs of other hands, and writes the rows that `experiments methods --csv` writes.

    python3 -m venv venv && venv/bin/pip install -r experiments/peers/requirements.txt
    venv/bin/python experiments/peers/peers.py ROOT --csv FILE [--method NAME]... [--level L]... [--count N] [--every N] [--threads N]

All start from the identity. Where a package gives no rigid motion, that of the points it has moved is taken. What is
called `own-...` is written here, plainly and with all pairs in memory, for want of a package: a second reading of the paper.
probreg's CPD is left out: with the scale held at 1 its variance stands still at 0.16 on clouds of unit size.
"""
import argparse
import csv
import os
import sys
import time

COLUMNS = ["method", "threads", "case", "exp", "model", "level", "seed", "success", "rot_deg", "trans", "rmse", "seconds"]
ICP_ITERATIONS = 200
EM_ITERATIONS = 150
OUTLIER_FRACTION = 0.1
GOLDEN = 0.6180339887498948


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root")
    parser.add_argument("--csv", required=True)
    parser.add_argument("--method", action="append", default=[])
    parser.add_argument("--level", action="append", default=[])
    parser.add_argument("--count", type=int, help="only the cases of each level that come first")
    parser.add_argument("--every", type=int, default=1, help="only every N-th point of both clouds")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    return parser.parse_args()


args = arguments()
for name in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{name}_NUM_THREADS"] = str(args.threads)

import numpy as np  # noqa: E402  (the threads must be known first)
from scipy.spatial import cKDTree  # noqa: E402


def cases():
    """Folder, meta and truth of each case that is wanted, in order."""
    seen = {}
    for folder, folders, files in sorted(os.walk(args.root)):
        folders.sort()
        if "gt.txt" not in files:
            continue
        with open(os.path.join(folder, "meta.txt")) as file:
            meta = dict(line.strip().split("=", 1) for line in file if "=" in line)
        key = (meta["exp"], meta["level"])
        if args.level and meta["level"] not in args.level:
            continue
        seen[key] = seen.get(key, 0) + 1
        if args.count is None or seen[key] <= args.count:
            yield folder, meta, np.loadtxt(os.path.join(folder, "gt.txt"))


def points(path):
    """The points of a binary PLY of x y z; a tiny file that holds a relative path stands for the file there."""
    if os.path.getsize(path) < 200:
        with open(path) as file:
            return points(os.path.join(os.path.dirname(path), file.read().strip()))
    with open(path, "rb") as file:
        header = b""
        while not header.endswith(b"end_header\n"):
            header += file.readline()
        line = next(line for line in header.split(b"\n") if line.startswith(b"element vertex"))
        count = int(line.split()[2])
        return np.frombuffer(file.read(count * 12), "<f4").reshape(count, 3).astype(np.float64)


def errors(source, meta, truth, estimate):
    """As `score.py` of the cases: eq. 11 and 12 of the paper, and the RMSE over the source points."""
    difference = estimate - truth
    rotation = np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(difference[:3, :3]) / 8**0.5)))
    translation = np.linalg.norm(difference[:3, 3])
    moved = source @ difference[:3, :3].T + difference[:3, 3]
    tolerance = 0.01 * float(meta["diag"]) / 2 if "diag" in meta else 0.02
    success = rotation < 2 and translation < tolerance
    return int(success), rotation, translation, np.sqrt((moved**2).sum(1).mean())


def motion(a, b):
    """The rigid motion that lays a on b."""
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


def open3d_cloud(cloud):
    import open3d

    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud))


def open3d_icp(source, target):
    import open3d

    criteria = open3d.pipelines.registration.ICPConvergenceCriteria(1e-9, 1e-9, ICP_ITERATIONS)
    step = open3d.pipelines.registration.TransformationEstimationPointToPoint()
    reach = 1e3 * np.ptp(target, axis=0).max()
    return open3d.pipelines.registration.registration_icp(
        open3d_cloud(source), open3d_cloud(target), reach, np.eye(4), step, criteria
    ).transformation


def own_tricp(source, target):
    """Trimmed ICP with the overlap by golden section (Chetverikov et al. 2005)."""
    tree = cKDTree(target)

    def run(overlap):
        pose, last, kept = np.eye(4), np.inf, max(3, round(overlap * len(source)))
        for _ in range(100):
            distances, partners = tree.query(placed(source, pose), workers=args.threads)
            order = np.argsort(distances, kind="stable")[:kept]
            error = (distances[order] ** 2).mean()
            if abs(last - error) <= 1e-4 * error:
                break
            last = error
            pose = motion(source[order], target[partners[order]])
        return last / overlap**3, pose

    low, high = 0.4, 1.0
    runs = [run(high)]
    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    of_left, of_right = run(left), run(right)
    while high - low > 0.02:
        runs += [of_left, of_right]
        if of_left[0] < of_right[0]:
            high, right, of_right = right, left, of_left
            left = high - GOLDEN * (high - low)
            of_left = run(left)
        else:
            low, left, of_left = left, right, of_right
            right = low + GOLDEN * (high - low)
            of_right = run(right)
    return min(runs + [of_left, of_right], key=lambda found: found[0])[1]


def pycpd_rigid(source, target):
    """In the unit that the authors' program brings the target to; pycpd leaves that to its caller."""
    from pycpd import RigidRegistration

    class FixedScale(RigidRegistration):
        """The package always finds a scale too; with 1 instead, translation and variance are others."""

        def update_transform(self):
            super().update_transform()
            self.s = 1.0
            self.t = (self.P.sum(0) @ self.X - (self.P.sum(1) @ self.Y) @ self.R) / self.Np

        def update_variance(self):
            super().update_variance()
            squared = self.Pt1 @ (self.X_hat**2).sum(1) - 2 * np.trace(self.A @ self.R) + self.YPY
            self.sigma2 = max(squared / (self.Np * self.D), np.finfo(float).eps)

    unit = np.sqrt(((target - target.mean(0)) ** 2).sum(1).mean())
    moved, _ = FixedScale(
        X=target / unit, Y=source / unit, w=OUTLIER_FRACTION, max_iterations=EM_ITERATIONS
    ).register()
    return motion(source, moved * unit)


def own_bcpd(source, target):
    """Rigid BCPD (Hirose 2021) with infinite lambda and kappa, omega 0.1, gamma 1, ended as the published program ends."""
    unit = np.sqrt(((source - source.mean(0)) ** 2).mean())
    x, y = (target - source.mean(0)) / unit, (source - source.mean(0)) / unit
    volume = np.prod(np.ptp(x, axis=0) * (len(x) + 1) / len(x))
    sigma = np.sqrt(((x**2).sum() * len(y) + (y**2).sum() * len(x) - 2 * x.sum(0) @ y.sum(0)) / (len(x) * len(y) * 3))
    pose = np.eye(4)
    for iteration in range(500):
        here = placed(y, pose)
        squared = (x**2).sum(1)[:, None] + (here**2).sum(1)[None, :] - 2 * x @ here.T
        share = np.exp(-np.maximum(squared, 0) / (2 * sigma**2)) / len(y)
        outlier = (2 * np.pi * sigma**2) ** 1.5 * OUTLIER_FRACTION / (volume * (1 - OUTLIER_FRACTION))
        share /= share.sum(1, keepdims=True) + outlier
        weights, of_x = np.maximum(share.sum(0), 1e-20), share.sum(1)
        matched = share.T @ x / weights[:, None]
        mean_x, mean_y = weights @ matched / weights.sum(), weights @ y / weights.sum()
        u, _, vt = np.linalg.svd((weights[:, None] * (matched - mean_x)).T @ (y - mean_y))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        pose = matrix(rotation, mean_x - rotation @ mean_y)
        here = placed(y, pose)
        total = of_x @ (x**2).sum(1) + weights @ (here**2).sum(1) - 2 * (weights[:, None] * matched * here).sum()
        last, sigma = sigma, np.sqrt(max(0.0, total / (3 * weights.sum())))
        if iteration > 30 and (sigma < 1e-4 or abs(last - sigma) < 1e-4):
            break
    return motion(source, placed(y, pose) * unit + source.mean(0))


def probreg_filterreg(source, target):
    from probreg import filterreg

    found = filterreg.registration_filterreg(
        open3d_cloud(source), open3d_cloud(target), update_sigma2=True, w=OUTLIER_FRACTION, maxiter=EM_ITERATIONS
    )
    return motion(source, np.asarray(found.transformation.transform(source)))


def spacing(cloud):
    return np.median(cKDTree(cloud).query(cloud, k=2)[0][:, 1])


def small_gicp_with(kind):
    def register(source, target):
        import small_gicp

        return small_gicp.align(
            target,
            source,
            registration_type=kind,
            downsampling_resolution=0.1 * spacing(target),
            max_correspondence_distance=0.5 * np.ptp(target, axis=0).max(),
            num_threads=args.threads,
            max_iterations=ICP_ITERATIONS,
        ).T_target_source

    return register


def kiss_matcher_robust(source, target):
    import kiss_matcher

    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(2.0 * spacing(target)))
    found = matcher.estimate(source.astype(np.float32), target.astype(np.float32))
    return matrix(np.asarray(found.rotation), np.asarray(found.translation))


METHODS = {
    "open3d-icp": open3d_icp,
    "own-tricp": own_tricp,
    "pycpd": pycpd_rigid,
    "own-bcpd": own_bcpd,
    "probreg-filterreg": probreg_filterreg,
    "small-gicp": small_gicp_with("GICP"),
    "small-icp": small_gicp_with("ICP"),
    "kiss-matcher": kiss_matcher_robust,
}


def main():
    names = args.method or list(METHODS)
    for name in names:
        # What a first call loads and compiles is not the method's time.
        cloud = np.random.default_rng(1).normal(size=(200, 3))
        try:
            METHODS[name](cloud, cloud + 0.01 * cloud[::-1])
        except Exception as error:
            print(f"{name}: the trial call failed: {error}", file=sys.stderr)
    with open(args.csv, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for folder, meta, truth in cases():
            source, target = (points(os.path.join(folder, name))[:: args.every] for name in ("source.ply", "target.ply"))
            for name in names:
                begun = time.perf_counter()
                try:
                    estimate = np.asarray(METHODS[name](source, target))
                except Exception as error:
                    print(f"{name} {folder}: {error}", file=sys.stderr)
                    estimate = np.full((4, 4), np.nan)
                seconds = time.perf_counter() - begun
                success, rotation, translation, rmse = errors(source, meta, truth, estimate)
                row = [name, args.threads, os.path.relpath(folder, args.root)]
                row += [meta.get(key, "") for key in ("exp", "model", "level", "seed")]
                row += [success, *(f"{value:.9f}" for value in (rotation, translation, rmse)), f"{seconds:.4f}"]
                rows.writerow(row)
                file.flush()


main()
