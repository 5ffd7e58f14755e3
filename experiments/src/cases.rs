//! Case folders: `source.ply`, `target.ply`, `gt.txt` (4 × 4 row-major, target_from_source), `meta.txt` (`key=value`).

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use bladescan::geometry::{PointCloud, read_cloud};
use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// One pair of clouds with its true motion.
pub(crate) struct Case {
    /// Its folder.
    pub(crate) folder: PathBuf,
    /// What `meta.txt` says.
    pub(crate) meta: BTreeMap<String, String>,
    /// The true motion, target_from_source.
    pub(crate) truth: Matrix4<f64>,
}

impl Case {
    /// What cases are grouped by: experiment, model and level.
    pub(crate) fn group(&self) -> String {
        let key = |name: &str| self.meta.get(name).cloned().unwrap_or_default();
        format!("{} {} {}", key("exp"), key("model"), key("level"))
    }
}

/// How far an estimate is from the truth.
pub(crate) struct Errors {
    /// Root mean square over the source points, in the clouds' unit.
    pub(crate) rmse: f64,
    /// The paper's eq. 11.
    pub(crate) rotation_deg: f64,
    /// The paper's eq. 12, in the clouds' unit.
    pub(crate) translation: f64,
    /// Rotation below 2 degrees and translation below 0.02 (1 % of the half diagonal where `meta` has one).
    pub(crate) success: bool,
}

/// The case folders under `root`, sorted, those whose `meta.txt` has `level` if that is given.
pub(crate) fn find(root: &Path, level: Option<&str>) -> Result<Vec<Case>, Box<dyn Error>> {
    let mut folders = vec![root.to_owned()];
    let mut cases = Vec::new();
    while let Some(folder) = folders.pop() {
        if folder.join("gt.txt").exists() {
            let meta: BTreeMap<String, String> = fs::read_to_string(folder.join("meta.txt"))?
                .lines()
                .filter_map(|line| line.split_once('='))
                .map(|(key, value)| (key.to_owned(), value.trim().to_owned()))
                .collect();
            if level.is_none_or(|level| meta.get("level").is_some_and(|found| found == level)) {
                let truth = matrix(&folder.join("gt.txt"))?;
                cases.push(Case { folder, meta, truth });
            }
            continue;
        }
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            }
        }
    }
    cases.sort_by(|a, b| a.folder.cmp(&b.folder));
    Ok(cases)
}

/// Reads a cloud; a tiny file that holds a relative path stands for the file there.
pub(crate) fn cloud(path: &Path) -> Result<PointCloud, Box<dyn Error>> {
    let mut path = path.to_owned();
    let mut bytes = fs::read(&path)?;
    if bytes.len() < 200 && bytes.starts_with(b"../") {
        let target = std::str::from_utf8(&bytes)?.trim().to_owned();
        path = path.parent().unwrap_or(Path::new(".")).join(target);
        bytes = fs::read(&path)?;
    }
    Ok(read_cloud(&path.to_string_lossy(), &bytes)?.cloud)
}

/// Reads 16 numbers, row-major.
pub(crate) fn matrix(path: &Path) -> Result<Matrix4<f64>, Box<dyn Error>> {
    let numbers = fs::read_to_string(path)?
        .split_whitespace()
        .map(str::parse)
        .collect::<Result<Vec<f64>, _>>()?;
    if numbers.len() < 16 {
        return Err(format!("{}: 16 numbers are needed", path.display()).into());
    }
    Ok(Matrix4::from_row_slice(&numbers[..16]))
}

/// The rigid motion nearest to a matrix.
pub(crate) fn isometry(matrix: &Matrix4<f64>) -> Isometry3<f64> {
    let rotation: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&rotation));
    let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    Isometry3::from_parts(Translation3::from(translation), rotation)
}

/// Compares an estimate with the truth of `case`.
pub(crate) fn errors(case: &Case, source: &PointCloud, estimate: &Isometry3<f64>) -> Errors {
    let estimate = estimate.to_homogeneous();
    let difference = estimate - case.truth;
    let frobenius = difference.fixed_view::<3, 3>(0, 0).norm();
    let rotation_deg = (2.0 * (frobenius / 8f64.sqrt()).min(1.0).asin()).to_degrees();
    let translation = difference.fixed_view::<3, 1>(0, 3).norm();
    let diagonal = case.meta.get("diag").and_then(|text| text.parse::<f64>().ok());
    let tolerance = diagonal.map_or(0.02, |diagonal| 0.01 * diagonal / 2.0);
    Errors {
        rmse: rmse(source, &estimate, &case.truth),
        rotation_deg,
        translation,
        success: rotation_deg < 2.0 && translation < tolerance,
    }
}

/// Root mean square distance between where two motions bring the points of a cloud.
pub(crate) fn rmse(cloud: &PointCloud, estimate: &Matrix4<f64>, truth: &Matrix4<f64>) -> f64 {
    let difference = estimate - truth;
    let squared: f64 = cloud
        .points()
        .iter()
        .map(|point: &Point3<f64>| (difference * point.to_homogeneous()).xyz().norm_squared())
        .sum();
    (squared / cloud.len().max(1) as f64).sqrt()
}

/// The middle value, or the mean of the two middle ones; NaN of nothing.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let half = values.len() / 2;
    match values.get(half) {
        None => f64::NAN,
        Some(upper) if values.len() % 2 == 1 => *upper,
        Some(upper) => f64::midpoint(values[half - 1], *upper),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_lies_between_the_two_middle_values() {
        assert_eq!(median(vec![5.0, 1.0, 3.0]), 3.0);
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), 2.5);
        assert!(median(Vec::new()).is_nan());
    }
}
