//! The criteria of a blade's section over turn and shift (Fig. P2), without and with noise and outliers.

use std::error::Error;

use hw_sim::blade::Builtin;
use nalgebra::{Point2, Rotation2, Vector2};
use rand::RngExt;
use rayon::prelude::*;

use super::Effort;
use super::item::{Item, Summary};
use super::svg::{Axis, Map, Plot, Series, Style};
use crate::generate::{self, Surface};

/// The turn and the shift along x that lay the template on the reference.
const TRUTH: [f64; 2] = [30.0, 0.8];
/// How far the map reaches to either side of the truth.
const REACH: [f64; 2] = [120.0, 2.5];
const SECTION_POINT_COUNT: usize = 150;
/// The slab of the normalised blade that is laid flat.
const SLAB: [f64; 2] = [0.3, 0.34];
const SLAB_SAMPLE_COUNT: usize = 30_000;
/// Over the section's root mean square radius, like all that follows.
const NOISE: f64 = 0.05;
const OUTLIER_COUNT: usize = 45;
const OUTLIER_REACH: f64 = 3.0;
/// ε²: that of MPE's first round.
const SOFTENING: f64 = 0.15;

type Loss = fn(Point2<f64>, &[Point2<f64>]) -> f64;

/// Values over turns (columns) and shifts (rows).
struct Grid {
    step_count: usize,
    rows: Vec<Vec<f64>>,
}

pub(crate) fn measure(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let step_count = if effort.quick { 48 } else { 96 };
    let template = section(effort)?;
    let clean = placed(&template);
    let noisy = disturbed(&clean, effort);
    let mut item = Item::new(
        &["turn_deg", "shift", "nfi_clean", "l2_clean", "nfi_noisy", "l2_noisy"],
        format!(
            "A section of {} points of the second blade, in units of its root mean square radius, turned by {} degrees and shifted by {}. Noisy: σ {NOISE} and \
             {OUTLIER_COUNT} outliers. Local minima are grid points lower than their eight neighbours; the path goes from (0, 0) to the lowest neighbour, again and again.",
            template.len(),
            TRUTH[0],
            TRUTH[1],
        ),
    );
    let mut grids = Vec::new();
    for (data, reference) in [("clean", &clean), ("noisy", &noisy)] {
        let flat = |points: &[Point2<f64>]| points.iter().map(|point| [point.x, point.y]).collect();
        item.plot(
            format!("data-{data}"),
            &Plot {
                title: format!("Section, {data}"),
                x: Axis::linear("x"),
                y: Axis::linear("y"),
                series: vec![
                    Series::new("reference", Style::Scatter, flat(reference)),
                    Series::new("template", Style::Scatter, flat(&template)),
                ],
                map: None,
            },
        );
        let losses: [(&str, Loss); 2] = [("NFI", attraction), ("ℓ2", nearest_squared)];
        for (name, loss) in losses {
            let grid = Grid::new(&template, reference, loss, step_count);
            let minima = grid.minima();
            let path = grid.path();
            let end = *path.last().unwrap_or(&[step_count / 2; 2]);
            let lowest = minima.first().copied();
            let is_right = |cell: [usize; 2]| cell.iter().all(|index| index.abs_diff(step_count / 2) <= 1);
            let claim = if name == "NFI" || data == "clean" {
                "the path ends at the truth"
            } else {
                "local minima disturb the path"
            };
            let as_claimed = (is_right(end) && lowest.is_some_and(is_right)) == (name == "NFI" || data == "clean");
            item.summary.push(Summary::new(
                format!("{data} data, {name}"),
                claim,
                format!(
                    "{} local minima; lowest at {}, path ends at {}",
                    minima.len(),
                    lowest.map_or("the rim".to_owned(), |cell| grid.said(cell)),
                    grid.said(end)
                ),
                if as_claimed { "as the paper says" } else { "not so" },
            ));
            let (part, plot) = grid.plot(data, name, &minima, &path);
            item.plot(part, &plot);
            grids.push(grid);
        }
    }
    item.rows = rows(&grids);
    Ok(item)
}

/// A row for each turn and shift with the value of every grid, all of the same size.
fn rows(grids: &[Grid]) -> Vec<Vec<String>> {
    let count = grids.first().map_or(0, |grid| grid.rows.len());
    let cells = (0..count).flat_map(|row| (0..count).map(move |column| [column, row]));
    cells
        .map(|cell| {
            let [turn_deg, shift] = grids[0].at(cell);
            let place = [format!("{turn_deg:.1}"), format!("{shift:.4}")];
            let values = grids.iter().map(|grid| format!("{:.5}", grid.value(cell)));
            place.into_iter().chain(values).collect()
        })
        .collect()
}

/// Points of a slab, laid flat, about their middle, with a root mean square radius of 1.
fn section(effort: &Effort) -> Result<Vec<Point2<f64>>, Box<dyn Error>> {
    let surface = Surface::of_builtin(Builtin::HptA)?.normalised();
    let mut rng = generate::stream(effort.seed, "p2 section");
    let points: Vec<Point2<f64>> = surface
        .sample(SLAB_SAMPLE_COUNT, &mut rng)
        .into_iter()
        .filter(|point| (SLAB[0]..SLAB[1]).contains(&point.z))
        .take(SECTION_POINT_COUNT)
        .map(|point| point.xy())
        .collect();
    if points.len() < SECTION_POINT_COUNT {
        return Err("the slab of the section has too few points".into());
    }
    let count = points.len() as f64;
    let middle = points.iter().map(|point| point.coords).sum::<Vector2<f64>>() / count;
    let squared: f64 = points.iter().map(|point| (point.coords - middle).norm_squared()).sum();
    let radius = (squared / count).sqrt();
    Ok(points
        .into_iter()
        .map(|point| Point2::from((point.coords - middle) / radius))
        .collect())
}

fn placed(template: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let turn = Rotation2::new(TRUTH[0].to_radians());
    template
        .iter()
        .map(|point| turn * point + Vector2::x() * TRUTH[1])
        .collect()
}

fn disturbed(points: &[Point2<f64>], effort: &Effort) -> Vec<Point2<f64>> {
    let mut rng = generate::stream(effort.seed, "p2 noise");
    let mut noisy: Vec<Point2<f64>> = points
        .iter()
        .map(|point| point + Vector2::from_fn(|_, _| NOISE * generate::normal(&mut rng)))
        .collect();
    for _ in 0..OUTLIER_COUNT {
        let place = Vector2::from_fn(|_, _| rng.random_range(-OUTLIER_REACH..OUTLIER_REACH));
        noisy.push(Point2::from(place + Vector2::x() * TRUTH[1]));
    }
    noisy
}

/// A point's part of the criterion of eq. 5.
fn attraction(at: Point2<f64>, reference: &[Point2<f64>]) -> f64 {
    -reference
        .iter()
        .map(|point| 1.0 / ((point - at).norm() + SOFTENING))
        .sum::<f64>()
}

/// A point's part of eq. 3.
fn nearest_squared(at: Point2<f64>, reference: &[Point2<f64>]) -> f64 {
    let squared = reference.iter().map(|point| (point - at).norm_squared());
    squared.fold(f64::INFINITY, f64::min)
}

impl Grid {
    /// `step_count` is even, so that the truth is in the middle.
    fn new(template: &[Point2<f64>], reference: &[Point2<f64>], loss: Loss, step_count: usize) -> Self {
        let mut grid = Self {
            step_count,
            rows: Vec::new(),
        };
        let value = |cell: [usize; 2]| {
            let [turn_deg, shift] = grid.at(cell);
            let turn = Rotation2::new(turn_deg.to_radians());
            let moved = template.iter().map(|point| turn * point + Vector2::x() * shift);
            moved.map(|point| loss(point, reference)).sum::<f64>() / template.len() as f64
        };
        let rows = (0..=step_count)
            .into_par_iter()
            .map(|row| (0..=step_count).map(|column| value([column, row])).collect())
            .collect();
        grid.rows = rows;
        grid
    }

    /// Turn in degrees and shift of a column and a row.
    fn at(&self, cell: [usize; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let share = 2.0 * cell[axis] as f64 / self.step_count as f64 - 1.0;
            TRUTH[axis] + REACH[axis] * share
        })
    }

    fn value(&self, cell: [usize; 2]) -> f64 {
        self.rows[cell[1]][cell[0]]
    }

    fn neighbours(&self, [column, row]: [usize; 2]) -> impl Iterator<Item = [usize; 2]> {
        let around = |index: usize| index.saturating_sub(1)..=(index + 1).min(self.step_count);
        around(row)
            .flat_map(move |y| around(column).map(move |x| [x, y]))
            .filter(move |cell| *cell != [column, row])
    }

    /// Cells lower than all around them, not on the rim, the lowest first.
    fn minima(&self) -> Vec<[usize; 2]> {
        let inner = 1..self.step_count;
        let cells = inner
            .clone()
            .flat_map(|row| inner.clone().map(move |column| [column, row]));
        let mut minima: Vec<[usize; 2]> = cells
            .filter(|cell| {
                self.neighbours(*cell)
                    .all(|other| self.value(*cell) < self.value(other))
            })
            .collect();
        minima.sort_by(|a, b| self.value(*a).total_cmp(&self.value(*b)));
        minima
    }

    /// From no turn and no shift always to the lowest neighbour, while it is lower.
    fn path(&self) -> Vec<[usize; 2]> {
        let start: [usize; 2] = std::array::from_fn(|axis| {
            let share = 0.5 - 0.5 * TRUTH[axis] / REACH[axis];
            (share * self.step_count as f64).round() as usize
        });
        let mut path = vec![start];
        let mut here = start;
        while let Some(next) = self
            .neighbours(here)
            .min_by(|a, b| self.value(*a).total_cmp(&self.value(*b)))
            .filter(|next| self.value(*next) < self.value(here))
        {
            path.push(next);
            here = next;
        }
        path
    }

    fn said(&self, cell: [usize; 2]) -> String {
        let [turn_deg, shift] = self.at(cell);
        format!("({turn_deg:.0}°, {shift:.2})")
    }

    fn plot(&self, data: &str, name: &str, minima: &[[usize; 2]], path: &[[usize; 2]]) -> (String, Plot) {
        let places = |cells: &[[usize; 2]]| cells.iter().map(|cell| self.at(*cell)).collect::<Vec<_>>();
        let range = |axis: usize| [TRUTH[axis] - REACH[axis], TRUTH[axis] + REACH[axis]];
        // Squares would leave all but the rim dark.
        let (part, label, rows) = if name == "NFI" {
            ("nfi", "NFI", self.rows.clone())
        } else {
            let root = |row: &Vec<f64>| row.iter().map(|value| value.sqrt()).collect();
            ("l2", "root of ℓ2", self.rows.iter().map(root).collect())
        };
        let plot = Plot {
            title: format!("{name}, {data} data"),
            x: Axis::linear("turn, degrees"),
            y: Axis::linear("shift along x"),
            series: vec![
                Series::new("truth", Style::Scatter, vec![TRUTH]),
                Series::new("path", Style::Line, places(path)),
                Series::new("local minima", Style::Scatter, places(minima)),
                Series::new("start", Style::Scatter, places(&path[..1])),
            ],
            map: Some(Map {
                label: label.to_owned(),
                x: range(0),
                y: range(1),
                rows,
            }),
        };
        (format!("{part}-{data}"), plot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_criterion_of_a_clean_section_is_lowest_at_the_truth() {
        let template: Vec<Point2<f64>> = (0..40)
            .map(|index| {
                let angle = std::f64::consts::TAU * f64::from(index) / 40.0;
                Point2::new(1.3 * angle.cos(), 0.3 * angle.sin() + 0.2 * (2.0 * angle).cos())
            })
            .collect();
        let grid = Grid::new(&template, &placed(&template), attraction, 24);
        assert_eq!(grid.minima().first(), Some(&[12, 12]));
        assert_eq!(grid.at([12, 12]), TRUTH);
        assert_eq!(grid.path().last(), Some(&[12, 12]));
    }
}
