#!/usr/bin/env python3
"""Registers case folders by programs of other hands and by bladescan, in turns, and writes a row for each registration.

    venv/bin/python experiments/peers/peers.py ROOT... --csv FILE [--method NAME]... [--level L]... [--count N] [--repeats R] [--threads N]...

See README.md beside this. The columns are those of `experiments methods --csv`, and two more.
"""
import argparse
import csv
import json
import os
import subprocess
import sys
import time

import numpy as np

import cases
from worker import CORES, rotated, workers

COLUMNS = ["method", "threads", "case", "exp", "model", "level", "seed", "success", "rot_deg", "trans", "rmse", "seconds"]
COLUMNS += ["repeat", "wall_s"]
OURS = "bladescan"
# What is not here takes minutes a case, or is written here and no peer.
DEFAULT = [OURS, "open3d-icp", "open3d-plane", "open3d-gicp", "open3d-fpfh-plane", "small-gicp-scales", "kiss-gicp", "probreg-filterreg"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roots", nargs="+", metavar="ROOT")
    parser.add_argument("--csv", required=True)
    parser.add_argument("--method", action="append", default=[], help=f"may be repeated [default: {' '.join(DEFAULT)}]")
    parser.add_argument("--level", action="append", default=[], help="only cases of this level; may be repeated")
    parser.add_argument("--count", type=int, help="only the cases of each level that come first")
    parser.add_argument("--every", type=int, default=1, help="only every N-th point of both clouds (not for bladescan)")
    parser.add_argument("--threads", type=int, action="append", help="may be repeated [default: one, and all cores]")
    parser.add_argument("--repeats", type=int, default=1, help="how often each case is registered anew")
    parser.add_argument("--bladescan", default="target/release/bladescan", help="the program")
    args = parser.parse_args()
    args.method = args.method or DEFAULT
    if args.every > 1 and OURS in args.method:
        parser.error("bladescan reads the files themselves: no --every with it")
    if args.threads and max(args.threads) > len(CORES):
        parser.error(f"there are {len(CORES)} cores")
    return args


def by_bladescan(program, folder):
    """The motion, and the seconds that the program says it took after reading."""
    clouds = [cases.cloud_path(os.path.join(folder, name)) for name in ("source.ply", "target.ply")]
    # A poor result ends with a status of its own and is a result all the same.
    said = subprocess.run([program, "register", *clouds, "--json"], capture_output=True, text=True)
    if not said.stdout:
        raise RuntimeError(said.stderr.strip())
    document = json.loads(said.stdout)
    return np.array(document["reference_from_template"]), document["seconds"]


def by_peer(name, source, target, threads):
    from methods import METHODS, Given, spacing

    given = Given(threads, spacing(target))
    begun = time.perf_counter()
    estimate = np.asarray(METHODS[name](source, target, given))
    return estimate, time.perf_counter() - begun


def register(threads, name, folder, meta, every, program):
    """One registration in a worker: the row's success, errors, seconds and wall time."""
    truth = np.loadtxt(os.path.join(folder, "gt.txt"))
    begun = time.perf_counter()
    source, target = (cases.points(os.path.join(folder, file))[::every] for file in ("source.ply", "target.ply"))
    reading = time.perf_counter() - begun
    try:
        if name == OURS:
            begun = time.perf_counter()
            estimate, seconds = by_bladescan(program, folder)
            wall = time.perf_counter() - begun
        else:
            estimate, seconds = by_peer(name, source, target, threads)
            wall = reading + seconds
    except Exception as error:
        print(f"{name} {folder}: {error}", file=sys.stderr)
        estimate, seconds, wall = np.full((4, 4), np.nan), float("nan"), float("nan")
    return *cases.errors(source, meta, truth, estimate), seconds, wall


def warm(threads, names):
    """What a first call loads and compiles is not the method's time."""
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    cloud = np.random.default_rng(1).normal(size=(200, 3))
    for name in names:
        try:
            by_peer(name, cloud, cloud + 0.01 * cloud[::-1], threads)
        except Exception as error:
            print(f"{name}: the trial call failed: {error}", file=sys.stderr)


def job(threads, what, *arguments):
    return {"warm": warm, "register": register}[what](threads, *arguments)


def main():
    args = arguments()
    pool = workers(args.threads, job)
    for worker in pool.values():
        worker.call("warm", [name for name in args.method if name != OURS])
    turn = 0
    with open(args.csv, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for root in args.roots:
            # Two roots may hold folders of one name.
            below = os.path.dirname(os.path.abspath(root)) if len(args.roots) > 1 else root
            for folder, meta in cases.find(root, args.level, args.count):
                for repeat in range(args.repeats):
                    for threads, worker in rotated(pool.items(), turn):
                        for name in rotated(args.method, turn):
                            asked = name, folder, meta, args.every, args.bladescan
                            success, *errors, seconds, wall = worker.call("register", *asked)
                            row = [name, threads, os.path.relpath(folder, below)]
                            row += [meta.get(key, "") for key in ("exp", "model", "level", "seed")]
                            row += [success, *(f"{error:.9f}" for error in errors)]
                            rows.writerow(row + [f"{seconds:.4f}", repeat, f"{wall:.4f}"])
                            file.flush()
                    turn += 1
    for worker in pool.values():
        worker.close()


if __name__ == "__main__":
    main()
