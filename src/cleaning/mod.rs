//! From an organised grid to a clean cloud with normals: windows on the grid, no search.
//!
//! 1. A plane is fitted through the 5 × 5 window about every pixel: its normal, the incidence, and the point's offset.
//! 2. Points that stand alone are taken out, then outliers: those whose offset is the greatest about them and beyond the
//!    limit, over a few rounds, the planes about them fitted anew. The limit follows the noise of this view, estimated from
//!    all offsets; it grows with the incidence as light falls off. Where points clearly fly at the edges of the view, the
//!    limit is stricter at all its edges, and points that jut out there are left out.
//! 3. Neighbours without a step between them are linked; small islands with a cliff about them are patches that float
//!    before or behind the surface.
//! 4. What is left without a plane lies at an edge; what is seen at too large an angle is grazing.
//!
//! Every step is a pass over rows with fixed windows and no sum runs over more than a window, so the bits depend neither
//! on the number of threads nor on the vector unit.

mod fit;
mod islands;
mod steps;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use self::fit::{Changed, FitRow, Fits, HALF_WINDOW};
use self::steps::StepLimits;
use crate::event::RemovedCounts;
use crate::geometry::PointCloud;
use crate::geometry::grid::Grid;
use crate::geometry::simd::Kernel;

/// What is taken for a wrong point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// A point farther from the plane of its neighbours than this many standard deviations is an outlier.
    pub outlier_sigma: f64,
    /// Islands of at most this many pixels are patches; 0 keeps them all.
    pub patch_max_count: usize,
    /// Points seen at a larger angle to their normal are left out, rad.
    pub incidence_max_rad: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            outlier_sigma: 5.0,
            patch_max_count: 400,
            incidence_max_rad: 75_f64.to_radians(),
        }
    }
}

/// What is thought of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing was measured.
    Unmeasured,
    /// The point is a good one.
    Kept,
    /// No surface about it.
    Isolated,
    /// Off the surface, beside a hole or the end of the surface.
    Flying,
    /// Off the surface, in its midst.
    Outlier,
    /// Part of a small patch before or behind the surface.
    Patch,
    /// Seen at too large an angle.
    Grazing,
    /// Too few neighbours for a normal.
    Edge,
}

/// A grid whose points are judged.
pub struct Judged {
    grid: Grid,
    fits: Fits,
    verdicts: Vec<Verdict>,
    pitch: f32,
    kernel: Kernel,
}

/// The clean points of a grid, each with a unit normal that faces the camera, row by row; and what was taken out.
pub fn clean(grid: Grid, settings: &Settings) -> (PointCloud, RemovedCounts) {
    let judged = judge(grid, settings, Kernel::fastest());
    (judged.cloud(), judged.removed_counts())
}

/// Judges every point of a grid in the camera's frame, mm.
pub fn judge(grid: Grid, settings: &Settings, kernel: Kernel) -> Judged {
    // Without two neighbours there is no pitch, and every point stands alone.
    let pitch = pitch(&grid).unwrap_or(f32::NAN);
    let mut judged = Judged {
        fits: Fits::new(&grid, pitch, kernel),
        verdicts: measured(&grid),
        grid,
        pitch,
        kernel,
    };
    judged.take_out_isolated();
    if let Some(sigma_mm) = judged.offset_sigma_mm() {
        judged.take_out_outliers(settings.outlier_sigma as f32 * sigma_mm);
        judged.take_out_patches(settings.patch_max_count);
        judged.take_out_isolated();
    }
    judged.leave_out_edges(settings.incidence_max_rad.cos() as f32);
    judged
}

impl Judged {
    /// What is thought of each pixel, row by row.
    pub fn verdicts(&self) -> &[Verdict] {
        &self.verdicts
    }

    /// The points that are kept, row by row, with their normals.
    pub fn cloud(&self) -> PointCloud {
        let width = self.grid.width();
        let mut kept: Vec<u32> = Vec::with_capacity(self.verdicts.len());
        kept.extend(
            (0..)
                .zip(&self.verdicts)
                .filter(|(_, verdict)| **verdict == Verdict::Kept)
                .map(|(index, _)| index),
        );
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        kept.par_iter()
            .with_min_len(1024)
            .map(|&index| {
                let (row, column) = (index as usize / width, index as usize % width);
                let at = self.grid.place(row, column);
                let point = self.grid.planes().each_ref().map(|plane| f64::from(plane[at]));
                let normal = self.fits.row(row).normal.map(|plane| f64::from(plane[column]));
                (Point3::from(point), Vector3::from(normal).normalize())
            })
            .unzip_into_vecs(&mut points, &mut normals);
        PointCloud::of_finite(points, normals)
    }

    /// How many points were taken out, by reason.
    pub fn removed_counts(&self) -> RemovedCounts {
        let mut counts = RemovedCounts::default();
        for verdict in &self.verdicts {
            match verdict {
                Verdict::Unmeasured | Verdict::Kept => {}
                Verdict::Isolated => counts.isolated += 1,
                Verdict::Flying => counts.flying += 1,
                Verdict::Outlier => counts.outlier += 1,
                Verdict::Patch => counts.patch += 1,
                Verdict::Grazing => counts.grazing += 1,
                Verdict::Edge => counts.edge += 1,
            }
        }
        counts
    }

    /// Points without company; those that were beside them may then be without, too.
    fn take_out_isolated(&mut self) {
        for _ in 0..ROUND_COUNT {
            let found = self.find(|_, column, fit| fit.offset[column] == f32::INFINITY);
            if found.is_empty() {
                return;
            }
            self.take_out(&found, Verdict::Isolated);
        }
    }

    /// Outliers; and where points fly at the edges of this view, doubtful and exposed points at its edges too.
    fn take_out_outliers(&mut self, limit_mm: f32) {
        let clearly_flying_count = self.take_out_beyond(limit_mm, limit_mm);
        let isolated_count = self
            .verdicts
            .iter()
            .filter(|verdict| **verdict == Verdict::Isolated)
            .count();
        let strange_count = (clearly_flying_count + isolated_count) as f32;
        // Lone points alone prove nothing: frayed edges have them, too.
        if clearly_flying_count > 0 && strange_count > STRANGE_MAX_FRACTION * self.edge_count() as f32 {
            self.take_out_beyond(limit_mm, DOUBTFUL_FRACTION * limit_mm);
            self.take_out_exposed();
        }
    }

    /// Points at an edge that jut out of what is left: with so few beside them, their plane follows them, wherever they fly.
    fn take_out_exposed(&mut self) {
        let found = self.find(|row, column, _| {
            self.kept_count_beside(row, column) <= EXPOSED_MAX_COUNT && self.is_at_an_edge((row as u32, column as u32))
        });
        self.take_out(&found, Verdict::Flying);
    }

    /// How many of the eight pixels beside a kept one are kept.
    fn kept_count_beside(&self, row: usize, column: usize) -> usize {
        let (width, height) = (self.grid.width(), self.grid.height());
        let columns = column.saturating_sub(1)..(column + 2).min(width);
        let kept = |row: usize| {
            let verdicts = &self.verdicts[row * width..][columns.clone()];
            verdicts.iter().filter(|verdict| **verdict == Verdict::Kept).count()
        };
        (row.saturating_sub(1)..(row + 2).min(height)).map(kept).sum::<usize>() - 1
    }

    /// Returns how many flew at twice the limit or more.
    fn take_out_beyond(&mut self, limit_mm: f32, edge_limit_mm: f32) -> usize {
        let mut clearly_flying_count = 0;
        for _ in 0..ROUND_COUNT {
            let found = self.find(|row, column, fit| {
                let own_mm = level_offset(&fit, column);
                let is_beyond =
                    own_mm > limit_mm || (own_mm > edge_limit_mm && self.is_at_an_edge((row as u32, column as u32)));
                is_beyond && self.stands_out(row, column, own_mm)
            });
            if found.is_empty() {
                break;
            }
            let (beside, midst): (Vec<Pixel>, _) = found.into_iter().partition(|&pixel| self.is_at_an_edge(pixel));
            let is_clear =
                |&(row, column): &Pixel| level_offset(&self.fits.row(row as usize), column as usize) > 2.0 * limit_mm;
            clearly_flying_count += beside.iter().filter(|pixel| is_clear(pixel)).count();
            self.take_out(&beside, Verdict::Flying);
            self.take_out(&midst, Verdict::Outlier);
            self.take_out_isolated();
        }
        clearly_flying_count
    }

    /// About how many points lie at an edge, from a share of the pixels.
    fn edge_count(&self) -> usize {
        let width = self.grid.width();
        let rows = (0..self.grid.height()).step_by(SAMPLE_STEP);
        let pixels = rows.flat_map(|row| {
            (row % SAMPLE_STEP..width)
                .step_by(SAMPLE_STEP)
                .map(move |column| (row, column))
        });
        let at_an_edge = pixels.filter(|&(row, column)| {
            self.verdicts[row * width + column] == Verdict::Kept && self.is_at_an_edge((row as u32, column as u32))
        });
        SAMPLE_STEP * SAMPLE_STEP * at_an_edge.count()
    }

    /// Whether a point that lies `own_mm` off its plane lies farther off than every point beside it.
    fn stands_out(&self, row: usize, column: usize, own_mm: f32) -> bool {
        let (width, height) = (self.grid.width(), self.grid.height());
        (row.saturating_sub(1)..(row + 2).min(height)).all(|r| {
            let fit = self.fits.row(r);
            (column.saturating_sub(1)..(column + 2).min(width)).all(|c| {
                let other = level_offset(&fit, c);
                self.verdicts[r * width + c] != Verdict::Kept
                    || other.is_nan()
                    || other < own_mm
                    || (other == own_mm && (r, c) >= (row, column))
            })
        })
    }

    /// Whether the window about a pixel holds one that was not measured.
    fn is_at_an_edge(&self, (row, column): Pixel) -> bool {
        let (width, height) = (self.grid.width(), self.grid.height());
        let (row, column) = (row as usize, column as usize);
        if row < HALF_WINDOW || column < HALF_WINDOW || row + HALF_WINDOW >= height || column + HALF_WINDOW >= width {
            return true;
        }
        (row - HALF_WINDOW..=row + HALF_WINDOW).any(|r| {
            self.verdicts[r * width..][column - HALF_WINDOW..=column + HALF_WINDOW].contains(&Verdict::Unmeasured)
        })
    }

    fn take_out_patches(&mut self, count_max: usize) {
        let [block_mm, line_mm, pair_mm] = steps::sampled_steps(&self.grid, &self.fits, SAMPLE_STEP)
            .map(|steps| STEP_SIGMA * MEDIAN_TO_SIGMA * median(steps).unwrap_or(0.0) + CREASE * self.spacing_mm());
        let limits = StepLimits {
            block_mm,
            line_mm,
            pair_mm,
        };
        let mut links = steps::links(&self.grid, &self.fits, self.pitch, limits, self.kernel);
        for (bits, verdict) in links.bits.iter_mut().zip(&self.verdicts) {
            if matches!(verdict, Verdict::Outlier | Verdict::Flying | Verdict::Isolated) {
                *bits |= steps::TAKEN_OUT;
            }
        }
        let mut found = Vec::new();
        islands::for_small_islands(&links, count_max, |row, columns| {
            found.extend(columns.map(|column| (row as u32, column as u32)));
        });
        self.take_out(&found, Verdict::Patch);
    }

    /// Points without a normal and points seen at too large an angle; neighbours keep what they know from them.
    fn leave_out_edges(&mut self, cosine_min: f32) {
        for (row, column) in self.find(|_, column, fit| fit.cosine[column].is_nan() || fit.cosine[column] < cosine_min)
        {
            let is_grazing = !self.fits.row(row as usize).cosine[column as usize].is_nan();
            self.verdicts[row as usize * self.grid.width() + column as usize] =
                if is_grazing { Verdict::Grazing } else { Verdict::Edge };
        }
    }

    /// The kept pixels of which something holds, row by row.
    fn find(&self, holds: impl Fn(usize, usize, FitRow) -> bool + Sync) -> Vec<Pixel> {
        let width = self.grid.width();
        (0..self.grid.height())
            .into_par_iter()
            .with_min_len(8)
            .flat_map_iter(|row| {
                let (fit, holds) = (self.fits.row(row), &holds);
                self.verdicts[row * width..][..width]
                    .iter()
                    .enumerate()
                    .filter(move |(column, verdict)| **verdict == Verdict::Kept && holds(row, *column, fit))
                    .map(move |(column, _)| (row as u32, column as u32))
            })
            .collect()
    }

    fn take_out(&mut self, found: &[Pixel], verdict: Verdict) {
        if found.is_empty() {
            return;
        }
        let mut changed = Changed::nothing(&self.grid);
        for &(row, column) in found {
            let (row, column) = (row as usize, column as usize);
            self.verdicts[row * self.grid.width() + column] = verdict;
            let at = self.grid.place(row, column);
            self.grid.depth_mut()[at] = f32::NAN;
            changed.mark(row, column);
        }
        self.fits.refit(&self.grid, self.pitch, &changed, self.kernel);
    }

    /// Standard deviation of the offsets, levelled, from a share of the pixels; `None` without planes.
    fn offset_sigma_mm(&self) -> Option<f32> {
        let mut offsets = Vec::new();
        for row in (0..self.grid.height()).step_by(SAMPLE_STEP) {
            let fit = self.fits.row(row);
            for column in (row % SAMPLE_STEP..self.grid.width()).step_by(SAMPLE_STEP) {
                let offset = level_offset(&fit, column);
                offsets.extend(offset.is_finite().then_some(offset));
            }
        }
        Some(MEDIAN_TO_SIGMA * median(offsets)?)
    }

    /// Distance between neighbouring points of a surface across the line of sight, mm.
    fn spacing_mm(&self) -> f32 {
        let depths = self.grid.planes()[2].iter().step_by(SAMPLE_STEP * SAMPLE_STEP - 3);
        self.pitch * median(depths.copied().filter(|z| !z.is_nan()).collect()).unwrap_or(0.0)
    }
}

/// Row and column.
type Pixel = (u32, u32);

fn measured(grid: &Grid) -> Vec<Verdict> {
    let z = &grid.planes()[2];
    let row = |row: usize| {
        let at = if grid.width() > 0 { grid.place(row, 0) } else { 0 };
        z[at..at + grid.width()].iter()
    };
    let verdict = |z: &f32| if z.is_nan() { Verdict::Unmeasured } else { Verdict::Kept };
    let mut verdicts = Vec::with_capacity(grid.width() * grid.height());
    for index in 0..grid.height() {
        verdicts.extend(row(index).map(verdict));
    }
    verdicts
}

/// The size of a pixel's offset, made comparable between angles: a slanted surface is lit less and noisier.
fn level_offset(fit: &FitRow, column: usize) -> f32 {
    fit.offset[column].abs() * fit.cosine[column].sqrt()
}

/// The angle between neighbouring pixels, rad: the median over some of them.
fn pitch(grid: &Grid) -> Option<f32> {
    let [x, y, z] = grid.planes();
    let mut found = Vec::new();
    for row in (0..grid.height()).step_by(SAMPLE_STEP) {
        for column in (row % SAMPLE_STEP..grid.width()).step_by(SAMPLE_STEP) {
            let at = grid.place(row, column);
            let across = ((x[at + 1] - x[at]).powi(2) + (y[at + 1] - y[at]).powi(2)).sqrt() / z[at];
            found.extend(across.is_finite().then_some(across));
        }
    }
    median(found)
}

fn median(mut values: Vec<f32>) -> Option<f32> {
    let middle = values.len() / 2;
    (middle < values.len()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Where points clearly fly, and they and those that stand alone are more than this share of those at edges...
const STRANGE_MAX_FRACTION: f32 = 0.005;
/// ... this share of the limit holds for the others there, since some flew only a little...
const DOUBTFUL_FRACTION: f32 = 0.42;
/// ... and points there with no more than so many of eight beside them are left out.
const EXPOSED_MAX_COUNT: usize = 3;
/// Estimates look at every so manyth row and column.
const SAMPLE_STEP: usize = 8;
/// Rounds of taking out before what remains is left in peace.
const ROUND_COUNT: usize = 6;
/// Of normally distributed numbers: standard deviation over the median of the sizes.
const MEDIAN_TO_SIGMA: f32 = 1.4826;
/// A step of more than this many standard deviations of all steps...
const STEP_SIGMA: f32 = 4.5;
/// ... and this share of the point spacing, for creases, parts two pixels.
const CREASE: f32 = 0.2;

#[cfg(test)]
mod tests;
