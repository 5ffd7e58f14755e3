//! Recorded views registered anew, without devices.

use crate::support::{Bench, Ended, RECIPE};
use bladescan::job::sha256;
use bladescan::journal::{Record, Topic};

/// Reconstructs `out/run.mcap` into `again`.
fn reconstruct(bench: &Bench, options: &[&str]) -> Ended {
    let mut words = vec!["reconstruct", "--from", "out/run.mcap", "--out", "again"];
    words.extend(options);
    bench.run(&words)
}

/// The points of a model, without what its header says.
fn points(bench: &Bench, name: &str) -> Vec<u8> {
    let bytes = bench.read(name);
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|window| window == end).unwrap();
    bytes[at..].to_vec()
}

#[test]
fn the_same_recipe_gives_the_same_views_bit_for_bit() {
    let bench = Bench::new("reconstruct-same");
    // View 1 is taken again, so that its second attempt is the one to use.
    bench.dry_run(3, &["--fault", "corrupt-chunk@1"]).expect(0, &[]);
    reconstruct(&bench, &[]).expect(0, &["3 of 3 views merged (at least 2 wanted); files in again"]);
    assert_eq!(bench.names("again"), ["model.ply", "poses.json", "summary.json"]);
    let [own, again] = ["out", "again"].map(|dir| bench.read_json(&format!("{dir}/poses.json")));
    assert_eq!(own["views"], again["views"]);
    assert_eq!(again["views"][1]["attempt"], 1);
    assert!(points(&bench, "out/model.ply") == points(&bench, "again/model.ply"));
    let source = &again["run"]["reconstructed_from"];
    assert_eq!(source["file"], "run.mcap");
    assert_eq!(source["sha256"], sha256(&bench.read("out/run.mcap")));
    assert_eq!(own["run"]["cameras"], again["run"]["cameras"]);
    assert_eq!(bench.read_json("again/summary.json")["run"], again["run"]);
}

#[test]
fn another_overlap_decides_otherwise() {
    let bench = Bench::new("reconstruct-overlap");
    bench.dry_run(3, &[]).expect(0, &[]);
    assert_eq!(bench.statuses("out"), ["merged", "merged", "merged"]);
    let other = RECIPE.replace("overlap_min_fraction = 0.5", "overlap_min_fraction = 0.999");
    bench.write("strict.toml", &other);
    let ended = reconstruct(&bench, &["--recipe", "strict.toml", "--json"]);
    ended.expect(3, &["view 1: discarded", "at least 0.999 wanted"]);
    assert_eq!(bench.statuses("again"), ["merged", "discarded", "discarded"]);
    let summary: serde_json::Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!(summary["run"]["recipe"]["sha256"], sha256(other.as_bytes()));
}

#[test]
fn the_recording_of_a_killed_run_gives_the_views_that_had_come() {
    let bench = with_records("reconstruct-killed", |records| {
        let is_second_trigger = |record: &Record| {
            let event: Option<serde_json::Value> = serde_json::from_slice(&record.payload).ok();
            event.is_some_and(|event| event["event"] == "triggered" && event["view_index"] == 1)
        };
        let at = records.iter().position(is_second_trigger).unwrap();
        records.truncate(at + 1);
    });
    // Without its last bytes it has no end, as when the process was killed.
    let bytes = bench.read("out/run.mcap");
    bench.write("out/run.mcap", &bytes[..bytes.len() - 5]);
    reconstruct(&bench, &[]).expect(3, &["1 of 2 views merged (at least 2 wanted)"]);
    assert_eq!(bench.statuses("again"), ["merged", "missing"]);
}

#[test]
fn what_cannot_be_reconstructed_is_said_and_leaves_no_folder() {
    let bench = Bench::new("reconstruct-errors");
    bench.dry_run(2, &[]).expect(0, &[]);
    bench.write("other.toml", RECIPE.replace("step_deg = 10.0", "step_deg = 20.0"));
    reconstruct(&bench, &["--recipe", "other.toml"])
        .expect(2, &["out/run.mcap: the recipe plans 18 views, the recorded run 36"]);
    let ended = bench.run(&["reconstruct", "--from", "tiny.toml", "--out", "again"]);
    ended.expect(2, &["tiny.toml: not a readable MCAP file"]);
    let ended = bench.run(&["reconstruct", "--from", "none.mcap", "--out", "again"]);
    ended.expect(2, &["cannot read none.mcap"]);
    assert_eq!(bench.names("."), ["other.toml", "out", "tiny.toml"]);
    let ended = bench.run(&["reconstruct", "--from", "out/run.mcap", "--out", "out"]);
    ended.expect(2, &["out exists"]);
}

#[test]
fn a_recording_without_a_frame_is_said_to_have_none() {
    let bench = Bench::new("reconstruct-no-frame");
    bench.dry_run(2, &["--fault", "remote-off"]).expect(1, &[]);
    reconstruct(&bench, &[]).expect(2, &["the recording has no frame"]);
    assert!(!bench.path("again").exists());
}

/// Records a run of two views and writes its recording anew, changed.
fn with_records(name: &str, change: impl FnOnce(&mut Vec<Record>)) -> Bench {
    let bench = Bench::new(name);
    bench.dry_run(2, &[]).expect(0, &[]);
    let mut records = bench.records("out/run.mcap");
    change(&mut records);
    bench.rewrite("out/run.mcap", "changed.mcap", &records);
    std::fs::rename(bench.path("changed.mcap"), bench.path("out/run.mcap")).unwrap();
    bench
}

#[test]
fn a_recording_that_comes_out_differently_still_gives_its_views() {
    let bench = with_records("reconstruct-differs", |records| {
        records.retain(|record| record.topic != Topic::RobotSent);
    });
    bench.run(&["replay", "out/run.mcap"]).expect(5, &[]);
    reconstruct(&bench, &[]).expect(0, &["2 of 2 views merged"]);
    let [own, again] = ["out", "again"].map(|dir| bench.read_json(&format!("{dir}/poses.json"))["views"].clone());
    assert_eq!(own, again);
}

#[test]
fn a_recording_whose_frames_do_not_come_any_more_is_not_passed_off_as_whole() {
    let bench = with_records("reconstruct-frames-lost", |records| {
        let told = |record: &Record| String::from_utf8_lossy(&record.payload).contains("\"frame-arrived\"");
        let event = records
            .iter()
            .find(|record| record.topic == Topic::Event && told(record));
        let event = event.unwrap().clone();
        records.push(event);
    });
    let said = "the recording has 3 frames, of which this version finds 2";
    reconstruct(&bench, &[]).expect(2, &[said]);
    assert!(!bench.path("again").exists());
}
