//! The vendor's side: late, wrong, gone.

use super::*;

#[test]
fn a_late_vendor_ends_in_a_coded_error_before_the_client_gives_up() {
    let mut bench = Bench::armed();
    bench.ask(at(0), 0, &trigger(1));
    // Predicted 158 ms: due at 1.5 × that + 0.8 s; the client waits 1 s.
    bench.bridge.handle_wake(at(1036));
    bench.run(at(1036));
    assert!(bench.heard(0).is_empty());
    bench.bridge.handle_wake(at(1037));
    bench.run(at(1037));
    let error = error_of(&bench.heard(0));
    assert_eq!((error.code, error.retryable, error.trigger_id), (402, true, 1));
    assert_eq!(error.phase, AcquisitionPhase::Exposure);
    assert_eq!(bench.bridge.state(), CameraState::Armed);
    bench.ask(at(2000), 0, &trigger(2));
    bench.expose(at(2100));
    bench.heard(0);
    bench.bridge.handle_wake(at(2000 + 1158 * 3 / 2 + 1500));
    bench.run(at(9000));
    assert_eq!(error_of(&bench.heard(0)).code, 403);
}

#[test]
fn an_announced_pause_moves_the_limit_and_is_told() {
    let mut bench = Bench::armed();
    bench.ask(at(0), 0, &trigger(1));
    bench.say_vendor(at(10), r#"{"is":"pause","duration_ms":3000,"text":"LED"}"#);
    let heard = bench.heard(0);
    assert!(
        matches!(&heard[..], [Heard::Message(ServerMessage::Event(event), 0)] if event.code == 5 && event.duration_ms == 3000)
    );
    bench.bridge.handle_wake(at(4000));
    bench.run(at(4000));
    assert!(bench.heard(0).is_empty());
    bench.bridge.handle_wake(at(4037));
    bench.run(at(4037));
    assert_eq!(error_of(&bench.heard(0)).code, 402);
}

#[test]
fn a_deadline_ends_what_is_no_longer_wanted() {
    let mut bench = Bench::armed();
    let ClientMessage::Trigger(mut wanted) = trigger(1) else {
        panic!()
    };
    wanted.deadline_ms = 300;
    bench.bridge.handle_wake(at(0));
    bench.ask(at(0), 0, &ClientMessage::Trigger(wanted));
    assert_eq!(bench.bridge.wake_at(), Some(at(300)));
    bench.bridge.handle_wake(at(300));
    bench.run(at(300));
    assert_eq!(error_of(&bench.heard(0)).code, 407);
    assert_eq!(bench.orders.last().unwrap(), r#"{"do":"abort","acquisition":1}"#);
}

#[test]
fn errors_of_the_vendor_keep_its_number_and_files_that_do_not_fit_are_named() {
    let mut bench = Bench::armed();
    bench.ask(at(0), 0, &trigger(1));
    bench.say_vendor(
        at(10),
        r#"{"is":"error","acquisition":1,"code":401,"vendor_code":-7,"text":"missed"}"#,
    );
    let heard = bench.heard(0);
    assert!(
        matches!(&heard[0], Heard::Message(ServerMessage::Event(event), 0) if event.code == DeviceEvent::MISSED_TRIGGER)
    );
    let error = error_of(&heard[1..]);
    assert_eq!((error.code, error.vendor_code, error.retryable), (401, -7, true));
    assert_eq!(bench.bridge.status().missed_count, 1);
    bench.ask(at(20), 0, &trigger(2));
    bench.say_vendor(at(30), r#"{"is":"frame","acquisition":2,"esm":"b.esm"}"#);
    let conversion = bench.conversions.pop().unwrap();
    let found = conversion.run(|_| Ok(vec![0; 100]));
    bench.bridge.handle_picture(at(30), 2, found);
    bench.run(at(30));
    let heard = bench.heard(0);
    let error = error_of(&heard[1..]);
    assert_eq!(error.text, "b.esm: 100 bytes where 168 are needed for the header");
}

#[test]
fn a_lost_device_takes_flight_and_settings_with_it_and_comes_back_idle() {
    let mut bench = Bench::armed();
    bench.ask(at(0), 0, &trigger(1));
    bench.say_vendor(at(10), r#"{"is":"lost","duration_ms":30000,"text":"device_reset"}"#);
    let heard = bench.heard(0);
    assert!(
        matches!(&heard[0], Heard::Message(ServerMessage::Event(event), 0) if (event.code, event.duration_ms) == (3, 30_000))
    );
    let error = error_of(&heard[1..]);
    assert_eq!((error.code, error.retryable, error.retry_after_ms), (504, true, 30_000));
    assert_eq!(bench.bridge.state(), CameraState::Resetting);
    bench.say_vendor(at(20), r#"{"is":"ready","vendor":"V","model":"M","serial":"S"}"#);
    let heard = bench.heard(0);
    assert!(
        matches!(&heard[..], [Heard::Message(ServerMessage::Event(event), 0)] if event.code == DeviceEvent::DEVICE_BACK)
    );
    assert_eq!(bench.bridge.state(), CameraState::Idle);
    let arm = Arm {
        mode: Arm::SOFTWARE,
        config_id: 1,
    };
    assert_eq!(bench.refused(at(30), 0, &ClientMessage::Arm(arm)), 206);
}

#[test]
fn the_vendors_side_is_started_anew_after_its_end() {
    let mut bench = Bench::armed();
    bench.bridge.handle_vendor_ended(at(100), "exit code 1");
    bench.run(at(100));
    assert_eq!(bench.bridge.state(), CameraState::Offline);
    bench.bridge.handle_wake(at(2099));
    bench.run(at(2099));
    assert_eq!(bench.starts, 1);
    bench.bridge.handle_wake(at(2100));
    bench.run(at(2100));
    assert_eq!(bench.starts, 2);
}

#[test]
fn a_vendors_side_that_takes_anothers_place_begins_without_settings() {
    let mut bench = Bench::armed();
    bench.ask(at(10), 0, &trigger(1));
    bench.bridge.handle_vendor_started(at(20));
    bench.run(at(20));
    let heard = bench.heard(0);
    assert_eq!(error_of(&heard[1..]).code, 501);
    assert_eq!(bench.bridge.state(), CameraState::Offline);
    bench.say_vendor(at(30), r#"{"is":"ready","vendor":"V","model":"M","serial":"S"}"#);
    assert_eq!(bench.bridge.state(), CameraState::Idle);
}
