//! Pairwise registration: the rigid motion that lays one cloud on another.
//!
//! [`register`] moves the *template* (the paper's X, one view) onto the fixed *reference* (Y, another view or the merged
//! model). Minimum Potential Energy ([`mpe`]) brings it near; where that does not explain the clouds, votes of point pairs
//! (two single views) or a swarm of short falls (other clouds) say where else to begin. Trimmed ICP ([`icp`]) refines the
//! candidates, and what ends the work depends on the clouds: dense surfaces are laid on each other patch by patch; points
//! among noise, or that repeat, take the most likely pose. The candidate that is more consistent with the reference wins,
//! so the result is never worse than the start. Everything is free of scale: lengths are in whatever unit the clouds are
//! in, and every default is derived from the clouds' extent and spacing.
//!
//! The symbols of the paper and our readings of it are in `docs/paper.md`.

pub mod field;
pub mod icp;
pub mod mpe;

mod coarse;
mod consistency;
mod distinct;
mod facing;
mod mixture;
mod nfi;
mod noisy;
mod normal_matrix;
mod point_pairs;
mod pointwise;
mod prior;
mod reference;
mod search;
mod sight;
mod stride;
mod surface;
mod swarm;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod tukey;
mod twist;
mod uncertainty;

use nalgebra::{Isometry3, Matrix6, Vector6};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

pub use self::field::Summation;
pub use self::icp::{IcpLevel, IcpSettings, Metric, Trimming};
pub use self::mpe::{Formulation, Halving, MpeSettings, Stop, Stride};
pub use self::reference::{POINT_MIN_COUNT, Reference, RegisterError};
use crate::geometry::PointCloud;

/// How a registration is done. The defaults suit any pair of scans of one part, in any unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// How many points of each cloud MPE works on (the paper's random downsampling).
    pub sample_count: usize,
    /// Where the start may lie.
    pub search: Search,
    /// The coarse stage.
    pub mpe: MpeSettings,
    /// What ends the work.
    pub fine: FineStage,
    /// The levels of trimmed ICP, before the fine stage and in it. Without any level every registration fails.
    pub icp: IcpSettings,
    /// A template point overlaps if a reference point is at most this far away, in the clouds' unit. `None`: three times
    /// the reference's median spacing.
    pub overlap_distance: Option<f64>,
    /// A residual of more than this many times the clouds' own roughness is not explained by noise and curvature: the
    /// result is then `Ambiguous`.
    pub residual_max_factor: f64,
    /// With a smaller share of overlapping template points the registration has failed, 0 to 1.
    pub overlap_min_fraction: f64,
    /// What happens to directions that the surfaces do not determine.
    pub weak_directions: WeakDirections,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            sample_count: 500,
            search: Search::Automatic,
            mpe: MpeSettings::default(),
            fine: FineStage::Automatic,
            icp: IcpSettings::default(),
            overlap_distance: None,
            residual_max_factor: 2.5,
            overlap_min_fraction: 0.1,
            weak_directions: WeakDirections::Hold,
        }
    }
}

/// Where the solution is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Search {
    /// Only the fine stage, from the start.
    StartOnly,
    /// MPE from the start, over the whole reference.
    Near,
    /// MPE from the start, over the reference points that lie within this multiple of the template's radius of the
    /// template at the start. For a good start (a robot's pose): the rest of the model would only pull the view away.
    NearPart {
        /// Reach over the template's root-mean-square radius.
        reach_factor: f64,
    },
    /// As `Near`, and as `Everywhere` when that does not explain most of the template or the clouds are noisy.
    Automatic,
    /// MPE from the start; for two single views the poses that pairs of oriented points vote for, otherwise MPE from 24
    /// rotations spread over all of SO(3) with the centroids laid on each other.
    Everywhere,
}

/// What ends the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FineStage {
    /// Surface to surface, for dense clouds; trimmed ICP for thin ones, and for a view in a part of a model
    /// ([`Search::NearPart`]), where merged points made the former worse. As `Pointwise` if the clouds' roughness is of
    /// the order of their spacing or one repeats the points of the other.
    Automatic,
    /// Trimmed ICP, as in the paper.
    TrimmedIcp,
    /// Trimmed ICP, then between second-order patches of both clouds where they are dense enough for them.
    SurfaceToSurface,
    /// The most likely pose when the points of one cloud (a few thousand) are those of the other with noise.
    Pointwise,
}

/// What is done about directions that the surfaces do not determine (a smooth airfoil along its span).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WeakDirections {
    /// Found, reported, and held at the start's value: for a start that is a measurement, such as a robot's pose.
    Hold,
    /// Found and reported; the motion along them is what the data happened to give.
    Report,
    /// Found, reported, and settled between surfaces and start: the answer is the mean of both, in every direction,
    /// weighed by their certainties. For a start whose own standard deviations are known.
    Weigh(StartSigma),
}

/// How well the start is known, one standard deviation each; finite, and not negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StartSigma {
    /// Of a turn about each axis through the template's centroid.
    pub turn_rad: f64,
    /// Of a shift of the template's centroid along each axis, in the clouds' unit.
    pub shift: f64,
}

/// The outcome of one registration. A poor one is a value, not an error.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// The motion from template to reference coordinates; the start when `status` is `Failed`.
    pub reference_from_template: Isometry3<f64>,
    /// Whether to trust it.
    pub status: Status,
    /// How much of the template lies on the reference.
    pub overlap: Overlap,
    /// Root mean square distance of the overlapping template points from the reference's surface (the tangent plane at
    /// the nearest reference point), in the clouds' unit; 0 when nothing overlaps.
    pub rmse: f64,
    /// Covariance of `[rx ry rz tx ty tz]`: a small rotation (rad) about the template's centroid and a translation
    /// (clouds' unit), both in the reference frame. From the residuals, taken as independent, and from the start's
    /// certainty where that is weighed; `None` when the fine stage could not be solved.
    pub covariance: Option<Matrix6<f64>>,
    /// The directions that the surfaces alone do not determine, weakest first.
    pub weak_directions: Vec<WeakDirection>,
    /// The stages, in the order in which they ended.
    pub stages: Vec<Stage>,
}

/// Whether a registration can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// One solution, determined in all six directions.
    Converged,
    /// Two clearly different poses explain the clouds about equally well, or the best one leaves residuals that the
    /// clouds' own roughness does not explain.
    Ambiguous,
    /// At least one direction is not determined by the surfaces.
    Weak,
    /// Too little overlap, or no solution: the start is returned.
    Failed,
}

/// How much of the template lies on the reference: its points that have a reference point within the overlap distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// How many template points.
    pub count: usize,
    /// Their share of the template's points, 0 to 1; 0 for an empty template.
    pub fraction: f64,
}

/// A direction of motion that the surfaces do not determine.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// `[rx ry rz tx ty tz]` as in [`Registration::covariance`]; `sigma` times it is the motion of one standard deviation.
    /// Its translation part and its rotation part times the template's radius of gyration make a unit vector together.
    pub direction: [f64; 6],
    /// Standard deviation along it in the clouds' unit, always finite; a very large value stands for "no information".
    pub sigma: f64,
}

/// One stage of a registration that has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stage {
    /// `prepare`, `mpe`, `coarse` or `fine`.
    pub name: &'static str,
    /// How many iterations it took, all candidates together.
    pub iterations: u32,
}

/// Registers two clouds with nothing known about the motion between them: from the identity, seed 1.
///
/// For a start, a reference that serves many templates, or times of the stages: [`register_from`].
///
/// # Errors
/// When a cloud has too few points to register, no extent, or coordinates that cannot be computed with.
///
/// ```
/// use bladescan::geometry::PointCloud;
/// use bladescan::registration::{Settings, Status, register};
/// use nalgebra::{Isometry3, Point3, Vector3};
///
/// // A wavy patch, and the same patch moved a little.
/// let points = (0..1600).map(|i| {
///     let (u, v) = (f64::from(i % 40) / 20.0 - 1.0, f64::from(i / 40) / 20.0 - 1.0);
///     Point3::new(u, v, 0.3 * (3.0 * u).sin() * (2.0 * v + 0.5).cos() + 0.2 * u * v)
/// });
/// let template = PointCloud::from_measured(points).cloud;
/// let truth = Isometry3::new(Vector3::new(0.05, -0.03, 0.02), Vector3::new(0.05, 0.02, 0.1));
/// let reference = template.transformed(&truth);
///
/// let found = register(&template, &reference, &Settings::default())?;
/// assert_eq!(found.status, Status::Converged);
/// let error = truth.inverse() * found.reference_from_template;
/// assert!(error.rotation.angle() < 1e-4 && error.translation.vector.norm() < 1e-4);
/// # Ok::<(), bladescan::registration::RegisterError>(())
/// ```
pub fn register(
    template: &PointCloud,
    reference: &PointCloud,
    settings: &Settings,
) -> Result<Registration, RegisterError> {
    can_be_registered(template)?;
    let settings = Settings {
        weak_directions: WeakDirections::Report,
        ..settings.clone()
    };
    Ok(register_from(
        template,
        &Reference::new(reference)?,
        &Isometry3::identity(),
        &settings,
        ChaCha8Rng::seed_from_u64(1),
        &mut |_| {},
    ))
}

/// Registers `template` to `reference` from `start` (`reference_from_template`).
///
/// `seed_stream` draws the samples; the same stream gives the same bits, whatever the number of threads. `on_stage` is
/// called when each stage ends, so that a caller with a clock can time it. Template normals are used if there are any
/// (they must face the sensor, like the reference's) and estimated otherwise. A template that as a reference would be
/// refused (too few points, all in one place), and a start that is not finite, give `Failed`.
pub fn register_from(
    template: &PointCloud,
    reference: &Reference,
    start: &Isometry3<f64>,
    settings: &Settings,
    seed_stream: ChaCha8Rng,
    on_stage: &mut dyn FnMut(&Stage),
) -> Registration {
    search::run(template, reference, start, settings, seed_stream, on_stage)
}

/// Whether a cloud can be registered, as a template or as a reference.
///
/// # Errors
/// When there are fewer than [`POINT_MIN_COUNT`] points, all of them coincide, or coordinates or extent are beyond what
/// can be computed with.
pub fn can_be_registered(cloud: &PointCloud) -> Result<(), RegisterError> {
    reference::centroid_and_radius(cloud).map(|_| ())
}

/// The covariance, weak directions and residual that the fine stage leaves behind.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Determination {
    pub(crate) covariance: Option<Matrix6<f64>>,
    pub(crate) weak: Vec<(Vector6<f64>, WeakDirection)>,
}
