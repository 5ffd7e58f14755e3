//! How warm the camera is: by the number of its triggers, so that equal runs are equally warm whatever time they take.

/// Warmth of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Thermal {
    /// Seconds of its warm-up that have passed; none where it has been warm for long.
    warming_s: Option<f64>,
    step_s: f64,
}

impl Thermal {
    /// Camera that has been on for long.
    pub(super) fn warm() -> Self {
        Self {
            warming_s: None,
            step_s: 0.0,
        }
    }

    /// Camera that was switched on just now, and is warm after this many triggers.
    pub(super) fn cold(trigger_count: u32) -> Self {
        Self {
            warming_s: Some(0.0),
            step_s: f64::from(WARM_UP_S) / f64::from(trigger_count),
        }
    }

    /// A trigger was accepted.
    pub(super) fn handle_trigger(&mut self) {
        if let Some(warming_s) = &mut self.warming_s {
            *warming_s += self.step_s;
        }
    }

    /// Seconds of the warm-up that are done, at most [`WARM_UP_S`].
    pub(super) fn warm_up_done_s(&self) -> u32 {
        self.warming_s
            .map_or(WARM_UP_S, |warming_s| (warming_s.round() as u32).min(WARM_UP_S))
    }

    /// Whether the warm-up is done.
    pub(super) fn is_warm(&self) -> bool {
        self.warm_up_done_s() == WARM_UP_S
    }

    /// Projector, camera 1, camera 2, board (unknown).
    pub(super) fn temperature_c(&self) -> [f32; 4] {
        let missing = self
            .warming_s
            .map_or(0.0, |warming_s| (-warming_s / TIME_CONSTANT_S).exp());
        let projector_c = WARM_C - (WARM_C - COLD_C) * missing;
        let camera_c = |lag_c: f64| (projector_c - lag_c * (1.0 - missing)) as f32;
        [
            projector_c as f32,
            camera_c(CAMERA_1_LAG_C),
            camera_c(CAMERA_2_LAG_C),
            f32::NAN,
        ]
    }
}

/// Warm-up that is asked for: what an integrator of an A5000 waits (*sourced*, one user).
pub(super) const WARM_UP_S: u32 = 2400;
/// How fast the warmth comes (*assumed*).
const TIME_CONSTANT_S: f64 = 720.0;
/// Where the projector starts and ends (*assumed*; the rate is that of another maker's camera).
const COLD_C: f64 = 25.0;
const WARM_C: f64 = 45.0;
/// How much cooler the cameras end than the projector (*assumed*).
const CAMERA_1_LAG_C: f64 = 5.5;
const CAMERA_2_LAG_C: f64 = 5.25;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warm_camera_stays_as_it_is() {
        let mut thermal = Thermal::warm();
        let before_c = thermal.temperature_c();
        thermal.handle_trigger();
        assert_eq!(before_c[..3], thermal.temperature_c()[..3]);
        assert_eq!((before_c[0], thermal.warm_up_done_s()), (45.0, 2400));
    }

    #[test]
    fn a_cold_camera_is_warm_after_its_triggers_and_never_cools() {
        let mut thermal = Thermal::cold(10);
        assert_eq!(thermal.temperature_c()[..3], [25.0; 3]);
        for done in 0..10 {
            assert_eq!((thermal.warm_up_done_s(), thermal.is_warm()), (240 * done, false));
            let before_c = thermal.temperature_c();
            thermal.handle_trigger();
            let rise_c = thermal.temperature_c()[0] - before_c[0];
            assert!(rise_c > 0.0 && rise_c < 6.0, "{rise_c}");
        }
        assert!(thermal.is_warm());
        assert!((thermal.temperature_c()[0] - 44.29).abs() < 0.01);
    }
}
