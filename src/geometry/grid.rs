//! Organised grids: the points of a view in the order of the camera's pixels, so that neighbours are known.

use rayon::prelude::*;

use super::simd::LANE_COUNT;

/// A row-major grid of points, one plane of numbers for each coordinate; NaN in all three where nothing was measured.
///
/// Rows and columns of NaN surround it, so that a window about any pixel lies inside the planes.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    width: usize,
    height: usize,
    planes: [Vec<f32>; 3],
}

/// One row of a grid under construction: x, y and z, as many of each as the grid is wide.
pub struct RowMut<'a> {
    /// Right in the picture, in the camera's frame.
    pub x: &'a mut [f32],
    /// Down in the picture.
    pub y: &'a mut [f32],
    /// Away from the camera.
    pub z: &'a mut [f32],
}

impl Grid {
    /// Builds a grid row by row: `fill` gets the number of each row and writes its points, in any order of the rows.
    ///
    /// A point with a coordinate that is not finite, or not before the camera (z above 0), counts as not measured.
    pub fn from_rows(width: usize, height: usize, fill: impl Fn(usize, RowMut) + Sync) -> Self {
        let stride = stride_of(width);
        let count = stride * (height + 2 * MARGIN_ROWS);
        let mut planes = [(); 3].map(|()| vec![f32::NAN; count]);
        if width == 0 {
            return Self { width, height, planes };
        }
        let [x, y, z] = planes
            .each_mut()
            .map(|plane| plane[stride * MARGIN_ROWS..].par_chunks_exact_mut(stride).take(height));
        x.zip(y)
            .zip(z)
            .enumerate()
            .with_min_len(8)
            .for_each(|(row, ((x, y), z))| {
                let row_mut = RowMut {
                    x: &mut x[MARGIN_COLUMNS..][..width],
                    y: &mut y[MARGIN_COLUMNS..][..width],
                    z: &mut z[MARGIN_COLUMNS..][..width],
                };
                fill(row, row_mut);
                drop_unmeasured(
                    &mut x[MARGIN_COLUMNS..][..width],
                    &mut y[MARGIN_COLUMNS..][..width],
                    &mut z[MARGIN_COLUMNS..][..width],
                );
            });
        Self { width, height, planes }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The point of a pixel; `None` where nothing was measured.
    pub fn point(&self, row: usize, column: usize) -> Option<[f32; 3]> {
        let at = self.place(row, column);
        let point = self.planes.each_ref().map(|plane| plane[at]);
        (!point[2].is_nan()).then_some(point)
    }

    /// The points of all pixels, row by row; `None` where nothing was measured.
    pub fn points(&self) -> impl Iterator<Item = Option<[f32; 3]>> {
        (0..self.height).flat_map(move |row| (0..self.width).map(move |column| self.point(row, column)))
    }

    /// How many pixels hold a point.
    pub fn point_count(&self) -> usize {
        let [_, _, z] = &self.planes;
        z.par_chunks(1 << 16)
            .map(|part| part.iter().filter(|z| !z.is_nan()).count())
            .sum()
    }

    /// Length of a row of the planes.
    pub(crate) fn stride(&self) -> usize {
        stride_of(self.width)
    }

    /// Where a pixel lies in the planes.
    pub(crate) fn place(&self, row: usize, column: usize) -> usize {
        assert!(row < self.height && column < self.width, "a pixel outside the grid");
        (row + MARGIN_ROWS) * self.stride() + MARGIN_COLUMNS + column
    }

    /// x, y and z.
    pub(crate) fn planes(&self) -> &[Vec<f32>; 3] {
        &self.planes
    }

    /// z, to take points out of: by NaN there alone.
    pub(crate) fn depth_mut(&mut self) -> &mut [f32] {
        &mut self.planes[2]
    }
}

fn stride_of(width: usize) -> usize {
    width.next_multiple_of(LANE_COUNT) + 2 * MARGIN_COLUMNS
}

fn drop_unmeasured(x: &mut [f32], y: &mut [f32], z: &mut [f32]) {
    for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
        let is_measured = (*x + *y + *z).is_finite() && *z > 0.0;
        for value in [x, y, z] {
            *value = if is_measured { *value } else { f32::NAN };
        }
    }
}

/// Columns of NaN on either side: a whole step of the widest kernel.
pub(crate) const MARGIN_COLUMNS: usize = LANE_COUNT;
/// Rows of NaN above and below.
pub(crate) const MARGIN_ROWS: usize = 3;
