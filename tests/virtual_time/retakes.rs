//! Views that are taken again, for the recipe's reasons, and views that are left out.

use super::*;
use serde_json::{Value, json};

/// The recipe with these lines in `[run]`, and a short coarse stage: many registrations here must fail.
fn recipe(run: &str) -> String {
    format!("{RECIPE}\n[registration]\nsample_count = 100\n[run]\n{run}\n")
}

/// The recipe with another exposure at view 1, µs.
fn exposed(exposure_us: u32, run: &str) -> String {
    recipe(run).replace(
        "[merge]",
        &format!("[[camera.exposure]]\nviews = [1]\nexposure_us = {exposure_us}\n[merge]"),
    )
}

impl Pair {
    fn summary(&self) -> Value {
        serde_json::from_slice(&self.files["summary.json"]).unwrap()
    }

    /// View and attempt of every trigger, in order.
    fn triggers(&self) -> Vec<(usize, u16)> {
        let triggered = self.events.iter().filter_map(|(_, event)| match event {
            Event::Triggered { view_index, attempt } => Some((*view_index, *attempt)),
            _ => None,
        });
        triggered.collect()
    }

    /// The views in the order in which they were merged or discarded.
    fn decided(&self) -> Vec<usize> {
        let decided = self.events.iter().filter_map(|(_, event)| match event {
            Event::ViewMerged { view_index, .. } | Event::ViewDiscarded { view_index, .. } => Some(*view_index),
            _ => None,
        });
        decided.collect()
    }
}

#[test]
fn a_dark_frame_is_taken_again_at_once_with_a_longer_exposure() {
    let text = exposed(DARK_US, "retake_exposure_factor = 10.0");
    let mut pair = Pair::with_recipe(&text, 3, &[], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!(pair.merged_count(), 3, "{:#?}", pair.events);
    assert_eq!(pair.triggers(), [(0, 0), (1, 0), (1, 1), (2, 0)]);
    // For view 0, for view 1, for view 1 again, and back for view 2.
    assert_eq!(pair.configured_at_ns.len(), 4);
    let note = format!("view 1: exposure {} us instead of {DARK_US} us", 10 * DARK_US);
    assert!(
        pair.events
            .iter()
            .any(|(_, event)| *event == Event::Noted { text: note.clone() })
    );
    let view = &pair.summary()["views"][1];
    assert_eq!((&view["attempts"], &view["retakes"]), (&json!(2), &json!(1)));
    let reason = view["not_used"][0]["reason"].as_str().unwrap();
    assert!(reason.ends_with("valid points, at least 1000 wanted"), "{reason}");
    pair.replay();
}

#[test]
fn a_saturated_frame_is_taken_again_shorter_if_the_recipe_says_so_and_used_if_not() {
    for (run, triggers) in [
        (
            "retake_on = [\"saturated\"]\nretake_exposure_factor = 10.0",
            vec![(0, 0), (1, 0), (1, 1), (2, 0)],
        ),
        (
            "retake_on = [\"no-frame\"]\nretake_exposure_factor = 10.0",
            vec![(0, 0), (1, 0), (2, 0)],
        ),
    ] {
        let text = exposed(BRIGHT_US, run).replace("points_min = 1000", "points_min = 1");
        let mut pair = Pair::with_recipe(&text, 3, &[], 0.0, 1);
        assert_eq!(pair.drive(|_| None), Ending::Finished);
        assert_eq!(pair.triggers(), triggers, "{run}");
        if triggers.len() == 4 {
            assert_eq!(pair.merged_count(), 3);
            let view = &pair.summary()["views"][1];
            let reason = view["not_used"][0]["reason"].as_str().unwrap();
            assert!(
                reason.contains("of its lit pixels are saturated, at most 0.200 wanted"),
                "{reason}"
            );
        }
        pair.replay();
    }
}

#[test]
fn a_frame_that_the_camera_itself_calls_too_bright_is_taken_again_shorter() {
    let text = recipe("retake_on = [\"saturated\"]\nretake_exposure_factor = 2.0");
    let mut pair = Pair::with_recipe(&text, 2, &["camera-error=405@1"], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!(pair.triggers(), [(0, 0), (1, 0), (1, 1)]);
    let note = "view 1: exposure 500 us instead of 1000 us";
    assert!(
        pair.events
            .iter()
            .any(|(_, event)| *event == Event::Noted { text: note.into() })
    );
    pair.replay();
}

#[test]
fn a_reason_that_the_recipe_does_not_name_takes_nothing_again() {
    let text = recipe("retake_on = [\"few-points\"]\nretakes_max = 3");
    let mut pair = Pair::with_recipe(&text, 3, &["corrupt-chunk@1"], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!(pair.triggers(), [(0, 0), (1, 0), (2, 0)]);
    assert_eq!(pair.summary()["views"][1]["decision"], "missing");
    assert_eq!(pair.summary()["views"][1]["attempts"], 1);
    pair.replay();
}

#[test]
fn discarded_views_are_taken_again_after_the_last_in_index_order_and_only_so_often() {
    let text = recipe("retake_on = [\"little-overlap\"]\nretakes_max = 2")
        .replace("overlap_min_fraction = 0.3", "overlap_min_fraction = 1.0");
    let course = |job_ns| {
        let mut pair = Pair::with_recipe(&text, 3, &[], 0.0, 1);
        pair.job_ns = job_ns;
        assert_eq!(pair.drive(|_| None), Ending::Finished);
        let course = (pair.triggers(), pair.decided(), pair.files["poses.json"].clone());
        let view = &pair.summary()["views"][2];
        assert_eq!((&view["decision"], &view["attempts"]), (&json!("discarded"), &json!(3)));
        let attempts: Vec<&Value> = view["not_used"]
            .as_array()
            .unwrap()
            .iter()
            .map(|entry| &entry["attempt"])
            .collect();
        assert_eq!(attempts, [0, 1]);
        pair.replay();
        course
    };
    let quick = course(1_000_000);
    let first = [(0, 0), (1, 0), (2, 0)];
    let again = [(1, 1), (2, 1), (1, 2), (2, 2)];
    assert_eq!(quick.0, [&first[..], &again[..]].concat());
    assert_eq!(quick.1, [0, 1, 2, 1, 2, 1, 2]);
    // However long registration takes.
    assert_eq!(course(5_000_000_000), quick);
}

/// Views 60° apart, view 1 left out: nothing joins view 0 but view 5, and view 4 only joins that.
#[test]
fn a_view_that_finds_no_place_is_merged_when_the_model_has_grown() {
    let text = recipe("retake_on = [\"ambiguous\"]")
        .replace("step_deg = 10.0", "step_deg = 60.0\nskip = [1]")
        .replace("overlap_min_fraction = 0.3", "overlap_min_fraction = 0.2");
    let mut pair = Pair::with_recipe(&text, 6, &[], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    let summary = pair.summary();
    let course = [0, 1, 2, 3, 4, 5].map(|view: usize| {
        let view = &summary["views"][view];
        (view["attempts"].as_u64().unwrap(), view["decision"].as_str().unwrap())
    });
    assert_eq!((course[0], course[1]), ((1, "merged"), (0, "missing")));
    assert_eq!((course[4], course[5]), ((2, "merged"), (1, "merged")));
    pair.replay();
}

#[test]
fn a_run_is_held_and_aborted_before_a_view_is_taken_again_and_the_view_stays_discarded() {
    let text =
        recipe("retake_on = [\"little-overlap\"]").replace("overlap_min_fraction = 0.3", "overlap_min_fraction = 1.0");
    let mut pair = Pair::with_recipe(&text, 2, &[], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::ViewTakenAgain { .. } => Some(Command::Hold),
        Event::Held => Some(Command::Abort),
        _ => None,
    });
    assert_eq!(ending, Ending::Aborted);
    let view = &pair.summary()["views"][1];
    assert_eq!((&view["decision"], &view["attempts"]), (&json!("discarded"), &json!(1)));
    assert_eq!(view["not_used"], json!([]));
    pair.replay();
}

#[test]
fn a_retake_goes_back_along_the_views_where_the_station_forbids_wide_turns() {
    let text =
        recipe("retake_on = [\"little-overlap\"]").replace("overlap_min_fraction = 0.3", "overlap_min_fraction = 1.0");
    let station = Station::BUILTIN_SIMULATED_TEXT.replace("[robot]", "[robot]\nstep_angle_max_deg = 10.0");
    let mut pair = Pair::at_station(&text, &station, 4, &[], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!(pair.triggers()[4..], [(1, 1), (2, 1), (3, 1)]);
    // 0, 1, 2, 3; back over 2 to 1; then 2 and 3.
    assert_eq!(pair.accepted_move_count, 8);
    pair.replay();
}

#[test]
fn views_that_the_recipe_leaves_out_are_missing_and_never_approached() {
    for skipped in ["0", "1"] {
        let text = RECIPE.replace("step_deg = 10.0", &format!("step_deg = 10.0\nskip = [{skipped}]"));
        let mut pair = Pair::with_recipe(&text, 3, &[], 0.0, 1);
        assert_eq!(pair.drive(|_| None), Ending::Finished);
        assert_eq!((pair.merged_count(), pair.accepted_move_count), (2, 2), "{skipped}");
        let poses: Value = serde_json::from_slice(&pair.files["poses.json"]).unwrap();
        let view = &poses["views"][skipped.parse::<usize>().unwrap()];
        assert_eq!(
            (&view["status"], &view["reason"]),
            (&json!("missing"), &json!("skipped by the recipe"))
        );
        assert_eq!(pair.summary()["counts"]["merged_min"], 2);
        pair.replay();
    }
}

#[test]
fn mistakes_about_views_that_are_left_out_are_named() {
    for (views, message) in [
        (
            "step_deg = 90.0\nskip = [3]\nviews_min = 4",
            "`views.views_min` is 4, but there are 4 views, 1 of them left out",
        ),
        (
            "step_deg = 10.0\nskip = [36]",
            "`views.skip` names view 36, but there are 36 views, from 0",
        ),
        (
            "step_deg = 10.0\nskip = [3, 3]",
            "`views.skip` names view 3 a second time",
        ),
        ("step_deg = 180.0\nskip = [0, 1]", "`views.skip` leaves no view"),
    ] {
        let error = Recipe::parse("small.toml", &RECIPE.replace("step_deg = 10.0", views)).unwrap_err();
        assert_eq!(error.message(), message);
    }
}

/// Too dark for the simulated blade, and bright enough to saturate it; ten times off each.
const DARK_US: u32 = 20;
const BRIGHT_US: u32 = 20_000;
