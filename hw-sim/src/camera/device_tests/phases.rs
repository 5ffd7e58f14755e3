//! Times, warmth and flags of an acquisition.

use super::*;

/// Predicted exposure and reconstruction, µs.
fn predicted(change: fn(&mut crate::camera::settings::Settings)) -> [u32; 2] {
    let mut bench = Bench::new(&[]);
    bench.greet();
    let mut settings = small_settings();
    change(&mut settings);
    let Message::Configured(configured) = bench.ask(&configure(&settings)) else {
        panic!()
    };
    let exposure_us = configured.predicted_exposure_us;
    [exposure_us, configured.predicted_total_us - exposure_us]
}

#[test]
fn the_exposure_takes_its_passes_images_and_frame_times() {
    assert_eq!(predicted(|_| ())[0], 24 * 4500, "the projector is the slower one");
    assert_eq!(predicted(|s| s.exposure_us = 10_000)[0], 24 * 20_000);
    assert_eq!(
        predicted(|s| (s.exposure_us, s.frame_time_ratio) = (10_000, 4.0))[0],
        24 * 40_000
    );
    assert_eq!(predicted(|s| s.image_count = 60)[0], 60 * 4500);
    assert_eq!(predicted(|s| s.hdr_us = [500, 4000])[0], 3 * 24 * 4500);
}

#[test]
fn the_reconstruction_takes_as_long_as_its_quality_asks() {
    let quality = |change: fn(&mut crate::camera::settings::Settings)| predicted(change)[1];
    assert_eq!(quality(|s| s.reconstruction_quality = 0), 40_000);
    assert_eq!(quality(|s| s.reconstruction_quality = 5), 100_000);
    assert_eq!(quality(|s| s.reconstruction_quality = 9), 148_000);
}

#[test]
fn bright_light_makes_pauses_that_are_announced() {
    let mut bench = Bench::new(&[]);
    bench.greet();
    let mut settings = small_settings();
    settings.led_percent = 50;
    bench.ask(&configure(&settings));
    bench.ask(&arm(1));
    bench.send(&trigger(3, 0));
    bench.render();
    let messages = bench.pass_with_signs_of_life(450 * MS_NS);
    let [
        (paused_ns, Message::Event(pause)),
        (done_ns, Message::ExposureDone(done)),
        (frame_ns, _),
        ..,
    ] = &messages[..]
    else {
        panic!("{messages:?}")
    };
    assert_eq!((pause.code, pause.duration_ms, pause.trigger_id), (5, 108, 3));
    assert_eq!(
        [*paused_ns, *done_ns, done.exposure_end_ns, *frame_ns],
        [54, 216, 216, 316].map(|ms| ms * MS_NS)
    );
}

#[test]
fn a_cold_camera_says_so_until_enough_triggers_have_warmed_it() {
    let mut bench = Bench::armed(&["cold-start=2"]);
    let mut flags_and_warmth = |id| {
        let messages = bench.take(id);
        let Message::FrameBegin(begin) = &messages[2] else {
            panic!()
        };
        let flags = begin.head.frame_flags;
        let status = bench.status();
        assert_eq!(status.temperature_c[..3], begin.head.temperature_c[..3]);
        (flags >> 10 & 1, status.warm_up_done_s, status.temperature_c[0] as u32)
    };
    assert_eq!(flags_and_warmth(0), (1, 1200, 41));
    assert_eq!(flags_and_warmth(1), (0, 2400, 44));
    assert_eq!(flags_and_warmth(2), (0, 2400, 44));
    let mut warm = Bench::armed(&[]);
    let messages = warm.take(0);
    let Message::FrameBegin(begin) = &messages[2] else {
        panic!()
    };
    assert_eq!(
        (begin.head.frame_flags, begin.head.temperature_c[0]),
        (1 | 1 << 11, 45.0)
    );
    assert_eq!(
        (warm.status().warm_up_done_s, warm.status().warm_up_required_s),
        (2400, 2400)
    );
}

#[test]
fn abort_stops_a_frame_between_two_chunks_and_the_next_trigger_is_taken() {
    let mut bench = Bench::armed(&[]);
    bench.send(&trigger(0, 0));
    bench.render();
    assert_eq!(names(&bench.pass(208 * MS_NS)), [0x22, 0x30, 0x31]);
    assert_eq!(names(&bench.send(&Message::Ping(1))), [0x61]);
    assert_eq!(names(&bench.send(&Message::Abort(0))), [0x41, 0x32]);
    assert_eq!(bench.state(), 2);
    assert_eq!(names(&bench.take(1)), WHOLE_FRAME);
}

#[test]
fn a_frame_of_many_chunks_comes_at_the_rate_of_the_link() {
    let mut bench = Bench::new(&[]);
    bench.greet();
    let mut settings = small_settings();
    (settings.roi.width_px, settings.roi.height_px) = (320, 240);
    bench.ask(&configure(&settings));
    bench.ask(&arm(1));
    bench.send(&trigger(0, 0));
    let count = 320 * 240;
    let large = Frame {
        width_px: 320,
        height_px: 240,
        xyz_mm: (0..count).map(|index| [index as f32, 1.0, 280.0]).collect(),
        mask: vec![0; count],
        intensity: vec![100; count],
        valid_count: count as u32,
        ..frame()
    };
    bench.device.handle_frame(0, 1, large);
    let messages: Vec<(u64, Message)> = bench.pass_with_signs_of_life(300 * MS_NS);
    let chunk_times: Vec<u64> = messages
        .iter()
        .filter(|(_, message)| message.kind() == 0x31)
        .map(|(at_ns, _)| at_ns / 1000)
        .collect();
    assert_eq!(chunk_times, [208_000, 210_097, 212_194, 214_291, 215_372, 215_987]);
    let messages: Vec<Message> = messages.into_iter().map(|(_, message)| message).collect();
    let [came, stated] = sums(&messages);
    assert_eq!(came, stated);
}
