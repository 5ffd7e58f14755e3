//! Devices that go away, start anew, are too hot or in use.

use super::*;

fn waiting(bench: &Bench) -> Option<u64> {
    bench.events.iter().find_map(|event| match event {
        CameraEvent::Waiting { within_ms, .. } => Some(*within_ms),
        _ => None,
    })
}

#[test]
fn a_reset_is_waited_for_and_then_everything_is_set_anew() {
    let mut bench = Bench::exposing();
    bench.say(&device_event(DeviceEvent::DEVICE_LOST, 35_000));
    bench.say(&error(TRIGGER, code::RESET_IN_PROGRESS, 35_000));
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, CameraEvent::Failed { retryable: true, .. }))
    );
    assert_eq!(waiting(&bench), Some(45_000));
    for _ in 0..68 {
        bench.pass_ms(500);
        bench.say(&status(CameraState::Resetting));
        bench.serve();
    }
    assert!(bench.take_said().is_empty(), "a device that is gone is not asked");
    bench.say(&device_event(DeviceEvent::DEVICE_BACK, 0));
    bench.serve();
    assert_eq!(bench.take_said(), ["configure", "arm"]);
    assert_eq!(bench.events.last(), Some(&CameraEvent::Rearmed));
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_device_that_does_not_come_back_is_given_up_in_time() {
    let mut bench = Bench::armed();
    bench.say(&device_event(DeviceEvent::DEVICE_LOST, 0));
    let since = bench.ms;
    while bench.lost().is_none() {
        bench.pass_ms(500);
        if bench.lost().is_none() {
            bench.say(&status(CameraState::Offline));
            bench.serve();
        }
    }
    assert_eq!(bench.ms - since, 45_000);
    assert!(matches!(bench.lost(), Some(Trouble::NotReady(text)) if text.contains("said by the device")));
}

#[test]
fn a_device_that_comes_and_goes_does_not_move_its_bound_for_ever() {
    let mut bench = Bench::armed();
    while bench.lost().is_none() {
        assert!(bench.ms < 600_000, "still waiting");
        bench.say(&device_event(DeviceEvent::DEVICE_LOST, 0));
        bench.pass_ms(500);
        if bench.lost().is_none() {
            bench.say(&device_event(DeviceEvent::DEVICE_BACK, 0));
            bench.pass_ms(500);
        }
        bench.heard.clear();
    }
}

#[test]
fn status_tells_of_a_reset_whose_event_was_lost() {
    let mut bench = Bench::armed();
    bench.say(&status(CameraState::Resetting));
    assert!(!bench.exchange.is_armed());
    assert_eq!(waiting(&bench), Some(45_000));
    bench.say(&status(CameraState::Idle));
    bench.serve();
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_device_in_fault_needs_a_person() {
    let mut bench = Bench::armed();
    bench.say(&status(CameraState::Fault));
    assert!(matches!(bench.lost(), Some(Trouble::NotReady(text)) if text.contains("FAULT")));
}

#[test]
fn a_device_in_use_is_asked_again_when_it_says_and_given_up_when_it_takes_too_long() {
    let mut bench = Bench::exposing();
    bench.say(&error(TRIGGER, code::IN_USE_BY_OTHER_PROCESS, 2000));
    assert_eq!(waiting(&bench), Some(60_000));
    bench.pass_ms(1999);
    bench.say(&status(CameraState::Armed));
    assert!(bench.take_said().is_empty());
    bench.pass_ms(1);
    // DISARM is answered, CONFIGURE is refused each time.
    let mut refused = 0;
    while bench.lost().is_none() {
        while let Some((request_id, message)) = bench.heard.pop() {
            match message {
                ClientMessage::Configure(_) => {
                    refused += 1;
                    bench.reply(
                        request_id,
                        &error(TriggerId(TRIGGER_ALL), code::IN_USE_BY_OTHER_PROCESS, 5000),
                    );
                }
                ClientMessage::Disarm => {
                    let state = CameraState::Idle;
                    bench.reply(request_id, &ServerMessage::Disarmed { state });
                }
                _ => {}
            }
        }
        bench.pass_ms(500);
        if bench.lost().is_none() {
            bench.say(&status(CameraState::Idle));
        }
    }
    assert!((12..=14).contains(&refused), "{refused}");
    assert!(matches!(bench.lost(), Some(Trouble::NotReady(text)) if text.contains("503")));
    assert!((60_000..61_000).contains(&bench.ms), "{}", bench.ms);
}

#[test]
fn too_hot_is_waited_for_and_then_armed_again() {
    let mut bench = Bench::exposing();
    bench.say(&device_event(DeviceEvent::OVER_TEMPERATURE, 0));
    bench.say(&error(TRIGGER, code::OVER_TEMPERATURE, 3000));
    assert!(!bench.exchange.is_armed());
    bench.pass_alive_ms(3000);
    bench.serve();
    assert!(bench.exchange.is_armed());
    assert!(bench.events.contains(&CameraEvent::Rearmed));
}

#[test]
fn a_trigger_refused_for_its_state_sets_everything_anew() {
    let mut bench = Bench::armed();
    bench.exchange.trigger(bench.now(), TRIGGER);
    bench.pump();
    let (request_id, _) = bench.heard.pop().unwrap();
    bench.said.clear();
    bench.reply(request_id, &error(TRIGGER, code::NOT_ARMED, 0));
    bench.serve();
    assert_eq!(bench.take_said(), ["abort", "disarm", "configure", "arm"]);
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_trigger_that_the_device_cannot_take_is_no_failed_view_and_is_waited_for_once() {
    let mut bench = Bench::armed();
    let mut refused = 0;
    while bench.lost().is_none() {
        if bench.exchange.is_armed() {
            bench.exchange.trigger(bench.now(), TRIGGER);
            bench.pump();
            let (request_id, _) = bench.heard.pop().unwrap();
            bench.reply(request_id, &error(TRIGGER, code::IN_USE_BY_OTHER_PROCESS, 0));
            refused += 1;
            let told = CameraEvent::TriggerRefused {
                trigger_id: TRIGGER,
                reason: "camera error 503: in_use_by_other_process".into(),
            };
            assert!(bench.events.contains(&told));
        }
        bench.pass_ms(500);
        if bench.lost().is_none() {
            bench.say(&status(CameraState::Armed));
            bench.serve();
        }
    }
    assert!(
        bench
            .events
            .iter()
            .all(|event| !matches!(event, CameraEvent::Failed { .. }))
    );
    assert!(matches!(bench.lost(), Some(Trouble::NotReady(text)) if text.contains("503")));
    assert!((50..=61).contains(&refused), "{refused}");
    assert!((60_000..61_000).contains(&bench.ms), "{}", bench.ms);
}
