//! Commands that touch no device, and mistakes that are told before anything is made or moved.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests, outside the functions that clippy takes for tests"
)]

use crate::support::{Bench, CLOSED, RECIPE, station};
use serde_json::Value;
use std::fmt::Write as _;

/// A dry run of [`RECIPE`] with `from` replaced by `to` ends before anything is made, and says each of the texts.
#[track_caller]
fn assert_bad_recipe(name: &str, from: &str, to: &str, texts: &[&str]) {
    let bench = Bench::new(name);
    let text = RECIPE.replacen(from, to, 1);
    assert_ne!(text, RECIPE, "nothing was replaced");
    bench.write("bad.toml", text);
    for words in [
        ["dry-run", "bad.toml", "--out=out"].as_slice(),
        ["check", "bad.toml"].as_slice(),
    ] {
        let ended = bench.run(words);
        ended.expect(2, texts);
        assert_eq!(ended.stdout, "");
    }
    assert_eq!(bench.names("."), ["bad.toml", "tiny.toml"]);
}

#[test]
fn an_unknown_key_is_shown_with_its_line_and_the_keys_there_are() {
    assert_bad_recipe(
        "cli-unknown-key",
        "points_min",
        "points_mim",
        &[
            "unknown key `camera.points_mim`",
            "[bad.toml:17:1]",
            "· ──────────",
            "did you mean `points_min`? keys of [camera]: optics, binning, roi_px",
        ],
    );
}

#[test]
fn a_value_out_of_range_is_shown_with_its_line_and_the_range() {
    assert_bad_recipe(
        "cli-negative-step",
        "step_deg = 10.0",
        "step_deg = -10.0",
        &[
            "`views.step_deg` is -10.0 deg, allowed is 0.5 to 180 deg",
            "[bad.toml:7:12]",
            "·            ─────",
        ],
    );
}

#[test]
fn a_step_that_does_not_divide_the_turn_is_shown_with_the_nearest_that_do() {
    assert_bad_recipe(
        "cli-undivided-turn",
        "step_deg = 10.0",
        "step_deg = 7.0",
        &[
            "does not divide 360 deg",
            "[bad.toml:7:12]",
            "·            ───",
            "6.923077 and 7.058824 deg",
        ],
    );
}

#[test]
fn a_value_of_another_type_is_shown_with_its_line_and_the_range() {
    assert_bad_recipe(
        "cli-wrong-type",
        "points_min = 500",
        "points_min = \"many\"",
        &[
            "`camera.points_min` must be a whole number, not text",
            "[bad.toml:17:14]",
            "allowed: 1 to 1555200",
        ],
    );
}

#[test]
fn an_unknown_lens_set_is_shown_with_those_there_are() {
    assert_bad_recipe(
        "cli-unknown-optics",
        "\"fine\"",
        "\"tele\"",
        &[
            "`camera.optics` cannot be \"tele\"",
            "[bad.toml:15:10]",
            "allowed: \"fine\", \"medium\", \"wide\"",
        ],
    );
}

#[test]
fn text_that_is_no_toml_is_shown_where_it_breaks() {
    assert_bad_recipe(
        "cli-broken-toml",
        "[camera]",
        "[camera",
        &["unclosed table, expected `]`", "[bad.toml:14:8]", "▲"],
    );
}

#[test]
fn an_unknown_section_is_named() {
    assert_bad_recipe(
        "cli-unknown-section",
        "[presentation]",
        "[run2]",
        &["unknown key `run2`", "[bad.toml:10:2]"],
    );
}

#[test]
fn a_missing_key_is_named() {
    assert_bad_recipe(
        "cli-missing-key",
        "position_mm = [0.0, 0.0, 280.0]\n",
        "",
        &["`presentation.position_mm` is missing", "[bad.toml:"],
    );
}

#[test]
fn a_shape_file_that_is_not_there_is_named() {
    assert_bad_recipe(
        "cli-missing-shape",
        "builtin:hpt-a",
        "blade.stl",
        &["bad.toml: blade.cad names blade.stl, which is not there"],
    );
}

#[test]
fn a_recipe_that_is_not_there_is_named() {
    let bench = Bench::new("cli-missing-recipe");
    for command in ["check", "dry-run"] {
        bench.run(&[command, "none.toml"]).expect(2, &["cannot read none.toml"]);
    }
    assert_eq!(bench.names("."), ["tiny.toml"]);
}

#[test]
fn a_built_in_blade_that_there_is_not_leaves_no_folder() {
    let bench = Bench::new("cli-unknown-blade");
    bench.write("bad.toml", RECIPE.replace("hpt-a", "hpt-z"));
    for arguments in [&["dry-run", "bad.toml", "--out", "out"][..], &["check", "bad.toml"][..]] {
        bench.run(arguments).expect(
            2,
            &["bad.toml: blade.cad names builtin:hpt-z", "builtin:lpt, builtin:hpt-a"],
        );
    }
    assert_eq!(bench.names("."), ["bad.toml", "tiny.toml"]);
}

#[test]
fn a_fault_that_there_is_not_is_answered_with_the_list_and_leaves_no_folder() {
    let bench = Bench::new("cli-unknown-fault");
    let ended = bench.run(&["dry-run", "tiny.toml", "--out", "out", "--fault", "gremlins"]);
    ended.expect(
        2,
        &[
            "no fault is called \"gremlins\"",
            "\n  camera-gone@VIEW ",
            "\n  elsewhere=MM@MOVE ",
        ],
    );
    assert_eq!(bench.names("."), ["tiny.toml"]);
}

#[test]
fn a_fault_without_its_view_is_answered_with_its_spelling() {
    let bench = Bench::new("cli-fault-form");
    let ended = bench.run(&["dry-run", "tiny.toml", "--out", "out", "--fault", "camera-gone"]);
    ended.expect(2, &["\"camera-gone\" is not of the form camera-gone@VIEW"]);
    assert_eq!(bench.names("."), ["tiny.toml"]);
}

#[test]
fn a_speed_out_of_range_is_answered_with_the_range() {
    let bench = Bench::new("cli-speed");
    let ended = bench.run(&["dry-run", "tiny.toml", "--out", "out", "--speed", "0"]);
    ended.expect(2, &["give a number from 0.1 to 1000"]);
    assert_eq!(bench.names("."), ["tiny.toml"]);
}

#[test]
fn a_run_without_arm_ends_before_anything_is_connected_or_made() {
    let bench = Bench::new("cli-unarmed");
    bench.write("station.toml", station(CLOSED, CLOSED));
    let ended = bench.run(&["run", "tiny.toml", "--station", "station.toml", "--out", "out"]);
    ended.expect(2, &["--arm", "nothing was connected"]);
    assert_eq!(bench.names("."), ["station.toml", "tiny.toml"]);
}

#[test]
fn an_armed_run_on_the_built_in_station_is_sent_to_the_dry_run() {
    let bench = Bench::new("cli-armed-simulation");
    bench.write("station.toml", bladescan::settings::Station::BUILTIN_SIMULATED_TEXT);
    let ended = bench.run(&["run", "tiny.toml", "--station", "station.toml", "--arm", "--out", "out"]);
    ended.expect(2, &["use dry-run"]);
    assert_eq!(bench.names("."), ["station.toml", "tiny.toml"]);
}

#[test]
fn a_mistake_in_a_station_is_shown_with_its_line() {
    let bench = Bench::new("cli-bad-station");
    let text = station(CLOSED, CLOSED).replace("kind = \"simulated\"", "kind = \"imagined\"");
    bench.write("station.toml", text);
    let ended = bench.run(&["run", "tiny.toml", "--station", "station.toml", "--arm", "--out", "out"]);
    ended.expect(
        2,
        &[
            "`kind` cannot be \"imagined\"",
            "[station.toml:4:8]",
            "\"simulated\", \"cell\"",
        ],
    );
    assert_eq!(bench.names("."), ["station.toml", "tiny.toml"]);
}

#[test]
fn check_prints_a_row_for_every_view_of_the_plan() {
    let bench = Bench::new("cli-check");
    let ended = bench.run(&["check", "tiny.toml"]);
    ended.expect(0, &[]);
    assert_eq!(ended.stderr, "");
    assert!(
        ended
            .stdout
            .starts_with("recipe tiny on station sim: valid\n36 views, ")
    );
    let rows = ended.stdout.lines().skip_while(|line| !line.starts_with("view "));
    let numbers: Vec<usize> = rows
        .skip(1)
        .map(|row| row.split_whitespace().next().unwrap().parse().unwrap())
        .collect();
    assert_eq!(numbers, (0..36).collect::<Vec<_>>());
}

#[test]
fn check_prints_one_json_document_on_demand() {
    let bench = Bench::new("cli-check-json");
    let ended = bench.run(&["check", "tiny.toml", "--json"]);
    ended.expect(0, &[]);
    let plan: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!((&plan["recipe"], &plan["valid"]), (&"tiny".into(), &true.into()));
    let views = plan["views"].as_array().unwrap();
    assert_eq!(views.len(), 36);
    assert!((views[9]["turn_deg"].as_f64().unwrap() - 90.0).abs() < 1e-9);
    assert!(
        views
            .iter()
            .all(|view| view["base_from_tool"][3] == serde_json::json!([0.0, 0.0, 0.0, 1.0]))
    );
}

#[test]
fn check_refuses_a_plan_that_leaves_the_workspace() {
    let bench = Bench::new("cli-workspace");
    let text = bladescan::settings::Station::BUILTIN_SIMULATED_TEXT;
    bench.write(
        "station.toml",
        text.replace("max_mm = [2000.0, 1500.0", "max_mm = [500.0, 1500.0"),
    );
    let ended = bench.run(&["check", "tiny.toml", "--station", "station.toml"]);
    ended.expect(2, &["view 0", "workspace"]);
}

#[test]
fn every_command_explains_itself_with_an_example() {
    let bench = Bench::new("cli-help");
    for command in ["dry-run", "run", "check", "replay", "register"] {
        let ended = bench.run(&[command, "--help"]);
        ended.expect(0, &[]);
        let example = format!("Example:\n  bladescan {command} ");
        assert!(ended.stdout.contains(&example), "{}", ended.stdout);
    }
}

/// A wavy surface without symmetry, `n × 3` in mm.
fn surface(x_range: std::ops::Range<i32>) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for i in x_range {
        for j in 0..50 {
            let (x, y) = (f64::from(i) * 0.5, f64::from(j) * 0.5);
            let z = 2.0 * (x / 4.0).sin() + 1.5 * (y / 3.0 + x / 9.0).cos() + 0.02 * x * y;
            points.push([x, y, z]);
        }
    }
    points
}

/// Turns by 2° about z, then moves by (0.4, -0.3, 0.2) mm.
fn moved([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = 2f64.to_radians().sin_cos();
    [cos * x - sin * y + 0.4, sin * x + cos * y - 0.3, z + 0.2]
}

fn ply(points: &[[f64; 3]], scale: f64) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nend_header\n",
        points.len()
    );
    for point in points {
        let [x, y, z] = point.map(|value| value * scale);
        writeln!(text, "{x:e} {y:e} {z:e}").unwrap();
    }
    text
}

/// A bench with `template.ply` and `reference.ply`: two thirds of each overlap, at [`moved`]'s motion.
fn clouds(name: &str, scale: f64) -> Bench {
    let bench = Bench::new(name);
    let reference: Vec<_> = surface(20..80).into_iter().map(moved).collect();
    bench.write("template.ply", ply(&surface(0..60), scale));
    bench.write("reference.ply", ply(&reference, scale));
    bench
}

fn registered(bench: &Bench) -> Value {
    let ended = bench.run(&["register", "template.ply", "reference.ply", "--json"]);
    ended.expect(0, &[]);
    serde_json::from_str(&ended.stdout).unwrap()
}

fn rows(registration: &Value) -> [[f64; 4]; 4] {
    serde_json::from_value(registration["reference_from_template"].clone()).unwrap()
}

#[test]
fn register_finds_a_known_motion() {
    let found = registered(&clouds("cli-register", 1.0));
    let rows = rows(&found);
    for corner in [[10.0, 0.0, 0.0], [30.0, 0.0, 0.0], [10.0, 25.0, 5.0], [30.0, 25.0, 5.0]] {
        let [x, y, z] = corner;
        let expected = moved(corner);
        for (row, expected) in rows.iter().zip(expected) {
            let value = row[0] * x + row[1] * y + row[2] * z + row[3];
            assert!((value - expected).abs() < 0.005, "{value} for {expected}");
        }
    }
    assert_eq!(found["status"], "converged");
    let overlap = found["overlap"]["fraction"].as_f64().unwrap();
    assert!((0.55..0.75).contains(&overlap), "{overlap}");
}

#[test]
fn register_has_exactly_the_published_keys() {
    let found = registered(&clouds("cli-register-keys", 1.0));
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let expected = [
        "covariance",
        "overlap",
        "reference_from_template",
        "rmse",
        "seconds",
        "stages",
        "status",
        "weak_directions",
    ];
    assert_eq!(keys(&found), expected);
    assert_eq!(keys(&found["overlap"]), ["count", "fraction"]);
    for stage in found["stages"].as_array().unwrap() {
        assert_eq!(keys(stage), ["iterations", "name", "seconds"]);
    }
    let covariance: [[f64; 6]; 6] = serde_json::from_value(found["covariance"].clone()).unwrap();
    assert!((0..6).all(|index| covariance[index][index] > 0.0));
}

#[test]
fn the_same_pair_in_metres_and_in_millimetres_gives_the_same_motion() {
    let in_mm = rows(&registered(&clouds("cli-register-mm", 1.0)));
    let in_m = rows(&registered(&clouds("cli-register-m", 1e-3)));
    for (mm, m) in in_mm.iter().zip(in_m).take(3) {
        for column in 0..3 {
            assert!((mm[column] - m[column]).abs() < 1e-9, "{in_mm:?} {in_m:?}");
        }
        assert!((mm[3] * 1e-3 - m[3]).abs() < 1e-9, "{in_mm:?} {in_m:?}");
    }
}

#[test]
fn points_that_are_not_finite_are_dropped_and_counted() {
    let bench = clouds("cli-register-nan", 1.0);
    let whole = rows(&registered(&bench));
    let mut points = surface(0..60);
    points.insert(7, [f64::NAN; 3]);
    points.push([1.0, f64::NAN, 2.0]);
    bench.write("template.ply", ply(&points, 1.0));
    let ended = bench.run(&["register", "template.ply", "reference.ply", "--json"]);
    ended.expect(0, &["template.ply: 2 points that are not finite were dropped"]);
    assert_eq!(rows(&serde_json::from_str(&ended.stdout).unwrap()), whole);
}

#[test]
fn a_plane_is_no_registration_and_exit_code_3() {
    let bench = Bench::new("cli-register-plane");
    let plane: Vec<_> = surface(0..60).into_iter().map(|[x, y, _]| [x, y, 0.0]).collect();
    bench.write("template.ply", ply(&plane, 1.0));
    bench.write("reference.ply", ply(&plane, 1.0));
    let ended = bench.run(&["register", "template.ply", "reference.ply", "--json"]);
    ended.expect(3, &[]);
    let found: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_ne!(found["status"], "converged");
    assert!(found["reference_from_template"].is_array());
}

#[test]
fn a_cloud_that_is_not_there_is_named() {
    let bench = clouds("cli-register-missing", 1.0);
    let ended = bench.run(&["register", "none.ply", "reference.ply", "--json"]);
    ended.expect(2, &["cannot read none.ply"]);
    assert_eq!(ended.stdout, "");
}

#[test]
fn garbage_in_a_cloud_is_shown_with_its_line() {
    let bench = clouds("cli-register-garbage", 1.0);
    let mut text = ply(&surface(0..60), 1.0);
    let at = text.find("end_header\n").unwrap() + "end_header\n".len();
    text.insert_str(at, "1 2 three\n");
    bench.write("template.ply", text);
    let ended = bench.run(&["register", "template.ply", "reference.ply"]);
    ended.expect(2, &["template.ply: ", "line 8"]);
}

#[test]
fn a_cloud_cut_short_is_bad_input() {
    let bench = clouds("cli-register-cut", 1.0);
    let text = ply(&surface(0..60), 1.0);
    bench.write("template.ply", &text[..text.len() / 2]);
    bench
        .run(&["register", "template.ply", "reference.ply"])
        .expect(2, &["template.ply: "]);
}
