//! `recover` and `resume`: runs that were killed, aborted or stopped by a fault go on as if nothing had happened.

use crate::support::{Bench, Process, Simulator, station};

impl Bench {
    /// The result of a run that nothing interrupts.
    fn unbroken(&self) -> [Vec<u8>; 2] {
        self.dry_run_into("unbroken", 3, &[], &[]).expect(0, &[]);
        self.results("unbroken")
    }

    fn results(&self, out: &str) -> [Vec<u8>; 2] {
        ["poses.json", "model.ply"].map(|name| self.read(&format!("{out}/{name}")))
    }

    fn begin(&self, out: &str) -> Process {
        self.start(&["dry-run", "tiny.toml", "--out", out, "--views", "3", "--speed", "100"])
    }

    /// Begins a run and holds it after its first view.
    fn begin_and_hold(&self, out: &str) -> Process {
        let mut process = self.begin(out);
        process.say("v");
        process.wait_for("HELD");
        process
    }

    /// Waits until the growing recording holds all of `texts` in one of its events.
    fn wait_for_event(&self, out: &str, texts: &[&str]) {
        let path = self.path(out).join("run.mcap");
        let begun = std::time::Instant::now();
        let has = |bytes: &[u8], text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
        let has_all = |bytes: &[u8]| {
            bytes
                .split(|byte| *byte == b'}')
                .any(|event| texts.iter().all(|text| has(event, text)))
        };
        while !std::fs::read(&path).is_ok_and(|bytes| has_all(&bytes)) {
            assert!(begun.elapsed().as_secs() < 60, "{texts:?} never came");
            std::thread::yield_now();
        }
    }
}

#[test]
fn a_run_killed_in_any_state_of_a_view_is_recovered_and_resumed_to_the_same_bytes() {
    let bench = Bench::new("resume-killed");
    let unbroken = bench.unbroken();
    for (number, event) in [
        "move-started",
        "arrived",
        "triggered",
        "exposure-done",
        "frame-arrived",
        "view-prepared",
        "view-merged",
    ]
    .into_iter()
    .enumerate()
    {
        let out = format!("killed-{event}");
        let process = bench.begin(&out);
        bench.wait_for_event(&out, &[&format!("\"event\":\"{event}\""), "\"view_index\":1,"]);
        process.signal("KILL");
        process.end();
        // With and without recovering first: resume does it by itself.
        if number % 2 == 0 {
            let recovered = bench.run(&["recover", &format!("{out}/run.mcap")]);
            assert_eq!(recovered.code, 0, "{recovered:?}");
        }
        // On a slow machine the last views may have been taken before the kill.
        bench.run(&["resume", &out]).expect(0, &["left to take"]);
        assert!(bench.results(&out) == unbroken, "{event}");
        bench.holds_a_whole_run(&out, 3);
        // A whole run: there is nothing to go on with, and nothing changes.
        let again = bench.run(&["resume", &out]);
        again.expect(0, &["nothing is left to take"]);
        assert!(bench.results(&out) == unbroken, "{event}");
    }
}

#[test]
fn a_run_stopped_by_a_fault_goes_on_and_the_results_of_both_parts_are_kept() {
    let bench = Bench::new("resume-fault");
    let unbroken = bench.unbroken();
    let faulted = bench.dry_run_into("out", 3, &["--fault", "robot-alarm=4315@2"], &[]);
    faulted.expect(1, &["FAULT robot-alarm"]);
    let before = bench.results("out");
    let shown = bench.run(&["resume", "out", "--show", "--json"]);
    assert_eq!(shown.code, 0, "{shown:?}");
    let left: serde_json::Value = serde_json::from_str(&shown.stdout).unwrap();
    // The frame of view 1 may have been on its way.
    assert_eq!(left["left"].as_array().unwrap().last(), Some(&2.into()), "{left}");
    bench.run(&["resume", "out"]).expect(
        0,
        &["stopped by robot-alarm", " left to take: ", "check: the blade sits"],
    );
    assert!(bench.results("out") == unbroken);
    assert!(bench.results("out/part-1") == before);
    bench.holds_a_whole_run("out", 3);
}

#[test]
fn an_aborted_run_is_resumed_and_what_the_robot_does_then_is_told() {
    let bench = Bench::new("resume-aborted");
    let unbroken = bench.unbroken();
    let process = bench.begin_and_hold("out");
    process.signal("TERM");
    process.end().expect(4, &[]);
    bench.run(&["resume", "out"]).expect(0, &["ended by the operator"]);
    assert!(bench.results("out") == unbroken);
    let truth = bench.read_json("out/truth.json");
    let views = truth["views"].as_array().unwrap();
    assert!(
        views.iter().any(|view| view["attempt"] == 0x8000),
        "the check is an acquisition of its own"
    );
}

#[test]
fn a_run_that_still_goes_on_is_neither_resumed_nor_recovered() {
    let bench = Bench::new("resume-in-use");
    let mut process = bench.begin_and_hold("out");
    for words in [&["resume", "out"][..], &["recover", "out/run.mcap"]] {
        bench.run(words).expect(2, &["another bladescan is writing"]);
    }
    process.say("r");
    process.end().expect(0, &["3 of 3 views merged"]);
    bench.holds_a_whole_run("out", 3);
}

#[test]
fn a_run_in_a_cell_goes_on_only_with_arm_and_where_the_station_says() {
    let bench = Bench::new("resume-cell");
    let cell = Simulator::start(
        &bench,
        "cell",
        &["--blade=builtin:hpt-a", "--optics=fine", "--speed=100"],
    );
    bench.write("cell.toml", station(cell.robot(), cell.camera()));
    let words = [
        "run",
        "tiny.toml",
        "--station",
        "cell.toml",
        "--arm",
        "--out",
        "out",
        "--views",
        "3",
    ];
    let mut process = bench.start(&words);
    process.say("v");
    process.wait_for("HELD");
    process.signal("KILL");
    process.end();
    bench
        .run(&["resume", "out"])
        .expect(2, &["--arm", "nothing was connected"]);
    bench
        .run(&["resume", "out", "--arm", "--fault", "estop@1"])
        .expect(2, &["--fault"]);
    bench
        .run(&["resume", "out", "--arm"])
        .expect(0, &["3 of 3 views merged"]);
    bench.holds_a_whole_run("out", 3);
    cell.stop();
}

#[test]
fn what_is_no_run_is_refused_in_words() {
    let bench = Bench::new("resume-nothing");
    bench
        .run(&["resume", "nowhere"])
        .expect(2, &["nowhere is no folder of a run"]);
    bench.write("empty.mcap", "");
    bench.run(&["recover", "empty.mcap"]).expect(2, &["empty.mcap", "MCAP"]);
    bench.dry_run(2, &[]).expect(0, &[]);
    let whole = bench.read("out/run.mcap");
    let recovered = bench.run(&["recover", "out/run.mcap"]);
    assert_eq!(
        (recovered.code, recovered.stdout.as_str()),
        (0, "the recording is whole: nothing to recover\n")
    );
    assert!(bench.read("out/run.mcap") == whole);
}
