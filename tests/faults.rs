//! What goes wrong in a cell, and that the run ends or goes on as `docs/faults.md` says.

use crate::support::{Bench, CLOSED, Ended, Process, RECIPE, Simulator, station};

/// Asserts that a run ended with this fault, on the console, in the summary and in the recording.
#[track_caller]
fn assert_faulted(bench: &Bench, ended: &Ended, code: &str, seen: &str) {
    ended.expect(1, &[&format!("FAULT {code}: "), seen]);
    let ending = &bench.read_json("out/summary.json")["ending"];
    assert_eq!(ending["how"], "faulted", "{ending}");
    assert_eq!(ending["fault"]["code"], code, "{ending}");
    assert!(ending["fault"]["seen"].as_str().unwrap().contains(seen), "{ending}");
    let first = bench
        .events("out/run.mcap")
        .into_iter()
        .find(|event| event["event"] == "faulted")
        .unwrap();
    assert_eq!(first["fault"]["code"], code);
}

/// Asserts that view 0 stayed in the model and the last view, never taken, has a reason.
#[track_caller]
fn assert_kept_the_first_view(bench: &Bench) {
    let statuses = bench.statuses("out");
    assert_eq!(statuses.first().unwrap(), "merged");
    assert_eq!(statuses.last().unwrap(), "missing");
    assert!(bench.read("out/model.ply").starts_with(b"ply\n"));
}

/// Asserts that the arm never moved and nothing was measured.
#[track_caller]
fn assert_no_motion(bench: &Bench) {
    assert!(
        bench
            .events("out/run.mcap")
            .iter()
            .all(|event| event["event"] != "move-started")
    );
    assert!(bench.statuses("out").iter().all(|status| status == "missing"));
    assert!(!bench.path("out/model.ply").exists());
}

/// A dry run that a fault of the cell ends after the first view, which is kept.
#[track_caller]
fn assert_ends_in_mid_run(name: &str, fault: &str, code: &str, seen: &str) {
    let bench = Bench::new(name);
    let ended = bench.dry_run(4, &["--fault", fault]);
    assert_faulted(&bench, &ended, code, seen);
    assert_kept_the_first_view(&bench);
}

/// A dry run that a fault of the cell ends before the arm has moved.
#[track_caller]
fn assert_ends_before_the_first_move(name: &str, fault: &str, code: &str, seen: &str) {
    let bench = Bench::new(name);
    let ended = bench.dry_run(2, &["--fault", fault]);
    assert_faulted(&bench, &ended, code, seen);
    assert_no_motion(&bench);
}

#[test]
fn a_camera_gone_in_mid_frame_is_connected_again_and_its_frame_is_fetched() {
    let bench = Bench::new("faults-camera-gone");
    let ended = bench.dry_run(3, &["--fault", "camera-gone@1"]);
    ended.expect(
        0,
        &[
            "camera lost: the camera closed the connection; connecting again, for 60 s at most",
            "camera back after ",
            "fetching the frame of view 1",
            "3 of 3 views merged",
        ],
    );
    assert_eq!(bench.read_json("out/summary.json")["views"][1]["retakes"], 0);
}

#[test]
fn an_alarm_in_mid_motion_ends_the_run_with_its_number_and_name() {
    let seen = "alarm 4315 COLLISION DETECT";
    assert_ends_in_mid_run("faults-robot-alarm", "robot-alarm=4315@2", "robot-alarm", seen);
}

#[test]
fn an_emergency_stop_in_mid_motion_ends_the_run() {
    assert_ends_in_mid_run("faults-estop", "estop@2", "robot-servo", "servo power went off");
}

#[test]
fn an_arm_that_stands_elsewhere_ends_the_run() {
    assert_ends_in_mid_run("faults-elsewhere", "elsewhere=2@2", "robot-elsewhere", "2.000 mm");
}

#[test]
fn a_robot_without_command_remote_is_never_moved() {
    let seen = "command remote is not set";
    assert_ends_before_the_first_move("faults-remote-off", "remote-off", "robot-not-remote", seen);
}

#[test]
fn servo_power_that_cannot_be_switched_on_ends_the_run_before_the_first_move() {
    assert_ends_before_the_first_move("faults-servo-refused", "servo-refused", "robot-servo", "3450");
}

#[test]
fn settings_that_the_camera_changed_end_the_run_before_the_first_move() {
    let seen = "exposure_us: asked for 1000, in force 1001";
    assert_ends_before_the_first_move("faults-config-echo", "config-echo", "camera-settings", seen);
}

#[test]
fn a_camera_that_serves_another_controller_ends_the_run_before_the_first_move() {
    assert_ends_before_the_first_move("faults-controller-busy", "controller-busy", "camera-refused", "201");
}

/// A run of three views in which view 1 fails once.
#[track_caller]
fn assert_taken_again(name: &str, fault: &str, reason: &str) {
    let bench = Bench::new(name);
    let ended = bench.dry_run(3, &["--fault", fault]);
    ended.expect(0, &[&format!("view 1: no frame ({reason}"), "taking it again"]);
    assert_eq!(bench.statuses("out"), ["merged", "merged", "merged"]);
    let views = &bench.read_json("out/poses.json")["views"];
    let attempts = [0, 1, 2].map(|index: usize| views[index]["attempt"].as_u64().unwrap());
    assert_eq!(attempts, [0, 1, 0]);
    assert_eq!(bench.read_json("out/summary.json")["views"][1]["retakes"], 1);
}

#[test]
fn a_damaged_frame_is_taken_again() {
    assert_taken_again("faults-corrupt-chunk", "corrupt-chunk@1", "the CRC of component 0");
}

#[test]
fn an_empty_frame_is_taken_again() {
    assert_taken_again("faults-empty-frame", "empty-frame@1", "0 valid points, at least 500");
}

#[test]
fn a_frame_that_the_camera_may_repeat_is_taken_again() {
    assert_taken_again("faults-camera-error", "camera-error=14@1", "camera error 14");
}

#[test]
fn a_frame_that_does_not_come_in_time_is_taken_again() {
    assert_taken_again("faults-late-frame", "late-frame=60@1", "the frame did not come in time");
}

#[test]
fn a_frame_that_comes_late_but_in_time_is_used() {
    let bench = Bench::new("faults-late-but-used");
    let ended = bench.dry_run(2, &["--fault", "late-frame=0.5@1"]);
    ended.expect(0, &["2 of 2 views merged"]);
    assert!(!ended.stderr.contains("no frame"), "{}", ended.stderr);
}

#[test]
fn without_retakes_an_empty_frame_is_a_missing_view_and_too_few_views_are_exit_code_3() {
    let bench = Bench::new("faults-no-retakes");
    bench.write(
        "tiny.toml",
        RECIPE
            .replace("retakes_max = 1", "retakes_max = 0")
            .replace("views_min = 2", "views_min = 3")
            .replace("overlap_min_fraction = 0.5", "overlap_min_fraction = 0.3"),
    );
    let ended = bench.dry_run(3, &["--fault", "empty-frame@1"]);
    ended.expect(3, &["going on without it", "2 of 3 views merged (at least 3 wanted)"]);
    assert_eq!(bench.statuses("out"), ["merged", "missing", "merged"]);
    let poses = bench.read_json("out/poses.json");
    assert_eq!(poses["views"][1]["reason"], "0 valid points, at least 500 wanted");
}

#[test]
fn three_views_in_a_row_without_a_frame_end_the_run() {
    let bench = Bench::new("faults-camera-failing");
    bench.write("tiny.toml", RECIPE.replace("retakes_max = 1", "retakes_max = 0"));
    let faults = ["empty-frame@1", "camera-error=14@2", "corrupt-chunk@3"];
    let options: Vec<&str> = faults.iter().flat_map(|fault| ["--fault", *fault]).collect();
    let ended = bench.dry_run(6, &options);
    assert_faulted(&bench, &ended, "camera-failing", "3 views in a row");
    assert_kept_the_first_view(&bench);
}

#[test]
fn lost_answers_of_the_robot_change_nothing_in_the_result() {
    let bench = Bench::new("faults-answer-lost");
    bench.dry_run_into("whole", 3, &[], &[]).expect(0, &[]);
    bench
        .dry_run_into("lossy", 3, &["--fault", "answer-lost=0.1"], &[])
        .expect(0, &[]);
    let sent = |out: &str| {
        let records = bench.records(&format!("{out}/run.mcap"));
        let count = |topic| records.iter().filter(|record| record.topic == topic).count();
        (
            count(bladescan::journal::Topic::RobotSent),
            count(bladescan::journal::Topic::RobotReceived),
        )
    };
    let (asked, answered) = sent("lossy");
    assert!(asked > answered, "no answer was lost");
    assert!(bench.read("whole/poses.json") == bench.read("lossy/poses.json"));
    assert!(bench.read("whole/model.ply") == bench.read("lossy/model.ply"));
}

/// A run of four views on a slow cell, its first view merged.
fn started_on(bench: &Bench, cell: &Simulator) -> Process {
    bench.write("station.toml", station(cell.robot(), cell.camera()));
    let mut run = bench.start(&[
        "run",
        "tiny.toml",
        "--station=station.toml",
        "--arm",
        "--out=out",
        "--views=4",
    ]);
    run.wait_for("view 0: merged");
    run
}

/// `run --arm` on a station at these addresses, replayed from its recording.
fn run_at(bench: &Bench, station_text: &str, view_count: usize) -> Ended {
    bench.write("station.toml", station_text);
    let views = view_count.to_string();
    let words = [
        "run",
        "tiny.toml",
        "--station",
        "station.toml",
        "--arm",
        "--out",
        "out",
        "--views",
        &views,
        "--part",
        "SN-0042",
    ];
    let ended = bench.run(&words);
    bench.holds_a_whole_run("out", view_count);
    ended
}

#[test]
fn a_run_works_on_a_cell_that_was_started_by_itself() {
    let bench = Bench::new("faults-own-cell");
    let cell = Simulator::start(&bench, "cell", &["--speed=1000"]);
    let ended = run_at(&bench, &station(cell.robot(), cell.camera()), 2);
    ended.expect(0, &["2 of 2 views merged"]);
    let summary = bench.read_json("out/summary.json");
    assert_eq!(summary["part"], "SN-0042");
    assert_eq!(summary["simulated"], true);
    assert_eq!(cell.stop().code, 0);
}

#[test]
fn a_station_of_a_real_cell_refuses_a_simulated_one_before_any_motion() {
    let bench = Bench::new("faults-identity");
    let cell = Simulator::start(&bench, "cell", &["--speed=1000"]);
    let text = station(cell.robot(), cell.camera()).replace("kind = \"simulated\"", "kind = \"cell\"");
    let ended = run_at(&bench, &text, 2);
    ended.expect(1, &["at an address meant for a real "]);
    let code = bench.read_json("out/summary.json")["ending"]["fault"]["code"].clone();
    assert!(code == "robot-identity" || code == "camera-identity", "{code}");
    assert_no_motion(&bench);
    assert_eq!(cell.stop().code, 0);
}

#[test]
fn a_robot_port_where_nothing_listens_is_named() {
    let bench = Bench::new("faults-robot-unreachable");
    let camera = Simulator::start(&bench, "camera", &[]);
    let ended = run_at(&bench, &station(CLOSED, camera.camera()), 2);
    assert_faulted(&bench, &ended, "robot-unreachable", CLOSED);
    assert_no_motion(&bench);
}

#[test]
fn a_camera_port_where_nothing_listens_is_named() {
    let bench = Bench::new("faults-camera-unreachable");
    let robot = Simulator::start(&bench, "robot", &[]);
    let ended = run_at(&bench, &station(robot.robot(), CLOSED), 2);
    assert_faulted(&bench, &ended, "camera-unreachable", CLOSED);
    assert_no_motion(&bench);
}

#[test]
fn a_robot_that_falls_silent_is_named_and_so_is_its_unconfirmed_hold() {
    let bench = Bench::new("faults-robot-silent");
    let cell = Simulator::start(&bench, "cell", &["--speed=1000", "--fault=robot-silent@2"]);
    let ended = run_at(&bench, &station(cell.robot(), cell.camera()), 4);
    assert_faulted(&bench, &ended, "robot-silent", "no answer to 5 questions");
    ended.expect(1, &["FAULT robot-not-held: ", "press the emergency stop"]);
    assert_kept_the_first_view(&bench);
}

#[test]
fn a_hold_that_the_robot_does_not_confirm_ends_the_run_with_the_call_for_the_emergency_stop() {
    let bench = Bench::new("faults-robot-not-held");
    let cell = Simulator::start(&bench, "cell", &["--speed=2"]);
    let mut run = started_on(&bench, &cell);
    cell.freeze();
    run.say("h");
    let ended = run.end();
    bench.holds_a_whole_run("out", 4);
    assert_faulted(&bench, &ended, "robot-not-held", "press the emergency stop");
    assert_kept_the_first_view(&bench);
}

#[test]
fn a_cell_that_dies_while_the_arm_is_held_ends_the_run() {
    let bench = Bench::new("faults-cell-dies");
    let cell = Simulator::start(&bench, "cell", &["--speed=2"]);
    let mut run = started_on(&bench, &cell);
    run.say("h");
    run.wait_for("HELD");
    cell.kill();
    let ended = run.end();
    bench.holds_a_whole_run("out", 4);
    assert_faulted(&bench, &ended, "camera-unreachable", "tried again for ");
    assert_kept_the_first_view(&bench);
}

#[test]
fn a_camera_that_falls_silent_is_connected_again_and_its_frame_is_fetched() {
    let bench = Bench::new("faults-camera-silent-once");
    let cell = Simulator::start(&bench, "cell", &["--speed=1000", "--fault=camera-silent@1"]);
    let ended = run_at(&bench, &station(cell.robot(), cell.camera()), 3);
    let said = [
        "nothing heard for 1000 ms",
        "fetching the frame of view 1",
        "3 of 3 views merged",
    ];
    ended.expect(0, &said);
    assert_eq!(bench.read_json("out/summary.json")["views"][1]["retakes"], 0);
}

#[test]
fn a_camera_that_falls_silent_and_is_not_to_be_connected_again_is_named() {
    let bench = Bench::new("faults-camera-silent");
    let cell = Simulator::start(&bench, "cell", &["--speed=1000", "--fault=camera-silent@1"]);
    let station =
        station(cell.robot(), cell.camera()).replace("reconnect_timeout_ms = 1000", "reconnect_timeout_ms = 0");
    let ended = run_at(&bench, &station, 3);
    assert_faulted(&bench, &ended, "camera-silent", "nothing heard for 1000 ms");
    assert_kept_the_first_view(&bench);
}

#[test]
fn a_camera_with_other_optics_is_named() {
    let bench = Bench::new("faults-optics");
    let cell = Simulator::start(&bench, "cell", &["--speed=1000", "--optics=medium"]);
    let ended = run_at(&bench, &station(cell.robot(), cell.camera()), 2);
    assert_faulted(&bench, &ended, "camera-optics", "the camera has \"medium\"");
    assert_no_motion(&bench);
}
