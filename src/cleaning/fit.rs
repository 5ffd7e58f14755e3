//! Planes through the window about every pixel: normals, incidence, and how far the pixel lies off its neighbours.
//!
//! The window's points are regressed on their pixel indices, which carry no noise: `P(i, j) = M + i P_u + j P_v`. The
//! normal is `P_u x P_v`, whatever the camera's distortion. Single precision is enough, as everything is taken from the
//! middle pixel.

use rayon::prelude::*;

use crate::geometry::grid::{Grid, MARGIN_COLUMNS, MARGIN_ROWS};
use crate::geometry::simd::{Kernel, LANE_COUNT, Work};

/// The plane at every pixel; NaN where there is none.
pub(super) struct Fits {
    width: usize,
    stride: usize,
    /// For each row of the grid: normal x, y and z, cosine of the incidence, offset; each as long as a row of the grid's
    /// planes.
    rows: Vec<f32>,
}

/// The planes of one row.
#[derive(Clone, Copy)]
pub(super) struct FitRow<'a> {
    /// Unit normal that faces the camera.
    pub(super) normal: [&'a [f32]; 3],
    /// Cosine of the angle between the normal and the line to the camera.
    pub(super) cosine: &'a [f32],
    /// How far the pixel's point lies before the plane of its window (towards the camera), mm.
    pub(super) offset: &'a [f32],
}

/// Pixels whose window has changed since their plane was fitted, in steps of [`LANE_COUNT`] columns.
pub(super) struct Changed {
    steps: usize,
    is_changed: Vec<bool>,
}

impl Changed {
    /// Nothing has changed.
    pub(super) fn nothing(grid: &Grid) -> Self {
        let steps = grid.width().div_ceil(LANE_COUNT);
        Self {
            steps,
            is_changed: vec![false; steps * grid.height()],
        }
    }

    /// The point of a pixel was taken out.
    pub(super) fn mark(&mut self, row: usize, column: usize) {
        let height = self.is_changed.len() / self.steps;
        let reach =
            |middle: usize, count: usize| middle.saturating_sub(HALF_WINDOW)..(middle + HALF_WINDOW + 1).min(count);
        let last = (column + HALF_WINDOW).min(self.steps * LANE_COUNT - 1);
        for row in reach(row, height) {
            for step in column.saturating_sub(HALF_WINDOW) / LANE_COUNT..=last / LANE_COUNT {
                self.is_changed[row * self.steps + step] = true;
            }
        }
    }
}

impl Fits {
    /// Fits a plane at every pixel of `grid`; `pitch` is the angle between pixels, rad.
    pub(super) fn new(grid: &Grid, pitch: f32, kernel: Kernel) -> Self {
        let stride = grid.stride();
        let mut fits = Self {
            width: grid.width(),
            stride,
            rows: vec![f32::NAN; FIGURE_COUNT * stride * grid.height()],
        };
        fits.fit(grid, pitch, None, kernel);
        fits
    }

    /// Fits anew where the window has changed.
    pub(super) fn refit(&mut self, grid: &Grid, pitch: f32, changed: &Changed, kernel: Kernel) {
        self.fit(grid, pitch, Some(changed), kernel);
    }

    /// The planes of a row, one value a column of the grid.
    pub(super) fn row(&self, row: usize) -> FitRow<'_> {
        let figures = &self.rows[row * FIGURE_COUNT * self.stride..][..FIGURE_COUNT * self.stride];
        let figure = |index: usize| &figures[index * self.stride + MARGIN_COLUMNS..][..self.width];
        FitRow {
            normal: [figure(0), figure(1), figure(2)],
            cosine: figure(3),
            offset: figure(4),
        }
    }

    /// Normal and cosine of the incidence of a row, over whole rows of the grid's planes, margins included; the last row
    /// stands in for the one below it.
    pub(super) fn with_margin(&self, row: usize) -> [&[f32]; 4] {
        let row = row.min(self.rows.len() / (FIGURE_COUNT * self.stride) - 1);
        [0, 1, 2, 3].map(|figure| &self.rows[(row * FIGURE_COUNT + figure) * self.stride..][..self.stride])
    }

    fn fit(&mut self, grid: &Grid, pitch: f32, changed: Option<&Changed>, kernel: Kernel) {
        if self.stride == 0 || self.rows.is_empty() {
            return;
        }
        let (stride, steps) = (self.stride, self.width.div_ceil(LANE_COUNT));
        self.rows
            .par_chunks_exact_mut(FIGURE_COUNT * stride)
            .enumerate()
            .with_min_len(8)
            .for_each(|(row, out)| {
                kernel.run(FitWork {
                    planes: grid.planes(),
                    stride,
                    first: (row + MARGIN_ROWS) * stride + MARGIN_COLUMNS,
                    steps,
                    pitch,
                    changed: changed.map(|changed| &changed.is_changed[row * steps..][..steps]),
                    out,
                });
            });
    }
}

struct FitWork<'a> {
    planes: &'a [Vec<f32>; 3],
    stride: usize,
    first: usize,
    steps: usize,
    pitch: f32,
    changed: Option<&'a [bool]>,
    out: &'a mut [f32],
}

impl Work for FitWork<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for step in 0..self.steps {
            if self.changed.is_some_and(|changed| !changed[step]) {
                continue;
            }
            let at = self.first + step * LANE_COUNT;
            let figures = fit_lanes(self.planes, at, self.stride, self.pitch);
            for (index, figure) in figures.iter().enumerate() {
                let place = index * self.stride + MARGIN_COLUMNS + step * LANE_COUNT;
                self.out[place..place + LANE_COUNT].copy_from_slice(figure);
            }
        }
    }
}

type Lanes = [f32; LANE_COUNT];

#[inline(always)]
pub(super) fn lanes(plane: &[f32], at: usize) -> Lanes {
    let mut lanes = [0.0; LANE_COUNT];
    lanes.copy_from_slice(&plane[at..at + LANE_COUNT]);
    lanes
}

/// Normal, cosine of the incidence and offset of as many pixels as there are lanes, the first at `at`.
#[inline(always)]
fn fit_lanes(planes: &[Vec<f32>; 3], at: usize, stride: usize, pitch: f32) -> [Lanes; FIGURE_COUNT] {
    let nothing = [[f32::NAN; LANE_COUNT]; FIGURE_COUNT];
    let middle = [lanes(&planes[0], at), lanes(&planes[1], at), lanes(&planes[2], at)];
    if middle[2].iter().all(|z| z.is_nan()) {
        return nothing;
    }
    let zero = [0.0f32; LANE_COUNT];
    // Sums over the window of 1, i, j, ii, ij, jj; of the offsets from the middle; and of those times i and times j.
    let (mut n, mut measured, mut si, mut sj, mut sii, mut sij, mut sjj) = (zero, zero, zero, zero, zero, zero, zero);
    let (mut sum, mut sum_i, mut sum_j) = ([zero; 3], [zero; 3], [zero; 3]);
    for r in 0..WINDOW {
        let j = r as f32 - HALF_WINDOW as f32;
        let (mut row_n, mut row_i, mut row_ii) = (zero, zero, zero);
        let (mut row_sum, mut row_sum_i) = ([zero; 3], [zero; 3]);
        let row_at = at + r * stride - HALF_WINDOW * stride - HALF_WINDOW;
        for c in 0..WINDOW {
            let i = c as f32 - HALF_WINDOW as f32;
            let [x, y, z] = [
                lanes(&planes[0], row_at + c),
                lanes(&planes[1], row_at + c),
                lanes(&planes[2], row_at + c),
            ];
            let steep = STEEP * pitch * (i * i + j * j).sqrt();
            for l in 0..LANE_COUNT {
                let dz = z[l] - middle[2][l];
                let counts = dz.abs() <= steep * middle[2][l];
                let one = if counts { 1.0 } else { 0.0 };
                let dx = if counts { x[l] - middle[0][l] } else { 0.0 };
                let dy = if counts { y[l] - middle[1][l] } else { 0.0 };
                let near_dz = if counts { dz } else { 0.0 };
                measured[l] += if dz.is_nan() { 0.0 } else { 1.0 };
                row_n[l] += one;
                row_i[l] += i * one;
                row_ii[l] += i * i * one;
                row_sum[0][l] += dx;
                row_sum[1][l] += dy;
                row_sum[2][l] += near_dz;
                row_sum_i[0][l] += i * dx;
                row_sum_i[1][l] += i * dy;
                row_sum_i[2][l] += i * near_dz;
            }
        }
        for l in 0..LANE_COUNT {
            n[l] += row_n[l];
            si[l] += row_i[l];
            sii[l] += row_ii[l];
            sj[l] += j * row_n[l];
            sij[l] += j * row_i[l];
            sjj[l] += j * j * row_n[l];
            for k in 0..3 {
                sum[k][l] += row_sum[k][l];
                sum_i[k][l] += row_sum_i[k][l];
                sum_j[k][l] += j * row_sum[k][l];
            }
        }
    }
    let mut figures = nothing;
    for l in 0..LANE_COUNT {
        let cii = n[l] * sii[l] - si[l] * si[l];
        let cij = n[l] * sij[l] - si[l] * sj[l];
        let cjj = n[l] * sjj[l] - sj[l] * sj[l];
        let (mut u, mut v) = ([0.0f32; 3], [0.0f32; 3]);
        for k in 0..3 {
            let ci = n[l] * sum_i[k][l] - si[l] * sum[k][l];
            let cj = n[l] * sum_j[k][l] - sj[l] * sum[k][l];
            u[k] = cjj * ci - cij * cj;
            v[k] = cii * cj - cij * ci;
        }
        let normal = [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ];
        let p = [middle[0][l], middle[1][l], middle[2][l]];
        let length = (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]).sqrt();
        let along = normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2];
        let distance = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
        let is_alone =
            (n[l] <= ALONE_MAX_COUNT) | ((n[l] <= ALONE_MAX_COUNT_AMONG_OTHERS) & (3.0 * n[l] < measured[l]));
        let is_enough = n[l] >= POINT_MIN_COUNT;
        let scale = if is_enough { 1.0 / length } else { f32::NAN };
        let scale = if along > 0.0 { -scale } else { scale };
        let unit = [normal[0] * scale, normal[1] * scale, normal[2] * scale];
        let off = unit[0] * sum[0][l] + unit[1] * sum[1][l] + unit[2] * sum[2][l];
        figures[0][l] = unit[0];
        figures[1][l] = unit[1];
        figures[2][l] = unit[2];
        figures[3][l] = (along * scale).abs() / distance;
        figures[4][l] = if is_alone { f32::INFINITY } else { -off / n[l] };
    }
    figures
}

/// Half the window's width in pixels, without the middle.
pub(super) const HALF_WINDOW: usize = 2;
const WINDOW: usize = 2 * HALF_WINDOW + 1;
/// How many pixels of the window must lie on the same surface, the middle among them, for a plane.
const POINT_MIN_COUNT: f32 = 6.0;
/// A pixel with no more than this many on its surface, itself among them, stands alone...
const ALONE_MAX_COUNT: f32 = 2.0;
/// ... and with no more than this many, if they are less than a third of the window's points.
const ALONE_MAX_COUNT_AMONG_OTHERS: f32 = 8.0;
/// A pixel of the window counts only if the line to it is at most this steep: the tangent of 79 degrees. Steeper ones are
/// jumps between surfaces.
pub(super) const STEEP: f32 = 5.0;
const FIGURE_COUNT: usize = 5;
