//! The dimensions of the built-in blades. All are *assumed*: proportions of published turbine blades, no real part.

use super::Mesh;
use super::airfoil::{Airfoil, Along, Foot};
use super::foot::{Platform, Root};
use nalgebra::Vector2;

/// A blade: airfoil, and for high-pressure blades what carries it. z = 0 is the airfoil's foot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Design {
    pub(super) airfoil: Airfoil,
    pub(super) carrier: Option<Carrier>,
}

/// Platform and root, and the annulus that bends them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Carrier {
    pub(super) platform: Platform,
    pub(super) root: Root,
    /// Radius of the flow channel: surfaces z = constant become cylinders about an axis along x at this distance.
    pub(super) annulus_radius_mm: f64,
    /// Rise of the flow channel along x, mm per mm.
    pub(super) annulus_slope: f64,
}

impl Design {
    /// The surface, with z = 0 at the airfoil's foot.
    pub(super) fn mesh(&self) -> Mesh {
        let mut mesh = self.airfoil.mesh();
        if let Some(carrier) = &self.carrier {
            mesh.append(carrier.platform.mesh());
            mesh.append(carrier.root.mesh());
            for point in &mut mesh.vertices {
                point.z += carrier.annulus_slope * point.x - point.y * point.y / (2.0 * carrier.annulus_radius_mm);
            }
        }
        mesh
    }
}

pub(super) fn lpt() -> Design {
    Design {
        airfoil: Airfoil {
            span_mm: 470.0,
            chord_mm: Along {
                foot: 90.0,
                tip: 60.0,
                bow: -2.0,
            },
            leading_angle_rad: Along::linear(rad(45.0), rad(18.0)),
            trailing_angle_rad: Along::linear(rad(38.0), rad(20.0)),
            thickness_fraction: Along::linear(0.11, 0.06),
            trailing_radius_mm: 0.45,
            stagger_rad: Along {
                foot: rad(8.0),
                tip: rad(50.0),
                bow: rad(3.0),
            },
            lean_x_mm: Along {
                foot: -3.0,
                tip: 3.0,
                bow: 1.5,
            },
            lean_y_mm: Along {
                foot: -6.0,
                tip: 6.0,
                bow: 4.0,
            },
            foot: Foot::Rounded,
            tip_round_mm: 3.0,
            tip_round_fraction: 0.9,
            contour_count: 300,
            span_count: 100,
        },
        carrier: None,
    }
}

pub(super) fn hpt_a() -> Design {
    Design {
        airfoil: Airfoil {
            span_mm: 29.0,
            chord_mm: Along {
                foot: 22.0,
                tip: 19.5,
                bow: 0.0,
            },
            leading_angle_rad: Along::linear(rad(58.0), rad(48.0)),
            trailing_angle_rad: Along::linear(rad(47.0), rad(45.0)),
            thickness_fraction: Along::linear(0.20, 0.14),
            trailing_radius_mm: 0.28,
            stagger_rad: Along::linear(rad(12.0), rad(26.0)),
            lean_x_mm: Along::linear(-0.3, 0.3),
            lean_y_mm: Along {
                foot: -0.6,
                tip: 0.4,
                bow: 0.3,
            },
            foot: Foot::Fillet {
                radius_mm: 1.5,
                embed_mm: 1.6,
            },
            tip_round_mm: 0.3,
            tip_round_fraction: 0.06,
            contour_count: 350,
            span_count: 40,
        },
        carrier: Some(Carrier {
            platform: Platform {
                centre_mm: Vector2::new(0.6, -1.2),
                length_mm: 27.0,
                width_mm: 17.0,
                skew_rad: rad(14.0),
                thickness_mm: 2.8,
                corner_radius_mm: 1.0,
                edge_radius_mm: 0.25,
            },
            root: Root {
                centre_mm: Vector2::new(-0.6, -0.9),
                length_mm: 22.0,
                skew_rad: rad(9.0),
                top_mm: -1.2,
                height_mm: 19.0,
                half_width_top_mm: 3.6,
                half_width_bottom_mm: 2.4,
                lobe_count: 2.0,
                lobe_mm: 1.9,
                lobe_shift_fraction: 0.06,
            },
            annulus_radius_mm: 160.0,
            annulus_slope: 0.03,
        }),
    }
}

pub(super) fn hpt_b() -> Design {
    Design {
        airfoil: Airfoil {
            span_mm: 74.0,
            chord_mm: Along {
                foot: 46.0,
                tip: 38.0,
                bow: 0.5,
            },
            leading_angle_rad: Along::linear(rad(56.0), rad(38.0)),
            trailing_angle_rad: Along::linear(rad(45.0), rad(40.0)),
            thickness_fraction: Along::linear(0.19, 0.11),
            trailing_radius_mm: 0.4,
            stagger_rad: Along {
                foot: rad(10.0),
                tip: rad(36.0),
                bow: rad(2.0),
            },
            lean_x_mm: Along::linear(-1.0, 1.0),
            lean_y_mm: Along {
                foot: -1.5,
                tip: 1.5,
                bow: 1.0,
            },
            foot: Foot::Fillet {
                radius_mm: 3.0,
                embed_mm: 3.5,
            },
            tip_round_mm: 0.5,
            tip_round_fraction: 0.05,
            contour_count: 440,
            span_count: 56,
        },
        carrier: Some(Carrier {
            platform: Platform {
                centre_mm: Vector2::new(1.0, -2.0),
                length_mm: 56.0,
                width_mm: 36.0,
                skew_rad: rad(12.0),
                thickness_mm: 6.0,
                corner_radius_mm: 2.0,
                edge_radius_mm: 0.5,
            },
            root: Root {
                centre_mm: Vector2::new(-1.5, -2.5),
                length_mm: 48.0,
                skew_rad: rad(7.0),
                top_mm: -2.5,
                height_mm: 38.0,
                half_width_top_mm: 8.5,
                half_width_bottom_mm: 4.5,
                lobe_count: 3.0,
                lobe_mm: 3.6,
                lobe_shift_fraction: 0.05,
            },
            annulus_radius_mm: 420.0,
            annulus_slope: 0.05,
        }),
    }
}

pub(super) fn hpt_c() -> Design {
    Design {
        airfoil: Airfoil {
            span_mm: 43.5,
            chord_mm: Along {
                foot: 32.0,
                tip: 34.0,
                bow: -1.0,
            },
            leading_angle_rad: Along::linear(rad(44.0), rad(52.0)),
            trailing_angle_rad: Along::linear(rad(46.0), rad(38.0)),
            thickness_fraction: Along::linear(0.22, 0.16),
            trailing_radius_mm: 0.35,
            stagger_rad: Along {
                foot: rad(30.0),
                tip: rad(16.0),
                bow: rad(-2.0),
            },
            lean_x_mm: Along {
                foot: 0.6,
                tip: -0.6,
                bow: -0.8,
            },
            lean_y_mm: Along {
                foot: 0.8,
                tip: -0.8,
                bow: -1.6,
            },
            foot: Foot::Fillet {
                radius_mm: 2.2,
                embed_mm: 2.4,
            },
            tip_round_mm: 0.4,
            tip_round_fraction: 0.08,
            contour_count: 400,
            span_count: 40,
        },
        carrier: Some(Carrier {
            platform: Platform {
                centre_mm: Vector2::new(-0.5, -0.6),
                length_mm: 38.0,
                width_mm: 24.0,
                skew_rad: rad(31.0),
                thickness_mm: 4.5,
                corner_radius_mm: 1.5,
                edge_radius_mm: 0.4,
            },
            root: Root {
                centre_mm: Vector2::new(1.0, 0.8),
                length_mm: 34.0,
                skew_rad: rad(24.0),
                top_mm: -2.0,
                height_mm: 27.5,
                half_width_top_mm: 4.0,
                half_width_bottom_mm: 7.0,
                lobe_count: 1.0,
                lobe_mm: 2.4,
                lobe_shift_fraction: 0.10,
            },
            annulus_radius_mm: 240.0,
            annulus_slope: -0.06,
        }),
    }
}

fn rad(angle_deg: f64) -> f64 {
    angle_deg.to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fillet_of_every_high_pressure_blade_lands_on_its_platform() {
        for (name, design) in [("hpt-a", hpt_a()), ("hpt-b", hpt_b()), ("hpt-c", hpt_c())] {
            let platform = design.carrier.unwrap().platform;
            for point in design.airfoil.mesh().vertices.iter().filter(|point| point.z <= 0.0) {
                assert!(platform.carries(point.xy()), "{name}: {point}");
            }
        }
    }
}
