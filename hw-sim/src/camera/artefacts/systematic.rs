//! Errors that are the same in every frame of one camera, or drift slowly (camera sheet 4.2 step 10).
//!
//! They are clocked by the trigger, not by a clock: view i of a run is taken [`CYCLE_S`] after view i - 1, as is a retake.

use super::super::optics::{Optics, SENSOR_HEIGHT_PX, SENSOR_WIDTH_PX};
use super::super::surface::{Term, Terms};
use crate::draws::{Purpose, generator, uniform};
use nalgebra::{Point2, Point3};

/// The systematic error of one frame.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Systematic {
    /// Error of all distances from camera 1, share.
    scale: f64,
    /// Peak to valley of the bowl, mm.
    bowl_mm: f64,
    middle_px: Point2<f64>,
}

impl Systematic {
    pub(in super::super) fn new(terms: Terms, optics: &Optics, trigger_id: u64) -> Systematic {
        let on = |term: Term, value: f64| if terms.has(term) { value } else { 0.0 };
        let mut rng = generator(DEVICE, Purpose::Device, 0, 0);
        let fixed = SCALE_MAX * (2.0 * uniform(&mut rng) - 1.0);
        let trigger_count = (trigger_id >> 16) + (trigger_id & 0xffff);
        let warm_up = WARM_UP_SCALE * (-(trigger_count as f64) * CYCLE_S / WARM_UP_S).exp();
        Systematic {
            scale: on(Term::Scale, fixed) + on(Term::WarmUp, warm_up),
            bowl_mm: on(Term::Bowl, BOWL_SPACINGS * optics.spacing_mm(optics.nominal_mm)),
            middle_px: optics.principal_px,
        }
    }

    /// The point as this camera finds it; the same bits when no systematic term is on.
    pub(in super::super) fn apply(&self, point_mm: Point3<f64>, sensor_px: Point2<f64>) -> Point3<f64> {
        if self.scale == 0.0 && self.bowl_mm == 0.0 {
            return point_mm;
        }
        let corner_px = Point2::new(f64::from(SENSOR_WIDTH_PX), f64::from(SENSOR_HEIGHT_PX)).coords / 2.0;
        let share = (sensor_px - self.middle_px).norm_squared() / corner_px.norm_squared();
        let bowl_mm = self.bowl_mm * (share - 0.5);
        point_mm + point_mm.coords * self.scale + point_mm.coords.normalize() * bowl_mm
    }
}

/// Which camera it is; its fixed errors are drawn from it and not from the seed of a run.
const DEVICE: u64 = 1;
/// Greatest fixed error of the scale, *sourced* (1.25 to 2 per mille).
const SCALE_MAX: f64 = 1.25e-3;
/// Peak to valley of the bowl in spacings: 0.16 mm for wide optics (0.10 to 0.22 mm *sourced*); that it scales is *assumed*.
const BOWL_SPACINGS: f64 = 0.36;
/// Error of the scale when the camera is switched on, with the first trigger. *Assumed*.
const WARM_UP_SCALE: f64 = 0.5e-3;
/// Time in which it falls to 1/e. *Assumed*.
const WARM_UP_S: f64 = 720.0;
/// Time from trigger to trigger. *Assumed*.
const CYCLE_S: f64 = 10.0;
