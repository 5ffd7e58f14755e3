//! What happens to the camera in the middle of a run, and settings that change from view to view.

use super::*;

impl Pair {
    fn count(&self, wanted: impl Fn(&Event) -> bool) -> usize {
        self.events.iter().filter(|(_, event)| wanted(event)).count()
    }

    fn first_at(&self, wanted: impl Fn(&Event) -> bool) -> u64 {
        self.events.iter().find(|(_, event)| wanted(event)).unwrap().0
    }
}

#[test]
fn a_connection_lost_in_mid_frame_is_opened_again_and_the_frame_fetched_without_a_second_exposure() {
    let mut pair = Pair::new(3, &["camera-gone@1"], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!(pair.merged_count(), 3);
    assert_eq!(pair.count(|event| matches!(event, Event::Triggered { .. })), 3);
    assert_eq!(pair.count(|event| matches!(event, Event::CameraAway { .. })), 1);
    let fetched = |event: &Event| {
        matches!(
            event,
            Event::CameraBack {
                restarted: false,
                fetched_view_index: Some(1),
                ..
            }
        )
    };
    assert_eq!(pair.count(fetched), 1);
    assert_eq!(pair.connection, 2);
    pair.replay();
}

/// Fault, how the run ends, retakes of view 1, the event that tells of it.
type Case = (&'static str, &'static str, u16, fn(&Event) -> bool);

#[test]
fn whatever_the_camera_does_in_mid_run_is_overcome_or_named() {
    let away: fn(&Event) -> bool = |event| matches!(event, Event::CameraAway { .. });
    let restarted: fn(&Event) -> bool = |event| matches!(event, Event::CameraBack { restarted: true, .. });
    let waiting: fn(&Event) -> bool = |event| matches!(event, Event::CameraWaiting { .. });
    let failed: fn(&Event) -> bool = |event| matches!(event, Event::FrameFailed { retaken: true, .. });
    let faulted: fn(&Event) -> bool = |event| matches!(event, Event::Faulted { .. });
    let cases: [Case; 21] = [
        ("camera-gone@1:request", "none", 1, away),
        ("camera-gone@1:acknowledge", "none", 0, away),
        ("camera-gone@1:exposure", "none", 0, away),
        ("camera-gone@1:reconstruction", "none", 0, away),
        // Exposure and frame are late before the silence is noticed.
        ("camera-silent@1:exposure", "none", 1, away),
        ("camera-silent@1:reconstruction", "none", 1, away),
        ("camera-restart@1:exposure", "none", 1, restarted),
        ("camera-restart@1:transfer", "none", 1, restarted),
        ("camera-kick@1:reconstruction", "none", 0, away),
        ("camera-reset=35@1:exposure", "none", 1, waiting),
        ("camera-lost=5@1:reconstruction", "none", 1, waiting),
        ("camera-lost=100@1:exposure", "camera-not-ready", 0, waiting),
        ("camera-broken@1:exposure", "camera-not-ready", 0, faulted),
        ("over-temperature=5@1", "none", 1, waiting),
        ("vendor-timeout=5@1", "none", 1, failed),
        ("over-temperature=5@1:acknowledge", "none", 0, waiting),
        (
            "cool-down=10@1",
            "none",
            0,
            |event| matches!(event, Event::Noted { text } if text.contains("pauses")),
        ),
        ("corrupt-payload@1:transfer", "none", 0, away),
        ("skip-seq@1:exposure", "none", 0, away),
        ("no-exposure@1", "none", 0, away),
        ("controller-busy=3", "none", 0, away),
    ];
    for (fault, expected, retakes, tells) in cases {
        let mut pair = Pair::new(2, &[fault], 0.0, 1);
        let ending = pair.drive(|_| None);
        assert_eq!(Pair::fault_name(&ending), expected, "{fault}: {ending:?}");
        assert!(pair.count(tells) > 0, "{fault}: {:#?}", pair.events);
        if expected == "none" {
            assert_eq!(pair.merged_count(), 2, "{fault}");
            assert_eq!(
                pair.run.controller().views()[1].attempt,
                retakes,
                "{fault}: {:#?}",
                pair.events
            );
        }
        assert!(pair.now_ns < 180_000_000_000, "{fault} took {} ns", pair.now_ns);
        pair.replay();
    }
}

#[test]
fn the_arm_does_not_move_before_the_exposure_is_known_to_be_over() {
    let mut pair = Pair::new(2, &["camera-gone@0:exposure"], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    let away = pair.first_at(|event| matches!(event, Event::CameraAway { .. }));
    let back = pair.first_at(|event| matches!(event, Event::CameraBack { .. }));
    let exposed = pair.first_at(|event| matches!(event, Event::ExposureDone { view_index: 0, .. }));
    let moving = pair.first_at(|event| matches!(event, Event::MoveStarted { view_index: 1, .. }));
    assert!(away < back && back < exposed && exposed <= moving);
    pair.replay();
}

#[test]
fn a_run_can_be_held_and_aborted_while_the_camera_is_away() {
    let mut pair = Pair::new(3, &["camera-gone@1:transfer"], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::CameraAway { .. } => Some(Command::Hold),
        Event::Held => Some(Command::Abort),
        _ => None,
    });
    assert_eq!(ending, Ending::Aborted);
    assert!(pair.servo_off_count > 0);
    pair.replay();
}

#[test]
fn exposures_of_a_view_are_set_while_the_arm_is_on_its_way_to_it() {
    let text = RECIPE.replace(
        "[merge]",
        "[[camera.exposure]]\nviews = [1]\nexposure_us = 2000\n[merge]",
    );
    let mut pair = Pair::with_recipe(&text, 3, &[], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!(pair.merged_count(), 3);
    // For view 0, for view 1, and back for view 2.
    assert_eq!(pair.configured_at_ns.len(), 3);
    for (view, &configured_ns) in pair.configured_at_ns.iter().enumerate().skip(1) {
        let moving =
            pair.first_at(|event| matches!(event, Event::MoveStarted { view_index, .. } if *view_index == view));
        let arrived = pair.first_at(|event| matches!(event, Event::Arrived { view_index, .. } if *view_index == view));
        assert!((moving..arrived).contains(&configured_ns), "view {view}");
    }
    pair.replay();
}

#[test]
fn a_view_taken_again_is_taken_with_its_own_exposures() {
    let text = RECIPE.replace(
        "[merge]",
        "[[camera.exposure]]\nviews = [1]\nexposure_us = 2000\n[merge]",
    );
    let mut pair = Pair::with_recipe(&text, 3, &["corrupt-chunk@1"], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    let attempts: Vec<u16> = pair.run.controller().views().iter().map(|view| view.attempt).collect();
    assert_eq!((pair.merged_count(), attempts), (3, vec![0, 1, 0]));
    pair.replay();
}

#[test]
fn a_cold_camera_is_noted_once_refused_or_waited_for_as_the_recipe_says() {
    for (policy, expected) in [
        ("note", "none"),
        ("refuse", "camera-not-ready"),
        // The simulated camera warms up by its work alone.
        ("wait", "camera-not-ready"),
    ] {
        let text = RECIPE.replace("[camera]", &format!("[camera]\nwarm_up = \"{policy}\""));
        let mut pair = Pair::with_recipe(&text, 2, &["cold-start=100"], 0.0, 1);
        let ending = pair.drive(|_| None);
        assert_eq!(Pair::fault_name(&ending), expected, "{policy}: {ending:?}");
        let noted = pair.count(|event| matches!(event, Event::Noted { text } if text.contains("warm")));
        let waited = pair.count(|event| matches!(event, Event::CameraWaiting { .. }));
        let moved = pair.count(|event| matches!(event, Event::Triggered { .. }));
        let (notes, waits, triggers) = match policy {
            "note" => (1, 0, 2),
            "refuse" => (0, 0, 0),
            _ => (0, 1, 0),
        };
        assert_eq!((noted, waited, moved), (notes, waits, triggers), "{policy}");
        pair.replay();
    }
}
