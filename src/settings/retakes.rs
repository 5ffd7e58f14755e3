//! Which views are taken again: why, how often, and with which exposures.

use serde::Deserialize;

/// What is done about views that came out badly.
#[derive(Debug, Clone, PartialEq)]
pub struct Retakes {
    /// How often one view is taken again before the run goes on without it, 0 to 10.
    pub max_count: u16,
    /// For which reasons.
    pub reasons: Vec<RetakeReason>,
    /// What the exposures of a frame with few points are multiplied by, and those of a saturated one divided by, 1 to 10.
    pub exposure_factor: f64,
    /// The share of the lit pixels (with 3D or saturated) that may be saturated, 0 to 1.
    pub saturated_max_fraction: f64,
}

/// Why a view is taken again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RetakeReason {
    /// The camera gave no frame.
    NoFrame,
    /// The frame has too few valid points.
    FewPoints,
    /// Too many of its lit pixels are saturated.
    Saturated,
    /// It was registered too far from the robot's pose.
    Disagrees,
    /// No pose was found, or not one alone.
    Ambiguous,
    /// It overlaps the model too little.
    LittleOverlap,
}

impl Retakes {
    /// Whether a view is taken again after this attempt failed for this reason.
    pub fn wants(&self, reason: RetakeReason, attempt: u16) -> bool {
        attempt < self.max_count && self.reasons.contains(&reason)
    }

    /// Whether a view may be taken again for what its registration found: then the last views are waited for.
    pub fn wants_any_registered(&self) -> bool {
        let registered = [
            RetakeReason::Disagrees,
            RetakeReason::Ambiguous,
            RetakeReason::LittleOverlap,
        ];
        registered.into_iter().any(|reason| self.wants(reason, 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Recipe;

    const RECIPE: &str = "name = \"probe\"\nblade.cad = \"builtin:lpt\"\nmerge.overlap_min_fraction = 0.5\n\
                          presentation = { position_mm = [10, -5, 600], rotation_deg = [0, 90, 0] }\n[views]\n";

    #[test]
    fn the_reasons_to_take_a_view_again_are_words_of_a_list() {
        let run = |line: &str| Recipe::parse("probe.toml", &format!("{RECIPE}[run]\n{line}\n"));
        let reasons = |line| run(line).unwrap().retakes.reasons;
        assert_eq!(reasons(""), [RetakeReason::NoFrame, RetakeReason::FewPoints]);
        assert_eq!(reasons("retake_on = []"), []);
        assert_eq!(
            reasons("retake_on = [\"saturated\", \"disagrees\", \"ambiguous\", \"little-overlap\"]"),
            [
                RetakeReason::Saturated,
                RetakeReason::Disagrees,
                RetakeReason::Ambiguous,
                RetakeReason::LittleOverlap
            ]
        );
        for (line, message) in [
            ("retake_on = [\"dark\"]", "`run.retake_on` cannot be \"dark\""),
            (
                "retake_on = [\"saturated\", 5]",
                "`run.retake_on` must be a list of words in quotes, not a list with a whole number in it",
            ),
            (
                "retake_on = \"saturated\"",
                "`run.retake_on` must be a list of words in quotes, not text",
            ),
        ] {
            assert_eq!(run(line).unwrap_err().message(), message);
        }
    }

    #[test]
    fn a_retake_has_a_bound_and_the_registration_reasons_need_the_last_views() {
        let retakes = |line: &str| {
            let text = format!("{RECIPE}[run]\nretakes_max = 2\n{line}\n");
            Recipe::parse("probe.toml", &text).unwrap().retakes
        };
        let plain = retakes("");
        assert!(plain.wants(RetakeReason::NoFrame, 1) && !plain.wants(RetakeReason::NoFrame, 2));
        assert!(!plain.wants(RetakeReason::Disagrees, 0) && !plain.wants_any_registered());
        assert!(retakes("retake_on = [\"disagrees\"]").wants_any_registered());
    }
}
