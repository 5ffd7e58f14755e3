//! One airfoil section: a parabolic camber line with a thickness distribution laid on both sides.
//!
//! Camber: the quadratic Bézier curve through both edges of the chord with given tangents there. Thickness: the NACA
//! four-digit polynomial with closed trailing edge (Jacobs, Ward, Pinkerton, NACA report 460, 1933), plus a rounded
//! trailing edge of constant radius. The contour runs counter-clockwise, from the leading edge over the pressure side to
//! the trailing edge and back over the suction side, with the chord along +x and the suction side towards +y.

use nalgebra::{Point2, Vector2};
use std::f64::consts::PI;

/// Shape of one section in its own plane, lengths in mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Section {
    /// Distance from leading to trailing edge.
    pub(super) chord_mm: f64,
    /// Angle between chord and camber line at the leading edge, 0 to 80°; 0 at both edges is a symmetric section.
    pub(super) leading_angle_rad: f64,
    /// Angle between chord and camber line at the trailing edge, 0 to 80°. The turning is the sum of both.
    pub(super) trailing_angle_rad: f64,
    /// Greatest thickness as a share of the chord.
    pub(super) thickness_fraction: f64,
    /// Radius of the trailing edge.
    pub(super) trailing_radius_mm: f64,
}

impl Section {
    /// The contour point at `angle_rad` (0 leading edge, π trailing edge, below π the pressure side), with the half
    /// thickness scaled by `thickness_scale` (0 to 1) and the contour moved outward by `flare_mm`.
    pub(super) fn contour_point(&self, angle_rad: f64, thickness_scale: f64, flare_mm: f64) -> Point2<f64> {
        let at = |angle_rad| self.bare_point(angle_rad, thickness_scale);
        if flare_mm == 0.0 {
            return at(angle_rad);
        }
        let tangent = at(angle_rad + DIFFERENCE_RAD) - at(angle_rad - DIFFERENCE_RAD);
        at(angle_rad) + Vector2::new(tangent.y, -tangent.x).normalize() * flare_mm
    }

    /// Centre of the enclosed area, mm, by the shoelace formula over a fine polygon.
    pub(super) fn centroid(&self) -> Point2<f64> {
        let point = |i: usize| {
            self.bare_point(2.0 * PI * i as f64 / CENTROID_POINTS as f64, 1.0)
                .coords
        };
        let (mut doubled_area_mm2, mut moment) = (0.0, Vector2::zeros());
        for i in 0..CENTROID_POINTS {
            let (a, b) = (point(i), point(i + 1));
            let cross_mm2 = a.perp(&b);
            doubled_area_mm2 += cross_mm2;
            moment += (a + b) * cross_mm2;
        }
        Point2::from(moment / (3.0 * doubled_area_mm2))
    }

    fn bare_point(&self, angle_rad: f64, thickness_scale: f64) -> Point2<f64> {
        let s = (1.0 - angle_rad.cos()) / 2.0;
        let side = if angle_rad.sin() >= 0.0 { -1.0 } else { 1.0 };
        let (camber, tangent) = self.camber(s);
        let normal = Vector2::new(-tangent.y, tangent.x).normalize();
        Point2::from(camber + normal * (side * thickness_scale * self.half_thickness_mm(s)))
    }

    /// Position and derivative of the camber line at `s` (0 leading edge, 1 trailing edge), mm.
    fn camber(&self, s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (rise, fall) = (self.leading_angle_rad.tan(), self.trailing_angle_rad.tan());
        let knee_fraction = if rise + fall > 0.0 { fall / (rise + fall) } else { 0.5 };
        let knee = Vector2::new(knee_fraction, knee_fraction * rise) * self.chord_mm;
        let end = Vector2::new(self.chord_mm, 0.0);
        (
            knee * (2.0 * s * (1.0 - s)) + end * (s * s),
            knee * (2.0 * (1.0 - 2.0 * s)) + end * (2.0 * s),
        )
    }

    fn half_thickness_mm(&self, s: f64) -> f64 {
        let polynomial = 0.2969 * s.sqrt() + s * (-0.1260 + s * (-0.3516 + s * (0.2843 - s * 0.1036)));
        let round_share = self.trailing_radius_mm / self.camber(1.0).1.norm();
        let knee = 1.0 - round_share;
        let offset = if s < knee {
            1.0 - s / knee
        } else {
            (s - knee) / round_share
        };
        5.0 * self.thickness_fraction * self.chord_mm * polynomial
            + self.trailing_radius_mm * (1.0 - offset * offset).max(0.0).sqrt()
    }
}

/// Half width of the central difference that gives the contour's normal.
const DIFFERENCE_RAD: f64 = 1e-5;
/// Corners of the polygon whose centroid stands for that of the section.
const CENTROID_POINTS: usize = 256;

#[cfg(test)]
mod tests {
    use super::*;

    fn symmetric() -> Section {
        Section {
            chord_mm: 100.0,
            leading_angle_rad: 0.0,
            trailing_angle_rad: 0.0,
            thickness_fraction: 0.12,
            trailing_radius_mm: 0.01,
        }
    }

    #[test]
    fn a_symmetric_section_has_the_published_thickness_of_naca_0012() {
        // Abbott and von Doenhoff, appendix I: half thickness 4.683 % of the chord at 10 %, 6.002 % at 30 %.
        for (station, half_mm) in [(0.1_f64, 4.683), (0.3, 6.002)] {
            let angle_rad = (1.0 - 2.0 * station).acos();
            let point = symmetric().contour_point(-angle_rad, 1.0, 0.0);
            assert!((point.x - 100.0 * station).abs() < 1e-9);
            assert!((point.y - half_mm).abs() < 0.015, "{point}");
        }
    }

    #[test]
    fn the_camber_line_leaves_the_edges_at_the_given_angles() {
        let section = Section {
            leading_angle_rad: 1.0,
            trailing_angle_rad: 0.7,
            thickness_fraction: 0.0,
            ..symmetric()
        };
        let (leading, trailing) = (section.camber(0.0).1, section.camber(1.0).1);
        assert!((leading.y.atan2(leading.x) - 1.0).abs() < 1e-12);
        assert!((trailing.y.atan2(trailing.x) + 0.7).abs() < 1e-12);
    }

    #[test]
    fn the_centroid_of_a_symmetric_section_lies_on_the_chord() {
        let centroid = symmetric().centroid();
        assert!(centroid.y.abs() < 1e-9 && (centroid.x - 42.0).abs() < 1.0, "{centroid}");
    }

    #[test]
    fn a_flare_moves_the_whole_contour_outward_by_its_size() {
        for step in 0..24 {
            let angle_rad = 0.01 + 2.0 * PI * f64::from(step) / 24.0;
            let bare = symmetric().contour_point(angle_rad, 1.0, 0.0);
            let flared = symmetric().contour_point(angle_rad, 1.0, 2.0);
            assert!(((flared - bare).norm() - 2.0).abs() < 1e-9);
            assert!((flared - Point2::new(42.0, 0.0)).norm() > (bare - Point2::new(42.0, 0.0)).norm());
        }
    }
}
