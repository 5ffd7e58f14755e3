//! Frames: what the camera delivers of a mesh in a given pose.
//!
//! Each pixel casts a ray from camera 1; where it meets the mesh, two more go to camera 2 and to the projector, so that
//! stereo shadows fall as in the cell. Rays are moved into the blade frame; the mesh stays as it was built.

pub use super::capture::{Capture, Compression, OutlierFilter, Roi, WorkingVolume};
pub use super::frame::*;
pub use super::noise::SurfaceNoise;
use super::noise::{Exposed, Window, holes, unit_field};
use super::optics::{Optics, SENSOR_HEIGHT_PX, SENSOR_WIDTH_PX};
use crate::blade::Mesh;
pub use crate::draws::Draws;
use crate::draws::{Purpose, generator, normal_pair, uniform};
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshBuilderError};
use rayon::prelude::*;

/// Takes frames of one mesh. Built once: it holds the tree that makes rays fast.
#[derive(Debug, Clone)]
pub struct Renderer {
    mesh: TriMesh,
    noise: SurfaceNoise,
}

/// Why a mesh cannot be rendered.
#[derive(Debug, thiserror::Error)]
#[error("the mesh cannot be rendered: {0}")]
pub struct RendererError(#[from] TriMeshBuilderError);

impl Renderer {
    /// Prepares a mesh; an error when it has no triangle. Both sides of a triangle are seen, so open meshes work.
    pub fn new(mesh: &Mesh, noise: SurfaceNoise) -> Result<Renderer, RendererError> {
        let vertices = mesh.vertices.iter().map(|point| glam(&point.coords)).collect();
        Ok(Renderer {
            mesh: TriMesh::new(vertices, mesh.triangles.clone())?,
            noise,
        })
    }

    /// Takes one frame. Equal arguments give equal bits, whatever the number of threads.
    ///
    /// A blade out of view, behind the camera or out of range gives a frame without valid points.
    pub fn render(
        &self,
        optics: &Optics,
        camera_from_blade: &Isometry3<f64>,
        capture: &Capture,
        draws: &Draws,
    ) -> Frame {
        let grid = Grid::new(capture);
        let mut frame = Frame::empty(&grid);
        let Some(window) = self.window(optics, camera_from_blade, &grid) else {
            return frame;
        };
        let shot = Shot {
            renderer: self,
            optics,
            blade_from_camera: camera_from_blade.inverse(),
            capture,
            draws: *draws,
            grid,
            window,
            lost: holes(window, self.noise.dropout_fraction, *draws),
            field: unit_field(window, self.noise.correlation_px, *draws),
        };
        let rows: Vec<Vec<Pixel>> = (window.y_px[0]..window.y_px[1])
            .into_par_iter()
            .map(|row| shot.row(row))
            .collect();
        frame.fill(window, &rows);
        frame
    }

    /// The pixels that can see the mesh's bounding box; all of them when part of it is beside or behind the camera.
    fn window(&self, optics: &Optics, camera_from_blade: &Isometry3<f64>, grid: &Grid) -> Option<Window> {
        let corners = self
            .mesh
            .local_aabb()
            .vertices()
            .map(|corner| camera_from_blade * Point3::new(corner.x, corner.y, corner.z));
        if corners.iter().all(|corner| corner.z <= 0.0) {
            return None;
        }
        let full = Window {
            x_px: [0, grid.width_px],
            y_px: [0, grid.height_px],
        };
        let Some(seen) = corners
            .iter()
            .map(|corner| optics.project(corner))
            .collect::<Option<Vec<_>>>()
        else {
            return Some(full);
        };
        let range = |values: &dyn Fn(&Point2<f64>) -> f64, count: usize| {
            let low = seen.iter().map(values).fold(f64::INFINITY, f64::min).floor().max(0.0);
            let high = seen.iter().map(values).fold(f64::NEG_INFINITY, f64::max).ceil() + 1.0;
            [low.min(count as f64) as usize, high.clamp(0.0, count as f64) as usize]
        };
        let window = Window {
            x_px: range(&|sensor_px| grid.column(sensor_px.x), grid.width_px),
            y_px: range(&|sensor_px| grid.row(sensor_px.y), grid.height_px),
        };
        (window.x_px[0] < window.x_px[1] && window.y_px[0] < window.y_px[1]).then_some(window)
    }
}

impl Frame {
    fn empty(grid: &Grid) -> Frame {
        let count = grid.width_px * grid.height_px;
        Frame {
            width_px: grid.width_px as u32,
            height_px: grid.height_px as u32,
            xyz_mm: vec![[f32::NAN; 3]; count],
            mask: vec![MASK_INVALID; count],
            intensity: vec![0; count],
            confidence: vec![0; count],
            valid_count: 0,
            saturated_count: 0,
            surface_points_mm: Vec::new(),
        }
    }

    fn fill(&mut self, window: Window, rows: &[Vec<Pixel>]) {
        let mut surface = Vec::new();
        for (row, pixels) in (window.y_px[0]..).zip(rows) {
            let first = row * self.width_px as usize + window.x_px[0];
            for (index, pixel) in (first..).zip(pixels) {
                self.intensity[index] = pixel.intensity;
                self.confidence[index] = pixel.confidence;
                match pixel.point {
                    Ok((measured, truth)) => {
                        self.xyz_mm[index] = measured;
                        self.mask[index] = 0;
                        surface.push(truth);
                    }
                    Err(mask) => self.mask[index] = MASK_INVALID | mask,
                }
                self.saturated_count += u32::from(self.mask[index] & MASK_SATURATED != 0);
            }
        }
        self.valid_count = surface.len() as u32;
        let count = surface.len().min(SURFACE_POINT_COUNT);
        self.surface_points_mm = (0..count)
            .map(|i| surface[(2 * i + 1) * surface.len() / (2 * count)])
            .map(|point| point.coords.into())
            .collect();
    }
}

/// The delivered grid and where its pixels lie on the sensor.
#[derive(Debug, Clone, Copy)]
struct Grid {
    width_px: usize,
    height_px: usize,
    offset_px: [f64; 2],
    /// Sensor pixels per delivered pixel, along each axis.
    step: f64,
}

impl Grid {
    fn new(capture: &Capture) -> Grid {
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

    fn sensor_px(&self, column: usize, row: usize) -> Point2<f64> {
        Point2::new(
            self.offset_px[0] + self.step * column as f64,
            self.offset_px[1] + self.step * row as f64,
        )
    }

    fn column(&self, sensor_x_px: f64) -> f64 {
        (sensor_x_px - self.offset_px[0]) / self.step
    }

    fn row(&self, sensor_y_px: f64) -> f64 {
        (sensor_y_px - self.offset_px[1]) / self.step
    }
}

/// One delivered pixel: measured and true point (camera frame, mm), or the mask bits that say why there is none.
struct Pixel {
    point: Result<([f32; 3], Point3<f64>), u8>,
    intensity: u8,
    confidence: u8,
}

/// What all rows of one frame share.
struct Shot<'a> {
    renderer: &'a Renderer,
    optics: &'a Optics,
    blade_from_camera: Isometry3<f64>,
    capture: &'a Capture,
    draws: Draws,
    grid: Grid,
    window: Window,
    lost: Vec<bool>,
    field: Vec<Vec<f64>>,
}

/// The random numbers of one pixel, drawn whether it needs them or not.
struct PixelDraws {
    depth: f64,
    lateral_uniform: [f64; 2],
    grazing_uniform: f64,
    lost: bool,
}

impl Shot<'_> {
    fn row(&self, row: usize) -> Vec<Pixel> {
        let mut rng = generator(self.draws.seed, Purpose::Pixel, self.draws.trigger_id, row as u64);
        let [first, end] = self.window.x_px;
        let window_row = row - self.window.y_px[0];
        let mut pixels = Vec::with_capacity(end - first);
        for column in 0..end {
            let [u, v, w] = [(); 3].map(|()| uniform(&mut rng));
            if column >= first {
                let x = column - first;
                let pixel_draws = PixelDraws {
                    depth: self.field[window_row][x],
                    lateral_uniform: [u, v],
                    grazing_uniform: w,
                    lost: self.lost[window_row * self.window.width_px() + x],
                };
                pixels.push(self.pixel(self.optics.ray(self.grid.sensor_px(column, row)), &pixel_draws));
            }
        }
        pixels
    }

    /// The ray of one pixel, `ray` in the camera frame with z = 1.
    fn pixel(&self, ray: Vector3<f64>, draws: &PixelDraws) -> Pixel {
        let blade_ray = Ray::new(
            glam(&self.blade_from_camera.translation.vector),
            glam(&(self.blade_from_camera * ray)),
        );
        let hit = self
            .renderer
            .mesh
            .cast_local_ray_and_get_normal(&blade_ray, FARTHEST_MM, false);
        let Some(hit) = hit else {
            return Pixel {
                point: Err(0),
                intensity: 0,
                confidence: 0,
            };
        };
        let depth_mm = hit.time_of_impact;
        let truth = Point3::from(ray * depth_mm);
        let normal = self.blade_from_camera.inverse_transform_vector(&nalgebra(hit.normal));
        let normal = normal.try_normalize(0.0).unwrap_or(-ray.normalize());
        let to_projector = self.optics.projector_mm - truth;
        let lit = self.sees(&truth, &normal, &self.optics.projector_mm);
        if !lit || !self.sees(&truth, &normal, &self.optics.camera_2_mm) {
            let intensity = if lit {
                self.exposed(&to_projector, &normal).intensity()
            } else {
                INTENSITY_UNLIT
            };
            return Pixel {
                point: Err(MASK_OCCLUDED),
                intensity,
                confidence: 0,
            };
        }
        let exposed = self.exposed(&to_projector, &normal);
        let incidence_rad = normal.angle(&-ray);
        let greatest_incidence_rad = incidence_rad.max(normal.angle(&(self.optics.camera_2_mm - truth)));
        let failed = self.failure(depth_mm, greatest_incidence_rad, exposed, draws);
        let point = if failed == 0 {
            let sigma_mm = self
                .renderer
                .noise
                .depth_sigma_mm(self.optics, depth_mm, incidence_rad, exposed);
            Ok((self.measured(&truth, sigma_mm, draws), truth))
        } else {
            Err(failed)
        };
        Pixel {
            point,
            intensity: exposed.intensity(),
            confidence: (255.0 * exposed.score()).round() as u8,
        }
    }

    /// Whether the segment from a surface point to a device meets nothing else (camera frame).
    fn sees(&self, point: &Point3<f64>, normal: &Vector3<f64>, device: &Point3<f64>) -> bool {
        let towards = device - point;
        if normal.dot(&towards) <= 0.0 {
            return false;
        }
        let origin = self.blade_from_camera * (point + normal * SKIN_MM);
        let shadow_ray = Ray::new(glam(&origin.coords), glam(&(self.blade_from_camera * towards)));
        !self.renderer.mesh.intersects_local_ray(&shadow_ray, 1.0)
    }

    fn exposed(&self, to_projector: &Vector3<f64>, normal: &Vector3<f64>) -> Exposed {
        let distance_mm = to_projector.norm();
        let cosine = normal.dot(to_projector) / distance_mm;
        Exposed::matte(
            self.optics,
            self.capture.exposure_us,
            self.capture.image_count,
            distance_mm,
            cosine,
        )
    }

    /// The mask bits of a pixel that all three see; 0 when it is valid.
    fn failure(&self, depth_mm: f64, incidence_rad: f64, exposed: Exposed, draws: &PixelDraws) -> u8 {
        let mut mask = 0;
        if exposed.brightness > 1.0 {
            mask |= MASK_SATURATED;
        }
        let grazing = draws.grazing_uniform >= self.renderer.noise.valid_probability(incidence_rad);
        if grazing || exposed.score() < f64::from(self.capture.score_threshold) {
            mask |= MASK_LOW_MODULATION;
        }
        if draws.lost || !(self.optics.near_mm..=self.optics.far_mm).contains(&depth_mm) {
            mask |= MASK_FILTERED;
        }
        mask
    }

    fn measured(&self, truth: &Point3<f64>, sigma_mm: f64, draws: &PixelDraws) -> [f32; 3] {
        let along = truth.coords.normalize() * (sigma_mm * draws.depth);
        let [u, v] = draws.lateral_uniform;
        let lateral_mm = self.renderer.noise.lateral_fraction * self.optics.spacing_mm(truth.z);
        let [x_mm, y_mm] = normal_pair(u, v).map(|value| value * lateral_mm);
        let point = truth + along + Vector3::new(x_mm, y_mm, 0.0);
        [point.x as f32, point.y as f32, point.z as f32]
    }
}

impl Exposed {
    fn intensity(self) -> u8 {
        (255.0 * self.brightness).round().clamp(0.0, 255.0) as u8
    }
}

fn glam(vector: &Vector3<f64>) -> Vector {
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

#[cfg(test)]
#[path = "render_tests.rs"]
mod tests;
