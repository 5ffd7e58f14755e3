//! Platform slab and root block under an airfoil.

use super::{Mesh, tube_with_fan_caps, tube_with_strip_caps};
use nalgebra::{Point2, Point3, Rotation2, Vector2};
use std::f64::consts::{FRAC_PI_2, PI};

/// A slab whose top is z = 0: a parallelogram with rounded corners and edges.
#[derive(Debug, Clone, Copy)]
pub(super) struct Platform {
    pub(super) centre_mm: Vector2<f64>,
    /// Length along x.
    pub(super) length_mm: f64,
    /// Width along y.
    pub(super) width_mm: f64,
    /// Angle by which the long sides lean from x towards -y.
    pub(super) skew_rad: f64,
    pub(super) thickness_mm: f64,
    pub(super) corner_radius_mm: f64,
    /// Radius of the edges between top, side and bottom; less than the corner radius and half the thickness.
    pub(super) edge_radius_mm: f64,
}

impl Platform {
    pub(super) fn mesh(&self) -> Mesh {
        let top = self.faces(0.0, 1.0);
        let mut rings: Vec<_> = self.faces(-self.thickness_mm, -1.0);
        rings.reverse();
        rings.extend(top);
        let centre = |z_mm| Point3::new(self.centre_mm.x, self.centre_mm.y, z_mm);
        tube_with_fan_caps(centre(-self.thickness_mm), &rings, centre(0.0))
    }

    /// Whether a point of the xy plane lies within the flat part of the top.
    #[cfg(test)]
    pub(super) fn carries(&self, point: Point2<f64>) -> bool {
        let outline = self.outline(self.edge_radius_mm);
        (0..outline.len()).all(|i| {
            let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
            (b - a).perp(&(point - a)) >= 0.0
        })
    }

    /// Rings of one face, from its outer edge inward; `side` is +1 for the top and -1 for the bottom.
    fn faces(&self, z_mm: f64, side: f64) -> Vec<Vec<Point3<f64>>> {
        let edge_mm = self.edge_radius_mm;
        let mut rings = Vec::new();
        for step in 0..=EDGE_COUNT {
            let angle_rad = FRAC_PI_2 * step as f64 / EDGE_COUNT as f64;
            let ring_z_mm = z_mm - side * edge_mm * (1.0 - angle_rad.sin());
            rings.push(raise(&self.outline(edge_mm * (1.0 - angle_rad.cos())), ring_z_mm));
        }
        let inner = self.outline(edge_mm);
        let centre = Point2::from(self.centre_mm);
        for step in 1..FACE_COUNT {
            let scale = 1.0 - step as f64 / FACE_COUNT as f64;
            let shrunk: Vec<_> = inner.iter().map(|point| centre + (point - centre) * scale).collect();
            rings.push(raise(&shrunk, z_mm));
        }
        rings
    }

    /// The outline moved inward by `inset_mm`, counter-clockwise seen from above.
    fn outline(&self, inset_mm: f64) -> Vec<Point2<f64>> {
        let (half_length_mm, half_width_mm) = (
            self.length_mm / 2.0 - self.corner_radius_mm,
            self.width_mm / 2.0 - self.corner_radius_mm,
        );
        let corners = [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(x, y)| {
            let x_mm = x * half_length_mm;
            Point2::new(x_mm, y * half_width_mm - x_mm * self.skew_rad.tan()) + self.centre_mm
        });
        let outward = |k: usize| {
            let side = corners[(k + 1) % 4] - corners[k];
            Vector2::new(side.y, -side.x).normalize()
        };
        let mut outline = Vec::new();
        for k in 0..4 {
            let (from, to) = (outward((k + 3) % 4), outward(k));
            let turn_rad = from.perp(&to).atan2(from.dot(&to));
            let radius_mm = self.corner_radius_mm - inset_mm;
            for step in 0..=CORNER_COUNT {
                let direction = Rotation2::new(turn_rad * step as f64 / CORNER_COUNT as f64) * from;
                outline.push(corners[k] + direction * radius_mm);
            }
            for step in 1..SIDE_COUNT {
                let along = (corners[(k + 1) % 4] - corners[k]) * (step as f64 / SIDE_COUNT as f64);
                outline.push(corners[k] + along + to * radius_mm);
            }
        }
        outline
    }
}

/// A root block under the platform: a fir-tree profile drawn along a horizontal, skewed direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Root {
    pub(super) centre_mm: Vector2<f64>,
    /// Length along the drawing direction.
    pub(super) length_mm: f64,
    /// Angle of the drawing direction from x towards -y (the broach angle).
    pub(super) skew_rad: f64,
    /// The block spans from `top_mm` (inside the platform) down by `height_mm`.
    pub(super) top_mm: f64,
    pub(super) height_mm: f64,
    /// Half width of the profile without lobes: at the top and at the bottom.
    pub(super) half_width_top_mm: f64,
    pub(super) half_width_bottom_mm: f64,
    /// Number and depth of the lobes on each flank; those of the right flank sit lower by `lobe_shift_fraction` of a pitch.
    pub(super) lobe_count: f64,
    pub(super) lobe_mm: f64,
    pub(super) lobe_shift_fraction: f64,
}

impl Root {
    pub(super) fn mesh(&self) -> Mesh {
        let along = Rotation2::new(-self.skew_rad) * Vector2::x();
        let across = Vector2::new(-along.y, along.x);
        let profile = self.profile();
        let rings: Vec<Vec<_>> = (0..=DRAW_COUNT)
            .map(|step| {
                let along_mm = self.length_mm * (step as f64 / DRAW_COUNT as f64 - 0.5);
                profile
                    .iter()
                    .map(|&(across_mm, z_mm)| {
                        let flat = self.centre_mm + along * along_mm + across * across_mm;
                        Point3::new(flat.x, flat.y, z_mm)
                    })
                    .collect()
            })
            .collect();
        tube_with_strip_caps(&rings)
    }

    /// Points (across, z) in mm, counter-clockwise seen against the drawing direction: up the +across flank, down the other.
    fn profile(&self) -> Vec<(f64, f64)> {
        let z_at = |t: f64| self.top_mm - self.height_mm * (1.0 - t);
        let flank = |step: usize, shift: f64| {
            let t = (1.0 - (PI * step as f64 / FLANK_COUNT as f64).cos()) / 2.0;
            (self.half_width_mm(t, shift), z_at(t))
        };
        let mut profile = vec![(0.0, z_at(0.0))];
        profile.extend((1..FLANK_COUNT).map(|step| flank(step, 0.0)));
        profile.push((0.0, z_at(1.0)));
        profile.extend((1..FLANK_COUNT).rev().map(|step| {
            let (across_mm, z_mm) = flank(step, self.lobe_shift_fraction);
            (-across_mm, z_mm)
        }));
        profile
    }

    /// Half width at height `t` (0 bottom, 1 top): a taper, lobes that fade towards the neck, and a rounded bottom.
    fn half_width_mm(&self, t: f64, lobe_shift: f64) -> f64 {
        let taper_mm = self.half_width_bottom_mm + (self.half_width_top_mm - self.half_width_bottom_mm) * t;
        let fade = (1.0 - t / NECK_START).max(0.0).sqrt().min(1.0);
        let phase = t / NECK_START * self.lobe_count + lobe_shift;
        let lobe_mm = self.lobe_mm * (0.5 - 0.5 * (2.0 * PI * phase).cos()) * fade;
        let round = (1.0 - (1.0 - t / BOTTOM_ROUND).max(0.0).powi(2)).sqrt();
        (taper_mm + lobe_mm) * round
    }
}

fn raise(outline: &[Point2<f64>], z_mm: f64) -> Vec<Point3<f64>> {
    outline
        .iter()
        .map(|point| Point3::new(point.x, point.y, z_mm))
        .collect()
}

/// Steps of the platform's mesh: edge rounding, rings across a face, each corner, each side.
const EDGE_COUNT: usize = 6;
const FACE_COUNT: usize = 8;
const CORNER_COUNT: usize = 14;
const SIDE_COUNT: usize = 12;
/// Steps of the root's mesh: each flank, the drawing direction.
const FLANK_COUNT: usize = 160;
const DRAW_COUNT: usize = 10;
/// Height, as a share of the root's, where the lobes end; and below which the bottom rounds off.
const NECK_START: f64 = 0.72;
const BOTTOM_ROUND: f64 = 0.10;
