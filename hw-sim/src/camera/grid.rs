//! The delivered grid and where its pixels lie on the sensor.

use super::capture::Capture;
use super::noise::Window;
use super::optics::{Optics, SENSOR_HEIGHT_PX, SENSOR_WIDTH_PX};
use nalgebra::{Isometry3, Point2, Point3};

#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    pub(super) width_px: usize,
    pub(super) height_px: usize,
    offset_px: [f64; 2],
    /// Sensor pixels per delivered pixel, along each axis.
    pub(super) step: f64,
}

impl Grid {
    pub(super) fn new(capture: &Capture) -> Grid {
        if capture.binning {
            let [width_px, height_px] = [SENSOR_WIDTH_PX as usize / 2, SENSOR_HEIGHT_PX as usize / 2];
            // The middle of the sensor pixels 0 and 1.
            return Grid {
                width_px,
                height_px,
                offset_px: [0.5, 0.5],
                step: 2.0,
            };
        }
        Grid {
            width_px: capture.roi.width_px as usize,
            height_px: capture.roi.height_px as usize,
            offset_px: [f64::from(capture.roi.offset_x_px), f64::from(capture.roi.offset_y_px)],
            step: 1.0,
        }
    }

    pub(super) fn sensor_px(&self, column: usize, row: usize) -> Point2<f64> {
        Point2::new(
            self.offset_px[0] + self.step * column as f64,
            self.offset_px[1] + self.step * row as f64,
        )
    }

    /// The pixels that can see a box, given by its corners (blade frame); all of them when part of it is beside or behind the
    /// camera, `None` when it cannot be seen.
    pub(super) fn window(
        &self,
        optics: &Optics,
        camera_from_blade: &Isometry3<f64>,
        corners: &[Point3<f64>],
    ) -> Option<Window> {
        let corners: Vec<Point3<f64>> = corners.iter().map(|corner| camera_from_blade * corner).collect();
        if corners.iter().all(|corner| corner.z <= 0.0) {
            return None;
        }
        let seen: Option<Vec<Point2<f64>>> = corners.iter().map(|corner| optics.project(corner)).collect();
        let Some(seen) = seen else {
            return Some(Window {
                x_px: [0, self.width_px],
                y_px: [0, self.height_px],
            });
        };
        let range = |axis: usize, count: usize| {
            let values = seen
                .iter()
                .map(|sensor_px| (sensor_px[axis] - self.offset_px[axis]) / self.step);
            let low = values.clone().fold(f64::INFINITY, f64::min).floor().max(0.0);
            let high = values.fold(f64::NEG_INFINITY, f64::max).ceil() + 1.0;
            [low.min(count as f64) as usize, high.clamp(0.0, count as f64) as usize]
        };
        let window = Window {
            x_px: range(0, self.width_px),
            y_px: range(1, self.height_px),
        };
        (window.x_px[0] < window.x_px[1] && window.y_px[0] < window.y_px[1]).then_some(window)
    }
}
