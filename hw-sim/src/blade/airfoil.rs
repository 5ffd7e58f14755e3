//! The airfoil: sections stacked along z with taper, twist and lean, and their ends.

use super::section::Section;
use super::{Mesh, tube_with_strip_caps};
use nalgebra::{Point3, Rotation2, Vector2};
use std::f64::consts::{FRAC_PI_2, PI};

/// A quantity along the span: linear from foot to tip, plus a parabola that vanishes at both.
#[derive(Debug, Clone, Copy)]
pub(super) struct Along {
    pub(super) foot: f64,
    pub(super) tip: f64,
    /// Deviation from the straight line at half span.
    pub(super) bow: f64,
}

impl Along {
    pub(super) fn linear(foot: f64, tip: f64) -> Along {
        Along { foot, tip, bow: 0.0 }
    }

    fn at(&self, fraction: f64) -> f64 {
        self.foot + (self.tip - self.foot) * fraction + self.bow * 4.0 * fraction * (1.0 - fraction)
    }
}

/// How the airfoil starts at z = 0.
#[derive(Debug, Clone, Copy)]
pub(super) enum Foot {
    /// A closed, rounded end like the tip.
    Rounded,
    /// A circular fillet into a platform whose top is z = 0, going on below it.
    Fillet { radius_mm: f64, embed_mm: f64 },
}

/// A lofted airfoil from z = 0 to z = `span_mm`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Airfoil {
    pub(super) span_mm: f64,
    pub(super) chord_mm: Along,
    pub(super) leading_angle_rad: Along,
    pub(super) trailing_angle_rad: Along,
    pub(super) thickness_fraction: Along,
    pub(super) trailing_radius_mm: f64,
    /// Angle by which the chord is turned from +x towards -y.
    pub(super) stagger_rad: Along,
    /// Where the section's centroid lies.
    pub(super) lean_x_mm: Along,
    pub(super) lean_y_mm: Along,
    pub(super) foot: Foot,
    /// Height over which the thickness rounds off at a free end, and the share of the thickness that goes.
    pub(super) tip_round_mm: f64,
    pub(super) tip_round_fraction: f64,
    /// Points around the contour, even; steps along the straight part of the span.
    pub(super) contour_count: usize,
    pub(super) span_count: usize,
}

/// One level of the loft.
#[derive(Debug, Clone, Copy)]
struct Station {
    z_mm: f64,
    thickness_scale: f64,
    flare_mm: f64,
}

impl Airfoil {
    pub(super) fn mesh(&self) -> Mesh {
        tube_with_strip_caps(&self.rings(1))
    }

    /// The rings of the loft, with `refine` times the steps in both directions.
    fn rings(&self, refine: usize) -> Vec<Vec<Point3<f64>>> {
        self.stations(refine)
            .iter()
            .map(|station| self.ring(station, self.contour_count * refine))
            .collect()
    }

    fn stations(&self, refine: usize) -> Vec<Station> {
        let steps = |count: usize| (0..count * refine).map(move |i| i as f64 / (count * refine) as f64);
        let free_end = |z_mm: f64, into_end: f64| Station {
            z_mm,
            thickness_scale: 1.0 - self.tip_round_fraction * (1.0 - (into_end * FRAC_PI_2).cos()),
            flare_mm: 0.0,
        };
        let mut stations = Vec::new();
        let body_start_mm = match self.foot {
            Foot::Rounded => {
                for t in steps(END_COUNT) {
                    let rise = 1.0 - ((1.0 - t) * FRAC_PI_2).sin();
                    stations.push(free_end(self.tip_round_mm * rise, 1.0 - t));
                }
                self.tip_round_mm
            }
            Foot::Fillet { radius_mm, embed_mm } => {
                for t in steps(1) {
                    stations.push(Station {
                        z_mm: -embed_mm * (1.0 - t),
                        thickness_scale: 1.0,
                        flare_mm: radius_mm,
                    });
                }
                for t in steps(FILLET_COUNT) {
                    let angle_rad = t * FRAC_PI_2;
                    stations.push(Station {
                        z_mm: radius_mm * (1.0 - angle_rad.cos()),
                        thickness_scale: 1.0,
                        flare_mm: radius_mm * (1.0 - angle_rad.sin()),
                    });
                }
                radius_mm
            }
        };
        let body_end_mm = self.span_mm - self.tip_round_mm;
        for t in steps(self.span_count) {
            stations.push(free_end(body_start_mm + (body_end_mm - body_start_mm) * t, 0.0));
        }
        for t in steps(END_COUNT) {
            stations.push(free_end(body_end_mm + self.tip_round_mm * (t * FRAC_PI_2).sin(), t));
        }
        stations.push(free_end(self.span_mm, 1.0));
        stations
    }

    fn ring(&self, station: &Station, point_count: usize) -> Vec<Point3<f64>> {
        let fraction = (station.z_mm / self.span_mm).max(0.0);
        let section = Section {
            chord_mm: self.chord_mm.at(fraction),
            leading_angle_rad: self.leading_angle_rad.at(fraction),
            trailing_angle_rad: self.trailing_angle_rad.at(fraction),
            thickness_fraction: self.thickness_fraction.at(fraction),
            trailing_radius_mm: self.trailing_radius_mm,
        };
        let centroid = section.centroid();
        let turn = Rotation2::new(-self.stagger_rad.at(fraction));
        let lean = Vector2::new(self.lean_x_mm.at(fraction), self.lean_y_mm.at(fraction));
        (0..point_count)
            .map(|i| {
                let even_rad = 2.0 * PI * i as f64 / point_count as f64;
                let angle_rad = even_rad - EDGE_CROWDING / 2.0 * (2.0 * even_rad).sin();
                let local = section.contour_point(angle_rad, station.thickness_scale, station.flare_mm);
                let placed = turn * (local - centroid) + lean;
                Point3::new(placed.x, placed.y, station.z_mm)
            })
            .collect()
    }
}

/// How much closer the contour's points stand at both edges than on average, as a share.
const EDGE_CROWDING: f64 = 0.5;
/// Steps over a rounded end and over a fillet.
const END_COUNT: usize = 24;
const FILLET_COUNT: usize = 28;

#[cfg(test)]
mod tests {
    use super::super::designs;
    use super::*;

    /// Greatest distance between the middle of a mesh edge and the smooth surface there, among the stations from
    /// `low_mm` to `high_mm`, and where.
    fn greatest_chord_error_mm(airfoil: &Airfoil, low_mm: f64, high_mm: f64) -> (f64, Point3<f64>) {
        let fine = airfoil.rings(2);
        let mut greatest = (0.0, Point3::origin());
        for (j, ring) in fine.iter().enumerate() {
            let n = ring.len();
            for (i, point) in ring.iter().enumerate() {
                let flat = match (i % 2, j % 2) {
                    (1, 0) => nalgebra::center(&ring[i - 1], &ring[(i + 1) % n]),
                    (0, 1) => nalgebra::center(&fine[j - 1][i], &fine[j + 1][i]),
                    (1, 1) => nalgebra::center(&fine[j - 1][i - 1], &fine[j + 1][(i + 1) % n]),
                    _ => continue,
                };
                // Along the skin a shifted middle is harmless: only the part across the skin counts.
                let along_ring = ring[(i + 1) % n] - ring[(i + n - 1) % n];
                let along_span = fine[(j + 1).min(fine.len() - 1)][i] - fine[j.saturating_sub(1)][i];
                let normal = along_ring.cross(&along_span).normalize();
                let error_mm = (flat - point).dot(&normal).abs();
                if (low_mm..=high_mm).contains(&point.z) && error_mm > greatest.0 {
                    greatest = (error_mm, *point);
                }
            }
        }
        greatest
    }

    #[test]
    fn facets_stay_close_to_the_smooth_skin() {
        for (name, design, blade_limit_mm, fillet_limit_mm) in [
            ("lpt", designs::lpt(), 0.010, 0.010),
            ("hpt-a", designs::hpt_a(), 0.002, 0.005),
            ("hpt-b", designs::hpt_b(), 0.003, 0.005),
            ("hpt-c", designs::hpt_c(), 0.002, 0.005),
        ] {
            let fillet_mm = match design.airfoil.foot {
                Foot::Rounded => 0.0,
                Foot::Fillet { radius_mm, .. } => radius_mm,
            };
            for (low_mm, high_mm, limit_mm) in [
                (fillet_mm + 1e-9, 1e3, blade_limit_mm),
                (0.0, fillet_mm, fillet_limit_mm),
            ] {
                let (error_mm, point) = greatest_chord_error_mm(&design.airfoil, low_mm, high_mm);
                assert!(error_mm < limit_mm, "{name}: {error_mm} mm at {point}");
            }
        }
    }
}
