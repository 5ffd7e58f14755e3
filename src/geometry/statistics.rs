//! Middles of numbers and of points.

use nalgebra::{Point3, Vector3};

/// The middle one of `values` in ascending order, the upper of two; `None` of nothing.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (middle < values.len()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The mean of the points; the origin of nothing.
pub fn mean(points: &[Point3<f64>]) -> Point3<f64> {
    let sum: Vector3<f64> = points.iter().map(|point| point.coords).sum();
    Point3::from(sum / points.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_the_upper_one_of_two_middles() {
        assert_eq!(median(vec![5.0, 1.0, 3.0]), Some(3.0));
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median(Vec::new()), None);
    }

    #[test]
    fn the_mean_of_nothing_is_the_origin() {
        let points = [Point3::new(1.0, 2.0, 3.0), Point3::new(3.0, 2.0, 1.0)];
        assert_eq!(mean(&points), Point3::new(2.0, 2.0, 2.0));
        assert_eq!(mean(&[]), Point3::origin());
    }
}
