//! The simulated camera against its own model: noise on planes, missing pixels on blades, and the time of a frame.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use bladescan::plan::Plan;
use bladescan::seed::Seed;
use bladescan::settings::{Cad, Recipe, Station};
use clap::Args;
use hw_sim::blade::{Builtin, Mesh};
use hw_sim::camera::optics::Optics;
use hw_sim::camera::render::{Capture, Draws, Frame, MASK_INVALID, PixelTruth, Renderer, Roi, Surface};
use nalgebra::{Isometry3, Point3, Vector3};

#[derive(Args)]
pub(crate) struct CameraArguments {
    /// Recipes whose blades, poses and binning are used.
    #[arg(required = true)]
    recipes: Vec<PathBuf>,
    /// Presets of the surface.
    #[arg(long, default_values = ["matte", "machined", "polished"])]
    surface: Vec<String>,
    /// Exposures in µs, main, dark and bright pass with commas between them, 0 = off; without it the recipe's alone, then with a
    /// dark pass of a quarter, then with a bright one of four times as well.
    #[arg(long, value_delimiter = ',')]
    passes: Vec<u32>,
    /// Every n-th view of the plan.
    #[arg(long, default_value_t = 3)]
    every: usize,
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(arguments: &CameraArguments) -> Result<(), Box<dyn Error>> {
    planes(arguments.seed)?;
    missing(arguments)?;
    speed(arguments)
}

/// Noise along the ray on planes across the axis and tilted about x, against the sheet's formula.
fn planes(seed: u64) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "noise along the ray on a matte plane at the nominal distance")?;
    writeln!(
        out,
        "{:8} {:>8} {:>9} {:>12} {:>11} {:>7}",
        "optics", "tilt deg", "points", "measured um", "model um", "ratio"
    )?;
    let mut worst: f64 = 0.0;
    for name in Optics::NAMES {
        let optics = Optics::from_name(name).ok_or("no such optics")?;
        let half_mm = optics.nominal_mm;
        let renderer = Renderer::new(&square(half_mm), Surface::matte())?;
        let capture = Capture {
            roi: Roi {
                width_px: 320,
                height_px: 240,
                offset_x_px: 560,
                offset_y_px: 420,
            },
            ..Capture::default()
        };
        for tilt_deg in [0.0_f64, 30.0, 60.0] {
            let tilt_rad = tilt_deg.to_radians();
            let pose = Isometry3::new(
                Vector3::new(0.0, 0.0, optics.nominal_mm),
                Vector3::new(tilt_rad, 0.0, 0.0),
            );
            let draws = Draws { seed, trigger_id: 0 };
            let (frame, truth) = renderer.render_with_truth(&optics, &pose, &capture, &draws);
            let errors: Vec<f64> = valid(&frame, &truth)
                .map(|(point, truth)| along_mm(&point, truth))
                .collect();
            let sigma_mm = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
            let model_mm = sheet_sigma_mm(&optics, tilt_rad);
            worst = worst.max((sigma_mm / model_mm - 1.0).abs());
            writeln!(
                out,
                "{name:8} {tilt_deg:>8} {:>9} {:>12.2} {:>11.2} {:>7.3}",
                errors.len(),
                sigma_mm * 1e3,
                model_mm * 1e3,
                sigma_mm / model_mm
            )?;
        }
    }
    writeln!(out, "farthest from the model: {:.1} %\n", 100.0 * worst)?;
    Ok(())
}

/// Sheet 4.2 step 6 in the middle of the field: brightness with the cosine to the projector and the square of its distance.
fn sheet_sigma_mm(optics: &Optics, tilt_rad: f64) -> f64 {
    let projector_mm = optics.nominal_mm.hypot(optics.projector_mm.x);
    let cosine = optics.nominal_mm / projector_mm * tilt_rad.cos();
    let brightness = cosine * (optics.nominal_mm / projector_mm).powi(2);
    let spacing_mm = optics.nominal_mm / optics.focal_px;
    (0.25 * spacing_mm / brightness.sqrt() / tilt_rad.cos()).max(0.005)
}

/// What is missing of the pixels that can be measured, and what is wrong with the others.
fn missing(arguments: &CameraArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "pixels that both cameras and the projector see within the range, at 60 deg of incidence or less; every {} views",
        arguments.every
    )?;
    writeln!(
        out,
        "{:12} {:9} {:16} {:>8} {:>7} {:>7} {:>7} {:>11} {:>9} {:>10} {:>10}",
        "recipe",
        "surface",
        "passes us",
        "seen",
        "valid %",
        "least",
        "most",
        "hole px",
        "lone %",
        "> 5 sig %",
        "points"
    )?;
    for path in &arguments.recipes {
        let shots = Shots::read(path, arguments)?;
        for name in &arguments.surface {
            let surface = Surface::from_name(name).ok_or("no such surface")?;
            let renderer = Renderer::new(&shots.mesh, surface)?;
            for capture in &shots.captures {
                let mut sum = Counts::default();
                let mut shares = Vec::new();
                for (pose, draws) in &shots.poses {
                    let (frame, truth) = renderer.render_with_truth(&shots.optics, pose, capture, draws);
                    let counts = Counts::of(&frame, &truth);
                    shares.push(counts.valid as f64 / counts.seen as f64);
                    sum.add(&counts);
                }
                let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole as f64;
                let passes: Vec<String> = capture.passes_us().map(|us| us.to_string()).collect();
                writeln!(
                    out,
                    "{:12} {name:9} {:16} {:>8} {:>7.2} {:>7.2} {:>7.2} {:>11} {:>9.2} {:>10.3} {:>10}",
                    shots.name,
                    passes.join("+"),
                    sum.seen / shots.poses.len(),
                    percent(sum.valid, sum.seen),
                    100.0 * shares.iter().copied().fold(f64::INFINITY, f64::min),
                    100.0 * shares.iter().copied().fold(0.0, f64::max),
                    sum.largest_hole,
                    percent(sum.lone, sum.seen - sum.valid),
                    percent(sum.off, sum.points),
                    sum.points / shots.poses.len(),
                )?;
            }
        }
    }
    writeln!(out)?;
    Ok(())
}

/// Time of a frame: the median of nine, on all threads and on one.
fn speed(arguments: &CameraArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:12} {:>9} {:>8} {:9} {:>10} {:>14} {:>13}",
        "recipe", "triangles", "binned", "surface", "points", "all threads ms", "one thread ms"
    )?;
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    for path in &arguments.recipes {
        let shots = Shots::read(path, arguments)?;
        for name in &arguments.surface {
            let renderer = Renderer::new(&shots.mesh, Surface::from_name(name).ok_or("no such surface")?)?;
            let capture = Capture {
                binning: true,
                ..shots.captures[0]
            };
            let (pose, draws) = &shots.poses[0];
            let mut points = 0;
            let mut median_ms = || {
                let mut times: Vec<f64> = (0..9)
                    .map(|_| {
                        let begun = Instant::now();
                        points = renderer.render(&shots.optics, pose, &capture, draws).valid_count;
                        begun.elapsed().as_secs_f64() * 1e3
                    })
                    .collect();
                times.sort_by(f64::total_cmp);
                times[4]
            };
            let (all_ms, one_ms) = (median_ms(), one.install(median_ms));
            let triangles = shots.mesh.triangles.len();
            writeln!(
                out,
                "{:12} {triangles:>9} {:>8} {name:9} {points:>10} {all_ms:>14.0} {one_ms:>13.0}",
                shots.name, capture.binning
            )?;
        }
    }
    Ok(())
}

/// A blade before the camera as a recipe has it.
struct Shots {
    name: String,
    mesh: Mesh,
    optics: Optics,
    captures: Vec<Capture>,
    poses: Vec<(Isometry3<f64>, Draws)>,
}

impl Shots {
    fn read(path: &PathBuf, arguments: &CameraArguments) -> Result<Shots, Box<dyn Error>> {
        let recipe = Recipe::parse(&path.display().to_string(), &std::fs::read_to_string(path)?)
            .map_err(|error| error.to_string())?;
        let Cad::Builtin(blade) = &recipe.cad else {
            return Err("only recipes of built-in blades".into());
        };
        let plan = Plan::new(&recipe, &Station::builtin_simulated(), Seed(arguments.seed))?;
        let views = plan.views().iter().step_by(arguments.every);
        let capture = |exposure_us: u32, hdr_us: [u32; 2]| Capture {
            binning: recipe.camera.roi == bladescan::settings::Roi::Binned,
            exposure_us: f64::from(exposure_us),
            hdr_us,
            image_count: u32::from(recipe.camera.image_count),
            ..Capture::default()
        };
        let main_us = recipe.camera.exposure.exposure_us;
        let captures = match arguments.passes[..] {
            [] => vec![
                capture(main_us, [0, 0]),
                capture(main_us, [main_us / 4, 0]),
                capture(main_us, [main_us / 4, 4 * main_us]),
            ],
            [main, low, high] => vec![capture(main, [low, high])],
            _ => return Err("three passes, 0 for none".into()),
        };
        Ok(Shots {
            name: blade.clone(),
            mesh: Builtin::from_name(blade).ok_or("no such blade")?.mesh(),
            optics: Optics::from_name(recipe.camera.optics.name()).ok_or("no such optics")?,
            captures,
            poses: views
                .map(|view| {
                    let trigger_id = (view.index as u64) << 16;
                    let draws = Draws {
                        seed: arguments.seed,
                        trigger_id,
                    };
                    (view.camera_from_blade, draws)
                })
                .collect(),
        })
    }
}

/// Counts over frames.
#[derive(Default)]
struct Counts {
    /// Pixels that should be valid.
    seen: usize,
    /// Those of them that are.
    valid: usize,
    /// The largest connected hole among them.
    largest_hole: usize,
    /// Those that are missing while all four neighbours are there.
    lone: usize,
    /// Valid pixels, wherever.
    points: usize,
    /// Those of them that are farther off along the ray than five standard deviations.
    off: usize,
}

impl Counts {
    fn of(frame: &Frame, truth: &[PixelTruth]) -> Counts {
        let should = |index: usize| truth[index].is_seen && truth[index].incidence_rad <= 60_f64.to_radians();
        let is_hole = |index: usize| should(index) && frame.mask[index] & MASK_INVALID != 0;
        let seen = (0..truth.len()).filter(|&index| should(index)).count();
        let mut holes: Vec<bool> = (0..truth.len()).map(is_hole).collect();
        let missing = holes.iter().filter(|&&hole| hole).count();
        let sizes = components(&mut holes, frame.width_px as usize);
        let off = valid(frame, truth)
            .filter(|(point, truth)| along_mm(point, truth).abs() > 5.0 * truth.sigma_mm)
            .count();
        Counts {
            seen,
            valid: seen - missing,
            largest_hole: sizes.iter().copied().max().unwrap_or(0),
            lone: sizes.iter().filter(|&&size| size == 1).count(),
            points: frame.valid_count as usize,
            off,
        }
    }

    fn add(&mut self, other: &Counts) {
        self.seen += other.seen;
        self.valid += other.valid;
        self.largest_hole = self.largest_hole.max(other.largest_hole);
        self.lone += other.lone;
        self.points += other.points;
        self.off += other.off;
    }
}

/// Sizes of the connected parts (over edges) of what is marked, which is marked no more.
fn components(marked: &mut [bool], width: usize) -> Vec<usize> {
    let mut sizes = Vec::new();
    for first in 0..marked.len() {
        let (mut open, mut size) = (Vec::new(), 0);
        if std::mem::take(&mut marked[first]) {
            open.push(first);
        }
        while let Some(index) = open.pop() {
            size += 1;
            let x = index % width;
            let beside = [
                (x > 0).then(|| index - 1),
                (x + 1 < width).then_some(index + 1),
                index.checked_sub(width),
                Some(index + width).filter(|&next| next < marked.len()),
            ];
            for next in beside.into_iter().flatten() {
                if std::mem::take(&mut marked[next]) {
                    open.push(next);
                }
            }
        }
        if size > 0 {
            sizes.push(size);
        }
    }
    sizes
}

/// Valid points with what is behind them.
fn valid<'a>(frame: &'a Frame, truth: &'a [PixelTruth]) -> impl Iterator<Item = (Point3<f64>, &'a PixelTruth)> {
    let points = frame.xyz_mm.iter().map(|point| Point3::from(*point).cast::<f64>());
    points.zip(truth).filter(|(point, _)| !point.x.is_nan())
}

/// How far the point is off along the ray, mm.
fn along_mm(point: &Point3<f64>, truth: &PixelTruth) -> f64 {
    let true_mm = Vector3::from(truth.point_mm);
    (point.coords - true_mm).dot(&true_mm.normalize())
}

/// A square about the origin, facing -z.
fn square(half_mm: f64) -> Mesh {
    let corner = |x: f64, y: f64| Point3::new(x * half_mm, y * half_mm, 0.0);
    Mesh {
        vertices: vec![
            corner(-1.0, -1.0),
            corner(-1.0, 1.0),
            corner(1.0, 1.0),
            corner(1.0, -1.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}
