//! The files of a run: `poses.json`, `summary.json`, `model.ply`.

use super::backlog::{Backlog, UnusedAttempt, ViewOutcome, ViewRecord};
use crate::event::Ending;
use crate::geometry::matrix_rows;
use crate::geometry::ply::write_ply;
use crate::seed::Seed;
use crate::stamp::Stamp;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// What names a run: it stands in the recording and in `summary.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Version of bladescan.
    pub version: String,
    /// What it was built for.
    pub target: String,
    /// The run's seed.
    pub seed: Seed,
    /// Names the run to the camera, which keeps the frames of one run; a run that is resumed keeps it. Not 0.
    #[serde(default = "run_id_of_old")]
    pub run_id: u64,
    /// Name of the recipe.
    pub recipe: String,
    /// Name of the station.
    pub station: String,
    /// Whether the cell is a simulated one.
    pub simulated: bool,
    /// Which part, as the operator named it.
    pub part: Option<String>,
    /// When the run began, UTC, RFC 3339.
    pub started_utc: String,
    /// How many of the plan's views are taken, if not all.
    pub view_count: Option<usize>,
}

/// What recordings without a run id said.
fn run_id_of_old() -> u64 {
    1
}

/// The files, in the order in which they are written.
pub(super) fn files(
    header: &Header,
    backlog: &Backlog,
    ending: &Ending,
    merged_min_count: usize,
    now: Stamp,
) -> Vec<(&'static str, Vec<u8>)> {
    let mut files = Vec::new();
    let model = backlog.model();
    if !model.is_empty() {
        let comments = [
            "bladescan model: millimetres, frame = camera frame at view 0",
            if header.simulated {
                "SIMULATED: nothing was measured"
            } else {
                "measured"
            },
        ];
        files.push(("model.ply", write_ply(&model.cloud(), &comments)));
    }
    files.push(("poses.json", text(&poses(backlog.views()))));
    files.push((
        "summary.json",
        text(&summary(header, backlog, ending, merged_min_count, now)),
    ));
    files
}

fn poses(views: &[ViewRecord]) -> Value {
    let views: Vec<Value> = views
        .iter()
        .enumerate()
        .map(|(index, view)| {
            let (status, reason) = status(&view.outcome);
            json!({
                "index": index,
                "attempt": view.attempt,
                "model_from_view": view.model_from_view().map(matrix_rows),
                "status": status,
                "reason": reason,
            })
        })
        .collect();
    json!({ "frame": "view_0", "views": views })
}

fn summary(header: &Header, backlog: &Backlog, ending: &Ending, merged_min_count: usize, now: Stamp) -> Value {
    let views = backlog.views();
    let count = |wanted: &str| views.iter().filter(|view| status(&view.outcome).0 == wanted).count();
    let mut stages: BTreeMap<&str, u64> = BTreeMap::new();
    for time in views.iter().flat_map(|view| &view.times) {
        *stages.entry(&time.name).or_default() += time.ns;
    }
    let stages: BTreeMap<&str, f64> = stages.into_iter().map(|(name, ns)| (name, seconds(ns))).collect();
    let mut removed: BTreeMap<&str, usize> = BTreeMap::new();
    for (reason, count) in views.iter().flat_map(|view| view.removed.by_reason()) {
        *removed.entry(reason).or_default() += count;
    }
    let entries: Vec<Value> = views
        .iter()
        .enumerate()
        .map(|(index, view)| summary_entry(index, view))
        .collect();
    json!({
        "recipe": header.recipe,
        "station": header.station,
        "part": header.part,
        "started_utc": header.started_utc,
        "simulated": header.simulated,
        "seed": header.seed.0,
        "versions": { "bladescan": header.version, "target": header.target },
        "ending": ending,
        "counts": {
            "planned": views.len(),
            "merged": count("merged"),
            "merged_min": merged_min_count,
            "discarded": count("discarded"),
            "missing": count("missing"),
            "model_points": backlog.model().len(),
            "removed": removed,
        },
        "timings": { "run_s": now.seconds(), "stages_s": stages },
        "views": entries,
    })
}

fn summary_entry(index: usize, view: &ViewRecord) -> Value {
    let (decision, reason) = status(&view.outcome);
    let figures = view.figures;
    let registration_ns: u64 = view.times.iter().map(|time| time.ns).sum();
    json!({
        "index": index,
        "decision": decision,
        "reason": reason,
        "retakes": view.attempt,
        "attempts": view.attempt_count,
        "not_used": view.not_used.iter().map(unused_entry).collect::<Vec<_>>(),
        "points": view.point_count,
        "removed": view.removed,
        "overlap": { "count": figures.overlap_count, "fraction": figures.overlap_fraction },
        "rmse_mm": figures.rmse_mm,
        "from_robot_pose": { "rotation_deg": figures.from_prior_deg, "translation_mm": figures.from_prior_mm },
        "weak_directions": figures.weak_direction_count,
        "registration_s": seconds(registration_ns),
        "latency_s": view.latency_ms as f64 * 1e-3,
    })
}

fn unused_entry(unused: &UnusedAttempt) -> Value {
    json!({ "attempt": unused.attempt, "reason": unused.reason })
}

fn status(outcome: &ViewOutcome) -> (&'static str, Option<&str>) {
    match outcome {
        ViewOutcome::Merged { .. } => ("merged", None),
        ViewOutcome::Discarded { reason } => ("discarded", Some(reason)),
        ViewOutcome::Missing { reason } => ("missing", Some(reason)),
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

fn text(value: &Value) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(value).expect("a JSON value always has a text");
    bytes.push(b'\n');
    bytes
}
