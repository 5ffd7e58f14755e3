//! The normal equations of one Gauss-Newton step, and which directions they determine.
//!
//! Unknowns are `[L·rx L·ry L·rz tx ty tz]` about the template's centroid, with L its radius of gyration, so that all six
//! are lengths and eigenvalues can be compared.

use nalgebra::{Matrix6, Vector3, Vector6};
use rayon::prelude::*;

use super::twist::unscaled;
use super::{Determination, WeakDirection};

/// Sums over weighted point pairs.
#[derive(Debug, Clone)]
pub(super) struct NormalMatrix {
    pub(super) weight: f64,
    pub(super) squared_residual: f64,
    normal_disagreement: f64,
    matrix: Matrix6<f64>,
    cross: Matrix6<f64>,
    gradient: Vector6<f64>,
}

impl NormalMatrix {
    pub(super) fn zero() -> Self {
        Self {
            weight: 0.0,
            squared_residual: 0.0,
            normal_disagreement: 0.0,
            matrix: Matrix6::zeros(),
            cross: Matrix6::zeros(),
            gradient: Vector6::zeros(),
        }
    }

    /// Adds one pair: `arm` from the centroid to the template point over L, residual `normal · (template − reference)`.
    #[inline]
    pub(super) fn add(&mut self, weight: f64, arm: &Vector3<f64>, normal: &Vector3<f64>, residual: f64) {
        let row = row(arm, normal);
        self.weight += weight;
        self.squared_residual += weight * residual * residual;
        self.matrix.syger(weight, &row, &row, 1.0);
        self.gradient.axpy(weight * residual, &row, 1.0);
    }

    /// Adds what two independent estimates of the same normal say together: their noise cancels in the mean.
    pub(super) fn add_cross(&mut self, weight: f64, arm: &Vector3<f64>, first: &Vector3<f64>, second: &Vector3<f64>) {
        let (a, b) = (row(arm, first), row(arm, second));
        self.cross.ger(0.5 * weight, &a, &b, 1.0);
        self.cross.ger(0.5 * weight, &b, &a, 1.0);
        self.normal_disagreement += weight * (first - second).norm_squared();
    }

    /// The sum over all `pairs` of what `part` makes of some of them; the same at any number of threads. `None` when they
    /// weigh nothing.
    pub(super) fn summed<T: Sync>(pairs: &[T], part: impl Fn(&[T]) -> Self + Send + Sync) -> Option<Self> {
        let parts: Vec<Self> = pairs.par_chunks(CHUNK_COUNT).map(part).collect();
        let mut total = Self::zero();
        for part in &parts {
            total.merge(part);
        }
        (total.weight > 0.0).then_some(total)
    }

    fn merge(&mut self, other: &Self) {
        self.weight += other.weight;
        self.squared_residual += other.squared_residual;
        self.normal_disagreement += other.normal_disagreement;
        self.matrix += other.matrix;
        self.cross += other.cross;
        self.gradient += other.gradient;
    }

    /// The step that minimises the linearised sum of squares, without the `held` unit directions; `None` when the
    /// equations are not finite or empty.
    pub(super) fn step(&self, held: &[Vector6<f64>]) -> Option<Vector6<f64>> {
        if self.weight <= 0.0 {
            return None;
        }
        let mut free = Matrix6::identity();
        for direction in held {
            free -= direction * direction.transpose();
        }
        let matrix = symmetric(&self.matrix) / self.weight;
        let damping = DAMPING * matrix.trace().max(f64::MIN_POSITIVE);
        let projected = free * matrix * free + (Matrix6::identity() - free) + Matrix6::identity() * damping;
        let step = projected.cholesky()?.solve(&(free * (-self.gradient / self.weight)));
        let step = free * step;
        step.iter().all(|value| value.is_finite()).then_some(step)
    }

    /// The covariance and the weak directions; `gyration` is L.
    pub(super) fn determination(&self, gyration: f64, dof_count: f64) -> Determination {
        let mut out = Determination {
            covariance: None,
            weak: Vec::new(),
        };
        if self.weight <= 0.0 || dof_count <= 0.0 {
            return out;
        }
        let information = symmetric(&self.cross) / self.weight;
        // The part of the information that comes from noise in the normals alone, an eighth of their mean squared
        // disagreement for the mean of two, tells how far the eigenvalues can be believed.
        let floor = self.normal_disagreement / self.weight / 8.0;
        let limit = (WEAK_NOISE_FACTOR * floor).max(WEAK_INFORMATION);
        let variance = (self.squared_residual / self.weight).max((VARIANCE_FLOOR * gyration).powi(2));
        let eigen = information.symmetric_eigen();
        let mut order: Vec<usize> = (0..6).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]).then(a.cmp(&b)));
        let mut covariance = Matrix6::zeros();
        for index in order {
            let value = eigen.eigenvalues[index];
            let scaled: Vector6<f64> = eigen.eigenvectors.column(index).into_owned();
            let squared_sigma = variance / (dof_count * value.max(INFORMATION_FLOOR));
            let direction = unscaled(&scaled, gyration);
            if value < limit {
                out.weak.push((
                    scaled,
                    WeakDirection {
                        direction: direction.into(),
                        sigma: squared_sigma.sqrt(),
                    },
                ));
            }
            covariance += direction * direction.transpose() * squared_sigma;
        }
        if covariance.iter().all(|value| value.is_finite()) {
            out.covariance = Some(covariance);
        }
        out
    }
}

#[inline]
fn row(arm: &Vector3<f64>, normal: &Vector3<f64>) -> Vector6<f64> {
    let turn = arm.cross(normal);
    Vector6::new(turn.x, turn.y, turn.z, normal.x, normal.y, normal.z)
}

/// `syger` fills the lower triangle only.
fn symmetric(lower: &Matrix6<f64>) -> Matrix6<f64> {
    let mut full = *lower;
    full.fill_upper_triangle_with_lower_triangle();
    full
}

const CHUNK_COUNT: usize = 1024;
/// Keeps the equations solvable without changing what a determined direction gives.
const DAMPING: f64 = 1e-9;
/// Mean squared slope of the surface along a direction below which it counts as not determined: 1.3 degrees root mean
/// square.
const WEAK_INFORMATION: f64 = 5e-4;
/// Less information than this counts as this much, to keep every number finite.
const INFORMATION_FLOOR: f64 = 1e-9;
/// A smaller residual, over the radius of gyration, is rounding.
const VARIANCE_FLOOR: f64 = 1e-9;
/// The limit of weakness again, in multiples of what noise in the normals feigns.
const WEAK_NOISE_FACTOR: f64 = 0.1;
