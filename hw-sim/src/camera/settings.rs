//! Settings of an acquisition, and the checks that CONFIGURE asks for (`docs/protocols/camera.md`, section 4.4).

use std::collections::BTreeMap;

use thiserror::Error;

use crate::camera::fields::{Field, FieldError, Zero, wire_struct};
use crate::camera::message::Caps;
use crate::checks::refuse_first;

wire_struct! {
    /// Region of interest.
    pub struct Roi {
        /// Columns.
        pub width_px: u16,
        /// Rows.
        pub height_px: u16,
        /// First column and row of camera 1.
        pub camera_1_px: [u16; 2],
        /// First column and row of camera 2.
        pub camera_2_px: [u16; 2],
    }
}

wire_struct! {
    /// Box in the camera frame outside of which points are dropped.
    pub struct VolumeOfInterest {
        /// 1 = in force.
        pub on: u8,
        /// 0.
        pub reserved: Zero<3>,
        /// Lowest x, y, z.
        pub min_mm: [f32; 3],
        /// Highest x, y, z.
        pub max_mm: [f32; 3],
    }
}

/// The complete settings.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "each field is the setting of its name on the protocol page")]
pub struct Settings {
    pub binning: u8,
    pub roi: Roi,
    pub exposure_us: u32,
    pub image_count: u16,
    /// Exposure of the low and of the high pass, µs; 0 = off.
    pub hdr_us: [u32; 2],
    pub compression: u8,
    pub led_percent: u8,
    pub frame_time_ratio: f32,
    pub score_threshold: f32,
    pub outlier_filter: u8,
    pub reconstruction_quality: u8,
    pub pre_filtering: u8,
    pub working_volume: u8,
    pub volume_of_interest: VolumeOfInterest,
    /// Bit mask of component kinds.
    pub components: u32,
}

/// Why a CONFIGURE is refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SettingsError {
    /// The list of records, or a value, has another length than it should.
    #[error("record {tag:#06x} is damaged: {cause}")]
    Damaged {
        /// Tag; 0 where not even a record can be read.
        tag: u16,
        /// What is wrong.
        cause: FieldError,
    },
    /// A tag that must be understood is not.
    #[error("critical tag {0:#06x} is not known")]
    UnknownCritical(u16),
    /// A tag is missing.
    #[error("tag {0:#06x} is missing")]
    Missing(u16),
    /// A tag stands twice.
    #[error("tag {0:#06x} is repeated")]
    Repeated(u16),
    /// A value is out of its range.
    #[error("tag {0:#06x} is out of range")]
    OutOfRange(u16),
    /// A value is not on its step.
    #[error("tag {0:#06x} is not on its step")]
    NotOnStep(u16),
    /// A component that the camera does not have.
    #[error("components {0:#x} are not offered")]
    NotOffered(u32),
}

impl SettingsError {
    /// Code of section 6.
    pub fn code(self) -> u16 {
        match self {
            Self::Damaged { cause, .. } => cause.code(),
            Self::OutOfRange(_) => 301,
            Self::NotOnStep(_) => 302,
            Self::UnknownCritical(_) => 304,
            Self::Missing(_) => 305,
            Self::Repeated(_) => 306,
            Self::NotOffered(_) => 307,
        }
    }
}

impl Settings {
    /// Reads tag-length-value records in any order. Values are not checked against what a camera can do.
    pub fn read(records: &[u8]) -> Result<Self, SettingsError> {
        let records = Records::read(records)?;
        Ok(Self {
            binning: records.value(BINNING)?,
            roi: records.value(ROI)?,
            exposure_us: records.value(EXPOSURE)?,
            image_count: records.value(IMAGE_COUNT)?,
            hdr_us: records.value(HDR)?,
            compression: records.value(COMPRESSION)?,
            led_percent: records.value(LED)?,
            frame_time_ratio: records.value(FRAME_TIME_RATIO)?,
            score_threshold: records.value(SCORE_THRESHOLD)?,
            outlier_filter: records.value(OUTLIER_FILTER)?,
            reconstruction_quality: records.value(RECONSTRUCTION_QUALITY)?,
            pre_filtering: records.value(PRE_FILTERING)?,
            working_volume: records.value(WORKING_VOLUME)?,
            volume_of_interest: records.value(VOLUME_OF_INTEREST)?,
            components: records.value(COMPONENTS)?,
        })
    }

    /// Records in ascending order of tags.
    pub fn to_records(&self) -> Vec<u8> {
        let mut records = Vec::new();
        let mut push = |tag: u16, value: Vec<u8>| {
            tag.write(&mut records);
            (value.len() as u16).write(&mut records);
            records.extend_from_slice(&value);
        };
        push(BINNING, self.binning.to_payload());
        push(ROI, self.roi.to_payload());
        push(EXPOSURE, self.exposure_us.to_payload());
        push(IMAGE_COUNT, self.image_count.to_payload());
        push(HDR, self.hdr_us.to_payload());
        push(COMPRESSION, self.compression.to_payload());
        push(LED, self.led_percent.to_payload());
        push(FRAME_TIME_RATIO, self.frame_time_ratio.to_payload());
        push(SCORE_THRESHOLD, self.score_threshold.to_payload());
        push(OUTLIER_FILTER, self.outlier_filter.to_payload());
        push(RECONSTRUCTION_QUALITY, self.reconstruction_quality.to_payload());
        push(PRE_FILTERING, self.pre_filtering.to_payload());
        push(WORKING_VOLUME, self.working_volume.to_payload());
        push(VOLUME_OF_INTEREST, self.volume_of_interest.to_payload());
        push(COMPONENTS, self.components.to_payload());
        records
    }

    /// Checks every value against what the camera can do. The region is not looked at when binned: it is ignored.
    pub fn check(&self, caps: &Caps) -> Result<(), SettingsError> {
        let exposures = caps.exposure_min_us..=caps.exposure_max_us;
        let in_mask = |value: u8, mask: u32| value < 32 && mask >> value & 1 == 1;
        let volume = &self.volume_of_interest;
        let ranges = [
            (BINNING, self.binning <= 1),
            (EXPOSURE, exposures.contains(&self.exposure_us)),
            (
                IMAGE_COUNT,
                (caps.image_count_min..=caps.image_count_max).contains(&self.image_count),
            ),
            (
                HDR,
                self.hdr_us
                    .iter()
                    .all(|pass_us| *pass_us == 0 || exposures.contains(pass_us)),
            ),
            (COMPRESSION, in_mask(self.compression, caps.compressions)),
            (LED, (1..=caps.led_max_percent).contains(&self.led_percent)),
            (FRAME_TIME_RATIO, (1.0..=4.0).contains(&self.frame_time_ratio)),
            (SCORE_THRESHOLD, (0.0..=1.0).contains(&self.score_threshold)),
            (OUTLIER_FILTER, in_mask(self.outlier_filter, caps.outlier_filters)),
            (RECONSTRUCTION_QUALITY, self.reconstruction_quality <= 9),
            (PRE_FILTERING, self.pre_filtering <= 9),
            (WORKING_VOLUME, in_mask(self.working_volume, caps.working_volumes)),
            (
                VOLUME_OF_INTEREST,
                volume.on == 0 || volume.on == 1 && volume.is_ordered(),
            ),
        ];
        let outside = ranges.map(|(tag, is_inside)| (!is_inside, SettingsError::OutOfRange(tag)));
        refuse_first(outside)?;
        if self.binning == 0 {
            self.roi.check(caps)?;
        }
        let not_offered = self.components & !caps.components;
        if not_offered != 0 {
            return Err(SettingsError::NotOffered(not_offered));
        }
        let has = |kind: u16| self.components >> kind & 1 == 1;
        if has(KIND_MASK) && (has(KIND_XYZ) || has(KIND_RANGE)) {
            Ok(())
        } else {
            Err(SettingsError::OutOfRange(COMPONENTS))
        }
    }

    /// Exposures of one acquisition: 1 to 3.
    pub fn pass_count(&self) -> u32 {
        1 + self.hdr_us.iter().filter(|pass_us| **pass_us != 0).count() as u32
    }

    /// Columns and rows of the frame.
    pub fn size_px(&self, caps: &Caps) -> [u32; 2] {
        match self.binning {
            0 => [u32::from(self.roi.width_px), u32::from(self.roi.height_px)],
            _ => caps.sensor_px.map(|size_px| u32::from(size_px) / 2),
        }
    }

    /// Kinds of the components asked for, ascending.
    pub fn kinds(&self) -> impl Iterator<Item = u16> {
        (0..=KIND_MASK).filter(|kind| self.components >> kind & 1 == 1)
    }
}

impl Roi {
    fn check(&self, caps: &Caps) -> Result<(), SettingsError> {
        let size_px = [self.width_px, self.height_px];
        let is_inside = (0..2).all(|axis| {
            let ends_inside =
                |first_px: u16| u32::from(first_px) + u32::from(size_px[axis]) <= u32::from(caps.sensor_px[axis]);
            size_px[axis] >= caps.roi_min_px[axis]
                && ends_inside(self.camera_1_px[axis])
                && ends_inside(self.camera_2_px[axis])
        });
        if !is_inside {
            return Err(SettingsError::OutOfRange(ROI));
        }
        let is_on_step = (0..2).all(|axis| {
            [size_px[axis], self.camera_1_px[axis], self.camera_2_px[axis]]
                .iter()
                .all(|value_px| value_px.is_multiple_of(caps.roi_step_px[axis]))
        });
        if is_on_step {
            Ok(())
        } else {
            Err(SettingsError::NotOnStep(ROI))
        }
    }
}

impl VolumeOfInterest {
    fn is_ordered(&self) -> bool {
        (0..3).all(|axis| self.min_mm[axis] < self.max_mm[axis])
    }

    /// Whether a point is kept.
    pub fn keeps(&self, point_mm: &[f32; 3]) -> bool {
        self.on == 0 || (0..3).all(|axis| (self.min_mm[axis]..=self.max_mm[axis]).contains(&point_mm[axis]))
    }
}

/// Values by tag.
struct Records<'a>(BTreeMap<u16, &'a [u8]>);

impl<'a> Records<'a> {
    fn read(mut bytes: &'a [u8]) -> Result<Self, SettingsError> {
        let mut values = BTreeMap::new();
        while !bytes.is_empty() {
            let damaged = |cause| SettingsError::Damaged { tag: 0, cause };
            let tag = u16::read(&mut bytes).map_err(damaged)?;
            let length = u16::read(&mut bytes).map_err(damaged)?;
            let (value, rest) = bytes
                .split_at_checked(usize::from(length))
                .ok_or(damaged(FieldError::Malformed))?;
            bytes = rest;
            let is_known = (BINNING..=COMPONENTS).contains(&tag);
            if !is_known && tag & CRITICAL != 0 {
                return Err(SettingsError::UnknownCritical(tag));
            }
            if values.insert(tag, value).is_some() {
                return Err(SettingsError::Repeated(tag));
            }
        }
        Ok(Self(values))
    }

    fn value<T: Field>(&self, tag: u16) -> Result<T, SettingsError> {
        let value = self.0.get(&tag).ok_or(SettingsError::Missing(tag))?;
        T::read_whole(value).map_err(|cause| SettingsError::Damaged { tag, cause })
    }
}

/// Component kind of coordinates.
pub const KIND_XYZ: u16 = 0;
/// Component kind of brightness.
pub const KIND_INTENSITY: u16 = 2;
/// Component kind of scores.
pub const KIND_CONFIDENCE: u16 = 3;
/// Component kind of validity.
pub const KIND_MASK: u16 = 4;

const KIND_RANGE: u16 = 1;
const CRITICAL: u16 = 0x8000;
const BINNING: u16 = 0x8001;
const ROI: u16 = 0x8002;
const EXPOSURE: u16 = 0x8003;
const IMAGE_COUNT: u16 = 0x8004;
const HDR: u16 = 0x8005;
const COMPRESSION: u16 = 0x8006;
const LED: u16 = 0x8007;
const FRAME_TIME_RATIO: u16 = 0x8008;
const SCORE_THRESHOLD: u16 = 0x8009;
const OUTLIER_FILTER: u16 = 0x800A;
const RECONSTRUCTION_QUALITY: u16 = 0x800B;
const PRE_FILTERING: u16 = 0x800C;
const WORKING_VOLUME: u16 = 0x800D;
const VOLUME_OF_INTEREST: u16 = 0x800E;
const COMPONENTS: u16 = 0x800F;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::message::Message;
    use crate::vectors::{CAMERA_PAGE, vector};

    fn caps() -> Caps {
        let Ok(Message::Caps(caps)) = Message::read(4, &vector(CAMERA_PAGE, "caps")[32..]) else {
            panic!()
        };
        caps
    }

    fn settings() -> Settings {
        Settings::read(&vector(CAMERA_PAGE, "configure")[32..]).unwrap()
    }

    #[test]
    fn the_settings_of_the_page_are_read_accepted_and_written_in_ascending_order() {
        let records = vector(CAMERA_PAGE, "configure")[32..].to_vec();
        assert_eq!(settings().to_records(), records);
        assert_eq!(settings().check(&caps()), Ok(()));
        assert_eq!(settings().size_px(&caps()), [720, 540]);
        assert_eq!(settings().kinds().collect::<Vec<_>>(), [0, 2, 4]);
    }

    #[test]
    fn the_order_of_the_records_does_not_matter() {
        let mut records = vector(CAMERA_PAGE, "configure")[32..].to_vec();
        records.rotate_left(5);
        assert_eq!(Settings::read(&records), Ok(settings()));
    }

    #[test]
    fn every_damage_of_the_list_has_its_code() {
        let good = vector(CAMERA_PAGE, "configure")[32..].to_vec();
        let with = |bytes: &[u8]| [&good[..], bytes].concat();
        let code = |records: &[u8]| Settings::read(records).map_err(SettingsError::code);
        assert_eq!(code(&with(&[0x01, 0x90, 0, 0])), Err(304));
        assert_eq!(code(&with(&[0x01, 0x10, 0, 0])), Ok(settings()));
        assert_eq!(code(&with(&[0x01, 0x80, 1, 0, 1])), Err(306));
        assert_eq!(code(&good[5..]), Err(305));
        assert_eq!(code(&with(&[0x01])), Err(108));
        assert_eq!(code(&with(&[0x01, 0x10, 9, 0, 0])), Err(108));
        let mut wrong_length = good[5..].to_vec();
        wrong_length.extend_from_slice(&[0x01, 0x80, 2, 0, 1, 0]);
        assert_eq!(code(&wrong_length), Err(108));
    }

    #[test]
    fn every_range_is_checked() {
        type Change = fn(&mut Settings);
        let changes: [(Change, u16); 24] = [
            (|s| s.binning = 2, 301),
            (|s| s.exposure_us = 9, 301),
            (|s| s.exposure_us = 50_001, 301),
            (|s| s.image_count = 11, 301),
            (|s| s.image_count = 61, 301),
            (|s| s.hdr_us = [5, 0], 301),
            (|s| s.compression = 4, 301),
            (|s| s.led_percent = 0, 301),
            (|s| s.led_percent = 101, 301),
            (|s| s.frame_time_ratio = 0.5, 301),
            (|s| s.frame_time_ratio = f32::NAN, 301),
            (|s| s.score_threshold = 1.5, 301),
            (|s| s.outlier_filter = 4, 301),
            (|s| s.reconstruction_quality = 10, 301),
            (|s| s.pre_filtering = 10, 301),
            (|s| s.working_volume = 2, 301),
            (|s| s.volume_of_interest.on = 1, 301),
            (|s| (s.binning, s.roi.width_px) = (0, 72), 301),
            (|s| (s.binning, s.roi.camera_1_px) = (0, [8, 0]), 301),
            (|s| (s.binning, s.roi.width_px) = (0, 84), 302),
            (
                |s| (s.binning, s.roi.height_px, s.roi.camera_2_px) = (0, 400, [0, 2]),
                302,
            ),
            (|s| s.components = 0b10111, 307),
            (|s| s.components = 0b00101, 301),
            (|s| s.components = 0b10100, 301),
        ];
        for (index, (change, code)) in changes.into_iter().enumerate() {
            let mut changed = settings();
            change(&mut changed);
            assert_eq!(
                changed.check(&caps()).map_err(SettingsError::code),
                Err(code),
                "change {index}"
            );
        }
    }
}
