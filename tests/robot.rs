//! `bladescan robot` over every link, and whole dry runs over every link in both ways to move.

use crate::support::{Bench, CLOSED, Ended, Simulator, station};
use serde_json::Value;

const SCAN_JOB: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/robot/BLADESCAN.JBI");

/// A simulated robot with every link, and the options that lead to each.
struct Cell {
    bench: Bench,
    simulator: Simulator,
}

impl Cell {
    fn new(name: &str, faults: &[&str]) -> Self {
        let bench = Bench::new(name);
        let mut options = vec!["--serial", "--serial-baud=0", "--host-control-pause=0"];
        options.extend(faults.iter().flat_map(|fault| ["--fault", *fault]));
        let simulator = Simulator::start(&bench, "robot", &options);
        Self { bench, simulator }
    }

    fn over(&self, link: &str) -> [String; 2] {
        let place = self.simulator.ready(&link.replace('-', "_"));
        [format!("--{link}"), place.to_owned()]
    }

    fn robot(&self, link: &str, words: &[&str]) -> Ended {
        let place = self.over(link);
        let mut all = vec!["robot"];
        all.extend(words);
        all.extend(place.iter().map(String::as_str));
        self.bench.run(&all)
    }

    fn json(&self, link: &str, words: &[&str]) -> Value {
        let ended = self.robot(link, &[words, &["--json"]].concat());
        ended.expect(0, &[]);
        serde_json::from_str(&ended.stdout).unwrap()
    }
}

const LINKS: [&str; 3] = ["hses", "host-control", "serial"];

#[test]
fn state_and_pose_are_the_same_over_every_link() {
    let cell = Cell::new("robot-state", &[]);
    let position = cell.json("hses", &["position"]);
    assert_eq!(position["position_mm"], serde_json::json!([1000.0, -200.0, 1100.0]));
    for link in LINKS {
        let status = cell.json(link, &["status"]);
        assert_eq!(status["simulated"], true, "{link}");
        assert_eq!(
            (&status["servo_on"], &status["takes_moves"]),
            (&false.into(), &false.into()),
            "{link}"
        );
        assert_eq!(cell.json(link, &["position"]), position, "{link}");
        assert_eq!(cell.json(link, &["alarms"])["active"], serde_json::json!([]), "{link}");
        let words = cell.robot(link, &["status"]);
        words.expect(0, &[]);
        assert!(
            words.stdout.contains("takes no moves: servo power is off"),
            "{link}: {}",
            words.stdout
        );
    }
}

#[test]
fn watch_ends_after_as_many_looks_as_wanted() {
    let cell = Cell::new("robot-watch", &[]);
    for link in LINKS {
        let ended = cell.robot(link, &["watch", "--count", "2", "--every-ms", "10", "--json"]);
        ended.expect(0, &[]);
        assert_eq!(ended.stdout.lines().count(), 2, "{link}");
        // A person is shown what has changed only.
        let ended = cell.robot(link, &["watch", "--count", "3", "--every-ms", "10"]);
        assert_eq!(ended.stdout.lines().count(), 2, "{link}: {}", ended.stdout);
    }
}

#[test]
fn jobs_come_and_go_over_hses_and_the_serial_line() {
    let cell = Cell::new("robot-jobs", &[]);
    let file_port = cell.simulator.ready("hses_file").to_owned();
    let text = std::fs::read(SCAN_JOB).unwrap();
    cell.bench.write(
        "OTHER.JBI",
        String::from_utf8(text)
            .unwrap()
            .replace("//NAME BLADESCAN", "//NAME OTHER"),
    );
    for link in ["hses", "serial"] {
        let jobs = |words: &[&str]| cell.robot(link, &[&["jobs"], words, &["--hses-file", &file_port]].concat());
        jobs(&["put", "OTHER.JBI", "--arm"]).expect(0, &[]);
        assert!(jobs(&["list"]).stdout.lines().any(|name| name == "OTHER"), "{link}");
        let copy = format!("{link}.JBI");
        jobs(&["get", "OTHER", "--out", &copy]).expect(0, &[]);
        assert_eq!(cell.bench.read(&copy), cell.bench.read("OTHER.JBI"), "{link}");
        jobs(&["get", "OTHER", "--out", &copy]).expect(2, &["cannot write", &copy]);
        jobs(&["delete", "OTHER", "--arm"]).expect(0, &[]);
        assert!(!jobs(&["list"]).stdout.contains("OTHER"), "{link}");
        let gone = jobs(&["get", "OTHER", "--out", "gone.JBI"]);
        gone.expect(1, &["file from the controller"]);
        assert!(!cell.bench.path("gone.JBI").exists());
    }
}

#[test]
fn what_changes_the_controller_wants_arm_and_connects_to_nothing_without() {
    let bench = Bench::new("robot-arm");
    bench.write("A.JBI", "text");
    for words in [["put", "A.JBI"], ["delete", "A"]] {
        let [what, name] = words;
        let ended = bench.run(&["robot", "jobs", what, name, "--hses", CLOSED]);
        ended.expect(2, &["--arm", "nothing was connected"]);
    }
}

#[test]
fn a_robot_that_is_not_there_is_an_error_in_words() {
    let bench = Bench::new("robot-absent");
    bench
        .run(&["robot", "status"])
        .expect(2, &["--station, --hses, --host-control or --serial"]);
    bench
        .run(&["robot", "status", "--hses", CLOSED])
        .expect(1, &[CLOSED, "refused"]);
    bench
        .run(&["robot", "status", "--host-control", CLOSED])
        .expect(1, &["no answer", CLOSED]);
    bench
        .run(&["robot", "status", "--serial", "no-such-tty"])
        .expect(1, &["no-such-tty"]);
}

#[test]
fn a_cable_pulled_in_mid_run_ends_the_run() {
    let bench = Bench::new("robot-cable");
    let simulator = Simulator::start(&bench, "cell", &["--serial", "--serial-baud=0", "--speed=1000"]);
    let station = station("127.0.0.1:1", simulator.camera()).replace(
        "address = \"127.0.0.1:1\"",
        &format!("link = \"serial\"\nserial_device = \"{}\"", simulator.ready("serial")),
    );
    bench.write("cable.toml", station);
    let words = [
        "run",
        "tiny.toml",
        "--station",
        "cable.toml",
        "--arm",
        "--out",
        "out",
        "--views",
        "9",
    ];
    let mut run = bench.start(&words);
    run.wait_for("view 0: merged");
    simulator.kill();
    let ended = run.end();
    ended.expect(1, &["FAULT "]);
    bench.holds_a_whole_run("out", 9);
}

#[test]
fn over_every_link_and_in_both_ways_to_move_a_dry_run_comes_to_the_same_poses() {
    let bench = Bench::new("robot-links");
    let mut first = None;
    for link in LINKS {
        for motion in ["direct", "job"] {
            let out = format!("{link}-{motion}");
            let options = ["--link", link, "--motion", motion];
            // Replayed and compared as well.
            bench
                .dry_run_into(&out, 2, &options, &[])
                .expect(0, &["2 of 2 views merged"]);
            // The station, which the file names too, is another one.
            let poses = bench.read_json(&format!("{out}/poses.json"))["views"].clone();
            assert_eq!(*first.get_or_insert(poses.clone()), poses, "{out}");
        }
    }
}
