//! The lines exchanged with the vendor's side: one JSON object each (`docs/protocols/bridge.md`).

use crate::camera::message::ComponentKind;
use crate::camera::settings::CameraSettings;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What the bridge asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Ask {
    /// Take these settings, all of them.
    Configure {
        /// Names the settings; the answer repeats it.
        config_id: u32,
        /// All settings.
        settings: AskedSettings,
    },
    /// Take one picture.
    Acquire {
        /// Names the acquisition, from 1; the answers repeat it.
        acquisition: u32,
        /// The settings it is taken with.
        config_id: u32,
    },
    /// End an acquisition; nothing more is wanted of it.
    Abort {
        /// Which.
        acquisition: u32,
    },
    /// Say how you are.
    Status,
    /// Leave.
    End,
}

impl Ask {
    /// Its line, without the line's end.
    pub fn line(&self) -> String {
        serde_json::to_string(self).expect("plain fields have a JSON form")
    }
}

/// The settings as lines say them: names and units of the page's table of settings, choices as words.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AskedSettings {
    /// Halve width and height; the region of interest is then ignored.
    pub binning: bool,
    /// Width, height, camera 1 x, y, camera 2 x, y.
    pub roi_px: [u16; 6],
    /// Exposure of one image.
    pub exposure_us: u32,
    /// Images in one frame.
    pub image_count: u16,
    /// Exposure of the low HDR pass; 0 = off.
    pub hdr_low_us: u32,
    /// Exposure of the high HDR pass; 0 = off.
    pub hdr_high_us: u32,
    /// Gradation compression.
    pub compression: Compression,
    /// LED brightness.
    pub led_percent: u8,
    /// Frame time over exposure.
    pub frame_time_ratio: f32,
    /// Least score.
    pub score_threshold: f32,
    /// Outlier filter.
    pub outlier_filter: OutlierFilter,
    /// 0 to 9.
    pub reconstruction_quality: u8,
    /// 0 to 9.
    pub pre_filtering: u8,
    /// Working volume.
    pub working_volume: WorkingVolume,
    /// Whether a confidence picture is wanted.
    pub confidence: bool,
}

/// Gradation compression.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compression {
    /// Off.
    None,
    /// Low: 10 bit.
    Low,
    /// Medium: 12 bit, slower.
    Medium,
    /// High: 12 bit, slower.
    High,
}

/// Outlier filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutlierFilter {
    /// Off.
    Disabled,
    /// Leaves most.
    Permissive,
    /// Between.
    Balanced,
    /// Leaves least.
    Strict,
}

/// Working volume.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorkingVolume {
    /// What both cameras and the projector see best.
    Standard,
    /// Everything that can be reconstructed.
    Extended,
}

impl AskedSettings {
    /// The words for settings whose ranges have been checked. The volume of interest is the bridge's own business.
    pub fn new(settings: &CameraSettings) -> Self {
        Self {
            binning: settings.binning,
            roi_px: settings.roi_px,
            exposure_us: settings.exposure_us,
            image_count: settings.image_count,
            hdr_low_us: settings.hdr_us[0],
            hdr_high_us: settings.hdr_us[1],
            compression: match settings.compression {
                0 => Compression::None,
                1 => Compression::Low,
                2 => Compression::Medium,
                _ => Compression::High,
            },
            led_percent: settings.led_percent,
            frame_time_ratio: settings.frame_time_ratio,
            score_threshold: settings.score_threshold,
            outlier_filter: match settings.outlier_filter {
                0 => OutlierFilter::Disabled,
                1 => OutlierFilter::Permissive,
                2 => OutlierFilter::Balanced,
                _ => OutlierFilter::Strict,
            },
            reconstruction_quality: settings.reconstruction_quality,
            pre_filtering: settings.pre_filtering,
            working_volume: match settings.working_volume {
                0 => WorkingVolume::Standard,
                _ => WorkingVolume::Extended,
            },
            confidence: settings.components & ComponentKind::Confidence.bit() != 0,
        }
    }
}

/// What the vendor's side says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case", deny_unknown_fields)]
pub enum Said {
    /// A device is there (again), without settings.
    Ready(Box<Ready>),
    /// The settings are in force.
    Configured {
        /// Which.
        config_id: u32,
        /// From `acquire` to `exposed`, where it is known better than the bridge's guess.
        #[serde(default)]
        predicted_exposure_us: Option<u32>,
        /// From `acquire` to `frame`, likewise.
        #[serde(default)]
        predicted_total_us: Option<u32>,
    },
    /// The exposures are over: the part may move.
    Exposed {
        /// Of which acquisition.
        acquisition: u32,
    },
    /// The files of a frame are written and closed.
    Frame(FrameFiles),
    /// Something went wrong: with an acquisition, with settings, or with neither.
    Error {
        /// The acquisition it ends.
        #[serde(default)]
        acquisition: Option<u32>,
        /// The settings it refuses.
        #[serde(default)]
        config_id: Option<u32>,
        /// What: a code of A3DP/1, section 6.
        code: u16,
        /// The vendor's own number.
        #[serde(default)]
        vendor_code: i32,
        /// In words.
        text: String,
    },
    /// How the device is. What is left out is unknown.
    Status(Condition),
    /// The device pauses to cool down.
    Pause {
        /// How long.
        duration_ms: u32,
        /// In words.
        #[serde(default)]
        text: String,
    },
    /// The device is gone, or starts anew; `ready` follows when it is back.
    Lost {
        /// How long it takes, where that is known: then it is a reset.
        #[serde(default)]
        duration_ms: u32,
        /// In words.
        text: String,
    },
    /// The device does not work and will not by itself.
    Fault {
        /// In words.
        text: String,
    },
    /// For the bridge's log.
    Note {
        /// In words.
        text: String,
    },
}

/// Which device is there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ready {
    /// Its maker.
    pub vendor: String,
    /// Its real model.
    pub model: String,
    /// Its serial number.
    pub serial: String,
    /// Its firmware.
    #[serde(default)]
    pub firmware: String,
    /// The vendor's software.
    #[serde(default)]
    pub sdk_version: String,
    /// Nothing is measured.
    #[serde(default)]
    pub simulated: bool,
    /// Whether `exposed` is said; if not, the part may move only when the frame is there.
    #[serde(default)]
    pub says_exposed: bool,
}

/// Where the files of a frame are: in the folder that the bridge was told, by name or whole path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameFiles {
    /// Of which acquisition.
    pub acquisition: u32,
    /// An ESM block.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub esm: Option<String>,
    /// A range image instead of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<RangeFiles>,
    /// Camera 1's picture: one byte per pixel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intensity: Option<String>,
    /// Score × 255: one byte per pixel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidence: Option<String>,
}

/// A range image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeFiles {
    /// u16 per pixel, little-endian.
    pub values: String,
    /// One byte per pixel; 0 = invalid.
    pub mask: String,
    /// Width and height.
    pub size_px: [u32; 2],
    /// Rows of the 3 × 4 map: vendor's x, y, z from (column, row, value, 1).
    pub vendor_from_pixel: [[f64; 4]; 3],
}

impl FrameFiles {
    /// Every file named, in a fixed order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let range = self.range.iter().flat_map(|range| [&range.values, &range.mask]);
        let single = [&self.esm, &self.intensity, &self.confidence].into_iter().flatten();
        single.chain(range).map(String::as_str)
    }
}

/// How the device is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Condition {
    /// Projector, camera 1, camera 2, board.
    pub temperature_c: [Option<f32>; 4],
    /// How long it has been warming up.
    pub warm_up_done_s: u32,
    /// How long it should.
    pub warm_up_required_s: u32,
    /// Packets lost between camera and PC since the start.
    pub lost_packet_count: u32,
    /// Speed of that link.
    pub link_mbit_s: u32,
}

/// Why a line of the vendor's side is not understood.
#[derive(Debug, Error)]
pub enum LineError {
    /// It is longer than lines may be.
    #[error("a line of {0} bytes, where {LINE_BYTES_MAX} are allowed")]
    TooLong(usize),
    /// It is no JSON object that this page knows.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
}

impl Said {
    /// Reads a line.
    ///
    /// # Errors
    ///
    /// It is too long, or says something that the page does not know.
    pub fn parse(line: &str) -> Result<Self, LineError> {
        if line.len() > LINE_BYTES_MAX {
            return Err(LineError::TooLong(line.len()));
        }
        Ok(serde_json::from_str(line.trim_start_matches('\u{feff}').trim())?)
    }
}

/// The longest line either side may say.
pub const LINE_BYTES_MAX: usize = 65_536;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::settings::tests::PAGE_SETTINGS;

    fn page_lines(marker: &str) -> Vec<&'static str> {
        let page = include_str!("../../../docs/protocols/bridge.md");
        page.lines().filter(|line| line.starts_with(marker)).collect()
    }

    #[test]
    fn every_line_of_the_page_is_understood_and_every_kind_stands_there() {
        let mut kinds: Vec<String> = page_lines("{\"is\":")
            .into_iter()
            .map(|line| {
                let said = Said::parse(line).unwrap_or_else(|error| panic!("{line}: {error}"));
                serde_json::to_value(said).unwrap()["is"].as_str().unwrap().to_owned()
            })
            .collect();
        kinds.sort();
        kinds.dedup();
        let expected = [
            "configured",
            "error",
            "exposed",
            "fault",
            "frame",
            "lost",
            "note",
            "pause",
            "ready",
            "status",
        ];
        assert_eq!(kinds, expected);
    }

    #[test]
    fn what_the_bridge_asks_is_what_the_page_shows() {
        let asks = [
            Ask::Configure {
                config_id: 77,
                settings: AskedSettings::new(&PAGE_SETTINGS),
            },
            Ask::Acquire {
                acquisition: 12,
                config_id: 77,
            },
            Ask::Abort { acquisition: 12 },
            Ask::Status,
            Ask::End,
        ];
        let said: Vec<String> = asks.iter().map(Ask::line).collect();
        assert_eq!(said, page_lines("{\"do\":"));
    }

    #[test]
    fn unknown_words_and_endless_lines_are_refused() {
        assert!(Said::parse(r#"{"is":"exposed","acquisition":1,"more":2}"#).is_err());
        assert!(Said::parse(r#"{"is":"exposed"}"#).is_err());
        let long = format!(r#"{{"is":"note","text":"{}"}}"#, "x".repeat(LINE_BYTES_MAX));
        assert!(matches!(Said::parse(&long), Err(LineError::TooLong(_))));
    }
}
