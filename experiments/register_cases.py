#!/usr/bin/env python3
"""Runs `bladescan register` on case folders and scores the answers with the cases' own scorer.

    register_cases.py ROOT LEVEL SCORER     for example  cases/model2 10 cases/score.py

A case folder has source.ply, target.ply, gt.txt and meta.txt; a source or target may be a small file that holds the
relative path of the real one. Needs numpy (the scorer does).
"""
import glob, importlib.util, json, os, statistics, subprocess, sys, time

root, level, scorer = sys.argv[1:4]
binary = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "target", "release", "bladescan")
spec = importlib.util.spec_from_file_location("score", scorer)
score = importlib.util.module_from_spec(spec)
spec.loader.exec_module(score)


def resolved(path):
    if os.path.getsize(path) < 200:
        text = open(path).read().strip()
        if text.endswith(".ply"):
            return os.path.join(os.path.dirname(path), text)
    return path


rows = []
for folder in sorted(glob.glob(os.path.join(root, "pair_*"))):
    if score.meta(folder)["level"] != level:
        continue
    source, target = (resolved(os.path.join(folder, name)) for name in ("source.ply", "target.ply"))
    begun = time.monotonic()
    answer = subprocess.run([binary, "register", source, target, "--json"], capture_output=True, text=True)
    seconds = time.monotonic() - begun
    found = json.loads(answer.stdout)
    matrix = [value for row in found["reference_from_template"] for value in row]
    row = score.score(folder, matrix, score.rply(source))
    rows.append((row["success"], row["rot_deg"], row["rmse"], seconds, found["status"]))
successes = sum(row[0] for row in rows)
print(f"{successes} of {len(rows)} succeed; rotation median {statistics.median(r[1] for r in rows):.5f} deg, worst "
      f"{max(r[1] for r in rows):.5f}; rmse median {statistics.median(r[2] for r in rows):.5f}; whole process median "
      f"{statistics.median(r[3] for r in rows):.2f} s; status {sorted(set(r[4] for r in rows))}")
sys.exit(0 if successes == len(rows) else 1)
