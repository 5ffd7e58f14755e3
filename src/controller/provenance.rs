//! Where a result comes from: the same words in every file of a run.

use super::header::Header;
use crate::event::Event;
use crate::settings::Station;
use serde::Serialize;
use serde_json::{Value, json};

/// What every file of results says of its origin: no times and nothing that differs between a run that was taken up again
/// and one that was not.
#[derive(Debug)]
pub(super) struct Provenance {
    header: Header,
    /// Names the hand-eye calibration of the station.
    calibration_id: String,
    /// As they greeted, each once: one, unless somebody changed the camera or its calibration.
    cameras: Vec<CameraIdentity>,
    reconstructed_from: Option<Source>,
}

/// The recording that views were registered anew from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Source {
    /// Name of the file, without its folder.
    pub file: String,
    /// Of all its bytes, hexadecimal.
    pub sha256: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct CameraIdentity {
    model: String,
    serial: String,
    calibration_id: u64,
}

impl Provenance {
    pub(super) fn new(header: Header, station: &Station) -> Self {
        Self {
            header,
            calibration_id: station.calibration_id.clone(),
            cameras: Vec::new(),
            reconstructed_from: None,
        }
    }

    /// The same of a result that was not measured but registered anew.
    pub(super) fn reconstructed_from(header: Header, station: &Station, source: Source) -> Self {
        Self {
            reconstructed_from: Some(source),
            ..Self::new(header, station)
        }
    }

    pub(super) fn header(&self) -> &Header {
        &self.header
    }

    /// Learns the camera from its greeting.
    pub(super) fn note(&mut self, event: &Event) {
        let Event::CameraReady {
            model,
            serial,
            calibration_id,
            ..
        } = event
        else {
            return;
        };
        let camera = CameraIdentity {
            model: model.clone(),
            serial: serial.clone(),
            calibration_id: *calibration_id,
        };
        if !self.cameras.contains(&camera) && self.cameras.len() < CAMERAS_MAX {
            self.cameras.push(camera);
        }
    }

    /// The object `run` of the JSON files.
    pub(super) fn value(&self) -> Value {
        let header = &self.header;
        json!({
            "part": header.part,
            "operator": header.operator,
            "recipe": { "name": header.recipe, "sha256": header.recipe_sha256 },
            "station": { "name": header.station, "sha256": header.station_sha256, "calibration_id": self.calibration_id },
            "cameras": self.cameras,
            "seed": header.seed.0,
            "simulated": header.simulated,
            "bladescan": { "version": header.version, "target": header.target },
            "reconstructed_from": self.reconstructed_from,
        })
    }

    /// The comments of a PLY file: one line a thing, short enough for every reader.
    pub(super) fn comments(&self) -> Vec<String> {
        let header = &self.header;
        let mut comments = vec![
            "bladescan model: millimetres, frame = camera frame at view 0".to_owned(),
            if header.simulated {
                "SIMULATED: nothing was measured"
            } else {
                "measured"
            }
            .to_owned(),
        ];
        let mut say = |what: &str, text: &str| {
            let text: String = text.chars().take(COMMENT_CHARACTERS_MAX).collect();
            comments.push(format!("{what}: {text}"));
        };
        if let Some(part) = &header.part {
            say("part", part);
        }
        if let Some(operator) = &header.operator {
            say("operator", operator);
        }
        say("recipe", &named(&header.recipe, &header.recipe_sha256));
        say("station", &named(&header.station, &header.station_sha256));
        say("hand-eye calibration", &self.calibration_id);
        for camera in &self.cameras {
            let CameraIdentity {
                model,
                serial,
                calibration_id,
            } = camera;
            say(
                "camera",
                &format!("{model}, serial {serial}, calibration {calibration_id}"),
            );
        }
        say("seed", &header.seed.0.to_string());
        say("bladescan", &format!("{} for {}", header.version, header.target));
        if let Some(source) = &self.reconstructed_from {
            say("reconstructed from", &named(&source.file, &source.sha256));
        }
        comments
    }
}

fn named(name: &str, sha256: &str) -> String {
    match sha256 {
        "" => name.to_owned(),
        _ => format!("{name}, SHA-256 {sha256}"),
    }
}

/// More cameras than this are not told apart: a run has one.
const CAMERAS_MAX: usize = 4;
/// Some readers of PLY take lines of at most 1024 bytes; a character has up to 4.
const COMMENT_CHARACTERS_MAX: usize = 200;

#[cfg(test)]
mod tests {
    use super::*;

    fn ready(calibration_id: u64) -> Event {
        Event::CameraReady {
            model: "A5000".into(),
            serial: "7".into(),
            simulated: false,
            optics: "fine".into(),
            calibration_id,
        }
    }

    #[test]
    fn a_camera_is_named_once_and_again_with_another_calibration() {
        let mut provenance = Provenance::new(Header::default(), &Station::builtin_simulated());
        for calibration_id in [3, 3, 4, 3] {
            provenance.note(&ready(calibration_id));
        }
        let ids: Vec<u64> = provenance.cameras.iter().map(|camera| camera.calibration_id).collect();
        assert_eq!(ids, [3, 4]);
    }

    #[test]
    fn no_comment_is_longer_than_readers_take() {
        let header = Header {
            part: Some("ü".repeat(5000)),
            recipe: "r".repeat(5000),
            ..Header::default()
        };
        let comments = Provenance::new(header, &Station::builtin_simulated()).comments();
        assert!(comments.iter().any(|comment| comment.starts_with("part: ü")));
        assert!(comments.iter().all(|comment| comment.len() < 1000), "{comments:?}");
    }
}
