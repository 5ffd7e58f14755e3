//! Times of the parts that have a budget: cleaning a grid, merging, preparing a reference.

use std::error::Error;
use std::io::Write;
use std::time::Instant;

use bladescan::cleaning;
use bladescan::geometry::PointCloud;
use bladescan::geometry::grid::Grid;
use bladescan::reconstruction::Model;
use bladescan::registration::Reference;
use nalgebra::Isometry3;

/// A wavy sheet of `width × height` pixels, 0.1 mm apart, 500 mm before the camera; `phase` shifts the sampling.
pub(crate) fn sheet(width: usize, height: usize, phase: f32) -> Vec<[f32; 3]> {
    (0..width * height)
        .map(|i| {
            let (x, y) = ((i % width) as f32 * 0.1 + phase, (i / width) as f32 * 0.1 + phase);
            [x - 30.0, y - 30.0, 500.0 + 3.0 * (0.1 * x).sin() * (0.13 * y).cos()]
        })
        .collect()
}

/// The clean cloud of such a sheet.
pub(crate) fn cloud(points: &[[f32; 3]], width: usize) -> PointCloud {
    let grid = Grid::from_rows(width, points.len() / width, |row, out| {
        for (column, [x, y, z]) in points[row * width..][..width].iter().enumerate() {
            (out.x[column], out.y[column], out.z[column]) = (*x, *y, *z);
        }
    });
    cleaning::clean(grid, &cleaning::Settings::default()).0
}

pub(crate) fn run() -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut time = |name: &str, work: &mut dyn FnMut()| -> Result<(), Box<dyn Error>> {
        let mut best = f64::INFINITY;
        for _ in 0..5 {
            let begun = Instant::now();
            work();
            best = best.min(begun.elapsed().as_secs_f64());
        }
        writeln!(out, "{name:<60} {:>8.1} ms", best * 1e3)?;
        Ok(())
    };
    let grid = sheet(640, 625, 0.0);
    time("a clean cloud with normals from a grid of 400,000 pixels", &mut || {
        cloud(&grid, 640);
    })?;
    let whole = cloud(&grid, 640);
    let view = cloud(&sheet(400, 250, 0.03), 400);
    let still = Isometry3::identity();
    let model = Model::default().merged_with(&whole, &still, 0.05);
    time("merging 100,000 points into a model of 400,000", &mut || {
        model.merged_with(&view, &still, 0.05);
    })?;
    time("preparing a reference of 400,000 points with normals", &mut || {
        Reference::new(&whole).ok();
    })?;
    time("preparing a reference of 100,000 points with normals", &mut || {
        Reference::new(&view).ok();
    })?;
    Ok(())
}
