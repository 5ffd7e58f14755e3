//! The files of a run: `poses.json`, `summary.json`, `model.ply`.

use super::backlog::{Backlog, UnusedAttempt, ViewOutcome, ViewRecord};
use super::provenance::Provenance;
use crate::event::Ending;
use crate::geometry::matrix_rows;
use crate::geometry::ply::write_ply;
use crate::stamp::Stamp;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// What the files tell of.
pub(super) struct Decided<'a> {
    pub(super) provenance: &'a Provenance,
    pub(super) backlog: &'a Backlog,
    pub(super) ending: &'a Ending,
    pub(super) merged_min_count: usize,
}

impl Decided<'_> {
    /// The files, in the order in which they are written.
    pub(super) fn files(&self, now: Stamp) -> Vec<(&'static str, Vec<u8>)> {
        let mut files = Vec::new();
        let model = self.backlog.model();
        if !model.is_empty() {
            let comments = self.provenance.comments();
            let comments: Vec<&str> = comments.iter().map(String::as_str).collect();
            files.push(("model.ply", write_ply(&model.cloud(), &comments)));
        }
        files.push(("poses.json", text(&poses(self.provenance, self.backlog.views()))));
        files.push(("summary.json", text(&summary(self, now))));
        files
    }
}

fn poses(provenance: &Provenance, views: &[ViewRecord]) -> Value {
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
    json!({ "frame": "view_0", "run": provenance.value(), "views": views })
}

fn summary(decided: &Decided<'_>, now: Stamp) -> Value {
    let backlog = decided.backlog;
    let header = decided.provenance.header();
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
        "run": decided.provenance.value(),
        "ending": decided.ending,
        "counts": {
            "planned": views.len(),
            "merged": count("merged"),
            "merged_min": decided.merged_min_count,
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

pub(super) fn text(value: &Value) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(value).expect("a JSON value always has a text");
    bytes.push(b'\n');
    bytes
}
