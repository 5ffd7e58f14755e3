//! The conformance suite against the simulated camera: it passes, and each fault fails the clause that it breaks.

use crate::camera_server::simulated_camera;
use bladescan::camera::conformance::{Permission, Told, Verdict, clauses, run, view_of};
use bladescan::camera::lines::Lines;

const ALLOWED: Permission = Permission {
    exposures: true,
    first_run: 1_000_000,
};

/// The report of the clauses whose ids begin with one of `wanted` (all, when there is none).
fn report(faults: &[String], wanted: &[&str]) -> Vec<Told> {
    let wanted: Vec<String> = wanted.iter().map(|&start| start.to_owned()).collect();
    let mut lines = Lines::new(simulated_camera(faults));
    run(&mut lines, ALLOWED, &wanted, |_| {}).unwrap()
}

fn failed(report: &[Told]) -> Vec<&'static str> {
    let is_failed = |told: &&Told| matches!(told.verdict, Verdict::Failed { .. });
    report.iter().filter(is_failed).map(|told| told.id).collect()
}

#[test]
fn the_simulated_camera_passes_every_clause_that_can_be_tried() {
    let report = report(&[], &[]);
    let failures: Vec<_> = report
        .iter()
        .filter(|told| matches!(told.verdict, Verdict::Failed { .. }))
        .collect();
    assert!(failures.is_empty(), "{failures:#?}");
    let is_skipped = |told: &&Told| matches!(told.verdict, Verdict::Skipped { .. });
    let skipped: Vec<&str> = report.iter().filter(is_skipped).map(|told| told.id).collect();
    assert_eq!(
        skipped,
        ["3.1-offline", "3.1-fault", "3.1-resetting", "3.5-device-lost"]
    );
}

#[test]
fn every_clause_has_a_name_of_its_own_and_a_row_in_the_docs() {
    let page = include_str!("../docs/protocols/conformance.md");
    let mut ids: Vec<&str> = clauses().iter().map(|clause| clause.id).collect();
    for clause in clauses() {
        let row = format!("| `{}` | {} | {} |", clause.id, clause.says, clause.does);
        assert!(page.contains(&row), "the page lacks this row:\n{row}");
    }
    ids.sort_unstable();
    let count = ids.len();
    ids.dedup();
    assert_eq!(ids.len(), count);
    let rows = page.lines().filter(|line| line.starts_with("| `")).count();
    assert_eq!(rows, count, "the page has rows of clauses that there are not");
}

/// Runs the clause, and one that must not suffer from what befalls it, with a fault aimed at the clause's trigger.
#[track_caller]
fn assert_fails(fault: &str, place: &str, clause: &str, expected: &[&str]) {
    let view = view_of(clause).unwrap();
    let spelling = format!("{fault}@{view}{place}");
    let report = report(std::slice::from_ref(&spelling), &[clause, "3.2-once"]);
    assert_eq!(failed(&report), expected, "{spelling}: {report:#?}");
}

#[test]
fn each_fault_of_a_trigger_fails_the_clause_that_it_breaks_and_no_other() {
    for (fault, place, clause) in [
        ("corrupt-chunk", "", "4.12-end"),
        ("wrong-count", "", "4.12-end"),
        ("wrong-count", ":reconstruction", "4.10-mask"),
        ("early-end", "", "4.11-chunks"),
        ("double-exposure", "", "3.2-course"),
        ("no-exposure", "", "3.2-course"),
        ("no-exposure", "", "4.10-head"),
        ("missed-trigger", "", "3.2-course"),
        ("camera-error=403", "", "3.2-course"),
        ("camera-error=402", ":exposure", "3.2-course"),
        ("camera-error=601", ":transfer", "4.11-chunks"),
        ("camera-gone", "", "3.2-course"),
        ("camera-gone", ":exposure", "3.2-course"),
        ("camera-silent", "", "3.2-course"),
        ("camera-kick", "", "3.2-course"),
        ("double-frame", "", "3.2-once"),
        ("late-frame=20", "", "3.7-times"),
        ("late-frame=5", ":exposure", "3.7-times"),
        ("camera-restart", "", "3.3-boot-id"),
        ("over-temperature=0.1", "", "3.2-course"),
        ("vendor-timeout=0.1", "", "3.2-course"),
    ] {
        assert_fails(fault, place, clause, &[clause]);
    }
    let view = view_of("3.2-again").unwrap();
    let report = report(
        &[format!("older-frame@{view}.1")],
        &["3.2-course", "3.2-again", "3.2-once"],
    );
    assert_eq!(failed(&report), ["3.2-again"]);
}

#[test]
fn frames_of_the_server_that_break_section_2_fail_the_clause_that_says_so() {
    for fault in [
        "corrupt-payload",
        "corrupt-header",
        "duplicate-seq",
        "skip-seq",
        "oversize",
    ] {
        for phase in ["acknowledge", "exposure", "reconstruction", "transfer"] {
            assert_fails(fault, &format!(":{phase}"), "2-server-frames", &["2-server-frames"]);
        }
    }
}

#[test]
fn a_device_that_pauses_degrades_or_sees_nothing_breaks_no_clause() {
    for (fault, place, clause) in [
        ("cool-down=20", "", "3.7-times"),
        ("degraded", "", "4.10-head"),
        ("empty-frame", "", "4.10-mask"),
        ("late-frame=0.5", "", "3.7-times"),
    ] {
        assert_fails(fault, place, clause, &[]);
    }
}

#[test]
fn a_device_that_is_lost_comes_back_or_does_not_as_the_page_says() {
    for (fault, place) in [
        ("camera-reset=3", ""),
        ("camera-reset=3", ":transfer"),
        ("camera-lost=4", ":reconstruction"),
        ("camera-broken", ""),
    ] {
        let view = view_of("3.5-device-lost").unwrap();
        let report = report(&[format!("{fault}@{view}{place}")], &["3.5-device-lost"]);
        assert_eq!(report[0].verdict, Verdict::Passed, "{fault}");
    }
}

#[test]
fn an_echo_that_differs_and_a_place_that_is_taken_fail_the_clauses_about_them() {
    let echo = report(&["config-echo".into()], &["4.5", "4.6", "3.1-idle"]);
    assert_eq!(failed(&echo), ["4.5-echo"]);
    let busy = report(&["controller-busy".into()], &["3.4", "4.14", "3.1-idle"]);
    assert_eq!(
        failed(&busy),
        [
            "3.4-second-controller",
            "3.4-observers",
            "4.14-config-changed",
            "3.1-idle",
            "3.4-observer-frames"
        ]
    );
}

#[test]
fn without_permission_the_camera_stays_dark() {
    let mut lines = Lines::new(simulated_camera(&[]));
    let dark = Permission {
        exposures: false,
        ..ALLOWED
    };
    let wanted = ["3.2".to_owned(), "4.13".to_owned(), "3.3".to_owned()];
    let report = run(&mut lines, dark, &wanted, |_| {}).unwrap();
    let skipped = report
        .iter()
        .filter(|told| matches!(told.verdict, Verdict::Skipped { .. }))
        .count();
    assert!(skipped > 20, "{report:#?}");
    assert_eq!(failed(&report), [""; 0]);
}
