//! How far a minimum of the NFI criterion may be from where it would be with other samples of the same surfaces.
//!
//! Among noise the pairs of trimmed ICP mean little, and so does a covariance from their residuals. The minimum of a sum
//! over points is an M-estimate: its covariance is `H⁻¹ J H⁻¹` with the curvature `H` of the energy (central differences
//! of force and torque) and the scatter `J` of what the single points contribute to force and torque (of both clouds).
//! A turn that hardly changes the energy, such as that of a slender blade about its span, has a large one.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};

use super::field::Field;
use super::reference::rms_radius;
use super::twist::moved;
use super::{Determination, WeakDirection};

/// Which motions count as not determined: those whose standard deviation is larger.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerance {
    /// Of a turn, in radians.
    pub(super) turn_rad: f64,
    /// Of a shift, over the template's radius of gyration.
    pub(super) shift_factor: f64,
}

/// The covariance of `[rx ry rz tx ty tz]` about the template's centroid, in the reference frame, at `pose`, a minimum
/// of the NFI criterion with ε² = `softening`; `None` when the energy has no minimum there or nothing is finite.
pub(super) fn covariance_of_minimum(
    template: &[Point3<f64>],
    reference: &[Point3<f64>],
    pose: &Isometry3<f64>,
    softening: f64,
) -> Option<Matrix6<f64>> {
    let placed: Vec<Point3<f64>> = template.iter().map(|point| pose * point).collect();
    let centre = mean(&placed);
    let radius = rms_radius(&placed, &centre);
    if radius <= 0.0 || !radius.is_finite() || reference.is_empty() {
        return None;
    }
    // Everything about the template's centroid and over its radius from here on.
    let scaled = |points: &[Point3<f64>]| -> Vec<Point3<f64>> {
        points
            .iter()
            .map(|point| Point3::from((point - centre) / radius))
            .collect()
    };
    let (moving, fixed) = (scaled(&placed), scaled(reference));
    let softening = softening / radius;
    let field = Field::new(&fixed);
    let mut scatter = scatter_of(&field, &moving, softening);
    scatter += scatter_of(&Field::new(&moving), &fixed, softening);

    let mut curvature = Matrix6::zeros();
    let step = STEP_SOFTENINGS * softening;
    for axis in 0..6 {
        let mut motion = Vector6::zeros();
        motion[axis] = step;
        let difference = load(&field, &moving, &-motion, softening) - load(&field, &moving, &motion, softening);
        curvature.set_column(axis, &(difference / (2.0 * step)));
    }
    let curvature = (curvature + curvature.transpose()) / 2.0;
    let inverse = curvature.cholesky()?.inverse();
    let mut covariance = inverse * scatter * inverse;
    for row in 0..6 {
        for column in 0..6 {
            let shifts = usize::from(row > 2) + usize::from(column > 2);
            covariance[(row, column)] *= radius.powi(shifts as i32);
        }
    }
    covariance.iter().all(|value| value.is_finite()).then_some(covariance)
}

/// What a covariance says: the motions of one standard deviation along the largest turn and the largest shift, where
/// they exceed `tolerance`; weakest first.
pub(super) fn determination(covariance: &Matrix6<f64>, gyration: f64, tolerance: &Tolerance) -> Determination {
    let limits = [tolerance.turn_rad, tolerance.shift_factor * gyration];
    let mut weak: Vec<(f64, Vector6<f64>, WeakDirection)> = Vec::new();
    for (block, limit) in [0, 3].into_iter().zip(limits) {
        let part: Matrix3<f64> = covariance.fixed_view::<3, 3>(block, block).into_owned();
        let eigen = part.symmetric_eigen();
        let largest = eigen.eigenvalues.imax();
        let excess = eigen.eigenvalues[largest].max(0.0).sqrt() / limit;
        if excess <= 1.0 {
            continue;
        }
        let mut axis = Vector6::zeros();
        axis.fixed_rows_mut::<3>(block)
            .copy_from(&eigen.eigenvectors.column(largest));
        let mut scaled = covariance * axis / (excess * limit);
        for turn in 0..3 {
            scaled[turn] *= gyration;
        }
        let sigma = scaled.norm();
        let Some(unit) = scaled.try_normalize(0.0) else {
            continue;
        };
        // The largest turn and the largest shift may be the same motion.
        if weak.iter().any(|(_, other, _)| other.dot(&unit).abs() > SAME_COSINE) {
            continue;
        }
        let mut direction = unit;
        for turn in 0..3 {
            direction[turn] /= gyration;
        }
        let direction = direction.into();
        weak.push((excess, unit, WeakDirection { direction, sigma }));
    }
    weak.sort_by(|a, b| b.0.total_cmp(&a.0));
    Determination {
        covariance: Some(*covariance),
        weak: weak.into_iter().map(|(_, scaled, weak)| (scaled, weak)).collect(),
    }
}

/// Whether another sample of the same surfaces might have preferred `rival` to `best`: the NFI criterion there is higher
/// by less than three standard deviations of the difference, the single points' differences taken as independent.
pub(super) fn may_be_preferred(
    template: &[Point3<f64>],
    reference: &[Point3<f64>],
    best: &Isometry3<f64>,
    rival: &Isometry3<f64>,
    softening: f64,
) -> bool {
    let centre = mean(reference);
    let radius = rms_radius(reference, &centre).max(f64::MIN_POSITIVE);
    let over = |points: &mut dyn Iterator<Item = Point3<f64>>| -> Vec<Point3<f64>> {
        points.map(|point| Point3::from((point - centre) / radius)).collect()
    };
    let fixed = over(&mut reference.iter().copied());
    let placed = [best, rival].map(|pose| over(&mut template.iter().map(|point| pose * point)));
    let field = Field::new(&fixed);
    let of_template = placed.each_ref().map(|points| field.pulls(points, softening / radius));
    let of_reference = placed.map(|points| Field::new(&points).pulls(&fixed, softening / radius));
    let (mut gap, mut variance) = (0.0, 0.0);
    for [at_best, at_rival] in [&of_template, &of_reference] {
        let differences = || {
            at_rival
                .iter()
                .zip(at_best)
                .map(|(there, here)| there.energy - here.energy)
        };
        // Both sums are the same total, but for rounding.
        gap = differences().sum::<f64>();
        let mean = gap / at_best.len().max(1) as f64;
        variance += differences().map(|difference| (difference - mean).powi(2)).sum::<f64>();
    }
    gap < PREFERENCE_SIGMAS * variance.sqrt()
}

/// The sum over `points` of the outer products of what each contributes to torque and force, about their mean.
fn scatter_of(field: &Field, points: &[Point3<f64>], softening: f64) -> Matrix6<f64> {
    let loads: Vec<Vector6<f64>> = field
        .pulls(points, softening)
        .iter()
        .zip(points)
        .map(|(pull, point)| stacked(&point.coords.cross(&pull.force), &pull.force))
        .collect();
    let mean = loads.iter().sum::<Vector6<f64>>() / loads.len().max(1) as f64;
    loads.iter().map(|load| (load - mean) * (load - mean).transpose()).sum()
}

/// Torque about the origin's image and force on `points` after a small motion.
fn load(field: &Field, points: &[Point3<f64>], motion: &Vector6<f64>, softening: f64) -> Vector6<f64> {
    let pose = moved(&Isometry3::identity(), &Point3::origin(), motion);
    let placed: Vec<Point3<f64>> = points.iter().map(|point| pose * point).collect();
    let centre = Vector3::new(motion[3], motion[4], motion[5]);
    field
        .pulls(&placed, softening)
        .iter()
        .zip(&placed)
        .map(|(pull, point)| stacked(&(point.coords - centre).cross(&pull.force), &pull.force))
        .sum()
}

fn stacked(turn: &Vector3<f64>, shift: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

fn mean(points: &[Point3<f64>]) -> Point3<f64> {
    let sum: Vector3<f64> = points.iter().map(|point| point.coords).sum();
    Point3::from(sum / points.len().max(1) as f64)
}

/// The step of the central differences: well inside the reach of the softened field, well above single precision.
const STEP_SOFTENINGS: f64 = 0.3;
const PREFERENCE_SIGMAS: f64 = 3.0;
/// Directions nearer to each other than this are one.
const SAME_COSINE: f64 = 0.9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PointCloud;
    use crate::registration::testing::{blade, extruded, noisy};

    const TOLERANCE: Tolerance = Tolerance {
        turn_rad: 0.0175,
        shift_factor: 0.03,
    };

    fn determined(template: &[Point3<f64>], reference: &[Point3<f64>], softening: f64) -> Determination {
        let pose = Isometry3::identity();
        let covariance = covariance_of_minimum(template, reference, &pose, softening).unwrap();
        determination(&covariance, rms_radius(template, &mean(template)), &TOLERANCE)
    }

    #[test]
    fn a_blade_with_a_platform_is_determined_among_little_noise() {
        let template = blade(2000, 0.0);
        let reference = noisy(&template, 0.02, 3);
        let found = determined(template.points(), reference.points(), 0.02);
        assert!(found.weak.is_empty(), "{found:?}");
    }

    #[test]
    fn a_nearly_round_bar_may_turn_about_its_axis() {
        let squeezed = extruded(2000, 0.3);
        let points = squeezed.points().iter().map(|p| Point3::new(0.3 * p.x, p.y, p.z));
        let template = PointCloud::from_measured(points).cloud;
        let reference = noisy(&template, 0.1, 3);
        let found = determined(template.points(), reference.points(), 0.1);
        assert!(!found.weak.is_empty(), "{found:?}");
        let direction = found.weak[0].1.direction;
        assert!(direction[2].abs() > 0.9, "{direction:?}");
    }

    #[test]
    fn a_flip_of_a_bar_may_be_preferred_and_that_of_a_blade_not() {
        let flip = Isometry3::rotation(Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        let preferred = |template: &PointCloud| {
            let reference = noisy(template, 0.05, 3);
            let here = Isometry3::identity();
            may_be_preferred(template.points(), reference.points(), &here, &flip, 0.05)
        };
        let bar = extruded(2000, 0.3);
        let points = bar.points().iter().map(|p| Point3::new(p.x, 0.02 * p.y, p.z));
        assert!(preferred(&PointCloud::from_measured(points).cloud));
        assert!(!preferred(&blade(2000, 0.0)));
    }

    #[test]
    fn two_places_far_apart_have_no_covariance() {
        let template = blade(200, 0.0);
        let far = template.transformed(&Isometry3::translation(50.0, 0.0, 0.0));
        let found = covariance_of_minimum(template.points(), far.points(), &Isometry3::identity(), 0.1);
        assert_eq!(found, None);
    }
}
