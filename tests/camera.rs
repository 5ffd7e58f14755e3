//! `bladescan camera` over sockets, against the simulated camera.

use crate::support::{Bench, Ended, RECIPE, Simulator};
use bladescan::camera::conformance::view_of;
use bladescan::geometry::read_cloud;
use serde_json::Value;

struct Camera {
    bench: Bench,
    simulator: Simulator,
}

impl Camera {
    fn new(name: &str, options: &[&str]) -> Self {
        let bench = Bench::new(name);
        let simulator = Simulator::start(&bench, "camera", options);
        Self { bench, simulator }
    }

    fn run(&self, words: &[&str]) -> Ended {
        let mut all = vec!["camera"];
        all.extend(words);
        all.push(self.simulator.camera());
        self.bench.run(&all)
    }

    fn json(&self, words: &[&str]) -> Value {
        let ended = self.run(&[words, &["--json"]].concat());
        ended.expect(0, &[]);
        serde_json::from_str(&ended.stdout).unwrap()
    }
}

#[test]
fn hello_says_who_the_camera_is_and_what_it_can_do() {
    let camera = Camera::new("camera-hello", &[]);
    let hello = camera.json(&["hello"]);
    assert_eq!(hello["greeting"]["simulated"], true);
    assert_eq!(hello["caps"]["optics"], "fine");
    assert_eq!(hello["status"]["state"], "idle");
    assert!(hello["clock"]["round_trip_ns"].as_u64().unwrap() > 0);
    let told = camera.run(&["hello"]).stdout;
    for text in ["SIMULATED A5000", "10 to 50000 us", "XYZ, INTENSITY", "round trip"] {
        assert!(told.contains(text), "{told}");
    }
}

#[test]
fn the_camera_can_be_looked_at_while_another_has_it() {
    let camera = Camera::new("camera-watch", &[]);
    let watched = camera.json(&["watch", "--count=1"]);
    assert_eq!(watched["trigger_count"], 0);
    let mut watching = camera
        .bench
        .start(&["camera", "watch", "--count=4", camera.simulator.camera()]);
    watching.next_stdout_line();
    camera
        .run(&["frame", "--recipe=tiny.toml", "--out=x.ply"])
        .expect(0, &[]);
    assert!(watching.end().stdout.contains("1 triggers, 1 frames"));
}

#[test]
fn settings_of_a_recipe_are_compared_with_those_in_force() {
    let camera = Camera::new("camera-settings", &[]);
    let settings = camera.json(&["settings", "--recipe=tiny.toml"]);
    assert_eq!(settings["difference"], Value::Null);
    assert_eq!(settings["asked"], settings["in_force"]);
    assert_eq!(settings["in_force"]["roi_px"][0], 240);
    let odd = Camera::new("camera-settings-odd", &["--fault=config-echo"]);
    let ended = odd.run(&["settings", "--recipe=tiny.toml"]);
    assert_eq!(ended.code, 1);
    assert!(
        ended.stdout.contains("exposure_us: asked for 1000, in force"),
        "{ended:?}"
    );
    let wide = Camera::new("camera-settings-wide", &["--optics=wide"]);
    let texts = ["the recipe wants optics fine, the camera has wide"];
    wide.run(&["settings", "--recipe=tiny.toml"]).expect(1, &texts);
}

#[test]
fn settings_and_frames_are_those_of_the_view_that_is_named() {
    let camera = Camera::new("camera-view", &[]);
    let tables = "[[camera.exposure]]\nviews = [18]\nexposure_us = 400\n[merge]";
    camera.bench.write("views.toml", RECIPE.replace("[merge]", tables));
    let exposure_us = |view: &str| {
        let settings = camera.json(&["settings", "--recipe=views.toml", view]);
        settings["in_force"]["exposure_us"].as_u64().unwrap()
    };
    assert_eq!(exposure_us("--view=0"), 1000);
    assert_eq!(exposure_us("--view=18"), 400);
    let outside = ["--view 36: views.toml has 36 views, from 0 to 35"];
    camera
        .run(&["settings", "--recipe=views.toml", "--view=36"])
        .expect(2, &outside);
    camera
        .run(&["frame", "--recipe=views.toml", "--view=36", "--out=x.ply"])
        .expect(2, &outside);
}

#[test]
fn a_frame_becomes_a_cloud_or_two_pictures() {
    let camera = Camera::new("camera-frame", &[]);
    let frame = camera.json(&["frame", "--recipe=tiny.toml", "--out=blade.ply"]);
    assert_eq!(frame["files"], serde_json::json!(["blade.ply"]));
    let cloud = read_cloud("blade.ply", &camera.bench.read("blade.ply")).unwrap().cloud;
    assert_eq!(frame["valid_count"], cloud.len());
    assert!(cloud.len() > 500);
    let frame = camera.json(&["frame", "--recipe=tiny.toml", "--out=blade.png"]);
    let names = ["blade-depth.png", "blade-intensity.png"];
    assert_eq!(frame["files"], serde_json::json!(names));
    for name in names {
        assert!(camera.bench.read(name).starts_with(b"\x89PNG\r\n"), "{name}");
    }
    camera
        .run(&["frame", "--out=blade.bmp"])
        .expect(2, &["give a name that ends in .ply or .png"]);
}

#[test]
fn exposures_are_suggested_as_lines_of_a_recipe() {
    let camera = Camera::new("camera-suggest", &["--surface=polished"]);
    let words = ["settings", "--suggest", "--frames=5", "--recipe=tiny.toml"];
    let told = camera.run(&words);
    told.expect(0, &[]);
    let suggestion = camera.json(&words);
    let exposure_us = suggestion["exposure_us"].as_u64().unwrap();
    assert!(
        told.stdout
            .contains(&format!("\n[camera]\nexposure_us = {exposure_us} ")),
        "{told:?}"
    );
    assert_eq!(suggestion["served"].as_array().unwrap().len(), 5);
    assert!(suggestion["valid_fraction"].as_f64().unwrap() > 0.5, "{suggestion}");
}

#[test]
fn conformance_tells_clause_by_clause_and_fails_when_one_does() {
    let camera = Camera::new("camera-conformance", &["--speed=20"]);
    let words = [
        "conformance",
        "--allow-exposures",
        "--only=2-",
        "--only=3.2-course",
        "--only=3.3-fetch",
    ];
    let ended = camera.run(&words);
    ended.expect(0, &[]);
    assert!(ended.stdout.contains("passed  2-magic"), "{ended:?}");
    assert!(ended.stdout.contains(" 0 FAILED, 0 skipped"), "{ended:?}");
    let fault = format!("--fault=corrupt-chunk@{}", view_of("4.12-end").unwrap());
    let broken = Camera::new("camera-conformance-broken", &[&fault]);
    let ended = broken.run(&["conformance", "--allow-exposures", "--only=4.12", "--only=3.2-course"]);
    assert_eq!(ended.code, 1);
    assert!(ended.stdout.contains("passed  3.2-course"), "{ended:?}");
    assert!(ended.stdout.contains("FAILED  4.12-end"), "{ended:?}");
    assert!(ended.stdout.contains("the CRC-32C is 0x"), "{ended:?}");
}

#[test]
fn where_nobody_listens_one_line_says_so() {
    let bench = Bench::new("camera-nobody");
    bench
        .run(&["camera", "hello", crate::support::CLOSED])
        .expect(1, &["no connection"]);
    bench
        .run(&["camera", "hello"])
        .expect(2, &["say where the camera is: HOST:PORT or --station"]);
}
