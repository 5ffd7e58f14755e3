//! Frames: what the camera delivers of a mesh in a given pose.
//!
//! Each pixel casts a ray from camera 1; where it meets the mesh, two more go to camera 2 and to the projector, so that
//! stereo shadows fall as in the cell, and on shiny surfaces a mirrored one. Rays are moved into the blade frame; the mesh
//! stays as it was built. Artefacts of neighbouring pixels follow on the whole picture. Terms, numbers and what they rest on:
//! `docs/simulator.md`.

use super::artefacts::{Change, Systematic, changes};
pub use super::capture::{Capture, Compression, OutlierFilter, Roi, WorkingVolume};
pub use super::frame::*;
use super::grid::Grid;
pub use super::noise::SurfaceNoise;
use super::optics::Optics;
use super::site::{Shot, Site, glam};
pub use super::surface::{Finish, Preset, Surface, Term, Terms};
use crate::blade::Mesh;
pub use crate::draws::Draws;
use nalgebra::{Isometry3, Point3};
use parry3d_f64::shape::{TriMesh, TriMeshBuilderError};
use rayon::prelude::*;

/// Takes frames of one mesh. Built once: it holds the tree that makes rays fast.
#[derive(Debug, Clone)]
pub struct Renderer {
    mesh: TriMesh,
    surface: Surface,
}

/// Why a mesh cannot be rendered.
#[derive(Debug, thiserror::Error)]
#[error("the mesh cannot be rendered: {0}")]
pub struct RendererError(#[from] TriMeshBuilderError);

impl Renderer {
    /// Prepares a mesh; an error when it has no triangle. Both sides of a triangle are seen, so open meshes work.
    pub fn new(mesh: &Mesh, surface: Surface) -> Result<Renderer, RendererError> {
        let vertices = mesh.vertices.iter().map(|point| glam(&point.coords)).collect();
        Ok(Renderer {
            mesh: TriMesh::new(vertices, mesh.triangles.clone())?,
            surface,
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
        let mut frame = empty(&Grid::new(capture));
        if let Some(picture) = self.picture(optics, camera_from_blade, capture, draws) {
            picture.fill(&mut frame);
        }
        frame
    }

    /// Takes the same frame, with what is behind each of its pixels.
    pub fn render_with_truth(
        &self,
        optics: &Optics,
        camera_from_blade: &Isometry3<f64>,
        capture: &Capture,
        draws: &Draws,
    ) -> (Frame, Vec<PixelTruth>) {
        let mut frame = empty(&Grid::new(capture));
        let mut truth = vec![PixelTruth::NOTHING; frame.mask.len()];
        if let Some(picture) = self.picture(optics, camera_from_blade, capture, draws) {
            picture.fill(&mut frame);
            for (index, pixel) in picture.pixels() {
                truth[index] = pixel.truth();
            }
        }
        (frame, truth)
    }

    fn picture<'a>(
        &'a self,
        optics: &'a Optics,
        camera_from_blade: &Isometry3<f64>,
        capture: &'a Capture,
        draws: &Draws,
    ) -> Option<Picture<'a>> {
        let shot = Shot::new(&self.mesh, &self.surface, optics, camera_from_blade, capture, *draws)?;
        let [first, end] = shot.window.y_px;
        let rows: Vec<Vec<Site>> = (first..end).into_par_iter().map(|row| shot.row(row)).collect();
        let sites = rows.concat();
        Some(Picture {
            changes: changes(&shot, &sites, capture.outlier_filter),
            systematic: Systematic::new(self.surface.terms, optics, draws.trigger_id),
            shot,
            sites,
        })
    }
}

/// The window of a frame, and what happened there.
struct Picture<'a> {
    shot: Shot<'a>,
    sites: Vec<Site>,
    /// One for each site, or none at all.
    changes: Vec<Change>,
    systematic: Systematic,
}

/// One pixel of the window.
struct Pixel<'a> {
    picture: &'a Picture<'a>,
    site: &'a Site,
    change: Change,
    column: usize,
    row: usize,
}

impl Picture<'_> {
    /// The pixels of the window, each with its index in the frame.
    fn pixels(&self) -> impl Iterator<Item = (usize, Pixel<'_>)> {
        let window = self.shot.window;
        let width_px = window.width_px();
        self.sites.iter().enumerate().map(move |(index, site)| {
            let pixel = Pixel {
                picture: self,
                site,
                change: self.changes.get(index).copied().unwrap_or_default(),
                column: window.x_px[0] + index % width_px,
                row: window.y_px[0] + index / width_px,
            };
            (pixel.row * self.shot.grid.width_px + pixel.column, pixel)
        })
    }

    fn fill(&self, frame: &mut Frame) {
        let mut surface = Vec::new();
        for (index, pixel) in self.pixels() {
            let site = pixel.site;
            frame.intensity[index] = site.intensity;
            frame.confidence[index] = site.confidence;
            if let Some(measured_mm) = pixel.measured_mm() {
                frame.xyz_mm[index] = measured_mm.coords.cast::<f32>().into();
                frame.mask[index] = 0;
                surface.push(pixel.surface_mm());
            } else {
                let lost = if pixel.change.is_lost { MASK_FILTERED } else { 0 };
                frame.mask[index] = MASK_INVALID | site.mask | lost;
            }
            frame.saturated_count += u32::from(frame.mask[index] & MASK_SATURATED != 0);
        }
        frame.valid_count = surface.len() as u32;
        let count = surface.len().min(SURFACE_POINT_COUNT);
        frame.surface_points_mm = (0..count)
            .map(|i| surface[(2 * i + 1) * surface.len() / (2 * count)])
            .map(|point| point.coords.into())
            .collect();
    }
}

impl Pixel<'_> {
    /// The measured point; `None` where invalid.
    fn measured_mm(&self) -> Option<Point3<f64>> {
        if !self.site.is_valid() || self.change.is_lost {
            return None;
        }
        let ray = self.picture.shot.ray(self.column, self.row);
        let noisy_mm = if self.change.displacement_mm == 0.0 {
            self.site.noisy_mm
        } else {
            self.site.noisy_mm + ray.normalize() * self.change.displacement_mm
        };
        Some(self.systematic(noisy_mm))
    }

    /// Where the ray meets the surface, camera frame.
    fn surface_mm(&self) -> Point3<f64> {
        Point3::from(self.picture.shot.ray(self.column, self.row) * self.site.depth_mm)
    }

    fn systematic(&self, point_mm: Point3<f64>) -> Point3<f64> {
        let sensor_px = self.picture.shot.grid.sensor_px(self.column, self.row);
        self.picture.systematic.apply(point_mm, sensor_px)
    }

    fn truth(&self) -> PixelTruth {
        let bounced = if self.site.is_bounced { TOUCHED_SECOND_BOUNCE } else { 0 };
        PixelTruth {
            point_mm: self.systematic(self.surface_mm()).coords.into(),
            sigma_mm: self.site.sigma_mm,
            incidence_rad: self.site.incidence_rad,
            is_seen: self.site.is_seen,
            touched: self.change.touched | bounced,
        }
    }
}

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

#[cfg(test)]
#[path = "render_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "artefact_tests.rs"]
mod artefact_tests;
