#!/usr/bin/env python3
"""Registers case folders by the published BCPD program (github.com/ohirose/bcpd), and writes the rows that peers.py writes.

    venv/bin/python experiments/peers/bcpd_program.py BINARY ROOT --csv FILE [--method NAME]... [--level L]... [--count N] [--every N] [--threads N]

BINARY is what its makefile builds, version 0.95 or later: earlier ones have no rigid mode with the scale held at 1. The
seconds are the program's own for the optimisation, without its reading and writing of text.
"""
import argparse
import csv
import os
import subprocess
import sys
import tempfile

import numpy as np

import cases

COLUMNS = ["method", "threads", "case", "exp", "model", "level", "seed", "success", "rot_deg", "trans", "rmse", "seconds"]
# Rigid without scale, and the weight of outliers that ours has; all else is the program's default, the sums over all pairs included.
EXACT = ["-Tr", "-w0.1"]
# As its authors' rigid examples: sums from 300 sampled points, later over neighbours only.
SAMPLED = [*EXACT, "-J300", "-p", "-f0.3", "-r1"]
METHODS = {"bcpd-program": EXACT, "bcpd-program-sampled": SAMPLED}


def register(binary, source, target, options=EXACT, threads=1):
    """The motion target_from_source, 4 x 4."""
    return run(binary, source, target, options, threads)[0]


def run(binary, source, target, options, threads):
    """The motion, and the seconds of the optimisation."""
    environment = dict(os.environ, OMP_NUM_THREADS=str(threads), OPENBLAS_NUM_THREADS=str(threads))
    with tempfile.TemporaryDirectory() as folder:
        for name, cloud in (("X.txt", target), ("Y.txt", source)):
            np.savetxt(os.path.join(folder, name), cloud, fmt="%.17g", delimiter="\t")
        # T: save the motion; 0: save the times as plain numbers.
        command = [os.path.abspath(binary), *options, "-sT0", "-q", "-W"]
        subprocess.run(command, cwd=folder, env=environment, check=True, stdout=sys.stderr)
        scale, rotation, translation, times = (
            np.loadtxt(os.path.join(folder, f"output_{name}.txt")) for name in ("s", "R", "t", "comptime")
        )
    if abs(scale - 1) > 1e-9:
        raise ValueError(f"the program has found a scale, {scale}")
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation, translation
    return found, times[2, 0]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("root")
    parser.add_argument("--csv", required=True)
    parser.add_argument("--method", action="append", choices=METHODS)
    parser.add_argument("--level", action="append", default=[])
    parser.add_argument("--count", type=int, help="only the cases of each level that come first")
    parser.add_argument("--every", type=int, default=1, help="only every N-th point of both clouds")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    args = parser.parse_args()
    with open(args.csv, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for folder, meta in cases.find(args.root, args.level, args.count):
            source, target = (cases.points(os.path.join(folder, name))[:: args.every] for name in ("source.ply", "target.ply"))
            truth = np.loadtxt(os.path.join(folder, "gt.txt"))
            for name in args.method or METHODS:
                try:
                    estimate, seconds = run(args.binary, source, target, METHODS[name], args.threads)
                except (subprocess.CalledProcessError, OSError, ValueError) as error:
                    print(f"{name} {folder}: {error}", file=sys.stderr)
                    estimate, seconds = np.full((4, 4), np.nan), np.nan
                success, rotation, translation, rmse = cases.errors(source, meta, truth, estimate)
                row = [name, args.threads, os.path.relpath(folder, args.root)]
                row += [meta[key] for key in ("exp", "model", "level", "seed")]
                row += [success, *(f"{value:.9f}" for value in (rotation, translation, rmse)), f"{seconds:.4f}"]
                rows.writerow(row)
                file.flush()


if __name__ == "__main__":
    main()
