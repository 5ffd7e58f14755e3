//! One pixel by itself: what its rays meet, how it is exposed, and its noise (camera sheet 4.2 steps 1 to 6).

use super::capture::{Capture, WorkingVolume};
use super::frame::{MASK_FILTERED, MASK_LOW_MODULATION, MASK_OCCLUDED, MASK_SATURATED};
use super::grid::Grid;
use super::noise::{Window, holes, share_below, unit_field};
use super::optics::Optics;
use super::radiometry::{Directions, Exposed, Exposure};
use super::surface::{Surface, Term};
use crate::draws::{Draws, Purpose, generator, normal_pair, uniform};
use nalgebra::{Isometry3, Point3, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::TriMesh;

/// A pixel before the terms that look at its neighbours.
#[derive(Debug, Clone, Copy)]
pub(super) struct Site {
    /// Depth of the true point along z, mm; NaN where the ray meets nothing.
    pub(super) depth_mm: f64,
    /// The point with its noise, camera frame, mm.
    pub(super) noisy_mm: Point3<f64>,
    /// Standard deviation of the noise along the ray, mm.
    pub(super) sigma_mm: f64,
    /// Greatest incidence of the rays to the cameras that must see it.
    pub(super) incidence_rad: f64,
    /// How far the mirrored ray of camera 1 goes until it meets the blade again, mm; infinite if it does not.
    pub(super) mirrored_mm: f64,
    /// Brightness in the main pass.
    pub(super) brightness: f64,
    /// The pass that is used, [`SATURATED`] or [`UNSEEN`].
    pub(super) pass: u8,
    /// Why it is invalid; 0 where it is valid or where there is nothing.
    pub(super) mask: u8,
    pub(super) intensity: u8,
    pub(super) confidence: u8,
    /// Whether all that must see it do, within the measured range.
    pub(super) is_seen: bool,
    /// Whether a second bounce lowered its score.
    pub(super) is_bounced: bool,
}

/// Stands for the pass of a pixel that is too bright in all.
pub(super) const SATURATED: u8 = 254;
/// Stands for the pass of a pixel that is not exposed.
pub(super) const UNSEEN: u8 = 255;

impl Site {
    const NOTHING: Site = Site {
        depth_mm: f64::NAN,
        noisy_mm: Point3::new(f64::NAN, f64::NAN, f64::NAN),
        sigma_mm: 0.0,
        incidence_rad: f64::NAN,
        mirrored_mm: f64::INFINITY,
        brightness: 0.0,
        pass: UNSEEN,
        mask: 0,
        intensity: 0,
        confidence: 0,
        is_seen: false,
        is_bounced: false,
    };

    pub(super) fn is_valid(&self) -> bool {
        self.mask == 0 && !self.depth_mm.is_nan()
    }
}

/// What all rows of one frame share.
pub(super) struct Shot<'a> {
    mesh: &'a TriMesh,
    pub(super) surface: &'a Surface,
    pub(super) optics: &'a Optics,
    blade_from_camera: Isometry3<f64>,
    capture: &'a Capture,
    pub(super) draws: Draws,
    pub(super) grid: Grid,
    pub(super) window: Window,
    exposure: Exposure,
    lost: Vec<bool>,
    field: Vec<Vec<f64>>,
    fate: Option<Vec<Vec<f64>>>,
}

/// The random numbers of one pixel, drawn whether it needs them or not.
struct PixelDraws {
    depth: f64,
    lateral_uniform: [f64; 2],
    grazing_uniform: f64,
    lost: bool,
}

impl<'a> Shot<'a> {
    /// `None` when the blade lies beside the field or behind the camera.
    pub(super) fn new(
        mesh: &'a TriMesh,
        surface: &'a Surface,
        optics: &'a Optics,
        camera_from_blade: &Isometry3<f64>,
        capture: &'a Capture,
        draws: Draws,
    ) -> Option<Shot<'a>> {
        let grid = Grid::new(capture);
        let corners = mesh
            .local_aabb()
            .vertices()
            .map(|corner| Point3::new(corner.x, corner.y, corner.z));
        let window = grid.window(optics, camera_from_blade, &corners)?;
        let noise = &surface.noise;
        let has = |term| surface.terms.has(term);
        let dropout_fraction = if has(Term::Dropouts) {
            noise.dropout_fraction
        } else {
            0.0
        };
        let is_compact = has(Term::Incidence) && noise.roll_off_px > 0.0;
        Some(Shot {
            mesh,
            surface,
            optics,
            blade_from_camera: camera_from_blade.inverse(),
            capture,
            draws,
            grid,
            window,
            exposure: Exposure::new(capture, optics, surface.finish, has(Term::Highlights)),
            lost: holes(window, dropout_fraction, draws),
            field: unit_field(window, noise.correlation_px(capture.pre_filtering), draws, PART_DEPTH),
            fate: is_compact.then(|| unit_field(window, noise.roll_off_px, draws, PART_ROLL_OFF)),
        })
    }

    pub(super) fn row(&self, row: usize) -> Vec<Site> {
        let mut rng = generator(self.draws.seed, Purpose::Pixel, self.draws.trigger_id, row as u64);
        let [first, end] = self.window.x_px;
        let window_row = row - self.window.y_px[0];
        let mut sites = Vec::with_capacity(end - first);
        for column in 0..end {
            let [u, v, w] = [(); 3].map(|()| uniform(&mut rng));
            if column >= first {
                let x = column - first;
                let compact = self.fate.as_ref().map(|fate| share_below(fate[window_row][x]));
                let draws = PixelDraws {
                    depth: self.field[window_row][x],
                    lateral_uniform: [u, v],
                    grazing_uniform: compact.unwrap_or(w),
                    lost: self.lost[window_row * self.window.width_px() + x],
                };
                sites.push(self.site(self.ray(column, row), &draws));
            }
        }
        sites
    }

    /// The ray of a delivered pixel, scaled to z = 1.
    pub(super) fn ray(&self, column: usize, row: usize) -> Vector3<f64> {
        self.optics.ray(self.grid.sensor_px(column, row))
    }

    /// Distance between neighbouring delivered pixels at a depth, mm.
    pub(super) fn pixel_mm(&self, depth_mm: f64) -> f64 {
        self.grid.step * self.optics.spacing_mm(depth_mm)
    }

    fn has(&self, term: Term) -> bool {
        self.surface.terms.has(term)
    }

    /// The pixel of one ray, `ray` in the camera frame with z = 1.
    fn site(&self, ray: Vector3<f64>, draws: &PixelDraws) -> Site {
        let blade_ray = Ray::new(
            glam(&self.blade_from_camera.translation.vector),
            glam(&(self.blade_from_camera * ray)),
        );
        let hit = self.mesh.cast_local_ray_and_get_normal(&blade_ray, FARTHEST_MM, false);
        let Some(hit) = hit else {
            return Site::NOTHING;
        };
        let depth_mm = hit.time_of_impact;
        let truth = Point3::from(ray * depth_mm);
        let normal = self.blade_from_camera.inverse_transform_vector(&nalgebra(hit.normal));
        let normal = normal.try_normalize(0.0).unwrap_or(-ray.normalize());
        let is_lit = self.sees(&truth, &normal, &self.optics.projector_mm);
        let in_2 = is_lit && self.sees(&truth, &normal, &self.optics.camera_2_mm);
        let to_camera_2 = self.optics.camera_2_mm - truth;
        let exposed = is_lit.then(|| {
            self.exposure.of(&Directions {
                normal,
                projector_mm: self.optics.projector_mm - truth,
                camera_1: -ray.normalize(),
                camera_2: in_2.then(|| to_camera_2.normalize()),
            })
        });
        let unexposed = Site {
            depth_mm,
            mask: MASK_OCCLUDED,
            intensity: exposed.map_or(INTENSITY_UNLIT, |exposed| self.exposure.grey(exposed.seen)),
            ..Site::NOTHING
        };
        let Some(exposed) = exposed else {
            return unexposed;
        };
        if !in_2 && self.capture.working_volume == WorkingVolume::Standard {
            return unexposed;
        }
        let incidence_rad = normal.angle(&-ray);
        let greatest_incidence_rad = if in_2 {
            incidence_rad.max(normal.angle(&to_camera_2))
        } else {
            incidence_rad
        };
        let mirrored_mm = self.mirrored_mm(&truth, &normal, &ray);
        let is_bounced = self.has(Term::SecondBounce) && mirrored_mm < MIRRORED_MAX_MM;
        let bounced = if is_bounced {
            self.bounced(&exposed, mirrored_mm)
        } else {
            0.0
        };
        let score = exposed.score(bounced);
        // Half the baseline, where the projector stands for camera 2.
        let baseline_factor = if in_2 { 1.0 } else { 2.0 };
        let sigma_mm = self.surface.finish.noise_factor
            * baseline_factor
            * self
                .surface
                .noise
                .depth_sigma_mm(self.optics, depth_mm, incidence_rad, &exposed);
        let is_in_range = (self.optics.near_mm..=self.optics.far_mm).contains(&depth_mm);
        let mut mask = self.failure(greatest_incidence_rad, &exposed, score, draws);
        if !is_in_range {
            mask |= MASK_FILTERED;
        }
        Site {
            noisy_mm: self.noisy(&truth, sigma_mm, draws),
            sigma_mm,
            incidence_rad: greatest_incidence_rad,
            mirrored_mm,
            brightness: exposed.seen,
            pass: if exposed.saturation > 1.0 {
                SATURATED
            } else {
                exposed.pass
            },
            mask,
            confidence: exposed.confidence(score),
            is_seen: is_in_range,
            is_bounced,
            ..unexposed
        }
    }

    /// Brightness of the light that comes by way of the mirrored surface, which is taken to be as bright as this one.
    fn bounced(&self, exposed: &Exposed, mirrored_mm: f64) -> f64 {
        self.surface.finish.mirror_fraction * exposed.brightness * (-mirrored_mm / BOUNCE_REACH_MM).exp()
    }

    /// The mask bits of a pixel that all see; 0 when it is valid.
    fn failure(&self, incidence_rad: f64, exposed: &Exposed, score: f64, draws: &PixelDraws) -> u8 {
        let mut mask = 0;
        if self.has(Term::Score) && exposed.saturation > 1.0 {
            mask |= MASK_SATURATED;
        }
        let is_weak = self.has(Term::Score) && score < f64::from(self.capture.score_threshold);
        let is_grazing =
            self.has(Term::Incidence) && draws.grazing_uniform >= self.surface.noise.valid_probability(incidence_rad);
        if is_weak || is_grazing {
            mask |= MASK_LOW_MODULATION;
        }
        if draws.lost {
            mask |= MASK_FILTERED;
        }
        mask
    }

    fn noisy(&self, truth: &Point3<f64>, sigma_mm: f64, draws: &PixelDraws) -> Point3<f64> {
        if !self.has(Term::Noise) {
            return *truth;
        }
        let along = truth.coords.normalize() * (sigma_mm * draws.depth);
        let [u, v] = draws.lateral_uniform;
        let lateral_mm = self.surface.noise.lateral_fraction * self.optics.spacing_mm(truth.z);
        let [x_mm, y_mm] = normal_pair(u, v).map(|value| value * lateral_mm);
        truth + along + Vector3::new(x_mm, y_mm, 0.0)
    }

    /// Whether the segment from a surface point to a device meets nothing else (camera frame).
    fn sees(&self, point: &Point3<f64>, normal: &Vector3<f64>, device: &Point3<f64>) -> bool {
        let towards = device - point;
        if normal.dot(&towards) <= 0.0 {
            return false;
        }
        !self.has(Term::Shadows)
            || !self
                .mesh
                .intersects_local_ray(&self.leaving(point, normal, &towards), 1.0)
    }

    /// How far the ray of camera 1 goes on once it is mirrored, up to the reach of the second bounce; infinite without one.
    fn mirrored_mm(&self, point: &Point3<f64>, normal: &Vector3<f64>, ray: &Vector3<f64>) -> f64 {
        if self.surface.finish.mirror_fraction == 0.0 || !(self.has(Term::SecondBounce) || self.has(Term::Ghosts)) {
            return f64::INFINITY;
        }
        let ray = ray.normalize();
        let mirrored = ray - normal * (2.0 * ray.dot(normal));
        self.mesh
            .cast_local_ray(&self.leaving(point, normal, &mirrored), MIRRORED_MAX_MM, false)
            .unwrap_or(f64::INFINITY)
    }

    /// A ray (blade frame) from just above a surface point (camera frame).
    fn leaving(&self, point: &Point3<f64>, normal: &Vector3<f64>, towards: &Vector3<f64>) -> Ray {
        let origin = self.blade_from_camera * (point + normal * SKIN_MM);
        Ray::new(glam(&origin.coords), glam(&(self.blade_from_camera * towards)))
    }
}

pub(super) fn glam(vector: &Vector3<f64>) -> Vector {
    Vector::new(vector.x, vector.y, vector.z)
}

fn nalgebra(vector: Vector) -> Vector3<f64> {
    Vector3::new(vector.x, vector.y, vector.z)
}

/// Rays end here, mm: beyond the range of every preset.
const FARTHEST_MM: f64 = 1e5;
/// Shadow rays start this far off the surface, mm, so that they do not meet the triangle they leave.
const SKIN_MM: f64 = 1e-4;
/// Brightness of a surface that only stray light reaches. *Assumed*.
const INTENSITY_UNLIT: u8 = 4;
/// Distance over which the light of a second bounce falls to 1/e. *Assumed*.
const BOUNCE_REACH_MM: f64 = 3.0;
/// Mirrored rays end here, mm.
const MIRRORED_MAX_MM: f64 = 9.0;
/// Which field is the depth noise.
const PART_DEPTH: u64 = 0;
/// Which field decides at grazing angles.
const PART_ROLL_OFF: u64 = 1;
