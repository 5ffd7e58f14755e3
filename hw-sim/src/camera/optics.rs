//! Geometry of the camera head: two cameras and a projector between them.
//!
//! Camera frame: origin at camera 1's centre of projection, x right, y down, z away from the camera, mm. The sensor's
//! grid is *sourced* (1440 × 1080, sheet 1.2); the three presets are *assumed*: distances and focal lengths such that the
//! point spacing at the nominal distance is that of a family member (0.04, 0.20, 0.45 mm), a baseline that gives a
//! triangulation angle of about 22° there, and no lens distortion.

use nalgebra::{Isometry3, Point2, Point3, Vector3};

/// A pinhole model of the whole head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// Name of the preset.
    pub name: &'static str,
    /// Focal length in pixels of the full grid.
    pub focal_px: f64,
    /// Where camera 1's axis meets the sensor, in pixels of the full grid; the centre of the first pixel is (0, 0).
    pub principal_px: Point2<f64>,
    /// Nearest distance along z that the camera measures, mm.
    pub near_mm: f64,
    /// Distance of the best focus, mm.
    pub nominal_mm: f64,
    /// Farthest distance along z that the camera measures, mm.
    pub far_mm: f64,
    /// Camera 2's centre of projection in the camera frame, mm. Its field is taken to cover camera 1's.
    pub camera_2_mm: Point3<f64>,
    /// The projector's centre of projection in the camera frame, mm.
    pub projector_mm: Point3<f64>,
}

impl Optics {
    /// Names of the presets, from the finest.
    pub const NAMES: [&'static str; 3] = ["fine", "medium", "wide"];

    /// The preset of that name; `None` for any other text.
    pub fn from_name(name: &str) -> Option<Optics> {
        match name {
            "fine" => Some(Optics::fine()),
            "medium" => Some(Optics::medium()),
            "wide" => Some(Optics::wide()),
            _ => None,
        }
    }

    /// 0.04 mm spacing at 280 mm: field 57.6 × 43.2 mm.
    pub fn fine() -> Optics {
        Optics::preset("fine", 0.04, [230.0, 280.0, 330.0])
    }

    /// 0.20 mm spacing at 600 mm: field 288 × 216 mm.
    pub fn medium() -> Optics {
        Optics::preset("medium", 0.20, [400.0, 600.0, 800.0])
    }

    /// 0.45 mm spacing at 1200 mm: field 648 × 486 mm.
    pub fn wide() -> Optics {
        Optics::preset("wide", 0.45, [850.0, 1200.0, 1550.0])
    }

    /// Distance between neighbouring points of the full grid at a depth, mm, on a surface across the axis.
    pub fn spacing_mm(&self, depth_mm: f64) -> f64 {
        depth_mm / self.focal_px
    }

    /// Direction of the ray through a sensor position in pixels of the full grid, scaled to z = 1.
    pub fn ray(&self, sensor_px: Point2<f64>) -> Vector3<f64> {
        let offset = (sensor_px - self.principal_px) / self.focal_px;
        Vector3::new(offset.x, offset.y, 1.0)
    }

    /// Where camera 1 sees a point (camera frame, mm), in pixels of the full grid; `None` at or behind the camera.
    pub fn project(&self, point_mm: &Point3<f64>) -> Option<Point2<f64>> {
        (point_mm.z > 0.0).then(|| self.principal_px + point_mm.xy().coords * (self.focal_px / point_mm.z))
    }

    /// Whether all points (blade frame, mm) lie in the full field of view and within the measured range.
    pub fn covers(&self, camera_from_blade: &Isometry3<f64>, points_mm: &[Point3<f64>]) -> bool {
        points_mm.iter().all(|point| {
            let point_mm = camera_from_blade * point;
            let within = |value: f64, count: u32| (-0.5..=f64::from(count) - 0.5).contains(&value);
            (self.near_mm..=self.far_mm).contains(&point_mm.z)
                && self
                    .project(&point_mm)
                    .is_some_and(|seen| within(seen.x, SENSOR_WIDTH_PX) && within(seen.y, SENSOR_HEIGHT_PX))
        })
    }

    fn preset(name: &'static str, spacing_mm: f64, [near_mm, nominal_mm, far_mm]: [f64; 3]) -> Optics {
        let baseline_mm = BASELINE_FRACTION * nominal_mm;
        Optics {
            name,
            focal_px: nominal_mm / spacing_mm,
            principal_px: Point2::new(
                f64::from(SENSOR_WIDTH_PX - 1) / 2.0,
                f64::from(SENSOR_HEIGHT_PX - 1) / 2.0,
            ),
            near_mm,
            nominal_mm,
            far_mm,
            camera_2_mm: Point3::new(baseline_mm, 0.0, 0.0),
            projector_mm: Point3::new(baseline_mm / 2.0, 0.0, 0.0),
        }
    }
}

/// Columns of the full grid, *sourced* (sheet 1.2).
pub const SENSOR_WIDTH_PX: u32 = 1440;
/// Rows of the full grid, *sourced* (sheet 1.2).
pub const SENSOR_HEIGHT_PX: u32 = 1080;
/// Distance of the cameras as a share of the nominal distance: 22° between their rays there. *Assumed*.
const BASELINE_FRACTION: f64 = 0.40;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_have_the_stated_spacing_and_a_triangulation_angle_of_20_to_25_degrees() {
        for (name, spacing_mm) in [("fine", 0.04), ("medium", 0.20), ("wide", 0.45)] {
            let optics = Optics::from_name(name).unwrap();
            assert_eq!(optics.name, name);
            assert!((optics.spacing_mm(optics.nominal_mm) - spacing_mm).abs() < 1e-12);
            let angle_deg = (optics.camera_2_mm.x / optics.nominal_mm).atan().to_degrees();
            assert!((20.0..25.0).contains(&angle_deg), "{angle_deg}");
        }
        assert!(Optics::from_name("narrow").is_none());
    }

    #[test]
    fn a_point_on_a_ray_is_seen_where_the_ray_left() {
        let optics = Optics::medium();
        let sensor_px = Point2::new(31.0, 1002.5);
        let seen = optics.project(&Point3::from(optics.ray(sensor_px) * 543.0)).unwrap();
        assert!((seen - sensor_px).norm() < 1e-9);
        assert!(optics.project(&Point3::new(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn points_beyond_the_field_or_the_range_are_not_covered() {
        let (optics, shift) = (Optics::medium(), Isometry3::translation(0.0, 0.0, 600.0));
        assert!(optics.covers(&shift, &[Point3::new(140.0, 100.0, 0.0)]));
        assert!(!optics.covers(&shift, &[Point3::new(150.0, 100.0, 0.0)]));
        assert!(!optics.covers(&shift, &[Point3::new(0.0, 0.0, 201.0)]));
    }
}
