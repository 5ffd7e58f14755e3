//! Commands that touch no device, and mistakes that are told before anything is made or moved.

use crate::support::{Bench, CLOSED, RECIPE, station};
use serde_json::Value;

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
            "\n  camera-gone@VIEW[:PHASE] ",
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
    for command in ["dry-run", "run", "check", "replay", "reconstruct", "register"] {
        let ended = bench.run(&[command, "--help"]);
        ended.expect(0, &[]);
        let example = format!("Example:\n  bladescan {command} ");
        assert!(ended.stdout.contains(&example), "{}", ended.stdout);
    }
}
