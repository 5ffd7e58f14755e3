//! Where results come from: every file says it, in the same words.

use crate::support::{Bench, RECIPE};
use bladescan::job::sha256;
use bladescan::settings::Station;

#[test]
fn every_file_of_results_says_where_it_comes_from() {
    let bench = Bench::new("provenance-files");
    let said = ["--part", "SN-0042", "--operator", "R. Roe", "--seed", "7"];
    bench.dry_run(2, &said).expect(0, &[]);
    let run = bench.read_json("out/poses.json")["run"].clone();
    assert_eq!(bench.read_json("out/summary.json")["run"], run);
    assert_eq!((&run["part"], &run["operator"]), (&"SN-0042".into(), &"R. Roe".into()));
    assert_eq!((&run["seed"], &run["simulated"]), (&7.into(), &true.into()));
    assert_eq!(run["recipe"]["name"], "tiny");
    assert_eq!(run["recipe"]["sha256"], sha256(RECIPE.as_bytes()));
    assert_eq!(
        run["station"]["sha256"],
        sha256(Station::BUILTIN_SIMULATED_TEXT.as_bytes())
    );
    assert_eq!(run["station"]["calibration_id"], "simulated-nominal");
    assert_eq!(run["bladescan"]["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(run["cameras"].as_array().unwrap().len(), 1);
    let camera = &run["cameras"][0];
    assert!(
        camera["serial"].is_string() && camera["calibration_id"].is_u64(),
        "{camera}"
    );
    assert!(run["reconstructed_from"].is_null());

    let model = bench.read("out/model.ply");
    let text = String::from_utf8_lossy(&model[..2000]).into_owned();
    let (head, _) = text.split_once("end_header\n").unwrap();
    let recipe = format!("comment recipe: tiny, SHA-256 {}", sha256(RECIPE.as_bytes()));
    let camera = format!(
        "comment camera: {}, serial {}, calibration {}",
        camera["model"].as_str().unwrap(),
        camera["serial"].as_str().unwrap(),
        camera["calibration_id"]
    );
    for line in [
        "comment part: SN-0042",
        "comment operator: R. Roe",
        &recipe,
        &camera,
        "comment seed: 7",
    ] {
        assert!(head.lines().any(|found| found == line), "{line} is not in {head}");
    }
}

#[test]
fn a_part_that_no_file_can_hold_is_refused_before_anything_is_made() {
    let bench = Bench::new("provenance-part");
    let long = "x".repeat(201);
    for text in ["", " ", "two\nlines", &long] {
        let ended = bench.run(&["dry-run", "tiny.toml", "--out", "out", "--part", text]);
        ended.expect(2, &["give 1 to 200 characters in one line"]);
    }
    assert_eq!(bench.names("."), ["tiny.toml"]);
}

#[test]
fn a_fault_tells_the_operator_what_to_do_and_leaves_a_file() {
    let bench = Bench::new("provenance-fault");
    let ended = bench.dry_run(3, &["--fault", "robot-alarm=4315@1"]);
    ended.expect(
        1,
        &[
            "Do: remove the cause, reset on the pendant.",
            "Back: then go on with this run: bladescan resume",
        ],
    );
    let left = bench.read_json("out/fault.json");
    assert_eq!(left["fault"]["code"], "robot-alarm");
    assert_eq!((&left["way_back"], &left["view_index"]), (&"resume".into(), &1.into()));
    assert_eq!(left["run"], bench.read_json("out/poses.json")["run"]);
}
