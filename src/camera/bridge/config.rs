//! The bridge's file: where it listens, who the vendor's side is, what the camera can do, which way its axes point.

use super::picture::Axes;
use crate::camera::message::{Caps, ComponentKind};
use core::net::SocketAddr;
use serde::Deserialize;
use std::path::PathBuf;
use thiserror::Error;

/// The bridge's file, as it is written.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BridgeConfig {
    /// Where controllers and observers connect.
    pub listen: SocketAddr,
    /// The vendor's side.
    pub vendor: VendorConfig,
    /// What the camera can do.
    pub camera: CameraConfig,
    /// Which way its axes point.
    pub axes: AxesConfig,
}

/// How the vendor's side is reached.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VendorConfig {
    /// Program and arguments of a child process that speaks on its standard input and output.
    pub command: Option<Vec<String>>,
    /// Instead of it: where a program that runs by itself connects.
    pub listen: Option<SocketAddr>,
    /// The folder of the frames' files; nothing outside it is read.
    pub frames: PathBuf,
    /// Whether read files stay; else they are removed.
    #[serde(default)]
    pub keep_frames: bool,
    /// How long `ready` may take after the start.
    #[serde(default = "ready_timeout_ms")]
    pub ready_timeout_ms: u64,
    /// Reconstruction as the bridge predicts it, until `configured` says better.
    #[serde(default = "reconstruction_ms")]
    pub reconstruction_ms: u32,
}

/// What the camera can do beyond the ranges of every A5000.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Name of the lens set.
    pub optics: String,
    /// Nearest, nominal and farthest working distance along z.
    pub working_distance_mm: [f32; 3],
    /// Point spacing at the nominal distance, unbinned.
    pub spacing_mm: f32,
    /// Centre of projection of camera 1 in the camera frame.
    #[serde(default = "unknown")]
    pub camera_1_mm: [f32; 3],
    /// The same of camera 2.
    #[serde(default = "unknown")]
    pub camera_2_mm: [f32; 3],
    /// The same of the projector.
    #[serde(default = "unknown")]
    pub projector_mm: [f32; 3],
    /// Brightest LED setting allowed here.
    #[serde(default = "led_max_percent")]
    pub led_max_percent: u8,
    /// Whether frames bring a confidence picture.
    #[serde(default)]
    pub confidence: bool,
    /// Which calibration; 0 = unknown.
    #[serde(default)]
    pub calibration_id: u64,
    /// year · 10000 + month · 100 + day; 0 = unknown.
    #[serde(default)]
    pub calibration_date: u32,
}

/// Which way the vendor's axes point.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxesConfig {
    /// One unit of the vendor's, mm.
    pub unit_mm: f64,
    /// Rows of the 3 × 4 motion (or mirrored motion), mm.
    pub camera_from_vendor: [[f64; 4]; 3],
}

/// What is wrong with the bridge's file.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// It is not the TOML that it should be.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// Neither or both of the two ways to the vendor's side.
    #[error("[vendor] needs one of command (with at least a program) and listen")]
    Vendor,
    /// The axes stretch, shear or have no unit.
    #[error("[axes] camera_from_vendor must have rows of length 1 at right angles, and unit_mm must be positive")]
    Axes,
    /// The distances do not ascend, or something is not positive.
    #[error("[camera] working_distance_mm must ascend from above 0, spacing_mm be positive, led_max_percent 1 to 100")]
    Camera,
}

impl BridgeConfig {
    /// Reads the text of a file.
    ///
    /// # Errors
    ///
    /// Unknown or missing keys, or values that cannot be.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text)?;
        let vendor = &config.vendor;
        match (&vendor.command, &vendor.listen) {
            (Some(command), None) if !command.is_empty() => {}
            (None, Some(_)) => {}
            _ => return Err(ConfigError::Vendor),
        }
        if !config.axes().is_rigid() {
            return Err(ConfigError::Axes);
        }
        let camera = &config.camera;
        let [near, nominal, far] = camera.working_distance_mm;
        let ascending = 0.0 < near && near < nominal && nominal < far && far.is_finite();
        let spacing = camera.spacing_mm > 0.0 && camera.spacing_mm.is_finite();
        let led = (1..=100).contains(&camera.led_max_percent);
        if !(ascending && spacing && led) {
            return Err(ConfigError::Camera);
        }
        Ok(config)
    }

    /// The vendor's axes.
    pub fn axes(&self) -> Axes {
        Axes {
            unit_mm: self.axes.unit_mm,
            camera_from_vendor: self.axes.camera_from_vendor,
        }
    }

    /// What CAPS says.
    pub fn caps(&self) -> Caps {
        let camera = &self.camera;
        let confidence = match camera.confidence {
            true => ComponentKind::Confidence.bit(),
            false => 0,
        };
        Caps {
            sensor_px: [1440, 1080],
            roi_min_px: [80, 4],
            roi_step_px: [8, 4],
            exposure_min_us: 10,
            exposure_max_us: 50_000,
            exposure_default_us: 1000,
            image_count_min: 12,
            image_count_max: 60,
            image_count_default: 24,
            led_max_percent: camera.led_max_percent,
            led_recommended_percent: camera.led_max_percent.min(25),
            hdr_slot_count: 2,
            hdr_in_free_run: false,
            working_distance_mm: camera.working_distance_mm,
            spacing_mm: camera.spacing_mm,
            camera_1_mm: camera.camera_1_mm,
            camera_2_mm: camera.camera_2_mm,
            projector_mm: camera.projector_mm,
            components: ComponentKind::WANTED | confidence,
            outlier_filters: 0b1111,
            compressions: 0b1111,
            working_volumes: 0b11,
            optics: camera.optics.clone(),
        }
    }
}

fn unknown() -> [f32; 3] {
    [f32::NAN; 3]
}

fn ready_timeout_ms() -> u64 {
    60_000
}

fn reconstruction_ms() -> u32 {
    1000
}

fn led_max_percent() -> u8 {
    100
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = include_str!("../../../config/bridges/a5000.toml");

    #[test]
    fn the_example_is_read() {
        let config = BridgeConfig::parse(EXAMPLE).unwrap();
        assert_eq!(config.listen.port(), 50_555);
        assert_eq!(config.caps().components & ComponentKind::WANTED, ComponentKind::WANTED);
    }

    #[test]
    fn unknown_keys_no_way_to_the_vendor_and_bent_axes_are_refused() {
        let with = |from: &str, to: &str| {
            assert!(EXAMPLE.contains(from), "{from}");
            BridgeConfig::parse(&EXAMPLE.replacen(from, to, 1))
        };
        assert!(matches!(
            with("[axes]", "[axes]\ncolour = 1"),
            Err(ConfigError::Toml(_))
        ));
        assert!(matches!(with("\ncommand =", "\n# command ="), Err(ConfigError::Vendor)));
        assert!(matches!(with("unit_mm = 1.0", "unit_mm = 0.0"), Err(ConfigError::Axes)));
        assert!(matches!(
            with("spacing_mm = ", "spacing_mm = -"),
            Err(ConfigError::Camera)
        ));
    }
}
