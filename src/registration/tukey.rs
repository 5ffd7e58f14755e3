//! Tukey's biweight: residuals much larger than most do not count.

use crate::geometry::statistics::median;

/// The weights of residuals by their sizes.
pub(super) struct Tukey {
    /// A residual of this size or more weighs nothing.
    cut: f64,
}

impl Tukey {
    /// For residuals of these `sizes`, between clouds of this `radius`; `None` where there are none.
    pub(super) fn of(sizes: Vec<f64>, radius: f64) -> Option<Self> {
        let cut = CUT_SIGMAS * MEDIAN_TO_SIGMA * median(sizes)?;
        Some(Self {
            cut: cut.max(ROUNDING * radius),
        })
    }

    /// The weight, 1 for no residual and down to 0; `None` from the cut on.
    pub(super) fn weight(&self, residual: f64) -> Option<f64> {
        let share = 1.0 - (residual / self.cut).powi(2);
        (share > 0.0).then_some(share * share)
    }
}

/// The cut that makes the estimate 95 % as efficient as least squares where the residuals are Gaussian.
const CUT_SIGMAS: f64 = 4.685;
/// The standard deviation over the median size, for Gaussian residuals.
const MEDIAN_TO_SIGMA: f64 = 1.4826;
/// Smaller residuals over the radius are rounding.
const ROUNDING: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_far_beyond_the_median_weighs_nothing() {
        let tukey = Tukey::of(vec![0.5, 1.0, 1.5, 2.0, 100.0], 1.0).unwrap();
        assert_eq!(tukey.weight(0.0), Some(1.0));
        assert_eq!(tukey.weight(-2.0), tukey.weight(2.0));
        assert!(tukey.weight(1.0) > tukey.weight(2.0) && tukey.weight(2.0) > Some(0.0));
        assert_eq!(tukey.weight(100.0), None);
    }

    #[test]
    fn residuals_that_are_but_rounding_all_count() {
        let tukey = Tukey::of(vec![0.0, 0.0, 1e-12], 1.0).unwrap();
        assert!(tukey.weight(1e-12) > Some(0.99));
        assert!(Tukey::of(Vec::new(), 1.0).is_none());
    }
}
