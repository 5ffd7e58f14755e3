//! Surfaces: how a blade answers to the projected light, and which parts of the artefact model are on (camera sheet 4.2).

use super::noise::SurfaceNoise;
use serde::{Deserialize, Serialize};

/// A surface as the camera meets it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// The preset that the numbers are those of, or began as.
    pub preset: Preset,
    /// Noise, roll-off and drop-outs.
    pub noise: SurfaceNoise,
    /// How light is thrown back.
    pub finish: Finish,
    /// What is on.
    pub terms: Terms,
}

/// Names of the presets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Sprayed or blasted, and without the artefacts of edges and highlights: what a careful laboratory sees.
    Matte,
    /// Machined: broad highlights.
    Machined,
    /// Polished: narrow, strong highlights.
    Polished,
}

/// How light is thrown back: `k_d cos θ + k_s 2^-(α / w)²`, α between the normal and the middle of the rays to the projector
/// and to the camera (sheet 4.2 step 3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finish {
    /// k_d, as a share of that of the matte reference. *Assumed*.
    pub diffuse: f64,
    /// k_s / k_d: 3 to 10 for machined and polished blades (sheet). *Assumed*.
    pub specular_ratio: f64,
    /// w: where half of the highlight is left, 5° to 15° (sheet). *Assumed*.
    pub lobe_rad: f64,
    /// Depth noise against that of a matte surface of the same brightness, 1.5 to 3 on shiny metal (sheet). *Assumed*.
    pub noise_factor: f64,
    /// Share of the light of a mirrored surface that reaches the camera by a second bounce, where both touch. *Assumed*.
    pub mirror_fraction: f64,
}

/// A part of the artefact model that can be switched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Term {
    /// Shadows of camera 2 and of the projector.
    Shadows,
    /// The highlight in the brightness.
    Highlights,
    /// Full scale and the threshold of the score.
    Score,
    /// Pixels lost at a grazing angle.
    Incidence,
    /// Compact drop-outs.
    Dropouts,
    /// Noise along and across the ray.
    Noise,
    /// Ripple beside steps of the brightness.
    Ripple,
    /// Flying and lost pixels at silhouettes.
    Silhouettes,
    /// Score lowered by light of a second bounce.
    SecondBounce,
    /// Ghosts of inter-reflections.
    Ghosts,
    /// Isolated gross mismatches.
    Outliers,
    /// Smooth bowl over the field.
    Bowl,
    /// Error of the scale.
    Scale,
    /// Error of the scale that fades while the camera warms up.
    WarmUp,
}

impl Term {
    /// All terms, in the order in which the model applies them.
    pub const ALL: [Term; 14] = [
        Term::Shadows,
        Term::Highlights,
        Term::SecondBounce,
        Term::Score,
        Term::Incidence,
        Term::Dropouts,
        Term::Noise,
        Term::Ripple,
        Term::Silhouettes,
        Term::Ghosts,
        Term::Outliers,
        Term::Bowl,
        Term::Scale,
        Term::WarmUp,
    ];
    /// The terms that are the same in every frame of one camera: off in every preset.
    pub const SYSTEMATIC: [Term; 3] = [Term::Bowl, Term::Scale, Term::WarmUp];

    /// The name on the command line and in the truth.
    pub fn name(self) -> &'static str {
        match self {
            Term::Shadows => "shadows",
            Term::Highlights => "highlights",
            Term::Score => "score",
            Term::Incidence => "incidence",
            Term::Dropouts => "dropouts",
            Term::Noise => "noise",
            Term::Ripple => "ripple",
            Term::Silhouettes => "silhouettes",
            Term::SecondBounce => "second-bounce",
            Term::Ghosts => "ghosts",
            Term::Outliers => "outliers",
            Term::Bowl => "bowl",
            Term::Scale => "scale",
            Term::WarmUp => "warm-up",
        }
    }

    /// The term of that name.
    pub fn from_name(name: &str) -> Option<Term> {
        Term::ALL.into_iter().find(|term| term.name() == name)
    }
}

/// A set of terms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<Term>", into = "Vec<Term>")]
pub struct Terms(u16);

impl Terms {
    /// Whether the term is on.
    pub fn has(self, term: Term) -> bool {
        self.0 >> (term as u16) & 1 == 1
    }

    /// With the term on.
    #[must_use]
    pub fn with(self, term: Term) -> Terms {
        Terms(self.0 | 1 << (term as u16))
    }

    /// With the term off.
    #[must_use]
    pub fn without(self, term: Term) -> Terms {
        Terms(self.0 & !(1 << (term as u16)))
    }
}

impl From<Vec<Term>> for Terms {
    fn from(terms: Vec<Term>) -> Terms {
        terms.into_iter().fold(Terms(0), Terms::with)
    }
}

impl From<Terms> for Vec<Term> {
    fn from(terms: Terms) -> Vec<Term> {
        Term::ALL.into_iter().filter(|&term| terms.has(term)).collect()
    }
}

impl Surface {
    /// Names of the presets, from the easiest.
    pub const NAMES: [&'static str; 3] = ["matte", "machined", "polished"];

    /// The preset of that name; `None` for any other text.
    pub fn from_name(name: &str) -> Option<Surface> {
        match name {
            "matte" => Some(Surface::matte()),
            "machined" => Some(Surface::machined()),
            "polished" => Some(Surface::polished()),
            _ => None,
        }
    }

    /// A sprayed or blasted surface, facing every direction alike; none of the terms of edges and highlights.
    pub fn matte() -> Surface {
        Surface {
            preset: Preset::Matte,
            noise: SurfaceNoise::matte(),
            finish: Finish {
                diffuse: 1.0,
                specular_ratio: 0.0,
                lobe_rad: 30_f64.to_radians(),
                noise_factor: 1.0,
                mirror_fraction: 0.0,
            },
            terms: MATTE_TERMS.to_vec().into(),
        }
    }

    /// A milled or ground surface.
    pub fn machined() -> Surface {
        Surface {
            preset: Preset::Machined,
            noise: SurfaceNoise {
                dropout_fraction: 0.006,
                roll_off_px: 2.5,
                ..SurfaceNoise::matte()
            },
            finish: Finish {
                diffuse: 0.35,
                specular_ratio: 4.5,
                lobe_rad: 12_f64.to_radians(),
                noise_factor: 1.5,
                mirror_fraction: 0.4,
            },
            terms: SHINY_TERMS.to_vec().into(),
        }
    }

    /// A polished surface.
    pub fn polished() -> Surface {
        Surface {
            preset: Preset::Polished,
            noise: SurfaceNoise {
                dropout_fraction: 0.008,
                roll_off_px: 2.5,
                ..SurfaceNoise::matte()
            },
            finish: Finish {
                diffuse: 0.25,
                specular_ratio: 10.0,
                lobe_rad: 7_f64.to_radians(),
                noise_factor: 2.0,
                mirror_fraction: 0.7,
            },
            terms: SHINY_TERMS.to_vec().into(),
        }
    }
}

const MATTE_TERMS: [Term; 5] = [Term::Shadows, Term::Score, Term::Incidence, Term::Dropouts, Term::Noise];
const SHINY_TERMS: [Term; 11] = [
    Term::Shadows,
    Term::Highlights,
    Term::SecondBounce,
    Term::Score,
    Term::Incidence,
    Term::Dropouts,
    Term::Noise,
    Term::Ripple,
    Term::Silhouettes,
    Term::Ghosts,
    Term::Outliers,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_has_its_name_and_none_a_systematic_term() {
        for name in Surface::NAMES {
            let surface = Surface::from_name(name).unwrap();
            let written = serde_json::to_value(surface).unwrap();
            assert_eq!(written["preset"], name);
            assert!(Term::SYSTEMATIC.iter().all(|&term| !surface.terms.has(term)));
            assert_eq!(serde_json::from_value::<Surface>(written).unwrap(), surface);
        }
        assert!(Surface::from_name("chrome").is_none());
    }

    #[test]
    fn a_term_is_switched_alone_and_bears_one_name_everywhere() {
        for term in Term::ALL {
            assert_eq!(Term::from_name(term.name()), Some(term));
            assert_eq!(serde_json::to_value(term).unwrap(), term.name());
            let terms = Surface::polished().terms;
            let (on, off) = (terms.with(term), terms.without(term));
            assert!(on.has(term) && !off.has(term));
            for other in Term::ALL.into_iter().filter(|&other| other != term) {
                assert_eq!((on.has(other), off.has(other)), (terms.has(other), terms.has(other)));
            }
        }
    }
}
