#!/usr/bin/env bash
# The end-to-end figures of docs/results.md: each shipped recipe as a dry run, scored, replayed at 1 and 2 threads, and
# run again with one thread. Usage: experiments/bars.sh [SEED [SURFACE]]; other surfaces than matte with the polished recipes.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --locked --quiet
bin=target/release/bladescan
seed=${1:-1}
surface=${2:-matte}
[ "$surface" = matte ] && variant= || variant=-polished
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for blade in hpt-blade-a hpt-blade-b hpt-blade-c lpt-blade; do
  recipe=$blade$variant
  dir="$work/$recipe"
  $bin dry-run "config/recipes/$recipe.toml" --seed "$seed" --surface "$surface" --out "$dir" --json >"$dir.json" 2>"$dir.log"
  $bin sim score "$dir" >"$dir.score"
  python3 - "$recipe" "$dir.json" "$dir.score" <<'PY'
import json, statistics, sys
summary, score = (json.load(open(path)) for path in sys.argv[2:])
counts, views, figures = summary["counts"], summary["views"], score["summary"]
points = [view["points"] for view in views]
seconds = [view["registration_s"] for view in views]
print(f"{sys.argv[1]:12} merged {counts['merged']}/{counts['planned']}  run {summary['timings']['run_s']:.1f} s  "
      f"points {min(points)}..{max(points)}  view {statistics.median(seconds):.2f} s  model {counts['model_points']}")
print(f"{'':12} pair rotation median {figures['pair_rotation_median_deg']:.4f} max {figures['pair_rotation_max_deg']:.4f} deg  "
      f"surface rms {figures['surface_rms_mm']:.4f} max {figures['surface_max_mm']:.4f} mm")
for view in views:
    if view["decision"] != "merged":
        print(f"{'':12} view {view['index']}: {view['decision']}, {view['reason']}")
PY
  for threads in 1 2; do
    printf '%12s replay on %s: ' '' "$threads"
    RAYON_NUM_THREADS=$threads $bin replay "$dir/run.mcap" | tail -n 1
  done
  RAYON_NUM_THREADS=1 $bin dry-run "config/recipes/$recipe.toml" --seed "$seed" --surface "$surface" --out "$dir-again" 2>>"$dir.log"
  for file in poses.json model.ply; do
    cmp "$dir/$file" "$dir-again/$file" && printf '%12s again on 1 thread: %s byte-equal\n' '' "$file"
  done
  rm -rf "$dir" "$dir-again"
done
