use super::*;

#[test]
fn the_requests_of_the_page_are_answered_as_the_page_says() {
    let mut bench = Bench::new(&[]);
    let [Message::HelloOk(greeting)] = &bench.send_bytes(&vector(CAMERA_PAGE, "hello"))[..] else {
        panic!()
    };
    assert_eq!(
        (greeting.simulated, greeting.boot_id, greeting.model.0.as_str()),
        (1, 9, "SIMULATED A5000")
    );
    let answers = bench.send_bytes(&vector(CAMERA_PAGE, "get_caps"));
    let Ok(Message::Caps(page)) = Message::read(4, &vector(CAMERA_PAGE, "caps")[32..]) else {
        panic!()
    };
    let [Message::Caps(caps)] = &answers[..] else { panic!() };
    assert_eq!(
        (caps.sensor_px, caps.exposure_max_us),
        (page.sensor_px, page.exposure_max_us)
    );
    assert_eq!(caps.components, 0b11101, "all but RANGE");
    let [Message::Configured(configured)] = &bench.send_bytes(&vector(CAMERA_PAGE, "configure"))[..] else {
        panic!()
    };
    assert_eq!(configured.to_payload()[4..], vector(CAMERA_PAGE, "configured")[36..]);
}

#[test]
fn before_hello_everything_else_is_refused_and_the_connection_stays() {
    let mut bench = Bench::new(&[]);
    for message in [
        Message::GetCaps,
        arm(1),
        trigger(0, 0),
        Message::Ping(1),
        Message::GetStatus,
        Message::Abort(0),
    ] {
        assert_eq!(code(&bench.ask(&message)), 205);
    }
    let unknown = bench.client().frame(0x66, 7, 0, Vec::new());
    assert_eq!(code(&bench.send_bytes(&unknown)[0]), 205);
    assert!(matches!(bench.ask(&hello()), Message::HelloOk(_)));
    assert_eq!(code(&bench.ask(&hello())), 203);
}

#[test]
fn versions_roles_runs_and_names_that_are_not_served_are_refused() {
    let greet = |change: fn(&mut Hello)| {
        let Message::Hello(mut greeting) = hello() else {
            unreachable!()
        };
        change(&mut greeting);
        let mut bench = Bench::new(&[]);
        let answers = bench.send(&Message::Hello(greeting));
        if let Some(Message::Bye(bye)) = answers.get(1) {
            assert_eq!(bye.reason, 3);
        }
        (code(&answers[0]), bench.closed.len())
    };
    assert_eq!(greet(|hello| hello.min_version = [1, 1]), (105, 1));
    assert_eq!(greet(|hello| hello.max_version = [0, 9]), (105, 1));
    assert_eq!(greet(|hello| hello.role = 3), (301, 0));
    assert_eq!(greet(|hello| hello.run_id = 0), (301, 0));
    assert_eq!(greet(|hello| hello.client_name = Str8::default()), (301, 0));
    assert_eq!(greet(|hello| hello.client_name = Str8("x".repeat(65))), (301, 0));
}

#[test]
fn an_acquisition_runs_through_its_phases_at_the_predicted_times() {
    let mut bench = Bench::armed(&[]);
    let begin_ns = bench.now_ns;
    let Message::TriggerOk(accepted) = bench.ask(&trigger(5 << 16, 0)) else {
        panic!()
    };
    assert_eq!(
        (
            accepted.repeated,
            accepted.predicted_exposure_us,
            accepted.predicted_total_us
        ),
        (0, 108_000, 208_000)
    );
    bench.render();
    assert!(bench.exposed.is_empty());
    let messages = bench.pass_with_signs_of_life(begin_ns + 207 * MS_NS);
    let [(done_ns, Message::ExposureDone(done))] = &messages[..] else {
        panic!("{messages:?}")
    };
    assert_eq!((*done_ns, done.exposure_end_ns), (108 * MS_NS, 108 * MS_NS));
    assert_eq!(bench.exposed, bench.jobs);
    let messages = bench.pass(begin_ns + 210 * MS_NS);
    let Message::FrameBegin(begin) = &messages[0] else {
        panic!()
    };
    assert_eq!(
        (begin.head.view_id, begin.head.width_px, begin.head.height_px),
        (5, 80, 40)
    );
    assert_eq!(
        (begin.head.frame_flags, begin.head.camera_1_px),
        (1 | 1 << 11, [680, 520])
    );
    assert_eq!(begin.head.reconstruction_end_ns, 208 * MS_NS);
    assert_eq!(
        begin
            .components
            .iter()
            .map(|entry| (entry.kind, entry.byte_count))
            .collect::<Vec<_>>(),
        [(0, 38_400), (2, 3_200), (4, 3_200)]
    );
    assert_eq!(names(&messages), [0x30, 0x31, 0x31, 0x31, 0x32]);
    let [came, stated] = sums(&messages);
    assert_eq!(came, stated);
    let Message::Status(status) = bench.ask(&Message::GetStatus) else {
        panic!()
    };
    assert_eq!((status.state, status.trigger_count, status.frame_count), (2, 1, 1));
    assert_eq!(bench.ask(&Message::Disarm), Message::Disarmed(state_now(1)));
}

#[test]
fn a_frame_waits_for_its_rendering() {
    let mut bench = Bench::armed(&[]);
    bench.send(&trigger(0, 0));
    assert_eq!(names(&bench.pass(900 * MS_NS)), [0x22]);
    bench.render();
    assert_eq!(names(&bench.receive()), [0x30, 0x31]);
    assert_eq!(names(&bench.pass(910 * MS_NS)), [0x31, 0x31, 0x32]);
}

#[test]
fn a_repeated_trigger_is_never_exposed_again() {
    let mut bench = Bench::armed(&[]);
    let repeated = |bench: &mut Bench| match bench.ask(&trigger(7, 0)) {
        Message::TriggerOk(TriggerOk { repeated, .. }) => repeated,
        other => panic!("{other:?}"),
    };
    assert_eq!(repeated(&mut bench), 0);
    assert_eq!(repeated(&mut bench), 1);
    bench.render();
    bench.pass(300 * MS_NS);
    assert_eq!(repeated(&mut bench), 2);
    assert_eq!(bench.pass(900 * MS_NS), []);
    assert_eq!(bench.jobs.len(), 1);
}

#[test]
fn requests_in_the_wrong_state_have_their_codes() {
    let mut bench = Bench::new(&[]);
    bench.ask(&hello());
    assert_eq!(code(&bench.ask(&arm(1))), 206);
    bench.ask(&configure(&small_settings()));
    assert_eq!(code(&bench.ask(&arm(2))), 206);
    assert_eq!(
        code(&bench.ask(&Message::Arm(Arm {
            mode: 2,
            reserved: Zero,
            config_id: 1
        }))),
        301
    );
    let refused = bench.ask(&trigger(5 << 16 | 1, 0));
    assert_eq!(error(&refused), (202, 5 << 16 | 1, 1, 1));
    let Message::Error(refused) = refused else { panic!() };
    let expected = vector(CAMERA_PAGE, "error")[36..].to_vec();
    assert_eq!(refused.to_payload()[4..], expected, "but for the request id");
    bench.ask(&arm(1));
    assert_eq!(code(&bench.ask(&arm(1))), 203);
    assert_eq!(code(&bench.ask(&configure(&small_settings()))), 203);
    let Message::Trigger(mut old) = trigger(3, 0) else {
        panic!()
    };
    old.config_id = 9;
    assert_eq!(error(&bench.ask(&Message::Trigger(old))), (206, 3, 1, 1));
    assert_eq!(code(&bench.ask(&trigger(NO_TRIGGER, 0))), 301);
    bench.ask(&trigger(3, 0));
    assert_eq!(error(&bench.ask(&trigger(4, 0))), (204, 4, 1, 1));
    assert_eq!(code(&bench.ask(&Message::Disarm)), 203);
    let Message::Trigger(mut wordy) = trigger(5, 0) else {
        panic!()
    };
    wordy.tag = Str8("x".repeat(65));
    let mut other = Bench::armed(&[]);
    assert_eq!(error(&other.ask(&Message::Trigger(wordy))), (301, 5, 1, 0));
    let unknown = bench.client().frame(0x66, 99, 0, vec![1]);
    assert_eq!(code(&bench.send_bytes(&unknown)[0]), 106);
    assert!(bench.closed.is_empty());
}

#[test]
fn settings_that_are_damaged_or_out_of_range_leave_the_connection_open() {
    let mut bench = Bench::new(&[]);
    bench.ask(&hello());
    assert_eq!(code(&bench.ask(&Message::Configure(Rest(vec![1, 2, 3])))), 108);
    let mut settings = small_settings();
    settings.exposure_us = 5;
    assert_eq!(code(&bench.ask(&configure(&settings))), 301);
    let ids: Vec<u32> = (0..2)
        .map(|_| match bench.ask(&configure(&small_settings())) {
            Message::Configured(configured) => configured.config_id,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(ids, [1, 2]);
}

#[test]
fn hdr_passes_make_the_exposure_longer() {
    let mut bench = Bench::new(&[]);
    bench.ask(&hello());
    let mut settings = small_settings();
    (settings.hdr_us, settings.exposure_us) = ([500, 4000], 3000);
    let Message::Configured(configured) = bench.ask(&configure(&settings)) else {
        panic!()
    };
    assert_eq!(configured.predicted_exposure_us, 3 * 24 * 6000);
    assert_eq!(configured.frame_bytes, 80 * 40 * 14);
}

#[test]
fn an_abort_catches_every_phase() {
    for (after_ms, phase, frame_end_count) in [(50, 2, 0), (150, 3, 0), (300, 4, 1)] {
        let mut bench = Bench::armed(&[]);
        bench.send(&trigger(9, 0));
        bench.pass(after_ms * MS_NS);
        if phase == 4 {
            bench.render();
            bench.receive();
        }
        let answers = bench.send(&Message::Abort(NO_TRIGGER));
        assert_eq!(
            answers[0],
            Message::Aborted(Aborted {
                trigger_id: 9,
                phase,
                reserved: Zero
            })
        );
        assert_eq!(answers.len(), 1 + frame_end_count);
        if let Some(Message::FrameEnd(end)) = answers.get(1) {
            assert_eq!((end.tail.status, end.components[0].byte_count), (1, 38_400));
            assert_eq!((end.components[1].byte_count, end.components[1].crc32c), (0, 0));
        }
        bench.render();
        assert_eq!(
            bench.pass(bench.now_ns + 900 * MS_NS),
            [],
            "nothing comes after phase {phase}"
        );
        assert_eq!(names(&bench.take(10)), WHOLE_FRAME);
    }
}

#[test]
fn an_abort_of_nothing_says_so() {
    let mut bench = Bench::armed(&[]);
    let none = |trigger_id| {
        Message::Aborted(Aborted {
            trigger_id,
            phase: 0,
            reserved: Zero,
        })
    };
    assert_eq!(bench.ask(&Message::Abort(NO_TRIGGER)), none(NO_TRIGGER));
    bench.send(&trigger(9, 0));
    assert_eq!(bench.ask(&Message::Abort(8)), none(8));
    assert_eq!(names(&bench.pass(200 * MS_NS)), [0x22]);
}

#[test]
fn a_deadline_ends_the_acquisition_with_an_error_that_names_it() {
    let mut bench = Bench::armed(&[]);
    bench.send(&trigger(9, 250));
    let messages = bench.pass(900 * MS_NS);
    assert_eq!(names(&messages), [0x22, 0x70]);
    assert_eq!(error(&messages[1]), (407, 9, 3, 1));
    assert_eq!(names(&bench.take(10)), WHOLE_FRAME);
}

#[test]
fn broken_bytes_end_the_connection_with_an_error_and_good_bye() {
    let break_frame = |change: fn(&mut Vec<u8>)| {
        let mut bench = Bench::armed(&[]);
        let mut bytes = bench.client().request(&Message::Ping(1));
        change(&mut bytes);
        let messages = bench.send_bytes(&bytes);
        assert_eq!(names(&messages), [0x70, 0x7F]);
        assert!(matches!(messages[1], Message::Bye(Bye { reason: 3, .. })));
        assert_eq!(bench.closed, [CLIENT]);
        let bytes = bench.client().request(&Message::Ping(1));
        assert_eq!(bench.send_bytes(&bytes), []);
        code(&messages[0])
    };
    fn seal(bytes: &mut [u8]) {
        let payload_crc = crc32c::crc32c(&bytes[32..]);
        bytes[24..28].copy_from_slice(&payload_crc.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..28]);
        bytes[28..32].copy_from_slice(&crc.to_le_bytes());
    }
    assert_eq!(break_frame(|bytes| bytes[0] = 0), 101);
    assert_eq!(break_frame(|bytes| bytes[12] ^= 1), 102);
    assert_eq!(break_frame(|bytes| bytes[33] ^= 1), 103);
    let oversize: fn(&mut Vec<u8>) = |bytes| {
        bytes[8..12].copy_from_slice(&65_537_u32.to_le_bytes());
        seal(bytes);
    };
    assert_eq!(break_frame(oversize), 104);
    let repeated: fn(&mut Vec<u8>) = |bytes| {
        bytes[16] -= 1;
        seal(bytes);
    };
    assert_eq!(break_frame(repeated), 107);
    let cut: fn(&mut Vec<u8>) = |bytes| {
        bytes.pop();
        bytes[8] -= 1;
        seal(bytes);
    };
    assert_eq!(break_frame(cut), 108);
    let as_reply: fn(&mut Vec<u8>) = |bytes| {
        bytes[20] = 1;
        seal(bytes);
    };
    assert_eq!(break_frame(as_reply), 108);
}

#[test]
fn signs_of_life_come_every_second_and_a_silent_client_is_dropped() {
    let mut bench = Bench::armed(&[]);
    let messages = bench.pass_with_signs_of_life(5000 * MS_NS);
    let times = |wanted: u16| -> Vec<u64> {
        messages
            .iter()
            .filter(|(_, message)| message.kind() == wanted)
            .map(|(at_ns, _)| at_ns / MS_NS)
            .collect()
    };
    assert_eq!(times(0x51), [1000, 2000, 3000, 4000, 5000]);
    assert_eq!(times(0x60), [500, 1500, 2500, 3500, 4500]);
    assert!(matches!(
        messages.last(),
        Some((_, Message::Bye(Bye { reason: 4, .. })))
    ));
    assert_eq!(bench.closed, [CLIENT]);
    assert_eq!(bench.device.wake_at(), None);
}

#[test]
fn a_pong_comes_between_the_chunks_of_a_frame() {
    let mut bench = Bench::armed(&[]);
    bench.send(&trigger(0, 0));
    bench.pass(300 * MS_NS);
    bench.render();
    assert_eq!(names(&bench.receive()), [0x30, 0x31]);
    assert_eq!(
        bench.ask(&Message::Ping(77)),
        Message::Pong(Pong {
            sender_ns: 77,
            device_ns: 300 * MS_NS,
            host_ns: 300 * MS_NS
        })
    );
    assert_eq!(names(&bench.pass(400 * MS_NS)), [0x31, 0x31, 0x32]);
}

#[test]
fn a_good_bye_ends_the_connection_and_is_not_answered() {
    let mut bench = Bench::armed(&[]);
    let reason = Bye {
        reason: 1,
        text: Str8::default(),
    };
    let good_bye = bench.client().frame(0x7F, 0, 0, reason.to_payload());
    assert_eq!(bench.send_bytes(&good_bye), []);
    assert_eq!(bench.closed, [CLIENT]);
}

#[test]
fn the_score_of_every_pixel_comes_when_it_is_asked_for() {
    let mut bench = Bench::new(&[]);
    bench.greet();
    let mut settings = small_settings();
    settings.components = 0b11101;
    let Message::Configured(configured) = bench.ask(&configure(&settings)) else {
        panic!()
    };
    assert_eq!(configured.frame_bytes, 80 * 40 * 15);
    bench.ask(&arm(1));
    bench.send(&trigger(0, 0));
    let scored = Frame {
        confidence: vec![217; 80 * 40],
        ..frame()
    };
    bench.device.handle_frame(0, 1, scored);
    let messages = bench.pass(300 * MS_NS);
    let Message::FrameBegin(begin) = &messages[1] else {
        panic!()
    };
    let entry = &begin.components[2];
    assert_eq!((entry.kind, entry.format, entry.byte_count), (3, 0x0108_00C6, 3200));
    let Message::FrameChunk(chunk) = &messages[4] else {
        panic!()
    };
    assert_eq!(chunk.data.0, [217; 3200]);
}

#[test]
fn a_volume_of_interest_drops_what_is_outside() {
    let mut bench = Bench::new(&[]);
    bench.ask(&hello());
    let mut settings = small_settings();
    settings.volume_of_interest.on = 1;
    settings.volume_of_interest.max_mm = [99.5, 10.0, 1000.0];
    bench.ask(&configure(&settings));
    bench.ask(&arm(1));
    let messages = bench.take(0);
    let Message::FrameBegin(begin) = &messages[2] else {
        panic!()
    };
    assert_eq!(begin.head.valid_count, 100);
    let Message::FrameChunk(mask) = &messages[5] else {
        panic!()
    };
    assert_eq!(mask.data.0[98..102], [0, 0, 17, 17]);
}
