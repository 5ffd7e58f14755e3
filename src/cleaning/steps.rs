//! Steps between neighbouring pixels, and which neighbours lie on one surface.
//!
//! Between two pixels stand two blocks of 3 x 3 pixels, one on either side. The plane trend of each is carried on to the
//! line between them; the difference is the step. It vanishes on planes and on even curvature, whatever the slant, and
//! averages noise away, so that a step of a few standard deviations stands out. Where a hole interrupts a block, the
//! same is done with the three pixels of the row or column alone, and where that is not possible either, with the two
//! pixels.

use rayon::prelude::*;

use super::fit::{Fits, STEEP, lanes};
use crate::geometry::grid::{Grid, MARGIN_COLUMNS, MARGIN_ROWS};
use crate::geometry::simd::{Kernel, LANE_COUNT, Work};

/// Which pixels are linked to the next one in the row ([`RIGHT`]) and to the one below ([`BELOW`]).
pub(super) struct Links {
    pub(super) width: usize,
    pub(super) height: usize,
    /// One byte a pixel, row by row.
    pub(super) bits: Vec<u8>,
}

/// The pixel and its right neighbour lie on one surface.
pub(super) const RIGHT: u8 = 1;
/// The pixel and the one below it lie on one surface.
pub(super) const BELOW: u8 = 2;
/// The pixel holds a point.
pub(super) const MEASURED: u8 = 4;
/// The pixel's point was taken out as an outlier.
pub(super) const TAKEN_OUT: u8 = 8;

/// How large a step between the pixels of a surface may be, mm along its normal.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepLimits {
    /// Between blocks.
    pub(super) block_mm: f32,
    /// Between three pixels and three.
    pub(super) line_mm: f32,
    /// Of a pixel from the plane of its neighbour.
    pub(super) pair_mm: f32,
}

pub(super) fn links(grid: &Grid, fits: &Fits, pitch: f32, limits: StepLimits, kernel: Kernel) -> Links {
    let (width, height, stride) = (grid.width(), grid.height(), grid.stride());
    let mut bits = vec![0; width * height];
    if !bits.is_empty() {
        bits.par_chunks_exact_mut(width)
            .enumerate()
            .with_min_len(8)
            .for_each(|(row, out)| {
                let row = RowAbout {
                    planes: grid.planes(),
                    fit: fits.with_margin(row),
                    fit_below: fits.with_margin(row + 1),
                    stride,
                    first: (row + MARGIN_ROWS) * stride + MARGIN_COLUMNS,
                    pitch,
                    limits,
                };
                kernel.run(LinkWork { row, out });
            });
    }
    Links { width, height, bits }
}

/// Steps at some pixels, along the normal, mm: of blocks, of lines and of pairs, to the right. Every `stride`-th row and column.
pub(super) fn sampled_steps(grid: &Grid, fits: &Fits, every: usize) -> [Vec<f32>; 3] {
    let z = &grid.planes()[2];
    let [mut blocks, mut lines, mut pairs] = [const { Vec::new() }; 3];
    for row in (0..grid.height()).step_by(every) {
        let [normal_x, normal_y, normal_z, cosines] = fits.with_margin(row);
        for column in (row % every..grid.width()).step_by(every) {
            let at = grid.place(row, column);
            let column_sum = |c: isize| {
                let at = at.wrapping_add_signed(c);
                z[at - grid.stride()] + z[at] + z[at + grid.stride()]
            };
            let block = step([-2, -1, 0, 1, 2, 3].map(column_sum)) / 3.0 * cosines[MARGIN_COLUMNS + column];
            let line = step([-2, -1, 0, 1, 2, 3].map(|c: isize| z[at.wrapping_add_signed(c)]))
                * cosines[MARGIN_COLUMNS + column];
            blocks.extend(block.is_finite().then_some(block.abs()));
            lines.extend(line.is_finite().then_some(line.abs()));
            let off = |c: usize| {
                let part = |plane: usize, normal: &[f32]| {
                    normal[MARGIN_COLUMNS + column + c] * (grid.planes()[plane][at + 1] - grid.planes()[plane][at])
                };
                part(0, normal_x) + part(1, normal_y) + part(2, normal_z)
            };
            let pair = mean_of_known(off(0), off(1));
            pairs.extend(pair.is_finite().then_some(pair.abs()));
        }
    }
    [blocks, lines, pairs]
}

/// The step between the third and the fourth of six values, each side carried on by its own trend.
#[inline(always)]
fn step(v: [f32; 6]) -> f32 {
    let means = (v[3] + v[4] + v[5]) - (v[0] + v[1] + v[2]);
    means * (1.0 / 3.0) - 0.75 * ((v[5] - v[3]) + (v[2] - v[0]))
}

struct LinkWork<'a, 'b> {
    row: RowAbout<'a>,
    /// What [`Links::bits`] says of the row.
    out: &'b mut [u8],
}

/// What stands about a row of pixels.
struct RowAbout<'a> {
    planes: &'a [Vec<f32>; 3],
    fit: [&'a [f32]; 4],
    fit_below: [&'a [f32]; 4],
    stride: usize,
    first: usize,
    pitch: f32,
    limits: StepLimits,
}

impl Work for LinkWork<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { row, out } = self;
        for (index, out) in out.chunks_mut(LANE_COUNT).enumerate() {
            let at = row.first + index * LANE_COUNT;
            let middle = lanes(&row.planes[2], at);
            if middle.iter().all(|z| z.is_nan()) {
                continue;
            }
            let column = MARGIN_COLUMNS + index * LANE_COUNT;
            let right = row.is_linked(at, [1, row.stride], column, |figure| lanes(row.fit[figure], column + 1));
            let below = row.is_linked(at, [row.stride, 1], column, |figure| {
                lanes(row.fit_below[figure], column)
            });
            let mut bits = [0u8; LANE_COUNT];
            for l in 0..LANE_COUNT {
                let measured = if middle[l].is_nan() { 0 } else { MEASURED };
                bits[l] = measured | (right[l] as u8 * RIGHT) | (below[l] as u8 * BELOW);
            }
            out.copy_from_slice(&bits[..out.len()]);
        }
    }
}

impl RowAbout<'_> {
    /// Whether each pixel is linked to the one `along` further; `across` is the way to the block's other rows.
    #[inline(always)]
    fn is_linked(
        &self,
        at: usize,
        [along, across]: [usize; 2],
        column: usize,
        next: impl Fn(usize) -> [f32; LANE_COUNT],
    ) -> [u32; LANE_COUNT] {
        let z = &self.planes[2];
        let cosine = lanes(self.fit[3], column);
        let off_plane = self.off_planes(at, along, column, next);
        let mut lines = [[0.0f32; LANE_COUNT]; 6];
        let mut blocks = [[0.0f32; LANE_COUNT]; 6];
        for k in 0..6 {
            let at = at + k * along - 2 * along;
            lines[k] = lanes(z, at);
            let (before, after) = (lanes(z, at - across), lanes(z, at + across));
            for l in 0..LANE_COUNT {
                blocks[k][l] = before[l] + lines[k][l] + after[l];
            }
        }
        let mut linked = [0; LANE_COUNT];
        for l in 0..LANE_COUNT {
            let of = |values: &[[f32; LANE_COUNT]; 6]| {
                step([
                    values[0][l],
                    values[1][l],
                    values[2][l],
                    values[3][l],
                    values[4][l],
                    values[5][l],
                ])
            };
            let block = (of(&blocks) * (1.0 / 3.0) * cosine[l]).abs();
            let line = (of(&lines) * cosine[l]).abs();
            let pair = (lines[3][l] - lines[2][l]).abs();
            let pair_is_flat = pair <= STEEP * self.pitch * lines[2][l];
            let block_is_even = block.is_nan() | (block <= self.limits.block_mm);
            let line_is_even = line.is_nan() | (line <= self.limits.line_mm);
            let pair_is_even = off_plane[l].is_nan() | (off_plane[l] <= self.limits.pair_mm);
            let is_linked = pair_is_flat & block_is_even & line_is_even & pair_is_even;
            linked[l] = is_linked as u32;
        }
        linked
    }

    /// How far each pixel and the one `along` further lie off each other's planes, the mean of both; NaN without planes.
    #[inline(always)]
    fn off_planes(
        &self,
        at: usize,
        along: usize,
        column: usize,
        next: impl Fn(usize) -> [f32; LANE_COUNT],
    ) -> [f32; LANE_COUNT] {
        let (mut own_off, mut next_off) = ([0.0f32; LANE_COUNT], [0.0f32; LANE_COUNT]);
        for k in 0..3 {
            let (here, there) = (lanes(&self.planes[k], at), lanes(&self.planes[k], at + along));
            let (own, next) = (lanes(self.fit[k], column), next(k));
            for l in 0..LANE_COUNT {
                own_off[l] += own[l] * (there[l] - here[l]);
                next_off[l] += next[l] * (there[l] - here[l]);
            }
        }
        let mut off = [0.0; LANE_COUNT];
        for l in 0..LANE_COUNT {
            off[l] = mean_of_known(own_off[l], next_off[l]).abs();
        }
        off
    }
}

/// The mean of two numbers, or the one that is not NaN.
#[inline(always)]
fn mean_of_known(one: f32, other: f32) -> f32 {
    let one_or_other = if one.is_nan() { other } else { one };
    let other_or_one = if other.is_nan() { one } else { other };
    0.5 * (one_or_other + other_or_one)
}
