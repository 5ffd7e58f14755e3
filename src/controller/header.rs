//! What names a run.

use crate::seed::Seed;
use serde::{Deserialize, Serialize};

/// What names a run: it stands in the recording, and what it says of the origin in every file of results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of bladescan.
    pub version: String,
    /// What it was built for.
    pub target: String,
    /// The run's seed.
    pub seed: Seed,
    /// Names the run to the camera, which keeps the frames of one run; a run that is resumed keeps it. Not 0.
    #[serde(default = "run_id_of_old")]
    pub run_id: u64,
    /// Name of the recipe.
    pub recipe: String,
    /// SHA-256 of the recipe's text, hexadecimal; empty in recordings of old.
    #[serde(default)]
    pub recipe_sha256: String,
    /// Name of the station.
    pub station: String,
    /// SHA-256 of the station's text, hexadecimal; it stands for the hand-eye calibration too. Empty in recordings of old.
    #[serde(default)]
    pub station_sha256: String,
    /// Whether the cell is a simulated one.
    pub simulated: bool,
    /// What the simulated cell of a dry run was started with; `None` for a cell that somebody else started.
    #[serde(default)]
    pub simulation: Option<Simulation>,
    /// Which part, as the operator named it.
    pub part: Option<String>,
    /// Who runs it, as the operator said.
    #[serde(default)]
    pub operator: Option<String>,
    /// When the run began, UTC, RFC 3339.
    pub started_utc: String,
    /// How many of the plan's views are taken, if not all.
    pub view_count: Option<usize>,
}

/// What the simulated cell of a dry run was started with, as far as recipe, station and seed do not say it. Faults are
/// left out: a cell that is started again has none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Simulation {
    /// `builtin:NAME` or the absolute path of an STL file.
    pub blade: String,
    /// How the blade throws light back: the name of a preset.
    pub surface: String,
    /// Parts of the camera's artefacts that are left out.
    pub without: Vec<String>,
    /// How much faster than real it moves and exposes.
    pub speed: f64,
}

impl Default for Header {
    /// A simulated run of this version, of nothing and nobody, for those who set the rest.
    fn default() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            target: String::new(),
            seed: Seed(1),
            run_id: run_id_of_old(),
            recipe: String::new(),
            recipe_sha256: String::new(),
            station: String::new(),
            station_sha256: String::new(),
            simulated: true,
            simulation: None,
            part: None,
            operator: None,
            started_utc: "1970-01-01T00:00:00Z".into(),
            view_count: None,
        }
    }
}

/// What recordings without a run id said.
fn run_id_of_old() -> u64 {
    1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_of_old_still_reads() {
        let text = r#"{"version":"0","target":"t","seed":7,"recipe":"r","station":"s","simulated":false,
                       "part":null,"started_utc":"2026-01-01T00:00:00Z","view_count":3}"#;
        let header: Header = serde_json::from_str(text).unwrap();
        let expected = Header {
            version: "0".into(),
            target: "t".into(),
            seed: Seed(7),
            recipe: "r".into(),
            station: "s".into(),
            simulated: false,
            started_utc: "2026-01-01T00:00:00Z".into(),
            view_count: Some(3),
            ..Header::default()
        };
        assert_eq!(header, expected);
    }
}
