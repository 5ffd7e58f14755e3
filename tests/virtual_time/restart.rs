//! Runs whose process ends anywhere, and those that go on with them.

use super::*;
use bladescan::journal::{Record, Topic};
use bladescan::run::rebuild;

/// The recording of a run as a killed process leaves it: its first records.
fn cut(bytes: &[u8], record_count: usize) -> Vec<u8> {
    let recording = Recording::open(bytes).unwrap();
    let out = Cursor::new(Vec::new());
    let mut writer = Writer::begin(
        out,
        recording.header(),
        START_UNIX_NS,
        recording.recipe_text(),
        recording.station_text(),
    )
    .unwrap();
    for record in recording.records().unwrap().take(record_count) {
        writer.write(&record.unwrap()).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

impl Pair {
    /// Goes on with a recorded run, in a cell that has been switched off and on, or in `cell` as the run has left it.
    fn resumed(bytes: &[u8], cell: Option<Cell>) -> Self {
        let recording = Recording::open(bytes).unwrap();
        let view_count = recording.header().view_count.unwrap();
        let seed = recording.header().seed.0;
        let mut pair = Self::with_recipe(recording.recipe_text(), view_count, &[], 0.0, seed);
        let rebuilt = rebuild(&recording, &pair.pool, &mut |_| ()).unwrap();
        let journal = recording.copied(Cursor::new(Vec::new()), &rebuilt.unwritten).unwrap();
        pair.run = Journalled::new(rebuilt.controller, journal, START_UNIX_NS);
        pair.now_ns = rebuilt.last.ns + 1_000_000;
        // Connections of before are not this process's.
        pair.connection = 100;
        if let Some(cell) = cell {
            pair.cell = cell;
        }
        for (job_id, done) in rebuilt.done {
            pair.send(JOB_NS, Delivery::ToController(Input::JobDone { job_id, done }));
        }
        pair
    }

    fn go_on(&mut self) -> Ending {
        let version = "next".to_owned();
        self.drive_from(Input::Restarted { version }, |_| None)
    }

    fn finish_recording(self) -> Vec<u8> {
        let (_, journal) = self.run.into_parts();
        journal.finish().unwrap().into_inner()
    }

    fn checked(&self) -> Option<(usize, f64, bool)> {
        self.events.iter().find_map(|(_, event)| match event {
            Event::GripChecked {
                view_index,
                distance_mm,
                moved,
                ..
            } => Some((*view_index, *distance_mm, *moved)),
            _ => None,
        })
    }
}

fn records(bytes: &[u8]) -> Vec<Record> {
    let recording = Recording::open(bytes).unwrap();
    recording.records().unwrap().map(Result::unwrap).collect()
}

/// A run of three views that nothing interrupts.
fn unbroken() -> (BTreeMap<&'static str, Vec<u8>>, Vec<u8>) {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    let files = std::mem::take(&mut pair.files);
    (files, pair.finish_recording())
}

#[test]
fn a_run_killed_in_any_state_of_a_view_ends_as_if_nothing_had_happened() {
    let (files, bytes) = unbroken();
    let records = records(&bytes);
    let states: Vec<usize> = (0..records.len())
        .filter(|&index| {
            let record = &records[index];
            let text = String::from_utf8_lossy(&record.payload);
            match record.topic {
                Topic::Event => text.contains("\"view_index\":1") || text.contains("robot-ready"),
                Topic::Input => text.contains("job-done"),
                _ => false,
            }
        })
        .collect();
    assert!(states.len() > 10, "{states:?}");
    for (count, index) in states.into_iter().enumerate() {
        // Just after this record, and with half of what follows from its input unwritten.
        let mut pair = Pair::resumed(&cut(&bytes, index + 1), None);
        let what = String::from_utf8_lossy(&records[index].payload).into_owned();
        assert_eq!(pair.go_on(), Ending::Finished, "{what}: {:#?}", pair.events);
        assert_eq!(pair.files["poses.json"], files["poses.json"], "{what}");
        assert!(pair.files["model.ply"] == files["model.ply"], "{what}");
        if count % 4 == 0 {
            pair.replay();
        }
    }
}

#[test]
fn a_frame_that_was_exposed_for_the_process_before_is_fetched_not_exposed_again() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    let mut exposed = false;
    let killed = pair.drive_until(|event| {
        exposed |= matches!(event, Event::ExposureDone { view_index: 1, .. });
        exposed
    });
    assert!(killed);
    let (cell, bytes) = (pair.cell.clone(), pair.finish_recording());
    let mut pair = Pair::resumed(&bytes, Some(cell));
    assert_eq!(pair.go_on(), Ending::Finished, "{:#?}", pair.events);
    assert_eq!(pair.merged_count(), 3);
    let exposures: Vec<(u32, u32)> = pair
        .cell
        .truth()
        .views
        .iter()
        .map(|view| (view.view_index, view.attempt))
        .collect();
    assert_eq!(exposures, [(0, 0), (1, 0), (0, 0x8000), (2, 0)]);
    pair.replay();
}

#[test]
fn a_run_that_was_aborted_or_ended_by_a_fault_goes_on_with_what_is_left() {
    let (files, _) = unbroken();
    for (fault, abort) in [("robot-alarm=4315@1", false), ("late-frame=1@2", true)] {
        let mut pair = Pair::new(3, &[fault], 0.0, 1);
        let ending = pair.drive(|event| {
            (abort && matches!(event, Event::ExposureDone { view_index: 1, .. })).then_some(Command::Abort)
        });
        assert_ne!(ending, Ending::Finished);
        let bytes = pair.finish_recording();
        let mut pair = Pair::resumed(&bytes, None);
        assert_eq!(pair.go_on(), Ending::Finished, "{fault}: {:#?}", pair.events);
        assert_eq!(pair.files["poses.json"], files["poses.json"], "{fault}");
        assert!(pair.files["model.ply"] == files["model.ply"], "{fault}");
        pair.replay();
    }
}

#[test]
fn a_run_can_be_taken_up_again_and_again() {
    let (files, _) = unbroken();
    let mut pair = Pair::new(3, &[], 0.0, 1);
    assert!(pair.drive_until(|event| matches!(event, Event::ViewMerged { view_index: 0, .. })));
    let mut part = pair.finish_recording();
    for _ in 0..2 {
        let mut pair = Pair::resumed(&part, None);
        let killed = pair.drive_from_until(Input::Restarted { version: "next".into() }, |event| {
            matches!(event, Event::GripChecked { .. })
        });
        assert!(killed);
        part = pair.finish_recording();
    }
    let mut pair = Pair::resumed(&part, None);
    assert_eq!(pair.go_on(), Ending::Finished, "{:#?}", pair.events);
    assert_eq!(pair.files["poses.json"], files["poses.json"]);
    assert!(pair.files["model.ply"] == files["model.ply"]);
    pair.replay();
}

#[test]
fn a_run_killed_among_its_last_records_replays_without_a_difference_and_is_not_complete() {
    let (_, bytes) = unbroken();
    let count = records(&bytes).len();
    let pool = Pool::new().unwrap();
    for (missing_count, complete) in [(0, true), (1, false), (8, false)] {
        let cut = cut(&bytes, count - missing_count);
        let report = replay(&Recording::open(&cut).unwrap(), &pool).unwrap();
        assert!(report.identical, "{missing_count}: {:?}", report.difference);
        assert_eq!(report.complete, complete, "{missing_count}");
    }
}

#[test]
fn a_blade_that_sits_where_it_sat_passes_and_one_that_has_moved_stops_the_run() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    assert!(pair.drive_until(|event| matches!(event, Event::FrameArrived { view_index: 1, .. })));
    let (taken, bytes) = (pair.cell.truth().views[1].camera_from_blade, pair.finish_recording());
    // What is left of the shift is the robot's own error, the same in both cells.
    for (slip_mm, passes) in [(0.0, true), (4.0, false)] {
        let mut pair = Pair::resumed(&bytes, Some(slipped_cell(slip_mm)));
        let ending = pair.go_on();
        let (view_index, distance_mm, moved) = pair.checked().unwrap();
        assert_eq!((view_index, moved), (1, !passes), "{slip_mm}: {ending:?}");
        assert_eq!(Pair::fault_name(&ending), if passes { "none" } else { "blade-moved" });
        let taken_again = pair.cell.truth().views[0].camera_from_blade;
        let true_mm = (0..3)
            .map(|row| (taken_again[row][3] - taken[row][3]).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(
            (distance_mm - true_mm).abs() < 0.3,
            "{slip_mm}: {distance_mm} instead of {true_mm}"
        );
        pair.replay();
    }
}

/// A cell in which the blade has slipped along its own x axis.
fn slipped_cell(slip_mm: f64) -> Cell {
    let station = Station::builtin_simulated();
    Cell::new(Scene {
        seed: 1,
        base_from_camera: station.base_from_camera,
        tool_from_blade: station.tool_from_blade * nalgebra::Isometry3::translation(slip_mm, 0.0, 0.0),
        ..Scene::default()
    })
}

#[test]
fn an_arm_that_still_moves_when_the_run_goes_on_is_held_when_asked() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    assert!(pair.drive_until(|event| matches!(event, Event::MoveStarted { view_index: 1, .. })));
    let cell = pair.cell.clone();
    let bytes = pair.finish_recording();
    let mut pair = Pair::resumed(&bytes, Some(cell));
    let version = "next".to_owned();
    let ending = pair.drive_from(Input::Restarted { version }, |event| match event {
        Event::Restarted { .. } => Some(Command::Hold),
        Event::Held => Some(Command::Abort),
        _ => None,
    });
    assert_eq!(ending, Ending::Aborted);
    let held = |event: &Event| matches!(event, Event::Held);
    assert!(pair.events.iter().any(|(_, event)| held(event)));
    assert!(pair.servo_off_count > 0, "servo power was switched on for this run");
    pair.replay();
}
