use super::*;

#[test]
fn camera_gone_closes_in_mid_frame_once_and_only_at_its_view() {
    let mut bench = Bench::armed(&["camera-gone@2"]);
    assert_eq!(names(&bench.take(1 << 16)), WHOLE_FRAME);
    assert_eq!(names(&bench.take(2 << 16)), [0x21, 0x22, 0x30, 0x31]);
    assert_eq!(bench.closed, [CLIENT]);
    bench.reconnect();
    assert!(matches!(bench.ask(&hello()), Message::HelloOk(_)));
    bench.ask(&configure(&small_settings()));
    bench.ask(&arm(2));
    let Message::Trigger(mut again) = trigger(2 << 16, 0) else {
        panic!()
    };
    again.config_id = 2;
    bench.send(&Message::Trigger(again));
    bench.render();
    assert_eq!(names(&bench.pass(bench.now_ns + 900 * MS_NS)), WHOLE_FRAME[1..]);
}

#[test]
fn camera_error_comes_instead_of_the_frame_and_the_retake_succeeds() {
    let mut bench = Bench::armed(&["camera-error=403@2"]);
    let messages = bench.take(2 << 16);
    assert_eq!(names(&messages), [0x21, 0x22, 0x70]);
    assert_eq!(error(&messages[2]), (403, 2 << 16, 3, 1));
    assert_eq!(names(&bench.take(2 << 16 | 1)), WHOLE_FRAME);
}

#[test]
fn corrupt_chunk_makes_the_crc_of_a_component_disagree() {
    let mut bench = Bench::armed(&["corrupt-chunk@0"]);
    let [came, stated] = sums(&bench.take(0));
    assert_ne!(came[0], stated[0]);
    assert_eq!(came[0].0, stated[0].0);
    assert_eq!(came[1..], stated[1..]);
    let [came, stated] = sums(&bench.take(1));
    assert_eq!(came, stated);
}

#[test]
fn empty_frame_has_no_valid_point() {
    let mut bench = Bench::armed(&["empty-frame@0"]);
    let messages = bench.take(0);
    let Message::FrameBegin(begin) = &messages[2] else {
        panic!()
    };
    assert_eq!(begin.head.valid_count, 0);
    let Message::FrameChunk(xyz) = &messages[3] else {
        panic!()
    };
    assert!(
        xyz.data
            .0
            .chunks_exact(4)
            .all(|value| f32::from_le_bytes(value.try_into().unwrap()).is_nan())
    );
}

#[test]
fn camera_silent_sends_nothing_more_and_does_not_close() {
    let mut bench = Bench::armed(&["camera-silent@0"]);
    assert_eq!(names(&bench.take(0)), [0x21, 0x22, 0x30, 0x31]);
    assert_eq!(bench.send(&Message::GetStatus), []);
    assert!(bench.closed.is_empty());
}

#[test]
fn late_frame_is_late_in_real_time() {
    let mut bench = Bench::armed(&["late-frame=1.5@0"]);
    bench.send(&trigger(0, 0));
    bench.render();
    assert_eq!(names(&bench.pass(1707 * MS_NS)), [0x22]);
    assert_eq!(names(&bench.pass(1708 * MS_NS)), [0x30, 0x31]);
}

#[test]
fn config_echo_differs_from_what_was_asked_for() {
    let mut bench = Bench::new(&["config-echo"]);
    bench.ask(&hello());
    let Message::Configured(configured) = bench.ask(&configure(&small_settings())) else {
        panic!()
    };
    assert_ne!(configured.settings.0, small_settings().to_records());
}

#[test]
fn a_faster_simulation_predicts_its_own_time() {
    let mut bench = Bench::new(&[]);
    bench.device.settings.speed = 20.0;
    bench.ask(&hello());
    let Message::Configured(configured) = bench.ask(&configure(&small_settings())) else {
        panic!()
    };
    assert_eq!(
        (configured.predicted_exposure_us, configured.predicted_total_us),
        (5400, 10_400)
    );
}
