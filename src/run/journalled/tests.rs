use super::*;
use crate::controller::{Command, Header};
use crate::journal::Topic;
use crate::plan::Plan;
use crate::seed::Seed;
use crate::settings::{Recipe, Station};

/// A journal that flushes and syncs when it is told to, and fails at a record.
#[derive(Debug, Default)]
struct Slow {
    records: Vec<Record>,
    progress: Progress,
    fails_at: Option<usize>,
}

impl Slow {
    fn count(&self) -> u64 {
        self.records.len() as u64
    }
}

impl Journal for Slow {
    fn record(&mut self, record: Record) -> Result<(), JournalError> {
        if self.fails_at == Some(self.records.len()) {
            return Err(JournalError::Write("no space left".into()));
        }
        self.records.push(record);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), JournalError> {
        Ok(())
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        Ok(())
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        Ok(self.progress)
    }
}

fn run_on(journal: Slow) -> Journalled<Slow> {
    let text = "name = \"probe\"\nblade.cad = \"builtin:lpt\"\nmerge.overlap_min_fraction = 0.3\n\
                presentation = { position_mm = [10, -5, 600], rotation_deg = [0, 90, 0] }\n[views]\n";
    let recipe = Recipe::parse("probe.toml", text).unwrap();
    let station = Station::builtin_simulated();
    let plan = Plan::new(&recipe, &station, Seed(1)).unwrap();
    let header = Header {
        version: "0".into(),
        target: "t".into(),
        seed: Seed(1),
        run_id: 1,
        recipe: recipe.name.clone(),
        station: station.name.clone(),
        simulated: true,
        part: None,
        started_utc: "2026-01-01T00:00:00Z".into(),
        view_count: None,
        ..Header::default()
    };
    let mut run = Journalled::new(Controller::new(header, &recipe, &station, plan), journal, 0);
    run.handle_input(at(0), Input::Begin);
    taken(&mut run);
    run
}

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

fn robot(text: &str, kind: Kind) -> Output {
    let bytes = text.as_bytes().to_vec();
    Output::Robot(RobotOutput::Bytes { bytes, kind })
}

fn camera(text: &str, act: bool) -> Output {
    let bytes = text.as_bytes().to_vec();
    Output::Camera(CameraOutput::Bytes { bytes, act })
}

/// Puts an output out as the controller's are.
fn say(run: &mut Journalled<Slow>, now: Stamp, output: Output) {
    for record in output_records(now, &output, 0) {
        run.record(record);
    }
    run.put_out(now, output);
    run.go_on(now);
}

/// Everything that leaves: bytes as text, events in words.
fn taken(run: &mut Journalled<Slow>) -> Vec<String> {
    std::iter::from_fn(|| run.poll_output())
        .filter_map(|output| match output {
            Output::Robot(RobotOutput::Bytes { bytes, .. }) | Output::Camera(CameraOutput::Bytes { bytes, .. }) => {
                Some(String::from_utf8_lossy(&bytes).into_owned())
            }
            Output::Event(event) => Some(event.words()),
            _ => None,
        })
        .collect()
}

fn flush(run: &mut Journalled<Slow>, now: Stamp) {
    run.journal.progress.flushed_count = run.journal.count();
    run.handle_progress(now);
}

fn inputs(run: &Journalled<Slow>) -> Vec<String> {
    let inputs = run.journal.records.iter().filter(|record| record.topic.is_input());
    inputs
        .map(|record| String::from_utf8_lossy(&record.payload).into_owned())
        .collect()
}

const WITHHELD: &str = "what waited for the recording was not sent to the robot";

#[test]
fn an_act_leaves_when_its_own_record_has_left_and_not_before() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), robot("move", Kind::Act));
    assert_eq!(taken(&mut run), [""; 0]);
    run.journal.progress.flushed_count = run.journal.count() - 1;
    run.handle_progress(at(2));
    assert_eq!(taken(&mut run), [""; 0]);
    flush(&mut run, at(3));
    assert_eq!(taken(&mut run), ["move"]);
    assert!(!run.is_waiting());
}

#[test]
fn an_order_waits_like_an_act_and_a_question_waits_for_nothing() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), robot("order", Kind::Order));
    say(&mut run, at(1), robot("status", Kind::Ask));
    say(&mut run, at(1), camera("ping", false));
    assert_eq!(taken(&mut run), ["status", "ping"]);
    flush(&mut run, at(2));
    assert_eq!(taken(&mut run), ["order"]);
}

#[test]
fn a_hold_leaves_at_once_and_the_act_that_waited_never_does() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), robot("move", Kind::Act));
    say(&mut run, at(2), robot("hold", Kind::Set));
    assert_eq!(taken(&mut run), ["hold", WITHHELD]);
    assert_eq!(inputs(&run).last().unwrap(), r#"{"input":"withheld","device":"robot"}"#);
    flush(&mut run, at(3));
    assert_eq!(taken(&mut run), [""; 0]);
}

#[test]
fn a_newer_act_of_the_robot_takes_the_place_of_one_that_waits() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), robot("move", Kind::Act));
    say(&mut run, at(400), robot("move again", Kind::Act));
    assert_eq!(taken(&mut run), [WITHHELD]);
    flush(&mut run, at(500));
    assert_eq!(taken(&mut run), ["move again"]);
}

#[test]
fn a_disk_that_is_too_slow_is_noticed_though_the_act_is_said_again_and_again() {
    let mut run = run_on(Slow::default());
    for ms in [1, 400, 800] {
        say(&mut run, at(ms), robot("servo on", Kind::Act));
    }
    run.handle_wake(at(1000));
    assert!(!run.has_failed());
    run.handle_wake(at(1001));
    assert!(run.has_failed());
}

#[test]
fn a_closed_connection_takes_what_waits_for_it_along() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), robot("start", Kind::Act));
    say(&mut run, at(1), camera("trigger", true));
    say(&mut run, at(2), Output::Robot(RobotOutput::Close));
    say(&mut run, at(2), Output::Camera(CameraOutput::Close));
    taken(&mut run);
    flush(&mut run, at(3));
    assert_eq!(taken(&mut run), [""; 0]);
    assert_eq!(inputs(&run).len(), 3, "begin, and two that tell of it");
}

#[test]
fn what_follows_a_trigger_to_the_camera_never_overtakes_it() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), camera("trigger", true));
    say(&mut run, at(2), camera("ping", false));
    say(&mut run, at(2), robot("hold", Kind::Set));
    assert_eq!(taken(&mut run), ["hold"]);
    flush(&mut run, at(3));
    assert_eq!(taken(&mut run), ["trigger", "ping"]);
}

#[test]
fn an_act_that_waits_too_long_ends_the_recording_and_never_leaves() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), robot("move", Kind::Act));
    assert!(run.wake_at().is_some_and(|due| due <= at(1001)));
    run.handle_wake(at(1000));
    assert!(!run.has_failed());
    run.handle_wake(at(1001));
    assert!(run.has_failed());
    let said = taken(&mut run);
    assert!(said.iter().any(|words| words.contains("FAULT journal")), "{said:?}");
    let count = run.journal.count();
    flush(&mut run, at(1002));
    run.handle_input(at(1003), Input::Operator(Command::Hold));
    taken(&mut run);
    say(&mut run, at(1004), robot("servo on", Kind::Act));
    say(&mut run, at(1004), robot("hold", Kind::Set));
    assert_eq!(taken(&mut run), ["hold"]);
    assert_eq!(run.journal.count(), count, "something was recorded after the failure");
}

#[test]
fn a_failed_record_ends_the_recording_without_a_gap_and_is_told_once() {
    for fails_at in 0..4 {
        let mut run = run_on(Slow {
            fails_at: Some(fails_at),
            ..Slow::default()
        });
        say(&mut run, at(1), robot("move", Kind::Act));
        run.journal.fails_at = None;
        say(&mut run, at(2), robot("move", Kind::Act));
        flush(&mut run, at(3));
        assert!(run.has_failed(), "record {fails_at}");
        assert_eq!(run.journal.records.len(), fails_at);
        assert!(!taken(&mut run).contains(&"move".to_owned()), "record {fails_at}");
        assert!(run.controller.ending().is_some(), "record {fails_at}: nobody told");
    }
}

#[test]
fn a_trigger_that_failed_with_the_recording_cuts_its_connection_short() {
    let mut run = run_on(Slow::default());
    say(&mut run, at(1), camera("trigger", true));
    run.handle_wake(at(1001));
    taken(&mut run);
    say(&mut run, at(1002), camera("ping", false));
    assert_eq!(taken(&mut run), [""; 0], "the camera would miss a number");
    say(&mut run, at(1003), Output::Camera(CameraOutput::Connect));
    say(&mut run, at(1004), camera("hello", false));
    assert_eq!(taken(&mut run), ["hello"]);
}

#[test]
fn an_input_stands_before_what_follows_from_it_and_this_before_the_next() {
    let mut run = run_on(Slow::default());
    run.handle_input(at(5), Input::Operator(Command::Abort));
    let topics: Vec<Topic> = run.journal.records.iter().map(|record| record.topic).collect();
    let begins: Vec<usize> = (0..topics.len()).filter(|index| topics[*index].is_input()).collect();
    assert_eq!(begins.len(), 2);
    assert_eq!(begins[0], 0);
    assert!(
        run.journal.records[begins[1]..]
            .iter()
            .all(|record| record.stamp == at(5))
    );
    assert!(
        run.journal.records[..begins[1]]
            .iter()
            .all(|record| record.stamp == at(0))
    );
}

#[test]
fn a_frame_is_kept_when_everything_before_it_is_on_the_disk() {
    let mut run = run_on(Slow::default());
    let frame = Output::Sync {
        view_index: 2,
        attempt: 1,
    };
    say(&mut run, at(1), frame);
    flush(&mut run, at(2));
    assert!(run.is_waiting(), "flushed is not on the disk");
    run.journal.progress.synced_count = run.journal.count();
    run.handle_progress(at(3));
    assert_eq!(
        inputs(&run).last().unwrap(),
        r#"{"input":"synced","view_index":2,"attempt":1}"#
    );
    assert!(!run.is_waiting());
}

#[test]
fn a_frame_that_waits_too_long_for_the_disk_ends_the_recording() {
    let mut run = run_on(Slow::default());
    let frame = Output::Sync {
        view_index: 0,
        attempt: 0,
    };
    say(&mut run, at(1), frame);
    flush(&mut run, at(10_000));
    assert!(!run.has_failed());
    run.handle_wake(at(10_001));
    assert!(run.has_failed());
}
