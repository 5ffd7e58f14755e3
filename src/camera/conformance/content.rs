//! What is in a frame (sections 4.9 to 4.12 and 5).

use super::bench::{Bench, require};
use super::course::Course;
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::LineId;
use crate::camera::message::{ComponentKind, Configured, FrameBegin};
use crate::camera::settings::CameraSettings;

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Exposures,
        "2-server-frames",
        "the server's own frames keep section 2: both CRCs agree, counts go up by one, flags fit, no payload is too long",
        "one acquisition, every frame checked",
        // Every clause checks every frame; this one is there so that it is said.
        |bench| {
            let settings = bench.context.small;
            acquire(bench, &settings).map(|_| ())
        },
    ),
    clause(
        Needs::Exposures,
        "4.10-head",
        "FRAME_BEGIN names trigger, view, config, calibration, region and the times of EXPOSURE_DONE; it tells who is simulated",
        "one acquisition of a part of the sensor",
        |bench| {
            let settings = bench.context.small;
            let (course, configured) = acquire(bench, &settings)?;
            let begin = begin(&course)?;
            head_fits(bench, begin, &settings, &configured)?;
            let done = &course
                .exposure_done
                .first()
                .ok_or_else(|| Miss::failed("no EXPOSURE_DONE".into()))?
                .1;
            let times = [
                begin.exposure_begin_ns,
                begin.exposure_end_ns,
                begin.reconstruction_end_ns,
            ];
            require([done.exposure_begin_ns, done.exposure_end_ns] == times[..2], || {
                format!(
                    "exposed from {} to {} ns, the frame says {times:?}",
                    done.exposure_begin_ns, done.exposure_end_ns
                )
            })?;
            require(times.is_sorted(), || format!("times are out of order: {times:?}"))
        },
    ),
    clause(
        Needs::Exposures,
        "4.10-binned",
        "a binned frame has half the sensor's width and height, and says so",
        "one binned acquisition",
        |bench| {
            let settings = bench.context.large;
            let (course, configured) = acquire(bench, &settings)?;
            head_fits(bench, begin(&course)?, &settings, &configured)
        },
    ),
    clause(
        Needs::Exposures,
        "4.10-components",
        "the components are those that were asked for, ascending, with their formats and sizes, as large as CONFIGURED said",
        "one acquisition with every component offered (but one of XYZ and RANGE), one with points and MASK alone",
        |bench| {
            let every = bench.context.small;
            let others = ComponentKind::Intensity.bit() | ComponentKind::Confidence.bit();
            let fewest = CameraSettings {
                components: every.components & !others,
                ..every
            };
            for settings in [every, fewest] {
                let (course, configured) = acquire(bench, &settings)?;
                let begin = begin(&course)?;
                let kinds = begin
                    .components
                    .iter()
                    .fold(0, |kinds, component| kinds | component.kind.bit());
                let asked = settings.components;
                require(kinds == asked, || {
                    format!("components {kinds:#b} came, {asked:#b} were asked for")
                })?;
                let bytes: u64 = begin.components.iter().map(|component| component.byte_count).sum();
                require(bytes == configured.frame_bytes, || {
                    format!("{bytes} bytes, CONFIGURED said {}", configured.frame_bytes)
                })?;
                bench.leave();
            }
            Ok(())
        },
    ),
    clause(
        Needs::Exposures,
        "4.10-mask",
        "MASK bit 0 marks exactly the pixels whose XYZ is NaN in all three; bits 5 to 7 are 0; valid_count is the rest",
        "one acquisition, every pixel looked at",
        |bench| {
            let settings = bench.context.small;
            let (course, _) = acquire(bench, &settings)?;
            mask_fits(&course)
        },
    ),
    clause(
        Needs::Exposures,
        "4.10-hdr",
        "frame_flags count the exposure passes",
        "one acquisition with a darker and a brighter pass",
        |bench| {
            let caps = &bench.context.caps;
            if caps.hdr_slot_count < 2 {
                return Err(Miss::Skipped("CAPS offers no two HDR passes".into()));
            }
            let usual = caps.exposure_default_us;
            let low = (usual / 2).max(caps.exposure_min_us);
            let high = (usual * 2).min(caps.exposure_max_us);
            let settings = CameraSettings {
                hdr_us: [low, high],
                ..bench.context.small
            };
            let (course, configured) = acquire(bench, &settings)?;
            head_fits(bench, begin(&course)?, &settings, &configured)
        },
    ),
    clause(
        Needs::Exposures,
        "4.11-chunks",
        "chunks come in order: components ascending, indices from 0, offsets without a gap, as many as FRAME_BEGIN says",
        "one large frame",
        |bench| {
            let settings = bench.context.large;
            // The order is checked chunk by chunk while they come.
            let (course, _) = acquire(bench, &settings)?;
            let said: Vec<u32> = begin(&course)?
                .components
                .iter()
                .map(|component| component.chunk_count)
                .collect();
            require(course.chunk_counts == said, || {
                format!("{:?} chunks came where FRAME_BEGIN says {said:?}", course.chunk_counts)
            })
        },
    ),
    clause(
        Needs::Exposures,
        "4.12-end",
        "FRAME_END has the byte counts and CRC-32C of all that was sent, and the valid_count of FRAME_BEGIN",
        "one acquisition, every byte counted and summed",
        |bench| {
            let settings = bench.context.small;
            let (course, _) = acquire(bench, &settings)?;
            end_fits(&course)
        },
    ),
];

fn acquire(bench: &mut Bench<'_, '_>, settings: &CameraSettings) -> Result<(Course, Configured), Miss> {
    let (line, configured): (LineId, Configured) = bench.armed(settings)?;
    Ok((bench.acquire(line, 0, &configured)?, configured))
}

fn begin(course: &Course) -> Result<&FrameBegin, Miss> {
    course
        .begin
        .as_ref()
        .ok_or_else(|| Miss::failed("no FRAME_BEGIN".into()))
}

/// Everything in FRAME_BEGIN that follows from the settings and the greeting.
fn head_fits(
    bench: &Bench<'_, '_>,
    begin: &FrameBegin,
    settings: &CameraSettings,
    configured: &Configured,
) -> Result<(), Miss> {
    let same = |what: &str, found: u64, expected: u64| {
        require(found == expected, || {
            format!("{what} is {found} where {expected} belongs")
        })
    };
    same("view_id", u64::from(begin.view_id), u64::from(bench.view))?;
    same("config_id", u64::from(begin.config_id), u64::from(configured.config_id))?;
    same(
        "calibration_id",
        begin.calibration_id,
        bench.context.greeting.calibration_id,
    )?;
    let [width, height, x_1, y_1, x_2, y_2] = settings.roi_px;
    let [width, height] = match settings.binning {
        true => bench.context.caps.sensor_px.map(|pixels| pixels / 2),
        false => [width, height],
    };
    same("width_px", u64::from(begin.width_px), u64::from(width))?;
    same("height_px", u64::from(begin.height_px), u64::from(height))?;
    if !settings.binning {
        let (found, expected) = ([begin.camera_1_px, begin.camera_2_px], [[x_1, y_1], [x_2, y_2]]);
        require(found == expected, || {
            format!("regions at {found:?} where {expected:?} belong")
        })?;
    }
    let passes = 1 + settings.hdr_us.iter().filter(|exposure_us| **exposure_us > 0).count();
    same("the number of passes", u64::from(begin.flags.pass_count), passes as u64)?;
    same(
        "flag bit 8, binned",
        u64::from(begin.flags.binned),
        u64::from(settings.binning),
    )?;
    let simulated = bench.context.greeting.simulated;
    same(
        "flag bit 11, simulated",
        u64::from(begin.flags.simulated),
        u64::from(simulated),
    )?;
    if settings.components & ComponentKind::Range.bit() == 0 {
        require(begin.scale == [1.0; 3] && begin.offset == [0.0; 3], || {
            format!("scale {:?} and offset {:?} of XYZ", begin.scale, begin.offset)
        })?;
    }
    let pixels = begin.width_px.saturating_mul(begin.height_px);
    require(begin.valid_count <= pixels && begin.saturated_count <= pixels, || {
        format!(
            "{} valid and {} saturated of {pixels} pixels",
            begin.valid_count, begin.saturated_count
        )
    })
}

fn component(course: &Course, kind: ComponentKind) -> Option<&[u8]> {
    let place = course
        .begin
        .as_ref()?
        .components
        .iter()
        .position(|component| component.kind == kind)?;
    course.components.get(place).map(Vec::as_slice)
}

fn mask_fits(course: &Course) -> Result<(), Miss> {
    let mask = component(course, ComponentKind::Mask).ok_or_else(|| Miss::failed("no MASK".into()))?;
    for (pixel, bits) in mask.iter().enumerate() {
        require(bits & 0b1110_0000 == 0, || {
            format!("MASK of pixel {pixel} is {bits:#010b}")
        })?;
    }
    if let Some(xyz) = component(course, ComponentKind::Xyz) {
        for (pixel, (bits, point)) in mask.iter().zip(xyz.chunks_exact(12)).enumerate() {
            let value = |at: usize| f32::from_le_bytes([point[at], point[at + 1], point[at + 2], point[at + 3]]);
            let point = [value(0), value(4), value(8)];
            let agrees = match bits & 1 {
                0 => point.iter().all(|value| value.is_finite()),
                _ => point.iter().all(|value| value.is_nan()),
            };
            require(agrees, || format!("pixel {pixel}: MASK {bits:#010b}, XYZ {point:?}"))?;
        }
    }
    let valid = mask.iter().filter(|bits| *bits & 1 == 0).count() as u32;
    let said = begin(course)?.valid_count;
    require(valid == said, || {
        format!("{valid} pixels are valid by MASK, valid_count says {said}")
    })
}

fn end_fits(course: &Course) -> Result<(), Miss> {
    let (_, end) = course.ends.first().ok_or_else(|| Miss::failed("no FRAME_END".into()))?;
    let begin = begin(course)?;
    require(end.frame_id == begin.frame_id, || {
        format!("frame {} ends frame {}", end.frame_id, begin.frame_id)
    })?;
    require(end.valid_count == begin.valid_count, || {
        format!(
            "valid_count is {} at the end and {} at the beginning",
            end.valid_count, begin.valid_count
        )
    })?;
    require(end.components.len() == course.components.len(), || {
        format!(
            "{} components end, {} began",
            end.components.len(),
            course.components.len()
        )
    })?;
    for (place, (bytes, sent)) in course.components.iter().zip(&end.components).enumerate() {
        let count = bytes.len() as u64;
        require(sent.byte_count == count, || {
            format!(
                "component {place}: {count} bytes came, FRAME_END says {}",
                sent.byte_count
            )
        })?;
        require(begin.components[place].byte_count == count, || {
            format!(
                "component {place}: {count} bytes came, FRAME_BEGIN says {}",
                begin.components[place].byte_count
            )
        })?;
        let crc = crc32c::crc32c(bytes);
        require(sent.crc == crc, || {
            format!(
                "component {place}: the CRC-32C is {crc:#010x}, FRAME_END says {:#010x}",
                sent.crc
            )
        })?;
    }
    Ok(())
}
