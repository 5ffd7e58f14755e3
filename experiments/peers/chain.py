#!/usr/bin/env python3
"""Registers the views of a folder one after the other to the growing model, by other hands' programs and by ours, in turns.

    venv/bin/python experiments/peers/chain.py FOLDER --csv FILE [--method NAME]... [--views N] [--repeats R] [--threads N]...

See README.md beside this. Ours is `experiments model FOLDER --csv FILE`, and the columns are its own.
"""
import argparse
import csv
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

import cases
from worker import CORES, rotated, workers

COLUMNS = ["method", "threads", "repeat", "view", "merged", "rms_mm", "seconds"]
OURS = "bladescan"
# The view's frame has z towards the camera.
CAMERA = [0.0, 0.0, 1e6]


class Open3dPlane:
    """Point to plane. A view's normals (30 neighbours, as the tutorial has) are found once and averaged as its points are merged."""

    # The start is a few tenths of a mm off. With a longer last reach, what lies over the model's rim pulls: 5 um a view instead of 1.
    REACHES_MM = (0.6, 0.2, 0.1)

    def __init__(self, voxel, threads):
        import open3d

        self.open3d, self.voxel = open3d, voxel
        self.model = open3d.geometry.PointCloud()

    def view(self, points):
        cloud = self.open3d.geometry.PointCloud(self.open3d.utility.Vector3dVector(points))
        cloud.estimate_normals(self.open3d.geometry.KDTreeSearchParamKNN(30))
        cloud.orient_normals_towards_camera_location(CAMERA)
        return cloud

    def estimation(self):
        return self.open3d.pipelines.registration.TransformationEstimationPointToPlane()

    def register(self, view, start):
        o3d = self.open3d.pipelines.registration
        criteria = o3d.ICPConvergenceCriteria(1e-7, 1e-7, 50)
        for reach in self.REACHES_MM:
            start = o3d.registration_icp(view, self.model, reach, start, self.estimation(), criteria).transformation
        return start

    def merge(self, view, pose):
        self.model = (self.model + view.transform(pose)).voxel_down_sample(self.voxel)


class Open3dIcp(Open3dPlane):
    """Point to point."""

    def view(self, points):
        return self.open3d.geometry.PointCloud(self.open3d.utility.Vector3dVector(points))

    def estimation(self):
        return self.open3d.pipelines.registration.TransformationEstimationPointToPoint()


class SmallGicp:
    """GICP; view and model go through the package's own preprocessing, with 20 neighbours as its C++ default."""

    # Ends at the spacing: four times as much, the ratio of the package's examples, is up to twice as wrong at the model's rim.
    REACHES_MM = (0.6, 0.15)

    def __init__(self, voxel, threads):
        import small_gicp

        self.package, self.voxel, self.threads = small_gicp, voxel, threads
        self.model = np.empty((0, 3))

    def view(self, points):
        return points, self.package.preprocess_points(points, self.voxel, 20, self.threads)[0]

    def limits(self):
        tight = {"max_iterations": 100, "rotation_epsilon": 1e-6, "translation_epsilon": 1e-4 * self.voxel}
        return [{"max_correspondence_distance": reach, "num_threads": self.threads, **tight} for reach in self.REACHES_MM]

    def register(self, view, start):
        target, tree = self.package.preprocess_points(self.model, self.voxel, 20, self.threads)
        for limits in self.limits():
            start = self.package.align(target, view[1], tree, start, registration_type="GICP", **limits).T_target_source
        return start

    def merge(self, view, pose):
        together = np.vstack([self.model, cases.placed(view[0], pose)])
        sampled = self.package.voxelgrid_sampling(together, self.voxel, num_threads=self.threads)
        self.model = sampled.points()[:, :3]


class SmallVgicp(SmallGicp):
    """GICP against the package's incremental map of Gaussian voxels, of four times the spacing as in its examples."""

    REACHES_MM = (0.6,)

    def __init__(self, voxel, threads):
        super().__init__(voxel, threads)
        self.map = self.package.GaussianVoxelMap(4 * voxel)
        # The map forgets what has not been seen for so many views, which is meant for driving.
        self.map.set_lru(1000, 1000)

    def register(self, view, start):
        for limits in self.limits():
            start = self.package.align(self.map, view[1], start, **limits).T_target_source
        return start

    def merge(self, view, pose):
        super().merge(view, pose)
        self.map.insert(view[1], pose)


METHODS = {"open3d-icp": Open3dIcp, "open3d-plane": Open3dPlane, "small-gicp": SmallGicp, "small-vgicp": SmallVgicp}


def wrong_start(error_mm):
    """As `experiments model` disturbs each start: along and about fixed directions, a tenth of a degree for each mm."""
    axis = np.array([0.5, -0.3, 0.8]) / np.linalg.norm([0.5, -0.3, 0.8])
    angle = np.radians(0.1 * error_mm)
    cross = np.cross(np.eye(3), axis)
    rotation = np.eye(3) - np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return cases.matrix(rotation, np.array([0.6, 0.64, -0.48]) * error_mm)


def by_peer(threads, name, args):
    """View, merged, rms and seconds of each view; the first lies at its true place."""
    chain = METHODS[name](args.coincident_mm, threads)
    poses = [np.loadtxt(os.path.join(args.folder, f"pose_{view:02}.txt")) for view in range(args.views)]
    rows = []
    for index, pose in enumerate(poses):
        points = cases.points(os.path.join(args.folder, f"view_{index:02}.ply"))
        truth = poses[0] @ np.linalg.inv(pose)
        begun = time.perf_counter()
        view = chain.view(points)
        found = chain.register(view, truth @ wrong_start(args.start_error_mm)) if index else truth
        chain.merge(view, found)
        seconds = time.perf_counter() - begun
        rows.append([index, 1, f"{cases.rmse(points, found, truth):.9f}", f"{seconds:.4f}"])
    return rows


def by_bladescan(args):
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "chain.csv")
        command = [args.experiments, "model", args.folder, "--csv", path, "--views", str(args.views)]
        command += ["--coincident-mm", str(args.coincident_mm), "--start-error-mm", str(args.start_error_mm)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with open(path, newline="") as file:
            return [[row[name] for name in COLUMNS[3:]] for row in csv.DictReader(file)]


def job(threads, name, args):
    return by_bladescan(args) if name == OURS else by_peer(threads, name, args)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", metavar="FOLDER", help="with view_NN.ply and pose_NN.txt")
    parser.add_argument("--csv", required=True)
    parser.add_argument("--method", action="append", default=[], help="may be repeated [default: all]")
    parser.add_argument("--views", type=int, default=36)
    parser.add_argument("--coincident-mm", type=float, default=0.15, help="the distance within which points are merged")
    parser.add_argument("--start-error-mm", type=float, default=0.3)
    parser.add_argument("--threads", type=int, action="append", help="may be repeated [default: one, and all cores]")
    parser.add_argument("--repeats", type=int, default=1, help="how often each chain is made anew")
    parser.add_argument("--experiments", default="target/release/experiments", help="the program")
    args = parser.parse_args()
    if args.threads and max(args.threads) > len(CORES):
        parser.error(f"there are {len(CORES)} cores")
    return args


def main():
    args = arguments()
    names = args.method or [OURS, *METHODS]
    pool = workers(args.threads, job)
    few = argparse.Namespace(**{**vars(args), "views": min(2, args.views)})
    for worker in pool.values():
        for name in names:
            # What a first call loads is not the method's time.
            worker.call(name, few)
    with open(args.csv, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for repeat in range(args.repeats):
            for threads, worker in rotated(pool.items(), repeat):
                for name in rotated(names, repeat):
                    print(f"{name}, {threads} threads, repeat {repeat}", file=sys.stderr)
                    rows.writerows([name, threads, repeat, *row] for row in worker.call(name, args))
                    file.flush()
    for worker in pool.values():
        worker.close()


if __name__ == "__main__":
    main()
