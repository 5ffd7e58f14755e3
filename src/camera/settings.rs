//! The complete settings of the camera, as CONFIGURE sends and CONFIGURED echoes them (sections 4.4 and 4.5 of the page).

use super::code;
use super::payload::{Field, PayloadReader};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Everything that CONFIGURE fixes. Ranges are the camera's (CAPS); the recipe's are within the A5000's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Halve width and height; the region of interest is then ignored.
    pub binning: bool,
    /// Region of interest: width, height, camera 1 x, y, camera 2 x, y, in pixels.
    pub roi_px: [u16; 6],
    /// Exposure of one image, µs.
    pub exposure_us: u32,
    /// Images in one 3D frame.
    pub image_count: u16,
    /// Exposure of the low and the high HDR pass, µs; 0 = pass off.
    pub hdr_us: [u32; 2],
    /// Gradation compression: 0 none, 1 low, 2 medium, 3 high.
    pub compression: u8,
    /// LED brightness, percent.
    pub led_percent: u8,
    /// Frame time over exposure, 1 to 4.
    pub frame_time_ratio: f32,
    /// Least correlation score, 0 to 1.
    pub score_threshold: f32,
    /// 0 disabled, 1 permissive, 2 balanced, 3 strict.
    pub outlier_filter: u8,
    /// 0 to 9.
    pub reconstruction_quality: u8,
    /// 0 to 9.
    pub pre_filtering: u8,
    /// 0 standard, 1 extended.
    pub working_volume: u8,
    /// Points outside it are left out; `None` = off.
    pub volume_of_interest: Option<VolumeOfInterest>,
    /// Components wanted: bit n = kind n.
    pub components: u32,
}

/// A box in the camera frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct VolumeOfInterest {
    /// Least x, y, z, mm.
    pub min_mm: [f32; 3],
    /// Greatest x, y, z, mm.
    pub max_mm: [f32; 3],
}

/// Why a list of settings is not one.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SettingsError {
    /// It ends inside a record, or a value has another length than its tag says.
    #[error("the list of settings is damaged at tag {tag:#06x}")]
    Damaged {
        /// The tag, 0 where not even a tag is left.
        tag: u16,
    },
    /// A critical tag that nobody knows.
    #[error("tag {tag:#06x} is critical and unknown")]
    UnknownCritical {
        /// The tag.
        tag: u16,
    },
    /// A setting is not there.
    #[error("{name} is missing")]
    Missing {
        /// Its name on the page.
        name: &'static str,
    },
    /// A setting is there twice.
    #[error("{name} is there twice")]
    Repeated {
        /// Its name on the page.
        name: &'static str,
    },
    /// A switch that is neither on nor off.
    #[error("{name} is neither 0 nor 1")]
    Switch {
        /// Its name on the page.
        name: &'static str,
    },
    /// An echo whose tags do not ascend.
    #[error("tag {tag:#06x} is out of order")]
    Order {
        /// The tag.
        tag: u16,
    },
}

impl SettingsError {
    /// The protocol's error code.
    pub fn code(&self) -> u16 {
        match self {
            Self::Damaged { .. } | Self::Order { .. } => code::MALFORMED_PAYLOAD,
            Self::UnknownCritical { .. } => code::UNKNOWN_CRITICAL_TAG,
            Self::Missing { .. } => code::MISSING_TAG,
            Self::Repeated { .. } => code::REPEATED_TAG,
            Self::Switch { .. } => code::OUT_OF_RANGE,
        }
    }
}

impl CameraSettings {
    /// The tag-length-value list, ascending.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (index, setting) in SETTINGS.iter().enumerate() {
            setting.tag.write(&mut bytes);
            setting.length.write(&mut bytes);
            self.put(index, &mut bytes);
        }
        bytes
    }

    fn put(&self, index: usize, bytes: &mut Vec<u8>) {
        match index {
            0 => self.binning.write(bytes),
            1 => self.roi_px.write(bytes),
            2 => self.exposure_us.write(bytes),
            3 => self.image_count.write(bytes),
            4 => self.hdr_us.write(bytes),
            5 => self.compression.write(bytes),
            6 => self.led_percent.write(bytes),
            7 => self.frame_time_ratio.write(bytes),
            8 => self.score_threshold.write(bytes),
            9 => self.outlier_filter.write(bytes),
            10 => self.reconstruction_quality.write(bytes),
            11 => self.pre_filtering.write(bytes),
            12 => self.working_volume.write(bytes),
            13 => {
                self.volume_of_interest.is_some().write(bytes);
                bytes.extend_from_slice(&[0; 3]);
                let corners = self
                    .volume_of_interest
                    .map_or([[0.0; 3]; 2], |volume| [volume.min_mm, volume.max_mm]);
                corners.write(bytes);
            }
            14 => self.components.write(bytes),
            _ => unreachable!("SETTINGS has 15 rows"),
        }
    }

    /// Reads a list in any order. Unknown tags that are not critical are passed over; ranges are the camera's business.
    pub fn decode(bytes: &[u8]) -> Result<Self, SettingsError> {
        Self::from_values(records(bytes)?)
    }

    /// Reads an echo, whose tags must ascend.
    pub fn decode_ascending(bytes: &[u8]) -> Result<Self, SettingsError> {
        let mut rest = bytes;
        let mut last = 0;
        while let Some((tag, _)) = record(&mut rest)? {
            if tag <= last {
                return Err(SettingsError::Order { tag });
            }
            last = tag;
        }
        Self::decode(bytes)
    }

    fn from_values(values: [&[u8]; SETTINGS.len()]) -> Result<Self, SettingsError> {
        Ok(Self {
            binning: switch(values[0], 0)?,
            roi_px: value(values[1], 1)?,
            exposure_us: value(values[2], 2)?,
            image_count: value(values[3], 3)?,
            hdr_us: value(values[4], 4)?,
            compression: value(values[5], 5)?,
            led_percent: value(values[6], 6)?,
            frame_time_ratio: value(values[7], 7)?,
            score_threshold: value(values[8], 8)?,
            outlier_filter: value(values[9], 9)?,
            reconstruction_quality: value(values[10], 10)?,
            pre_filtering: value(values[11], 11)?,
            working_volume: value(values[12], 12)?,
            volume_of_interest: volume_of_interest(values[13])?,
            components: value(values[14], 14)?,
        })
    }
}

/// One record from the front of a list; `None` at its end.
fn record<'a>(rest: &mut &'a [u8]) -> Result<Option<(u16, &'a [u8])>, SettingsError> {
    let Some((head, tail)) = rest.split_at_checked(4) else {
        return if rest.is_empty() {
            Ok(None)
        } else {
            Err(SettingsError::Damaged { tag: 0 })
        };
    };
    let tag = u16::from_le_bytes([head[0], head[1]]);
    let length = u16::from_le_bytes([head[2], head[3]]);
    let (value, tail) = tail
        .split_at_checked(usize::from(length))
        .ok_or(SettingsError::Damaged { tag })?;
    *rest = tail;
    Ok(Some((tag, value)))
}

/// The values of a list in the order of [`SETTINGS`].
fn records(bytes: &[u8]) -> Result<[&[u8]; SETTINGS.len()], SettingsError> {
    let mut found: [Option<&[u8]>; SETTINGS.len()] = [None; SETTINGS.len()];
    let mut rest = bytes;
    while let Some((tag, value)) = record(&mut rest)? {
        let Some(index) = SETTINGS.iter().position(|setting| setting.tag == tag) else {
            if tag & CRITICAL != 0 {
                return Err(SettingsError::UnknownCritical { tag });
            }
            continue;
        };
        if value.len() != usize::from(SETTINGS[index].length) {
            return Err(SettingsError::Damaged { tag });
        }
        let name = SETTINGS[index].name;
        if found[index].replace(value).is_some() {
            return Err(SettingsError::Repeated { name });
        }
    }
    let mut values: [&[u8]; SETTINGS.len()] = [&[]; SETTINGS.len()];
    for ((value, found), setting) in values.iter_mut().zip(found).zip(&SETTINGS) {
        *value = found.ok_or(SettingsError::Missing { name: setting.name })?;
    }
    Ok(values)
}

fn value<F: Field>(bytes: &[u8], index: usize) -> Result<F, SettingsError> {
    let tag = SETTINGS[index].tag;
    PayloadReader::new(bytes)
        .field()
        .map_err(|_| SettingsError::Damaged { tag })
}

fn switch(bytes: &[u8], index: usize) -> Result<bool, SettingsError> {
    match value::<u8>(bytes, index)? {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(SettingsError::Switch {
            name: SETTINGS[index].name,
        }),
    }
}

fn volume_of_interest(bytes: &[u8]) -> Result<Option<VolumeOfInterest>, SettingsError> {
    const INDEX: usize = 13;
    if bytes[1..4] != [0; 3] {
        return Err(SettingsError::Damaged {
            tag: SETTINGS[INDEX].tag,
        });
    }
    let on = switch(&bytes[..1], INDEX)?;
    let [min_mm, max_mm] = value(&bytes[4..], INDEX)?;
    Ok(on.then_some(VolumeOfInterest { min_mm, max_mm }))
}

/// The first setting whose echo differs, in words.
pub fn difference(wanted: &CameraSettings, found: &CameraSettings) -> Option<String> {
    let list = |settings: &CameraSettings| {
        [
            ("binning", f64::from(u8::from(settings.binning))),
            ("exposure_us", f64::from(settings.exposure_us)),
            ("image_count", f64::from(settings.image_count)),
            ("hdr_low_us", f64::from(settings.hdr_us[0])),
            ("hdr_high_us", f64::from(settings.hdr_us[1])),
            ("compression", f64::from(settings.compression)),
            ("led_percent", f64::from(settings.led_percent)),
            ("frame_time_ratio", f64::from(settings.frame_time_ratio)),
            ("score_threshold", f64::from(settings.score_threshold)),
            ("outlier_filter", f64::from(settings.outlier_filter)),
            ("reconstruction_quality", f64::from(settings.reconstruction_quality)),
            ("pre_filtering", f64::from(settings.pre_filtering)),
            ("working_volume", f64::from(settings.working_volume)),
            ("components", f64::from(settings.components)),
        ]
    };
    if wanted.roi_px != found.roi_px {
        return Some(format!(
            "roi: asked for {:?}, in force {:?}",
            wanted.roi_px, found.roi_px
        ));
    }
    if wanted.volume_of_interest != found.volume_of_interest {
        return Some(format!(
            "volume_of_interest: asked for {:?}, in force {:?}",
            wanted.volume_of_interest, found.volume_of_interest
        ));
    }
    list(wanted)
        .iter()
        .zip(list(found))
        .find(|((_, wanted), (_, found))| wanted != found)
        .map(|((name, wanted), (_, found))| format!("{name}: asked for {wanted}, in force {found}"))
}

/// One row of the page's table of settings.
struct Setting {
    tag: u16,
    length: u16,
    name: &'static str,
}

const fn setting(tag: u16, length: u16, name: &'static str) -> Setting {
    Setting { tag, length, name }
}

const SETTINGS: [Setting; 15] = [
    setting(0x8001, 1, "binning"),
    setting(0x8002, 12, "roi"),
    setting(0x8003, 4, "exposure_us"),
    setting(0x8004, 2, "image_count"),
    setting(0x8005, 8, "hdr"),
    setting(0x8006, 1, "compression"),
    setting(0x8007, 1, "led_percent"),
    setting(0x8008, 4, "frame_time_ratio"),
    setting(0x8009, 4, "score_threshold"),
    setting(0x800A, 1, "outlier_filter"),
    setting(0x800B, 1, "reconstruction_quality"),
    setting(0x800C, 1, "pre_filtering"),
    setting(0x800D, 1, "working_volume"),
    setting(0x800E, 28, "volume_of_interest"),
    setting(0x800F, 4, "components"),
];

/// Tags with this bit must be known.
const CRITICAL: u16 = 0x8000;

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::camera) const PAGE_SETTINGS: CameraSettings = CameraSettings {
        binning: true,
        roi_px: [1440, 1080, 0, 0, 0, 0],
        exposure_us: 1000,
        image_count: 24,
        hdr_us: [0, 0],
        compression: 1,
        led_percent: 25,
        frame_time_ratio: 2.0,
        score_threshold: 0.85,
        outlier_filter: 1,
        reconstruction_quality: 5,
        pre_filtering: 3,
        working_volume: 1,
        volume_of_interest: None,
        components: 0b10101,
    };

    #[test]
    fn settings_read_back_and_no_cut_list_is_believed() {
        let bytes = PAGE_SETTINGS.encode();
        assert_eq!(CameraSettings::decode(&bytes), Ok(PAGE_SETTINGS));
        for length in 0..bytes.len() {
            assert!(CameraSettings::decode(&bytes[..length]).is_err(), "cut to {length}");
        }
    }

    #[test]
    fn a_volume_of_interest_reads_back() {
        let settings = CameraSettings {
            volume_of_interest: Some(VolumeOfInterest {
                min_mm: [-10.0, -20.0, 200.0],
                max_mm: [10.0, 20.0, 300.0],
            }),
            ..PAGE_SETTINGS
        };
        let bytes = settings.encode();
        assert_eq!(CameraSettings::decode(&bytes), Ok(settings));
        assert!(
            difference(&PAGE_SETTINGS, &settings)
                .unwrap()
                .starts_with("volume_of_interest")
        );
    }

    fn reversed(bytes: &[u8]) -> Vec<u8> {
        let mut records: Vec<&[u8]> = Vec::new();
        let mut rest = bytes;
        while !rest.is_empty() {
            let (record, tail) = rest.split_at(4 + usize::from(rest[2]));
            records.push(record);
            rest = tail;
        }
        records.reverse();
        records.concat()
    }

    #[test]
    fn a_list_may_stand_in_any_order_but_an_echo_may_not() {
        let bytes = reversed(&PAGE_SETTINGS.encode());
        assert_eq!(CameraSettings::decode(&bytes), Ok(PAGE_SETTINGS));
        assert_eq!(
            CameraSettings::decode_ascending(&bytes),
            Err(SettingsError::Order { tag: 0x800E })
        );
    }

    #[test]
    fn each_way_to_spoil_a_list_has_its_own_code() {
        let bytes = PAGE_SETTINGS.encode();
        let code = |bytes: &[u8]| CameraSettings::decode(bytes).map_err(|error| error.code());
        assert_eq!(code(&[&bytes[..], &[0x10, 0x80, 0, 0]].concat()), Err(304));
        assert_eq!(code(&[&bytes[..], &[0x10, 0x00, 1, 0, 7]].concat()), Ok(PAGE_SETTINGS));
        assert_eq!(code(&bytes[5..]), Err(305));
        assert_eq!(code(&[&bytes[..], &bytes[..5]].concat()), Err(306));
        assert_eq!(code(&bytes[..bytes.len() - 1]), Err(108));
        let mut switch = bytes.clone();
        switch[4] = 2;
        assert_eq!(code(&switch), Err(301));
    }
}
