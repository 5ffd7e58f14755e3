//! Recipe and station files: what they mean, how mistakes are shown, and that the documents say the same.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::{Path, PathBuf};

use bladescan::plan::Plan;
use bladescan::reconstruction::OverlapMin;
use bladescan::seed::Seed;
use bladescan::settings::{
    Cad, HostPort, Key, Need, Optics, RECIPE_KEYS, Recipe, RobotAddress, Roi, STATION_KEYS, SettingsError, Start,
    Station, Target,
};
use miette::{GraphicalReportHandler, GraphicalTheme};
use nalgebra::{Point3, Vector3};

pub const RECIPE: &str = r#"name = "probe"

[blade]
cad = "builtin:hpt-a"

[views]
step_deg = 10.0

[presentation]
position_mm = [0.0, 0.0, 260.0]
rotation_deg = [0.0, 90.0, 0.0]

[camera]
optics = "fine"

[merge]
overlap_min_fraction = 0.5
"#;

pub const STATION: &str = r#"name = "probe"
kind = "cell"

[robot]
address = "192.168.1.31:10040"

[robot.workspace]
min_mm = [0, -1000, 300]
max_mm = [2000, 1500, 1700]

[camera]
address = "127.0.0.1:50555"

[calibration]
id = "c1"
base_from_camera = { position_mm = [1000, -700, 1000], rotation_deg = [-90, 0, 0] }
tool_from_blade = { position_mm = [0, 0, 400], rotation_deg = [0, 0, 0] }
"#;

/// The error of [`RECIPE`] with `from` replaced by `to`.
pub fn recipe_error(from: &str, to: &str) -> SettingsError {
    assert!(RECIPE.contains(from), "{from}");
    Recipe::parse("probe.toml", &RECIPE.replace(from, to)).unwrap_err()
}

/// The error of [`STATION`] with `from` replaced by `to`.
fn station_error(from: &str, to: &str) -> SettingsError {
    assert!(STATION.contains(from), "{from}");
    Station::parse("cell.toml", &STATION.replace(from, to)).unwrap_err()
}

/// Where the error points: line and column from 1, and the text to blame.
fn place<'text>(error: &SettingsError, text: &'text str) -> (usize, usize, &'text str) {
    (error.line(), error.column(), &text[error.span()])
}

fn rendered(error: &SettingsError) -> String {
    let mut text = String::new();
    GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor())
        .with_width(120)
        .render_report(&mut text, error)
        .unwrap();
    text
}

fn shipped(folder: &str) -> Vec<(PathBuf, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(folder);
    let mut paths: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    paths
        .into_iter()
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            (path, text)
        })
        .collect()
}

#[test]
fn every_shipped_recipe_can_be_planned_at_every_shipped_station() {
    let recipes = shipped("recipes");
    let stations = shipped("stations");
    assert_eq!((recipes.len(), stations.len()), (8, 2));
    for (recipe_path, text) in &recipes {
        let recipe = Recipe::parse(&recipe_path.display().to_string(), text).unwrap();
        assert_eq!(recipe_path.file_stem().unwrap().to_str(), Some(recipe.name.as_str()));
        assert_eq!(recipe.view_count(), 36);
        for (station_path, text) in &stations {
            let station = Station::parse(&station_path.display().to_string(), text).unwrap();
            assert_eq!(station_path.file_stem().unwrap().to_str(), Some(station.name.as_str()));
            if let Err(error) = Plan::new(&recipe, &station, Seed(1)) {
                panic!("{} at {}: {error}", recipe.name, station.name);
            }
        }
    }
}

#[test]
fn the_built_in_station_is_simulated() {
    assert_eq!(Station::builtin_simulated().target, Target::Simulated);
}

#[test]
fn a_recipe_is_read_into_millimetres_and_radians() {
    let recipe = Recipe::parse("probe.toml", RECIPE).unwrap();
    assert_eq!(recipe.cad, Cad::Builtin("hpt-a".to_owned()));
    assert_eq!((recipe.views.count, recipe.views.merged_min_count), (36, 35));
    assert!((recipe.views.step_rad() - TAU / 36.0).abs() < 1e-15);
    assert_eq!(recipe.camera.optics, Optics::Fine);
    let whole_sensor = Roi::Rectangle {
        width_px: 1440,
        height_px: 1080,
        x_px: 0,
        y_px: 0,
    };
    assert_eq!(recipe.camera.roi, whole_sensor);
    assert_eq!(recipe.camera.exposure.hdr_low_us, None);
    assert_eq!(recipe.registration.start, Start::Robot);
    assert!((recipe.registration.prior_rotation_max_rad - FRAC_PI_2 / 45.0).abs() < 1e-15);
    assert_eq!(recipe.merge.overlap_min, OverlapMin::Fraction(0.5));
    // The presentation lays the blade's z along the camera's x.
    let blade_z = recipe.camera_from_fixture * Vector3::z();
    assert!((blade_z - Vector3::x()).norm() < 1e-15);
    assert_eq!(
        recipe.camera_from_fixture.translation.vector,
        Vector3::new(0.0, 0.0, 260.0)
    );
}

#[test]
fn the_overlap_distance_follows_optics_and_binning() {
    let distances_mm = |camera: &str| {
        let recipe = Recipe::parse("probe.toml", &RECIPE.replace("optics = \"fine\"", camera)).unwrap();
        (
            recipe.registration.overlap_distance_mm,
            recipe.merge.coincident_distance_mm,
        )
    };
    let document = include_str!("../docs/recipe.md");
    assert!(
        document.contains("fine 0.12, medium 0.6, wide 1.35 mm (three times the nominal point spacing), twice that")
    );
    for (camera, overlap_distance_mm) in [
        ("optics = \"fine\"", 0.12),
        ("optics = \"fine\"\nbinning = true", 0.24),
        ("optics = \"medium\"", 0.6),
        ("optics = \"wide\"", 1.35),
    ] {
        assert_eq!(distances_mm(camera), (overlap_distance_mm, overlap_distance_mm / 3.0));
    }
}

#[test]
fn a_path_that_is_not_built_in_is_a_file() {
    let recipe = Recipe::parse("probe.toml", &RECIPE.replace("builtin:hpt-a", "../cad/blade.stl")).unwrap();
    assert_eq!(recipe.cad, Cad::File(PathBuf::from("../cad/blade.stl")));
}

#[test]
fn a_station_is_read_into_millimetres_radians_and_nanoseconds() {
    let station = Station::parse("cell.toml", STATION).unwrap();
    let address = |host: &str, port| HostPort {
        host: host.to_owned(),
        port,
    };
    let cell = Target::Cell {
        robot: RobotAddress::Hses(address("192.168.1.31", 10040)),
        camera: address("127.0.0.1", 50555),
    };
    assert_eq!(station.target, cell);
    assert_eq!(station.robot.answer_timeout_ns, 300_000_000);
    assert_eq!(station.camera.dead_after_ns, 5_000_000_000);
    assert!((station.robot.rotation_speed_rad_s - FRAC_PI_2 / 9.0).abs() < 1e-15);
    // The camera looks along base y.
    let viewed = station.base_from_camera * Point3::new(0.0, 0.0, 600.0);
    assert!((viewed - Point3::new(1000.0, -100.0, 1000.0)).norm() < 1e-9);
}

#[test]
fn addresses_are_host_and_port() {
    for text in ["192.168.1.31:10040", "robot.cell-3:1", "[::1]:65535"] {
        assert_eq!(
            HostPort::parse(text).map(|address| address.to_string()).as_deref(),
            Some(text)
        );
    }
    for text in [
        "",
        ":1",
        "host",
        "host:",
        "host:0",
        "host:65536",
        "host:+5",
        "::1:5",
        "[::1:5",
        "a b:5",
        "[]:5",
    ] {
        assert_eq!(HostPort::parse(text), None, "{text}");
    }
}

#[test]
fn a_negative_step_is_shown_with_file_line_caret_and_range() {
    let error = recipe_error("10.0", "-10.0");
    let expected = "  × `views.step_deg` is -10.0 deg, allowed is 0.5 to 180 deg
   ╭─[probe.toml:7:12]
 6 │ [views]
 7 │ step_deg = -10.0
   ·            ─────
 8 │ 
   ╰────
";
    assert_eq!(rendered(&error), expected);
}

#[test]
fn an_unknown_key_is_shown_with_the_key_that_was_meant() {
    let error = recipe_error("step_deg", "steps_deg");
    let expected = "  × unknown key `views.steps_deg`
   ╭─[probe.toml:7:1]
 6 │ [views]
 7 │ steps_deg = 10.0
   · ─────────
 8 │ 
   ╰────
  help: did you mean `step_deg`? keys of [views]: step_deg, tilt_max_deg, skip, views_min
";
    assert_eq!(rendered(&error), expected);
}

#[test]
fn a_step_that_does_not_divide_the_turn_is_shown_with_its_neighbours() {
    let error = recipe_error("10.0", "11.0");
    let expected = "  × `views.step_deg` is 11 deg, which does not divide 360 deg
   ╭─[probe.toml:7:12]
 6 │ [views]
 7 │ step_deg = 11.0
   ·            ────
 8 │ 
   ╰────
  help: the nearest that do are 10.909091 and 11.25 deg; allowed: 0.5 to 180 deg
";
    assert_eq!(rendered(&error), expected);
    let written_as_suggested = Recipe::parse("probe.toml", &RECIPE.replace("10.0", "10.909091")).unwrap();
    assert_eq!(written_as_suggested.view_count(), 33);
}

#[test]
fn a_key_in_the_wrong_table_or_an_unknown_table_is_named() {
    let error = recipe_error("step_deg = 10.0", "exposure_us = 900");
    let help = "`exposure_us` belongs in [camera]; keys of [views]: step_deg, tilt_max_deg, skip, views_min";
    assert_eq!(error.help_text(), Some(help));
    let error = recipe_error("[views]", "[view]");
    assert_eq!(error.message(), "unknown key `view`");
    assert!(
        error
            .help_text()
            .unwrap()
            .starts_with("did you mean `views`? keys of the file: name, ")
    );
    assert_eq!((error.line(), error.column()), (6, 2));
}

#[test]
fn a_wrong_type_is_named_at_the_value() {
    let error = recipe_error("10.0", "\"ten\"");
    assert_eq!(error.message(), "`views.step_deg` must be a number, not text");
    assert_eq!(error.help_text(), Some("allowed: 0.5 to 180 deg"));
    assert_eq!(place(&error, &RECIPE.replace("10.0", "\"ten\"")), (7, 12, "\"ten\""));

    let message = |from, to| recipe_error(from, to).message().to_owned();
    let run_as_number = message("[blade]", "run = 3\n[blade]");
    assert_eq!(run_as_number, "`run` must be a table, not a whole number");
    let fraction = message("\"fine\"", "\"fine\"\nexposure_us = 10.5");
    assert_eq!(
        fraction,
        "`camera.exposure_us` must be a whole number, not a number with a fraction"
    );
    let two_numbers = message("[0.0, 0.0, 260.0]", "[0.0, 260.0]");
    assert_eq!(
        two_numbers,
        "`presentation.position_mm` must be a list of 3 numbers, not 2"
    );
    let text_in_list = message("[0.0, 0.0, 260.0]", "[0.0, 0.0, \"260\"]");
    assert_eq!(
        text_in_list,
        "`presentation.position_mm` must be a list of 3 numbers, not a list with text in it"
    );
}

#[test]
fn a_number_out_of_range_is_shown_as_written_with_unit_and_range() {
    let cases = [
        ("10.0", "nan", "`views.step_deg` is nan deg, allowed is 0.5 to 180 deg"),
        ("10.0", "inf", "`views.step_deg` is inf deg, allowed is 0.5 to 180 deg"),
        (
            "0.0, 260.0",
            "9_000, 260.0",
            "`presentation.position_mm[1]` is 9_000 mm, allowed is -5000 to 5000 mm",
        ),
        (
            "\"fine\"",
            "\"fine\"\nexposure_us = -1",
            "`camera.exposure_us` is -1 us, allowed is 10 to 50000 us",
        ),
        (
            "\"fine\"",
            "\"fine\"\nled_percent = 99999999999999999999999",
            "`camera.led_percent` is 99999999999999999999999 %, allowed is 1 to 100 %",
        ),
        (
            "0.5",
            "1.5",
            "`merge.overlap_min_fraction` is 1.5, allowed is 0.01 to 1",
        ),
    ];
    for (from, to, message) in cases {
        assert_eq!(recipe_error(from, to).message(), message);
    }
}

#[test]
fn a_word_that_is_no_choice_is_answered_with_the_choices() {
    let error = recipe_error("\"fine\"", "\"fime\"");
    assert_eq!(error.message(), "`camera.optics` cannot be \"fime\"");
    let help = "did you mean `fine`? allowed: \"fine\", \"medium\", \"wide\"";
    assert_eq!(error.help_text(), Some(help));
}

#[test]
fn a_missing_key_points_at_its_table_or_at_the_start() {
    let error = recipe_error("cad = \"builtin:hpt-a\"\n", "");
    assert_eq!(error.message(), "`blade.cad` is missing: it must be text in quotes");
    assert_eq!(place(&error, RECIPE), (3, 2, "blade"));
    let error = recipe_error("[blade]\ncad = \"builtin:hpt-a\"\n", "");
    assert_eq!((error.line(), error.column()), (1, 1));
    assert!(rendered(&error).contains("╭─[probe.toml:1:1]"), "{}", rendered(&error));
    let error = Recipe::parse("empty.toml", "").unwrap_err();
    assert_eq!(error.message(), "`name` is missing: it must be text in quotes");
    rendered(&error);
}

#[test]
fn the_least_overlap_is_given_exactly_once() {
    let twice = "overlap_min_count = 900\noverlap_min_fraction = 0.5";
    let error = recipe_error("overlap_min_fraction = 0.5", twice);
    assert_eq!(
        error.message(),
        "the least overlap is given twice, as a fraction and as a count"
    );
    // The second of the two is to blame, whichever it is.
    assert_eq!((error.line(), error.column()), (18, 24));
    let twice = "overlap_min_fraction = 0.5\noverlap_min_count = 900";
    let error = recipe_error("overlap_min_fraction = 0.5", twice);
    assert_eq!((error.line(), error.column()), (18, 21));

    let error = recipe_error("overlap_min_fraction = 0.5", "");
    assert_eq!((error.message(), error.line()), ("the least overlap is missing", 16));
    let error = recipe_error("[merge]\noverlap_min_fraction = 0.5", "");
    assert_eq!((error.message(), error.line()), ("the least overlap is missing", 1));
}

#[test]
fn keys_that_contradict_each_other_are_refused() {
    let error = recipe_error("10.0", "10.0\nviews_min = 37");
    assert_eq!(error.message(), "`views.views_min` is 37, but there are 36 views");
    let error = recipe_error("\"fine\"", "\"fine\"\nbinning = true\nroi_px = [80, 4, 0, 0]");
    assert_eq!(
        error.message(),
        "`camera.roi_px` has no effect while `camera.binning` is on"
    );
    let error = recipe_error("\"fine\"", "\"fine\"\nroi_px = [1440, 1080, 8, 0]");
    assert_eq!(
        error.message(),
        "`camera.roi_px` does not fit the sensor: 1440 x 1080 px at 8, 0"
    );
    let error = recipe_error("\"fine\"", "\"fine\"\nroi_px = [84, 8, 0, 0]");
    assert_eq!(
        error.message(),
        "`camera.roi_px` is off the sensor's steps: 84 x 8 px at 0, 0"
    );
}

#[test]
fn broken_toml_is_shown_at_its_place() {
    let error = recipe_error("optics = \"fine\"", "optics = \"fine");
    assert_eq!((error.file(), error.line()), ("probe.toml", 14));
    assert!(rendered(&error).contains("[probe.toml:14:"), "{}", rendered(&error));
    let error = recipe_error("step_deg = 10.0", "step_deg = 10.0\nstep_deg = 20.0");
    assert_eq!((error.message(), error.line(), error.column()), ("duplicate key", 8, 1));
}

#[test]
fn every_broken_text_has_a_place_that_can_be_shown() {
    let shown = |text: &str| {
        if let Err(error) = Recipe::parse("probe.toml", text) {
            assert!(error.line() >= 1 && error.column() >= 1);
            assert!(rendered(&error).contains("[probe.toml:"), "{text}");
        }
    };
    for (at, letter) in RECIPE.char_indices() {
        shown(&RECIPE[..at]);
        for instead in ["", "ü", "\r\n", "\"", "[", "}", ".", "=", "0", "\u{0}"] {
            let after = &RECIPE[at + letter.len_utf8()..];
            shown(&format!("{}{instead}{after}", &RECIPE[..at]));
        }
    }
    shown(&format!("name = {}", "[".repeat(100_000)));
    shown(&format!("{}name = 1", "a.".repeat(100_000)));
}

#[test]
fn names_that_cannot_name_files_are_refused() {
    for name in ["", "a/b", "a b", "ü"] {
        let error = recipe_error("\"probe\"", &format!("\"{name}\""));
        assert_eq!((error.line(), error.column()), (1, 8), "{name}");
    }
    for cad in ["", "builtin:"] {
        assert_eq!(recipe_error("builtin:hpt-a", cad).line(), 4, "{cad}");
    }
}

#[test]
fn columns_count_characters_and_not_bytes() {
    let error = recipe_error("name = \"probe\"", "description = \"Müßig\"; name = 3");
    assert_eq!((error.line(), error.column()), (1, 22), "{error}");
}

#[test]
fn a_station_with_one_address_only_is_refused() {
    let error = station_error("address = \"192.168.1.31:10040\"\n", "");
    assert_eq!(
        error.message(),
        "`robot.address` is missing: a station needs both addresses, unless it is the simulated one that a dry run starts"
    );
    assert_eq!((error.line(), error.column()), (4, 2));
}

#[test]
fn a_bad_address_is_shown_with_an_example() {
    let error = station_error("127.0.0.1:50555", "127.0.0.1");
    let expected = "  × `camera.address` is \"127.0.0.1\", which is no address
    ╭─[cell.toml:12:11]
 11 │ [camera]
 12 │ address = \"127.0.0.1\"
    ·           ───────────
 13 │ 
    ╰────
  help: HOST:PORT with a port from 1 to 65535, as in \"127.0.0.1:50555\"
";
    assert_eq!(rendered(&error), expected);
}

#[test]
fn mistakes_in_nested_tables_of_a_station_are_found() {
    let error = station_error("[2000, 1500, 1700]", "[2000, -1000, 1700]");
    assert_eq!(
        error.message(),
        "`robot.workspace.max_mm[1]` is -1000 mm, not above `min_mm[1]` of -1000 mm"
    );
    let error = station_error("[0, 0, 400], rotation_deg = [0, 0, 0]", "[0, 0, 400]");
    assert_eq!(
        error.message(),
        "`calibration.tool_from_blade.rotation_deg` is missing: it must be a list of 3 numbers"
    );
    assert_eq!((error.line(), error.column()), (17, 1));
    let error = station_error("127.0.0.1:50555\"", "127.0.0.1:50555\"\ndead_after_ms = 900");
    assert_eq!(
        error.message(),
        "`camera.dead_after_ms` is 900 ms, not above `ping_interval_ms` of 1000 ms"
    );
}

#[test]
fn every_optional_key_of_a_recipe_is_heard() {
    let text = RECIPE
        .replace("step_deg = 10.0", "views_min = 3\nskip = [5]")
        .replace(
            "optics = \"fine\"",
            "roi_px = [80, 4, 8, 12]\nhdr_low_us = 10\nhdr_high_us = 50000\n[registration]\noverlap_distance_mm = 0.3",
        )
        .replace(
            "overlap_min_fraction = 0.5",
            "overlap_min_count = 900\ncoincident_distance_mm = 0.01",
        );
    let recipe = Recipe::parse("probe.toml", &text).unwrap();
    assert_eq!(
        (recipe.views.merged_min_count, recipe.views.skipped.contains(&5)),
        (3, true)
    );
    let roi = Roi::Rectangle {
        width_px: 80,
        height_px: 4,
        x_px: 8,
        y_px: 12,
    };
    assert_eq!(recipe.camera.roi, roi);
    assert_eq!(
        (recipe.camera.exposure.hdr_low_us, recipe.camera.exposure.hdr_high_us),
        (Some(10), Some(50_000))
    );
    assert_eq!(recipe.registration.overlap_distance_mm, 0.3);
    assert_eq!(recipe.merge.overlap_min, OverlapMin::Count(900));
    assert_eq!(recipe.merge.coincident_distance_mm, 0.01);
}

/// The rows of the key table in a document: key, unit, default, range.
fn documented(markdown: &str) -> Vec<[String; 4]> {
    markdown
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| {
            let cells: Vec<_> = line.split('|').map(str::trim).collect();
            assert_eq!(cells.len(), 7, "{line}");
            assert!(!cells[5].is_empty(), "no description: {line}");
            [cells[1], cells[2], cells[3], cells[4]].map(str::to_owned)
        })
        .collect()
}

fn expected_row(key: &Key) -> [String; 4] {
    let default = match key.need {
        Need::Default(toml) => format!("`{toml}`"),
        Need::Required | Need::Optional(_) => key.default_text().to_owned(),
    };
    [
        format!("`{}`", key.path),
        key.unit().to_owned(),
        default,
        key.range_text(),
    ]
}

#[test]
fn the_documents_list_exactly_the_keys_with_their_units_defaults_and_ranges() {
    let documents = [
        (include_str!("../docs/recipe.md"), RECIPE_KEYS),
        (include_str!("../docs/station.md"), STATION_KEYS),
    ];
    for (markdown, keys) in documents {
        let expected: Vec<_> = keys.iter().map(expected_row).collect();
        assert_eq!(documented(markdown), expected);
    }
}

#[test]
fn a_default_written_out_changes_nothing() {
    let with_defaults = |text: &str, keys: &[Key]| {
        let mut file: toml::Table = text.parse().unwrap();
        for key in keys {
            let Need::Default(default) = key.need else { continue };
            let value = format!("value = {default}").parse::<toml::Table>().unwrap()["value"].clone();
            let mut path: Vec<_> = key.path.split('.').collect();
            let name = path.pop().unwrap();
            let table = path.into_iter().fold(&mut file, |table, part| {
                table
                    .entry(part)
                    .or_insert_with(|| toml::Table::new().into())
                    .as_table_mut()
                    .unwrap()
            });
            table.entry(name).or_insert(value);
        }
        file.to_string()
    };
    let recipe_text = with_defaults(RECIPE, RECIPE_KEYS);
    assert!(recipe_text.contains("retakes_max"));
    assert_eq!(Recipe::parse("a", &recipe_text), Recipe::parse("a", RECIPE));
    let station_text = with_defaults(STATION, STATION_KEYS);
    assert!(station_text.contains("hold_repeat_ms"));
    assert_eq!(Station::parse("a", &station_text), Station::parse("a", STATION));
}
