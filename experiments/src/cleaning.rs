//! Cleaning against the simulator's truth: what of the wrong points is taken out, and what of the good ones is lost.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use bladescan::cleaning::{Verdict, judge};
use bladescan::geometry::grid::Grid;
use bladescan::geometry::simd::Kernel;
use bladescan::settings::{Cad, Recipe, Roi};
use clap::Args;
use hw_sim::blade::Builtin;
use hw_sim::camera::optics::Optics;
use hw_sim::camera::render::{
    Capture, Draws, Frame, PixelTruth, Renderer, Surface, TOUCHED_GHOST, TOUCHED_OUTLIER, TOUCHED_RIPPLE,
    TOUCHED_SILHOUETTE,
};
use nalgebra::{UnitQuaternion, Vector3};

#[derive(Args)]
pub(crate) struct CleaningArguments {
    /// Recipes of built-in blades, whose optics, pose, exposures and cleaning are taken.
    #[arg(default_values_t = BLADES.into_iter().flat_map(|name| [
        format!("config/recipes/{name}.toml"),
        format!("config/recipes/{name}-polished.toml"),
    ]))]
    recipes: Vec<String>,
    /// Surface of the blades; without it, polished for recipes whose name ends so, and matte for the others.
    #[arg(long)]
    surface: Option<String>,
    /// Views of each, spread over a turn.
    #[arg(long, default_value_t = 6)]
    views: u32,
    /// Seed of the artefacts.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Points of some views, counted.
#[derive(Default)]
struct Tally {
    good_count: usize,
    /// By the reason they were taken out for.
    lost: [usize; REASONS.len()],
    /// Off by more than five standard deviations, by what touched them: all, and of these kept.
    bad: [(usize, usize); CAUSES.len()],
    /// Of the bad ones kept, those off by more than eight.
    far_missed: usize,
}

pub(crate) fn run(arguments: &CleaningArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "| blade | surface | bad | removed | missed by more than 8 σ | {} | good | lost | {} |",
        CAUSES.map(|(name, _)| name).join(" | "),
        REASONS.map(|(name, _)| name).join(" | ")
    )?;
    writeln!(out, "|{}", "---|".repeat(7 + CAUSES.len() + REASONS.len()))?;
    for path in &arguments.recipes {
        let recipe = Recipe::parse(path, &std::fs::read_to_string(PathBuf::from(path))?)?;
        let own_surface = if path.contains("polished") { "polished" } else { "matte" };
        let surface = arguments.surface.as_deref().unwrap_or(own_surface);
        let tally = tally(arguments, &recipe, surface)?;
        let bad: usize = tally.bad.iter().map(|(count, _)| count).sum();
        let missed: usize = tally.bad.iter().map(|(_, missed)| missed).sum();
        let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
        let causes = tally
            .bad
            .map(|(count, missed)| format!("{} of {count}", count - missed))
            .join(" | ");
        writeln!(
            out,
            "| {} | {surface} | {bad} | {:.2} % | {} | {causes} | {} | {:.2} % | {} |",
            recipe.name,
            percent(bad - missed, bad),
            tally.far_missed,
            tally.good_count,
            percent(tally.lost.iter().sum(), tally.good_count),
            tally.lost.map(|count| count.to_string()).join(" | ")
        )?;
    }
    Ok(())
}

fn tally(arguments: &CleaningArguments, recipe: &Recipe, surface: &str) -> Result<Tally, Box<dyn Error>> {
    let Cad::Builtin(blade) = &recipe.cad else {
        return Err(format!("{}: not a built-in blade", recipe.name).into());
    };
    let blade = Builtin::from_name(blade).ok_or("no such blade")?;
    let optics = Optics::from_name(recipe.camera.optics.name()).ok_or("no such optics")?;
    let renderer = Renderer::new(&blade.mesh(), Surface::from_name(surface).ok_or("no such surface")?)?;
    let exposure = recipe.camera.exposure;
    let capture = Capture {
        binning: recipe.camera.roi == Roi::Binned,
        exposure_us: f64::from(exposure.exposure_us),
        hdr_us: [exposure.hdr_low_us, exposure.hdr_high_us].map(Option::unwrap_or_default),
        image_count: u32::from(recipe.camera.image_count),
        ..Capture::default()
    };
    let mut tally = Tally::default();
    for view in 0..arguments.views {
        let turn_rad = std::f64::consts::TAU * f64::from(view) / f64::from(arguments.views);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad);
        let camera_from_blade = recipe.camera_from_fixture * turn;
        let draws = Draws {
            seed: arguments.seed,
            trigger_id: u64::from(view) << 16,
        };
        let (frame, truth) = renderer.render_with_truth(&optics, &camera_from_blade, &capture, &draws);
        let judged = judge(grid(&frame), &recipe.cleaning, Kernel::fastest());
        for ((point, truth), verdict) in frame.xyz_mm.iter().zip(&truth).zip(judged.verdicts()) {
            if *verdict != Verdict::Unmeasured {
                tally.add(point, truth, *verdict);
            }
        }
    }
    Ok(tally)
}

impl Tally {
    fn add(&mut self, point: &[f32; 3], truth: &PixelTruth, verdict: Verdict) {
        let off_mm = (Vector3::from(point.map(f64::from)) - Vector3::from(truth.point_mm)).norm();
        let is_kept = verdict == Verdict::Kept;
        if off_mm <= BAD_SIGMA * truth.sigma_mm {
            self.good_count += 1;
            if let Some(reason) = REASONS.iter().position(|(_, reason)| *reason == verdict) {
                self.lost[reason] += 1;
            }
            return;
        }
        let cause = CAUSES.iter().position(|(_, bit)| truth.touched & bit != 0);
        let (count, missed) = &mut self.bad[cause.unwrap_or(CAUSES.len() - 1)];
        *count += 1;
        *missed += usize::from(is_kept);
        self.far_missed += usize::from(is_kept && off_mm > FAR_SIGMA * truth.sigma_mm);
    }
}

fn grid(frame: &Frame) -> Grid {
    let width = frame.width_px as usize;
    Grid::from_rows(width, frame.height_px as usize, |row, out| {
        for (column, [x, y, z]) in frame.xyz_mm[row * width..][..width].iter().enumerate() {
            (out.x[column], out.y[column], out.z[column]) = (*x, *y, *z);
        }
    })
}

const BLADES: [&str; 4] = ["hpt-blade-a", "hpt-blade-b", "hpt-blade-c", "lpt-blade"];
const BAD_SIGMA: f64 = 5.0;
const FAR_SIGMA: f64 = 8.0;
const REASONS: [(&str, Verdict); 6] = [
    ("isolated", Verdict::Isolated),
    ("flying", Verdict::Flying),
    ("outlier", Verdict::Outlier),
    ("patch", Verdict::Patch),
    ("grazing", Verdict::Grazing),
    ("edge", Verdict::Edge),
];
/// What touched a point, the gravest first; the last stands for nothing.
const CAUSES: [(&str, u8); 5] = [
    ("ghosts", TOUCHED_GHOST),
    ("gross", TOUCHED_OUTLIER),
    ("silhouettes", TOUCHED_SILHOUETTE),
    ("ripple", TOUCHED_RIPPLE),
    ("noise", 0),
];
