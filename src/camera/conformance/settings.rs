//! CONFIGURE, its echo, and ARM (sections 4.4 to 4.6).

use super::bench::{Bench, REPLY_MS, arm, hello, is_error, require};
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::LineId;
use crate::camera::message::{Arm, CameraState, ClientMessage, ComponentKind};
use crate::camera::settings::{CameraSettings, VolumeOfInterest};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Device,
        "4.5-echo",
        "CONFIGURED echoes every setting as asked, its config id is not 0, frame_bytes fits, total follows exposure",
        "CONFIGURE with a part of the sensor, and with binning",
        |bench| {
            let line = bench.controller()?;
            for settings in [bench.context.small, bench.context.large] {
                let configured = bench.configure(line, &settings)?;
                if let Some(difference) = crate::camera::settings::difference(&settings, &configured.settings) {
                    return Err(Miss::failed(format!("the echo differs: {difference}")));
                }
                require(configured.config_id != 0, || "config_id is 0".into())?;
                let bytes = frame_bytes(bench, &settings);
                require(configured.frame_bytes == bytes, || {
                    format!("frame_bytes is {}, the components have {bytes}", configured.frame_bytes)
                })?;
                let (exposure, total) = (configured.predicted_exposure_us, configured.predicted_total_us);
                require(exposure <= total, || format!("{exposure} us of exposure in {total} us"))?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Device,
        "4.5-ascending",
        "the settings in force come in ascending order of tags",
        "CONFIGURE with the tags in descending order",
        |bench| {
            let line = bench.controller()?;
            let mut records = records(&bench.context.small);
            records.reverse();
            let heard = configure_raw(bench, line, &records.concat())?;
            require(heard.kind == 0x11, || format!("CONFIGURED was expected: {heard}"))?;
            let tags = tags(&heard.payload[20..]);
            require(tags.len() == 15 && tags.is_sorted(), || {
                format!("the echo has the tags {tags:x?}")
            })
        },
    ),
    clause(
        Needs::Device,
        "4.5-new-id",
        "the config id is new for each accepted CONFIGURE",
        "the same settings three times",
        |bench| {
            let line = bench.controller()?;
            let settings = bench.context.small;
            let mut ids = Vec::new();
            for _ in 0..3 {
                ids.push(bench.configure(line, &settings)?.config_id);
            }
            require(ids[0] != ids[1] && ids[1] != ids[2] && ids[0] != ids[2], || {
                format!("ids {ids:?}")
            })
        },
    ),
    clause(
        Needs::Device,
        "4.4-critical-tag",
        "an unknown critical tag: ERROR 304",
        "the settings and tag 0x80F0",
        |bench| list(bench, Some(304), |records| records.push(vec![0xF0, 0x80, 1, 0, 7])),
    ),
    clause(
        Needs::Device,
        "4.4-optional-tag",
        "an unknown tag without bit 15 is ignored",
        "the settings and tag 0x00F0",
        |bench| list(bench, None, |records| records.push(vec![0xF0, 0x00, 1, 0, 7])),
    ),
    clause(
        Needs::Device,
        "4.4-missing",
        "a missing tag: ERROR 305",
        "the settings, once without each tag",
        |bench| {
            for place in 0..TAG_COUNT {
                list(bench, Some(305), |records| {
                    records.remove(place);
                })
                .map_err(|miss| at(miss, place))?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Device,
        "4.4-repeated",
        "a repeated tag: ERROR 306",
        "the settings, once with each tag twice",
        |bench| {
            for place in 0..TAG_COUNT {
                list(bench, Some(306), |records| records.push(records[place].clone()))
                    .map_err(|miss| at(miss, place))?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Device,
        "4.4-damaged",
        "a damaged list or a value of a wrong length: ERROR 108, and the connection stays open",
        "a list cut inside a record, a value one byte short, a value one byte long; then a good list",
        |bench| {
            let line = bench.controller()?;
            let whole = records(&bench.context.small);
            let mut cut = whole.concat();
            cut.pop();
            let resized = |change: fn(&mut Vec<u8>)| {
                let mut records = whole.clone();
                change(&mut records[2]);
                records[2][2] = (records[2].len() - 4) as u8;
                records.concat()
            };
            for payload in [
                cut,
                resized(|record| record.truncate(7)),
                resized(|record| record.push(0)),
            ] {
                is_error(&configure_raw(bench, line, &payload)?, 108)?;
            }
            let settings = bench.context.small;
            bench.configure(line, &settings).map(|_| ())
        },
    ),
    clause(
        Needs::Device,
        "4.4-range",
        "a value out of its range: ERROR 301",
        "each setting below and above what CAPS and the page allow",
        out_of_range,
    ),
    clause(
        Needs::Device,
        "4.4-roi",
        "the region of interest lies inside the sensor (301) and on its steps (302); it is not checked while binned",
        "regions too small, beyond the sensor, off the steps; then one off the steps, binned",
        regions,
    ),
    clause(
        Needs::Device,
        "4.4-components",
        "MASK and one of XYZ and RANGE are among the components (301); a kind that is not offered: ERROR 307",
        "CONFIGURE without MASK, without points, and with a kind that CAPS does not offer",
        components,
    ),
    clause(
        Needs::Device,
        "4.4-refused-keeps",
        "a refused CONFIGURE leaves the settings in force",
        "good settings, then bad ones, then ARM for the good ones",
        |bench| {
            let line = bench.controller()?;
            let good = bench.context.small;
            let configured = bench.configure(line, &good)?;
            let bad = CameraSettings { exposure_us: 0, ..good };
            bench.refused(line, &ClientMessage::Configure(bad), 301)?;
            bench.arm(line, configured.config_id)
        },
    ),
    clause(
        Needs::Device,
        "4.6-mode",
        "ARM in a mode other than software: ERROR 301",
        "ARM in modes 0, 2 and 3",
        |bench| {
            let line = bench.controller()?;
            let settings = bench.context.small;
            let config_id = bench.configure(line, &settings)?.config_id;
            for mode in [0, 2, 3] {
                bench.refused(line, &ClientMessage::Arm(Arm { mode, config_id }), 301)?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Device,
        "4.6-config-id",
        "ARM names the settings in force, else ERROR 206",
        "ARM with the id of the settings before, and with those in force",
        |bench| {
            let line = bench.controller()?;
            let settings = bench.context.small;
            let before = bench.configure(line, &settings)?.config_id;
            let now = bench.configure(line, &settings)?.config_id;
            bench.refused(line, &arm(before), 206)?;
            bench.arm(line, now)
        },
    ),
    clause(
        Needs::Device,
        "4.7-config-id",
        "TRIGGER names the settings in force, else ERROR 206, and nothing is exposed",
        "TRIGGER in ARMED with another config id",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            let wrong = bench.trigger(0, configured.config_id.wrapping_add(7));
            bench.refused(line, &wrong, 206)?;
            bench.is_in(line, CameraState::Armed)
        },
    ),
    clause(
        Needs::Device,
        "3.3-settings-stay",
        "settings stay in force when a controller's connection has ended",
        "CONFIGURE and ARM, the connection closed; a new one of the same run: IDLE, ARM with the same config id",
        |bench| {
            let run_id = bench.new_run();
            let (line, _) = bench.greet(&hello(run_id))?;
            let settings = bench.context.small;
            let config_id = bench.configure(line, &settings)?.config_id;
            bench.arm(line, config_id)?;
            bench.lines.close(line);
            let (line, _) = bench.greet(&hello(run_id))?;
            bench.is_in(line, CameraState::Idle)?;
            bench.arm(line, config_id)
        },
    ),
];

/// Pixels times bytes of the components asked for.
fn frame_bytes(bench: &Bench<'_, '_>, settings: &CameraSettings) -> u64 {
    let [width, height] = match settings.binning {
        true => bench.context.caps.sensor_px.map(|pixels| pixels / 2),
        false => [settings.roi_px[0], settings.roi_px[1]],
    };
    let kinds = ComponentKind::ALL.into_iter();
    let wanted = kinds.filter(|kind| settings.components & kind.bit() != 0);
    let pixel_bytes: u64 = wanted.map(ComponentKind::pixel_bytes).sum();
    u64::from(width) * u64::from(height) * pixel_bytes
}

/// The records of a list, one by one.
fn records(settings: &CameraSettings) -> Vec<Vec<u8>> {
    let bytes = settings.encode();
    let (mut records, mut rest) = (Vec::new(), bytes.as_slice());
    while rest.len() >= 4 {
        let (record, after) = rest.split_at(4 + usize::from(u16::from_le_bytes([rest[2], rest[3]])));
        records.push(record.to_vec());
        rest = after;
    }
    records
}

fn tags(mut list: &[u8]) -> Vec<u16> {
    let mut tags = Vec::new();
    while let [low, high, length_low, length_high, rest @ ..] = list {
        tags.push(u16::from_le_bytes([*low, *high]));
        let length = usize::from(u16::from_le_bytes([*length_low, *length_high]));
        list = rest.get(length..).unwrap_or_default();
    }
    tags
}

fn configure_raw(bench: &mut Bench<'_, '_>, line: LineId, list: &[u8]) -> Result<crate::camera::lines::Heard, Miss> {
    bench.context.next_raw_id += 1;
    let request_id = bench.context.next_raw_id;
    let frame = bench.lines.raw_frame(line, 0x10, request_id, 0, list);
    bench.lines.send(line, frame);
    Ok(bench.lines.reply(line, request_id, "reply to CONFIGURE", REPLY_MS)?)
}

/// A list that was changed: refused with a code, or taken.
fn list(bench: &mut Bench<'_, '_>, code: Option<u16>, change: impl Fn(&mut Vec<Vec<u8>>)) -> Result<(), Miss> {
    let line = bench.controller()?;
    let mut records = records(&bench.context.small);
    change(&mut records);
    let heard = configure_raw(bench, line, &records.concat())?;
    match code {
        Some(code) => is_error(&heard, code).map(|_| ())?,
        None => require(heard.kind == 0x11, || format!("CONFIGURED was expected: {heard}"))?,
    }
    bench.leave();
    Ok(())
}

fn at(miss: Miss, place: usize) -> Miss {
    match miss {
        Miss::Failed(words) => Miss::Failed(format!("tag {:#06x}: {words}", 0x8001 + place)),
        skipped => skipped,
    }
}

/// Each must be refused with the code.
fn are_refused(bench: &mut Bench<'_, '_>, code: u16, unfit: &[(&str, CameraSettings)]) -> Result<(), Miss> {
    let line = bench.controller()?;
    for (what, settings) in unfit {
        bench
            .refused(line, &ClientMessage::Configure(*settings), code)
            .map_err(|miss| match miss {
                Miss::Failed(words) => Miss::Failed(format!("{what}: {words}")),
                skipped => skipped,
            })?;
    }
    Ok(())
}

fn out_of_range(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let (caps, good) = (bench.context.caps.clone(), bench.context.small);
    let mut unfit: Vec<(&str, CameraSettings)> = Vec::new();
    let mut add = |what, change: &dyn Fn(&mut CameraSettings)| {
        let mut settings = good;
        change(&mut settings);
        unfit.push((what, settings));
    };
    add("exposure_us too short", &|s| {
        s.exposure_us = caps.exposure_min_us.saturating_sub(1)
    });
    add("exposure_us too long", &|s| s.exposure_us = caps.exposure_max_us + 1);
    add("image_count too low", &|s| {
        s.image_count = caps.image_count_min.saturating_sub(1)
    });
    add("image_count too high", &|s| s.image_count = caps.image_count_max + 1);
    if caps.hdr_slot_count > 0 {
        add("hdr low too long", &|s| s.hdr_us[0] = caps.exposure_max_us + 1);
    }
    if caps.exposure_min_us > 1 {
        add("hdr high too short", &|s| s.hdr_us[1] = caps.exposure_min_us - 1);
    }
    add("compression 4", &|s| s.compression = 4);
    add("led_percent 0", &|s| s.led_percent = 0);
    add("led_percent too high", &|s| s.led_percent = caps.led_max_percent + 1);
    add("frame_time_ratio 0.9", &|s| s.frame_time_ratio = 0.9);
    add("frame_time_ratio 4.1", &|s| s.frame_time_ratio = 4.1);
    add("frame_time_ratio NaN", &|s| s.frame_time_ratio = f32::NAN);
    add("score_threshold -0.1", &|s| s.score_threshold = -0.1);
    add("score_threshold 1.1", &|s| s.score_threshold = 1.1);
    add("score_threshold NaN", &|s| s.score_threshold = f32::NAN);
    add("outlier_filter 4", &|s| s.outlier_filter = 4);
    add("reconstruction_quality 10", &|s| s.reconstruction_quality = 10);
    add("pre_filtering 10", &|s| s.pre_filtering = 10);
    add("working_volume 2", &|s| s.working_volume = 2);
    for (what, max_mm) in [
        ("volume_of_interest without depth", [10.0, 10.0, 200.0]),
        ("volume_of_interest with NaN", [10.0, f32::NAN, 300.0]),
    ] {
        let min_mm = [-10.0, -10.0, 200.0];
        add(what, &|s| {
            s.volume_of_interest = Some(VolumeOfInterest { min_mm, max_mm })
        });
    }
    are_refused(bench, 301, &unfit)?;
    bench.leave();
    list(bench, Some(301), |records| records[0][4] = 2)
}

fn regions(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let (caps, good) = (bench.context.caps.clone(), bench.context.small);
    let with = |roi_px| CameraSettings { roi_px, ..good };
    let [width, height, x, y, ..] = good.roi_px;
    let ([step_x, step_y], [least_x, least_y]) = (caps.roi_step_px, caps.roi_min_px);
    let mut unfit = vec![
        (
            "beyond the right edge",
            with([width, height, caps.sensor_px[0], y, x, y]),
        ),
        (
            "beyond the lower edge",
            with([width, height, x, caps.sensor_px[1], x, y]),
        ),
        (
            "camera 2 beyond the right edge",
            with([width, height, x, y, caps.sensor_px[0], y]),
        ),
        ("no width", with([0, height, x, y, x, y])),
    ];
    if least_x > step_x {
        unfit.push(("too narrow", with([least_x - step_x, height, x, y, x, y])));
    }
    if least_y > step_y {
        unfit.push(("too low", with([width, least_y - step_y, x, y, x, y])));
    }
    are_refused(bench, 301, &unfit)?;
    bench.leave();
    let mut off_step = Vec::new();
    if step_x > 1 {
        off_step.push(("width off its step", with([width + 1, height, x, y, x, y])));
        off_step.push(("x off its step", with([width, height, x + 1, y, x, y])));
        off_step.push(("camera 2's x off its step", with([width, height, x, y, x + 1, y])));
    }
    if step_y > 1 {
        off_step.push(("height off its step", with([width, height + 1, x, y, x, y])));
        off_step.push(("y off its step", with([width, height, x, y + 1, x, y])));
    }
    are_refused(bench, 302, &off_step)?;
    bench.leave();
    let line = bench.controller()?;
    let binned = CameraSettings {
        binning: true,
        ..with([width + 1, height + 1, x, y, x, y])
    };
    bench.configure(line, &binned).map(|_| ())
}

fn components(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let (offered, good) = (bench.context.caps.components, bench.context.small);
    let with = |components| CameraSettings { components, ..good };
    let mask = ComponentKind::Mask.bit();
    let unfit = [
        ("no MASK", with(good.components & !mask)),
        ("no points", with(mask)),
        ("nothing", with(0)),
    ];
    are_refused(bench, 301, &unfit)?;
    bench.leave();
    let missing = ComponentKind::ALL.into_iter().filter(|kind| offered & kind.bit() == 0);
    let unfit: Vec<(&str, CameraSettings)> = missing
        .map(|kind| ("a kind not offered", with(good.components | kind.bit())))
        .chain([("kind 9", with(good.components | 1 << 9))])
        .collect();
    are_refused(bench, 307, &unfit)
}

const TAG_COUNT: usize = 15;
