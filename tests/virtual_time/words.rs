//! The operator's words: holds that come after a view, single steps, and words that are not accepted.

use super::*;

impl Pair {
    /// What the arm and the camera did, and the holds, in order.
    fn course(&self) -> Vec<String> {
        self.events
            .iter()
            .filter_map(|(_, event)| match event {
                Event::MoveStarted { view_index, .. } => Some(format!("move {view_index}")),
                Event::FrameArrived { view_index, .. } => Some(format!("frame {view_index}")),
                Event::HoldDeferred { view_index } => Some(format!("after {view_index}")),
                Event::HoldAsked { .. } => Some("hold".into()),
                Event::Held => Some("held".into()),
                Event::Resumed => Some("resumed".into()),
                _ => None,
            })
            .collect()
    }

    fn notes(&self) -> Vec<&str> {
        let texts = self.events.iter().map(|(_, event)| match event {
            Event::Noted { text } => Some(text.as_str()),
            _ => None,
        });
        texts.flatten().collect()
    }
}

#[test]
fn a_hold_after_the_view_in_work_waits_for_its_frame_and_leaves_the_arm_there() {
    for word in [Command::HoldAfterView, Command::Step] {
        for when in ["moving", "at-target", "exposing"] {
            let mut pair = Pair::new(3, &[], 0.0, 1);
            let ending = pair.drive(|event| match (event, when) {
                (Event::MoveStarted { view_index: 1, .. }, "moving")
                | (Event::Arrived { view_index: 1, .. }, "at-target")
                | (Event::Triggered { view_index: 1, .. }, "exposing") => Some(word),
                (Event::Held, _) => Some(Command::Resume),
                _ => None,
            });
            assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3), "{word:?} {when}");
            let course = pair.course();
            let expected = [
                "move 0", "frame 0", "move 1", "after 1", "frame 1", "hold", "held", "resumed", "move 2", "frame 2",
            ];
            let mut sorted = course.clone();
            sorted.sort_unstable();
            let mut wanted = expected.map(String::from).to_vec();
            wanted.sort_unstable();
            assert_eq!(sorted, wanted, "{word:?} {when}: {course:?}");
            // The frame of view 0 may still be on its way when the arm leaves for view 1.
            let from_frame = course.iter().position(|entry| entry == "frame 1").unwrap();
            assert_eq!(course[from_frame..], expected[4..], "{word:?} {when}");
            pair.replay();
        }
    }
}

#[test]
fn each_step_takes_one_view_and_holds_again() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::RobotReady => Some(Command::Hold),
        Event::Held => Some(Command::Step),
        _ => None,
    });
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3));
    let course = pair.course();
    let first = course.iter().position(|entry| entry == "held").unwrap();
    let expected: Vec<String> = ["held", "resumed", "after 0", "move 0", "frame 0", "hold"]
        .into_iter()
        .chain(["held", "resumed", "after 1", "move 1", "frame 1", "hold"])
        // After the last view the run ends instead.
        .chain(["held", "resumed", "after 2", "move 2", "frame 2"])
        .map(String::from)
        .collect();
    // The first move may have begun before the first hold.
    assert_eq!(course[first..], expected);
    pair.replay();
}

#[test]
fn a_run_can_be_stepped_from_its_opening_on() {
    let mut pair = Pair::new(2, &[], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::Started { .. } => Some(Command::Step),
        Event::Held => Some(Command::Resume),
        _ => None,
    });
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 2));
    let course = pair.course();
    assert_eq!(course[..5], ["after 0", "move 0", "frame 0", "hold", "held"]);
    pair.replay();
}

#[test]
fn a_view_that_is_taken_again_at_once_is_still_the_view_in_work() {
    let mut pair = Pair::new(3, &["corrupt-chunk@1"], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::Triggered {
            view_index: 1,
            attempt: 0,
        } => Some(Command::HoldAfterView),
        Event::Held => Some(Command::Resume),
        _ => None,
    });
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3));
    let course = pair.course();
    let deferred = course.iter().position(|entry| entry == "after 1").unwrap();
    // The arm is told its pose anew, where it stands already.
    let expected = [
        "after 1", "move 1", "frame 1", "hold", "held", "resumed", "move 2", "frame 2",
    ];
    assert_eq!(course[deferred..], expected);
    assert_eq!(pair.run.controller().views()[1].attempt, 1);
    pair.replay();
}

#[test]
fn a_hold_at_once_takes_the_place_of_a_deferred_one() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    let mut first = true;
    let ending = pair.drive(|event| match event {
        Event::MoveStarted { view_index: 1, .. } if std::mem::take(&mut first) => Some(Command::HoldAfterView),
        Event::HoldDeferred { .. } => Some(Command::Hold),
        Event::Held => Some(Command::Resume),
        _ => None,
    });
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3));
    let holds = pair.course().iter().filter(|entry| *entry == "hold").count();
    assert_eq!(holds, 1, "{:?}", pair.course());
    pair.replay();
}

#[test]
fn a_word_that_is_not_accepted_is_noted_with_what_would_be_and_changes_nothing() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::MoveStarted { view_index: 1, .. } => Some(Command::Resume),
        Event::HoldAsked { .. } => Some(Command::Hold),
        Event::Held => Some(Command::HoldAfterView),
        Event::Triggered { view_index: 2, .. } => Some(Command::Hold),
        Event::Noted { text } if text.starts_with("hold-after-view") => Some(Command::Resume),
        _ => None,
    });
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3));
    assert_eq!(
        pair.notes(),
        [
            "resume does nothing while the arm is on its way; accepted now: hold, hold-after-view, step, abort, stop",
            "hold does nothing while the hold is not confirmed; accepted now: abort, stop",
            "hold-after-view does nothing while the arm is held; accepted now: step, resume, abort, stop",
        ]
    );
    pair.replay();
}
