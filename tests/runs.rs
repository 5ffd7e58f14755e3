//! Runs on the simulated cell: what they leave behind, that they repeat, and the operator's words.

use crate::support::{Bench, Process, RECIPE, Simulator};
use bladescan::journal::{Record, Recording, Topic};
use bladescan::settings::Station;
use serde_json::Value;

#[test]
fn a_dry_run_leaves_its_files_and_merges_every_view() {
    let bench = Bench::new("runs-files");
    let ended = bench.dry_run(3, &[]);
    ended.expect(0, &["3 of 3 views merged (at least 2 wanted); files in out"]);
    assert_eq!(
        bench.names("out"),
        ["model.ply", "poses.json", "run.mcap", "summary.json", "truth.json"]
    );
    assert_eq!(bench.statuses("out"), ["merged", "merged", "merged"]);
    let summary = bench.read_json("out/summary.json");
    assert_eq!(summary["ending"]["how"], "finished");
    assert_eq!(summary["simulated"], true);
    assert_eq!(summary["seed"], 1);
    assert!(summary["counts"]["model_points"].as_u64().unwrap() > 10_000);
}

#[test]
fn standard_output_of_a_json_run_is_one_document_and_nothing_else() {
    let bench = Bench::new("runs-json");
    let ended = bench.dry_run(2, &["--json"]);
    ended.expect(0, &["run finished"]);
    let printed: Value = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!(printed, bench.read_json("out/summary.json"));
}

#[test]
fn without_a_terminal_progress_is_plain_lines() {
    let bench = Bench::new("runs-lines");
    let ended = bench.dry_run(2, &[]);
    ended.expect(
        0,
        &["run begins: recipe tiny, station sim, 2 views\n", "view 1: merged, "],
    );
    assert_eq!(ended.stdout, "");
    assert!(!ended.stderr.contains(['\x1b', '\r']), "{:?}", ended.stderr);
}

#[test]
fn a_run_never_writes_into_a_folder_that_is_there() {
    let bench = Bench::new("runs-existing");
    std::fs::create_dir(bench.path("out")).unwrap();
    bench.write("out/mine.txt", "mine");
    let ended = bench.run(&["dry-run", "tiny.toml", "--out", "out", "--views", "2"]);
    ended.expect(2, &["out exists", "--out"]);
    assert_eq!(bench.names("out"), ["mine.txt"]);
    assert_eq!(bench.read("out/mine.txt"), b"mine");
}

#[test]
fn a_run_without_a_folder_gets_one_named_after_recipe_and_time() {
    let bench = Bench::new("runs-default-folder");
    let ended = bench.run(&["dry-run", "tiny.toml", "--views", "2", "--speed", "1000"]);
    ended.expect(0, &["files in runs/tiny-"]);
    let [name] = bench.names("runs").try_into().unwrap();
    let time = name.strip_prefix("tiny-").unwrap();
    assert_eq!((time.len(), &time[8..9], &time[15..]), (16, "T", "Z"), "{time}");
    bench.holds_a_whole_run(&format!("runs/{name}"), 2);
}

#[test]
fn the_seed_fixes_every_bit_of_the_result_whatever_the_number_of_threads() {
    let bench = Bench::new("runs-seed");
    for (out, seed, thread_count) in [
        ("one", "7", "1"),
        ("two", "7", "2"),
        ("again", "7", "2"),
        ("other", "8", "2"),
    ] {
        let threads = [("RAYON_NUM_THREADS", thread_count)];
        bench.dry_run_into(out, 3, &["--seed", seed], &threads).expect(0, &[]);
    }
    let result = |out: &str| ["poses.json", "model.ply"].map(|name| bench.read(&format!("{out}/{name}")));
    assert!(result("one") == result("two"), "1 and 2 threads differ");
    assert!(result("two") == result("again"), "the same run differs");
    let [poses, model] = result("other");
    assert!(poses != result("two")[0] && model != result("two")[1]);
}

#[test]
fn a_recording_replays_alike_on_one_and_on_two_threads() {
    let bench = Bench::new("runs-replay-threads");
    bench.dry_run(3, &[]).expect(0, &[]);
    for thread_count in ["1", "2"] {
        let threads = [("RAYON_NUM_THREADS", thread_count)];
        let replayed = bench.start_with(&["replay", "out/run.mcap"], &threads).end();
        replayed.expect(0, &[]);
        let used = format!("6 jobs run again on {thread_count} threads");
        assert!(replayed.stdout.contains(&used), "{}", replayed.stdout);
        assert!(replayed.stdout.ends_with("\nbit-identical\n"), "{}", replayed.stdout);
    }
}

/// Records a run, changes the first record that `change` takes to, and returns what replay says of it.
fn replay_of_a_changed_recording(name: &str, change: impl Fn(&mut Record) -> bool) -> (i32, Value) {
    let bench = Bench::new(name);
    bench.dry_run(2, &[]).expect(0, &[]);
    let mut records = bench.records("out/run.mcap");
    assert!(records.iter_mut().any(change), "nothing was changed");
    bench.rewrite("out/run.mcap", "changed.mcap", &records);
    let replayed = bench.run(&["replay", "changed.mcap", "--json"]);
    (replayed.code, serde_json::from_str(&replayed.stdout).unwrap())
}

/// Replaces a text in a record's bytes by another of the same length.
fn replace(record: &mut Record, from: &[u8], to: &[u8]) -> bool {
    let Some(at) = record.payload.windows(from.len()).position(|window| window == from) else {
        return false;
    };
    record.payload[at..at + to.len()].copy_from_slice(to);
    true
}

#[test]
fn replay_finds_a_changed_byte_in_an_answer_of_the_robot() {
    let (code, report) = replay_of_a_changed_recording("runs-changed-answer", |record| {
        record.topic == Topic::RobotReceived && replace(record, b"DX200", b"DX100")
    });
    assert_eq!(code, 5);
    assert_eq!(report["identical"], false);
    assert_eq!(report["difference"]["topic"], "/event");
    assert!(
        report["difference"]["recorded"]
            .as_str()
            .unwrap()
            .contains("SIMULATED DX200")
    );
    assert!(
        report["difference"]["replayed"]
            .as_str()
            .unwrap()
            .contains("SIMULATED DX100")
    );
    let before = report["difference"]["inputs_before"].as_array().unwrap();
    assert!(
        before
            .last()
            .unwrap()
            .as_str()
            .unwrap()
            .starts_with("/robot/received at "),
        "{before:?}"
    );
}

#[test]
fn replay_finds_a_changed_digest_of_a_job() {
    let (code, report) = replay_of_a_changed_recording("runs-changed-digest", |record| {
        let Some(at) = record.payload.windows(10).position(|window| window == b"\"digest\":\"") else {
            return false;
        };
        let digit = &mut record.payload[at + 10];
        *digit = if *digit == b'0' { b'1' } else { b'0' };
        true
    });
    assert_eq!(code, 5);
    assert_eq!(report["difference"]["topic"], "/input");
    assert!(report["difference"]["recorded"].as_str().unwrap().contains("job-done"));
}

#[test]
fn replay_finds_a_changed_event() {
    let (code, report) = replay_of_a_changed_recording("runs-changed-event", |record| {
        record.topic == Topic::Event && replace(record, b"\"view-merged\"", b"\"view-nerged\"")
    });
    assert_eq!(code, 5);
    assert_eq!(report["difference"]["topic"], "/event");
    assert!(
        report["difference"]["recorded"]
            .as_str()
            .unwrap()
            .contains("view-nerged")
    );
    assert!(
        report["difference"]["replayed"]
            .as_str()
            .unwrap()
            .contains("view-merged")
    );
}

#[test]
fn replay_finds_a_missing_output() {
    let (code, report) = replay_of_a_changed_recording("runs-missing-output", |record| {
        let is_sent = record.topic == Topic::RobotSent;
        if is_sent {
            record.topic = Topic::CameraSent;
        }
        is_sent
    });
    assert_eq!(code, 5);
    assert!(
        report["difference"]["replayed"]
            .as_str()
            .unwrap()
            .starts_with("/robot/sent")
    );
}

#[test]
fn replay_says_in_words_where_a_recording_differs() {
    let bench = Bench::new("runs-changed-words");
    bench.dry_run(2, &[]).expect(0, &[]);
    let mut records = bench.records("out/run.mcap");
    let changed = records
        .iter_mut()
        .any(|record| record.topic == Topic::Event && replace(record, b"view-merged", b"view-nerged"));
    assert!(changed);
    bench.rewrite("out/run.mcap", "changed.mcap", &records);
    let replayed = bench.run(&["replay", "changed.mcap"]);
    replayed.expect(5, &[]);
    for text in [
        "DIFFERS at ",
        " s on /event after ",
        "recorded: ",
        "view-nerged",
        "replayed: ",
    ] {
        assert!(replayed.stdout.contains(text), "{}", replayed.stdout);
    }
}

#[test]
fn a_file_that_is_no_recording_is_bad_input() {
    let bench = Bench::new("runs-no-recording");
    let replayed = bench.run(&["replay", "tiny.toml"]);
    replayed.expect(2, &["tiny.toml: not a readable MCAP file"]);
    let replayed = bench.run(&["replay", "missing.mcap"]);
    replayed.expect(2, &["cannot read missing.mcap"]);
}

#[test]
fn a_held_run_goes_on_when_the_operator_resumes_it() {
    let bench = Bench::new("runs-hold-resume");
    let mut run = held_after_the_first_view(&bench);
    run.say("r");
    run.wait_for("the run goes on");
    run.end().expect(0, &["4 of 4 views merged"]);
    bench.holds_a_whole_run("out", 4);
    assert_hold_was_asked_and_confirmed(&bench);
}

#[test]
fn a_run_that_was_held_gives_the_same_result_as_one_that_was_not() {
    let bench = Bench::new("runs-hold-result");
    bench.dry_run_into("straight", 4, &[], &[]).expect(0, &[]);
    let mut run = held_after_the_first_view(&bench);
    run.say("r");
    run.end().expect(0, &[]);
    bench.holds_a_whole_run("out", 4);
    assert!(bench.read("straight/poses.json") == bench.read("out/poses.json"));
    assert!(bench.read("straight/model.ply") == bench.read("out/model.ply"));
}

#[test]
fn a_hold_before_the_devices_are_ready_can_be_resumed() {
    let bench = Bench::new("runs-hold-early");
    let mut run = start_slowly(&bench);
    run.wait_for("run begins");
    run.say("h");
    run.wait_for("HELD");
    run.say("r");
    run.wait_for("the run goes on");
    run.end().expect(0, &["4 of 4 views merged"]);
    bench.holds_a_whole_run("out", 4);
}

#[test]
fn a_held_run_can_be_aborted_and_keeps_what_was_merged() {
    let bench = Bench::new("runs-hold-abort");
    let mut run = held_after_the_first_view(&bench);
    run.say("a");
    run.end().expect(
        4,
        &["ending the run, as the operator asked", "run aborted by the operator"],
    );
    bench.holds_a_whole_run("out", 4);
    assert_hold_was_asked_and_confirmed(&bench);
    assert_eq!(bench.read_json("out/summary.json")["ending"]["how"], "aborted");
    assert_eq!(bench.statuses("out")[0], "merged");
    assert_eq!(bench.statuses("out")[3], "missing");
}

#[test]
fn the_first_interrupt_holds_the_arm_and_the_second_aborts() {
    let bench = Bench::new("runs-interrupts");
    let mut run = start_slowly(&bench);
    run.wait_for("view 0: merged");
    run.signal("INT");
    run.wait_for("HELD");
    run.signal("INT");
    run.end().expect(4, &["run aborted by the operator"]);
    bench.holds_a_whole_run("out", 4);
    assert_hold_was_asked_and_confirmed(&bench);
}

#[test]
fn a_termination_by_the_system_aborts_at_once() {
    let bench = Bench::new("runs-termination");
    let mut run = start_slowly(&bench);
    run.wait_for("view 0: merged");
    run.signal("TERM");
    run.end().expect(4, &["holding the arm", "run aborted by the operator"]);
    bench.holds_a_whole_run("out", 4);
}

#[test]
fn the_end_of_standard_input_does_not_stop_a_run() {
    let bench = Bench::new("runs-stdin-closed");
    let mut run = start_slowly(&bench);
    run.close_stdin();
    run.end().expect(0, &["4 of 4 views merged"]);
    bench.holds_a_whole_run("out", 4);
}

#[test]
fn a_killed_run_takes_its_simulator_along_and_its_recording_replays_as_far_as_it_goes() {
    let bench = Bench::new("runs-killed");
    let mut run = start_slowly(&bench);
    run.wait_for("view 0: merged");
    run.signal("KILL");
    // The simulator shares standard error, so this ends only when both have.
    assert_eq!(run.end().code, -1);
    let replayed = bench.run(&["replay", "out/run.mcap"]);
    replayed.expect(0, &[]);
    let last = "bit-identical as far as the recording goes; it lacks the end of its run\n";
    assert!(replayed.stdout.ends_with(last), "{}", replayed.stdout);
}

#[test]
fn a_simulated_cell_ends_with_its_standard_input() {
    let bench = Bench::new("runs-cell-ends");
    let cell = Simulator::start(&bench, "cell", &[]);
    assert_ne!(cell.robot(), cell.camera());
    cell.stop().expect(0, &[]);
}

/// Four views, slow enough that there is motion left to hold after the first.
fn start_slowly(bench: &Bench) -> Process {
    bench.start(&["dry-run", "tiny.toml", "--out", "out", "--views", "4", "--speed", "2"])
}

/// The same run, held by the operator when its first view was merged.
fn held_after_the_first_view(bench: &Bench) -> Process {
    let mut run = start_slowly(bench);
    run.wait_for("view 0: merged");
    run.say("h");
    run.wait_for("HELD");
    run
}

/// The operator's word, then the datagram that holds the arm, then the event that the arm is held.
fn assert_hold_was_asked_and_confirmed(bench: &Bench) {
    let records = bench.records("out/run.mcap");
    let position = |what: &str, is_it: &dyn Fn(&Record) -> bool| {
        records.iter().position(is_it).unwrap_or_else(|| panic!("no {what}"))
    };
    let has = |record: &Record, text: &str| String::from_utf8_lossy(&record.payload).contains(text);
    let word = position("word", &|record| {
        record.topic == Topic::Input && (has(record, "\"hold\"") || has(record, "\"stop\""))
    });
    let sent = position("datagram", &|record| {
        record.topic == Topic::RobotSent && record.payload[24..28] == HOLD_ON_INSTANCE_1
    });
    let asked = position("request", &|record| {
        record.topic == Topic::Event && has(record, "hold-asked") && has(record, "operator")
    });
    let held = position("confirmation", &|record| {
        record.topic == Topic::Event && has(record, "\"held\"")
    });
    assert!(word < sent && word < asked && sent < held && asked < held);
    let answered = records[sent..held]
        .iter()
        .any(|record| record.topic == Topic::RobotReceived);
    assert!(answered, "held without a word of the robot");
}

/// Command 0x83 (hold, servo, HLOCK) with instance 1 (hold), little-endian, as at bytes 24 to 27 of an HSES request.
const HOLD_ON_INSTANCE_1: [u8; 4] = [0x83, 0, 1, 0];

#[test]
fn a_recording_says_who_ran_which_part_and_how_its_cell_was_started() {
    let bench = Bench::new("runs-said");
    let options = [
        "--part",
        "SN-0042",
        "--operator",
        "R. Roe",
        "--surface",
        "machined",
        "--without",
        "ghosts",
    ];
    bench.dry_run(2, &options).expect(0, &[]);
    let bytes = bench.read("out/run.mcap");
    let recording = Recording::open(&bytes).unwrap();
    let header = recording.header();
    assert_eq!(
        (header.part.as_deref(), header.operator.as_deref()),
        (Some("SN-0042"), Some("R. Roe"))
    );
    let simulation = header.simulation.as_ref().unwrap();
    assert_eq!(
        (simulation.blade.as_str(), simulation.surface.as_str()),
        ("builtin:hpt-a", "machined")
    );
    assert_eq!(
        (simulation.without.as_slice(), simulation.speed),
        (["ghosts".to_owned()].as_slice(), 1000.0)
    );
}

#[test]
fn viewers_find_clouds_and_poses_under_their_published_schemas() {
    let bench = Bench::new("runs-viewer");
    bench.dry_run(3, &[]).expect(0, &[]);
    let bytes = bench.read("out/run.mcap");
    let messages: Vec<mcap::Message<'_>> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    for (topic, schema_name) in [
        ("/view/cloud", "foxglove.PointCloud"),
        ("/tf", "foxglove.FrameTransform"),
    ] {
        let found: Vec<_> = messages
            .iter()
            .filter(|message| message.channel.topic == topic)
            .collect();
        assert_eq!(found.len(), 3, "{topic}");
        for message in &found {
            let schema = message.channel.schema.as_ref().unwrap();
            assert_eq!(
                (schema.name.as_str(), schema.encoding.as_str()),
                (schema_name, "protobuf")
            );
            assert_eq!(message.channel.message_encoding, "protobuf");
        }
        // Clouds come as they are ready: one view's may overtake another's.
        for view_index in 0..3 {
            let frame = format!("view_{view_index:02}");
            let has_frame = |message: &&mcap::Message<'_>| {
                let mut windows = message.data.windows(frame.len());
                windows.any(|window| window == frame.as_bytes())
            };
            assert!(found.iter().any(has_frame), "{topic} has no {frame}");
        }
    }
    let models = messages
        .iter()
        .filter(|message| message.channel.topic == "/model")
        .count();
    assert_eq!(models, 1);
}

#[test]
fn a_recording_carries_recipe_and_station_word_for_word_and_an_index() {
    let bench = Bench::new("runs-attachments");
    bench.dry_run(2, &[]).expect(0, &[]);
    let bytes = bench.read("out/run.mcap");
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(!summary.chunk_indexes.is_empty());
    let attachments: Vec<(String, String)> = summary
        .attachment_indexes
        .iter()
        .map(|index| {
            let attachment = mcap::read::attachment(&bytes, index).unwrap();
            (
                attachment.name,
                String::from_utf8(attachment.data.into_owned()).unwrap(),
            )
        })
        .collect();
    let expected = [
        ("recipe.toml", RECIPE),
        ("station.toml", Station::BUILTIN_SIMULATED_TEXT),
    ]
    .map(|(name, text)| (name.to_owned(), text.to_owned()));
    assert_eq!(attachments, expected);
    let [index] = summary.metadata_indexes.try_into().unwrap();
    let run = mcap::read::metadata(&bytes, &index).unwrap();
    assert_eq!(run.name, "bladescan.run");
    let header: Value = serde_json::from_str(&run.metadata["header"]).unwrap();
    assert_eq!(
        (&header["recipe"], &header["seed"]),
        (&Value::from("tiny"), &Value::from(1))
    );
    for (name, text) in [("recipe", RECIPE), ("station", Station::BUILTIN_SIMULATED_TEXT)] {
        assert_eq!(
            header[format!("{name}_sha256")],
            bladescan::job::sha256(text.as_bytes())
        );
    }
}
