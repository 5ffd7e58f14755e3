//! How near a registration comes to what known correspondences give on the same points.
//!
//! Where the target's first points are the source's in order, that is the least-squares motion between them. Where they
//! are in another order, the pairs are not known, and their expected root mean square error stands for it: σ √(6 / N).

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;

use bladescan::geometry::PointCloud;
use bladescan::geometry::statistics::mean;
use bladescan::registration::Registration;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::cases::{self, Case};
use crate::doubt::normalised;

/// Outcomes by kind and level of the cases, over all models.
#[derive(Default)]
pub(crate) struct Table {
    groups: BTreeMap<(String, String), Vec<Row>>,
}

struct Row {
    rmse: f64,
    bound: f64,
    /// The squared error in units of the covariance that the registration states; 6 in the mean when that is right.
    normalised: Option<f64>,
    success: bool,
    status: String,
}

impl Table {
    /// Adds a case whose target repeats its source's points; others are left out.
    ///
    /// `found` was found for the source moved by `turn`.
    pub(crate) fn add(
        &mut self,
        case: &Case,
        source: &PointCloud,
        target: &PointCloud,
        turn: &Isometry3<f64>,
        found: &Registration,
    ) {
        let repeats = case
            .meta
            .get("exp")
            .is_some_and(|exp| exp == "noise" || exp == "outlier");
        if !repeats || target.len() < source.len() || source.is_empty() {
            return;
        }
        let Some(bound) = bound(case, source, target) else {
            return;
        };
        let estimate = found.reference_from_template * turn;
        let errors = cases::errors(case, source, &estimate);
        let key = |name: &str| case.meta.get(name).cloned().unwrap_or_default();
        self.groups.entry((key("exp"), key("level"))).or_default().push(Row {
            rmse: errors.rmse,
            bound,
            normalised: normalised(
                found,
                &(cases::isometry(&case.truth) * turn.inverse()),
                &(turn * source.centroid()),
            ),
            success: errors.success,
            status: format!("{:?}", found.status),
        });
    }

    /// One line a kind and level: success, surface RMSE, that of the known correspondences, the median of their ratios.
    pub(crate) fn print(&self, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
        writeln!(
            out,
            "{:<10} {:>6} {:>6} {:>6} {:>12} {:>12} {:>12} {:>10} {:>10}  statuses",
            "exp", "level", "cases", "right", "median rmse", "known pairs", "median ratio", "rms ratio", "normalised"
        )?;
        for ((exp, level), rows) in &self.groups {
            let of = |value: fn(&Row) -> f64| cases::median(rows.iter().map(value).collect());
            let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
            let right = || rows.iter().filter(|row| row.success);
            let squares = mean(right().map(|row| (row.rmse / row.bound).powi(2)).collect());
            let normalised = mean(right().filter_map(|row| row.normalised).collect());
            let mut statuses: BTreeMap<&str, usize> = BTreeMap::new();
            for row in rows {
                *statuses.entry(&row.status).or_default() += 1;
            }
            writeln!(
                out,
                "{exp:<10} {level:>6} {:>6} {:>6} {:>12.6} {:>12.6} {:>12.3} {:>10.3} {normalised:>10.2}  {statuses:?}",
                rows.len(),
                right().count(),
                of(|row| row.rmse),
                of(|row| row.bound),
                of(|row| row.rmse / row.bound),
                squares.sqrt(),
            )?;
        }
        Ok(())
    }
}

/// The surface RMSE that known correspondences leave.
fn bound(case: &Case, source: &PointCloud, target: &PointCloud) -> Option<f64> {
    let (from, to) = (source.points(), &target.points()[..source.len()]);
    let truth = cases::isometry(&case.truth);
    let rms = |squares: &mut dyn Iterator<Item = f64>| (squares.sum::<f64>() / from.len() as f64).sqrt();
    let apart = rms(&mut from.iter().zip(to).map(|(a, b)| (truth * a - b).norm_squared()));
    let centroid = source.centroid();
    if apart < 0.5 * rms(&mut from.iter().map(|point| (point - centroid).norm_squared())) {
        return Some(cases::errors(case, source, &motion_between(from, to)).rmse);
    }
    let number = |name: &str| case.meta.get(name).and_then(|text| text.parse::<f64>().ok());
    let sigma = match case.meta.get("exp").map(String::as_str) {
        Some("noise") => number("sigma").or(number("level"))?,
        _ => number("sigma").unwrap_or(OUTLIER_SIGMA),
    };
    Some(sigma * (6.0 / from.len() as f64).sqrt())
}

/// The motion that lays points on their partners with the least squares (Kabsch).
pub(crate) fn motion_between(from: &[Point3<f64>], to: &[Point3<f64>]) -> Isometry3<f64> {
    let (here, there) = (mean(from).coords, mean(to).coords);
    let moments: Matrix3<f64> = from
        .iter()
        .zip(to)
        .map(|(a, b)| (b.coords - there) * (a.coords - here).transpose())
        .sum();
    motion_from_moments(&moments, &here, &there)
}

/// The motion from the middle `here` to the middle `there` whose rotation agrees best with the `moments`
/// `Σ (b − there)(a − here)ᵀ` of pairs.
pub(crate) fn motion_from_moments(moments: &Matrix3<f64>, here: &Vector3<f64>, there: &Vector3<f64>) -> Isometry3<f64> {
    let decomposed = moments.svd(true, true);
    let (u, v_t) = (decomposed.u.unwrap_or_default(), decomposed.v_t.unwrap_or_default());
    let mirrored = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirrored)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Isometry3::from_parts((there - rotation * here).into(), rotation)
}

/// The noise of the outlier cases, in the blade's half extent.
const OUTLIER_SIGMA: f64 = 0.005;
