//! One table of the registration's speed: kernels, full-sample MPE, and the stages of one production view.

use std::error::Error;
use std::f64::consts::TAU;
use std::hint::black_box;
use std::io::Write;
use std::time::Instant;

use bladescan::camera::{Capture, CapturedPoints, TriggerId};
use bladescan::cleaning;
use bladescan::geometry::PointCloud;
use bladescan::geometry::nearest::NearestPoints;
use bladescan::geometry::normals::with_estimated_normals;
use bladescan::geometry::sampling::random_indices;
use bladescan::geometry::simd::Kernel;
use bladescan::registration::field::{FORCE_ERROR_MAX, Field};
use bladescan::registration::mpe::descend;
use bladescan::registration::{MpeSettings, Reference, Search, Settings, Summation, register_from};
use bladescan::seed::{Seed, Stream};
use clap::Args;
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::ThreadPoolBuilder;

/// Prints one table of the registration's speed.
#[derive(Args)]
pub(crate) struct BenchArguments {
    /// Threads for MPE and for the view.
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Every time is the least of this many.
    #[arg(long, default_value_t = 5)]
    repeats: u32,
    /// Leaves out MPE with brute force on more points than this.
    #[arg(long, default_value_t = 32_000)]
    pairs_max_count: usize,
    /// A few seconds, for checking that everything still runs: once each, up to 2,000 points, a small view. Ends with an
    /// error when a force of the fast field is off by more than its bound.
    #[arg(long)]
    quick: bool,
    /// Seeds clouds and samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(arguments: &BenchArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout();
    let one = ThreadPoolBuilder::new().num_threads(1).build()?;
    let all = ThreadPoolBuilder::new().num_threads(arguments.threads).build()?;
    one.install(|| kernels(arguments, &mut out))?;
    one.install(|| frame(arguments, &mut out))?;
    let force_error = all.install(|| mpe(arguments, &mut out))?;
    all.install(|| view(arguments, &mut out))?;
    if force_error > FORCE_ERROR_MAX {
        return Err(format!("a force is off by {force_error:.1e}, allowed is {FORCE_ERROR_MAX:.0e}").into());
    }
    Ok(())
}

impl BenchArguments {
    fn repeats(&self) -> u32 {
        if self.quick { 1 } else { self.repeats }
    }

    /// Numbers of points and the goals for them, in seconds.
    fn sizes(&self) -> &'static [(usize, f64)] {
        let all = &[(500, 0.02), (2000, 0.1), (8000, 0.3), (32_000, 1.5)];
        if self.quick { &all[..2] } else { all }
    }
}

/// The least time of several, in seconds, and what the work gives.
fn best_of<T>(repeats: u32, mut work: impl FnMut() -> T) -> (f64, T) {
    let mut timed = || {
        let begun = Instant::now();
        let result = work();
        (begun.elapsed().as_secs_f64(), result)
    };
    let mut best = timed();
    for _ in 1..repeats {
        let next = timed();
        if next.0 < best.0 {
            best = next;
        }
    }
    best
}

/// A twisted blade on a platform, half height 1; the golden ratio spreads the points, `phase` shifts them.
pub(crate) fn blade(count: usize, phase: f64) -> Vec<Point3<f64>> {
    let golden = 0.618_033_988_749_895;
    let on_platform = count / 4;
    (0..count)
        .map(|i| {
            let spread = |rate: f64| (i as f64 * golden * rate + phase).fract();
            if i < on_platform {
                let u = (i as f64 + phase) / on_platform as f64 - 0.5;
                return Point3::new(1.3 * u, spread(1.0) - 0.5, -1.0 + 0.15 * u);
            }
            let height = 2.0 * ((i - on_platform) as f64 + phase) / (count - on_platform) as f64 - 1.0;
            let around = TAU * spread(1.0);
            let chord = 0.5 * around.cos() * (1.0 - 0.2 * height);
            let thickness = 0.1 * around.sin() * (1.0 - 0.6 * around.cos()) + 0.25 * (0.25 - chord * chord);
            let (sin, cos) = (0.5 * height).sin_cos();
            Point3::new(cos * chord - sin * thickness, sin * chord + cos * thickness, height)
        })
        .collect()
}

/// How far the template is moved before it falls.
fn truth() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.1, -0.1, 0.05), Vector3::new(0.1, 0.2, 0.3))
}

fn kernels(arguments: &BenchArguments, out: &mut impl Write) -> std::io::Result<()> {
    let clock_hz = clock_hz();
    writeln!(
        out,
        "kernel on one core at {:.2} GHz, 4,096 x 1,024 pairs of {PAIR_OPERATIONS} operations, one a root and one a quotient",
        clock_hz * 1e-9
    )?;
    let (masses, at) = (blade(4096, 0.0), blade(1024, 0.5));
    for kernel in Kernel::available() {
        let field = Field::new(&masses).with_kernel(kernel);
        let (seconds, _) = best_of(20 * arguments.repeats(), || field.pulls(&at, 0.1));
        let rate = (masses.len() * at.len()) as f64 / seconds;
        let lanes = match kernel.name() {
            "avx512" => 16.0,
            "avx2" => 8.0,
            _ => 4.0,
        };
        let cycles = lanes * clock_hz / rate;
        writeln!(
            out,
            "  {:<10} {:>6.2} G pairs/s  {:>6.1} G operations/s  {cycles:>5.1} cycles a vector of {lanes} pairs",
            kernel.name(),
            rate * 1e-9,
            PAIR_OPERATIONS * rate * 1e-9
        )?;
    }
    let peak = root_and_quotient_hz();
    let operation = "roots with quotients alone, as this program is compiled: the limit of `portable`";
    writeln!(out, "  {:<10} {:>6.2} G pairs/s  {operation}", "peak", peak * 1e-9)
}

/// The core's clock, from a chain of products and sums of which each waits for the one before: 3 cycles and 1.
fn clock_hz() -> f64 {
    const CHAIN_COUNT: u64 = 20_000_000;
    let (seconds, _) = best_of(5, || {
        let factor = black_box(6_364_136_223_846_793_005u64);
        let mut value = black_box(1u64);
        for _ in 0..CHAIN_COUNT {
            value = value.wrapping_mul(factor).wrapping_add(1);
        }
        black_box(value)
    });
    4.0 * CHAIN_COUNT as f64 / seconds
}

/// Square roots each followed by a quotient, a second, that wait for nothing.
fn root_and_quotient_hz() -> f64 {
    const COUNT: usize = 1024;
    const REPEATS: usize = 2000;
    let values: Vec<f32> = (0..COUNT).map(|i| 1.0 + i as f32).collect();
    let mut results = vec![0.0f32; COUNT];
    let (seconds, ()) = best_of(10, || {
        for _ in 0..REPEATS {
            for (result, value) in results.iter_mut().zip(black_box(&values)) {
                *result = 1.5 / value.sqrt();
            }
            black_box(&mut results);
        }
    });
    (COUNT * REPEATS) as f64 / seconds
}

/// Returns the largest force error.
fn mpe(arguments: &BenchArguments, out: &mut impl Write) -> std::io::Result<f64> {
    writeln!(
        out,
        "\nMPE with {} threads, template and reference of N points (s; growth: power of N since the row above)",
        arguments.threads
    )?;
    writeln!(
        out,
        "{:>7} {:>6} {:>9} {:>6} {:>9} {:>6} {:>6} {:>10} {:>10} {:>6}",
        "N", "points", "fast", "growth", "pairs", "growth", "steps", "force err", "apart rad", "goal"
    )?;
    let mut rows: Vec<(f64, f64, f64)> = Vec::new();
    let mut force_error_max = 0.0f64;
    for &(count, goal) in arguments.sizes() {
        let template = blade(count, 0.0);
        let reference: Vec<_> = blade(count, 0.5).iter().map(|point| truth() * point).collect();
        for sample_count in [count, 200, 100] {
            let mut rng = Seed(arguments.seed).stream(Stream::Sampling { view_index: 0 });
            let mut sample = |points: &[Point3<f64>]| -> Vec<Point3<f64>> {
                random_indices(points.len(), sample_count, &mut rng)
                    .into_iter()
                    .map(|index| points[index])
                    .collect()
            };
            let (moving, fixed) = (sample(&template), sample(&reference));
            let fall = |summation, repeats| {
                let settings = MpeSettings {
                    summation,
                    ..MpeSettings::default()
                };
                best_of(repeats, || descend(&moving, &fixed, &Isometry3::identity(), &settings))
            };
            let (fast_s, fast) = fall(Summation::Automatic, arguments.repeats());
            write!(out, "{count:>7} {sample_count:>6} {fast_s:>9.4}")?;
            if sample_count != count {
                writeln!(out, " {:>6} {:>9} {:>6} {:>6}", "", "", "", fast.iterations)?;
                continue;
            }
            let repeats = if count > 2000 { 1 } else { arguments.repeats() };
            let exact = (count <= arguments.pairs_max_count).then(|| fall(Summation::Pairs, repeats));
            let pairs_s = exact.as_ref().map_or(f64::NAN, |(seconds, _)| *seconds);
            let growth = rows.last().map_or((f64::NAN, f64::NAN), |(n, fast, pairs)| {
                let ratio = count as f64 / n;
                (power(fast_s / fast, ratio), power(pairs_s / pairs, ratio))
            });
            rows.push((count as f64, fast_s, pairs_s));
            let force_error = force_error(&moving, &fixed);
            force_error_max = force_error_max.max(force_error);
            let apart = exact.map_or(f64::NAN, |(_, exact)| {
                let between = exact.reference_from_template.inverse() * fast.reference_from_template;
                between.rotation.angle()
            });
            writeln!(
                out,
                " {:>6.2} {pairs_s:>9.4} {:>6.2} {:>6} {:>10.1e} {apart:>10.1e} {:>6} {}",
                growth.0,
                growth.1,
                fast.iterations,
                force_error,
                goal,
                if fast_s <= goal { "met" } else { "missed" },
            )?;
        }
    }
    if let [first, .., last] = rows.as_slice() {
        let ratio = last.0 / first.0;
        writeln!(
            out,
            "from {} to {} points: fast grows with N^{:.2}, pairs with N^{:.2}; largest force error {force_error_max:.1e}",
            first.0,
            last.0,
            power(last.1 / first.1, ratio),
            power(last.2 / first.2, ratio)
        )?;
    }
    Ok(force_error_max)
}

/// The exponent that makes `ratio` of sizes a ratio of times.
fn power(times: f64, ratio: f64) -> f64 {
    times.ln() / ratio.ln()
}

/// The largest error of a force over the sum of the magnitudes of its parts, of the field that MPE takes by itself.
fn force_error(template: &[Point3<f64>], reference: &[Point3<f64>]) -> f64 {
    let fast = Field::summed(reference, Summation::Automatic);
    let exact = Field::summed(reference, Summation::Pairs);
    let order = fast.best_order(template);
    let at: Vec<_> = match order {
        Some(order) => order.into_iter().map(|index| template[index]).collect(),
        None => template.to_vec(),
    };
    let softening = 0.03;
    let errors = fast.pulls(&at, softening).into_iter().zip(exact.pulls(&at, softening));
    let largest = errors
        .zip(&at)
        .step_by(at.len().div_ceil(2000))
        .map(|((fast, exact), at)| {
            let parts = reference.iter().map(|mass| ((mass - at).norm() + softening).powi(-2));
            (fast.force - exact.force).norm() / parts.sum::<f64>()
        });
    largest.fold(0.0, f64::max)
}

/// A whole frame on one core: decoded, judged, and handed on as a cloud.
fn frame(arguments: &BenchArguments, out: &mut impl Write) -> std::io::Result<()> {
    let (width, height) = if arguments.quick { (360, 270) } else { (1440, 1080) };
    let count = (width * height) as usize;
    let xyz = (0..height).flat_map(|row| {
        (0..width).flat_map(move |column| {
            let [u, v] = [(column as f32 - 720.0) * 1.4e-4, (row as f32 - 540.0) * 1.4e-4];
            let noise = 0.03 * (((column * 131 + row * 977) as f32 * 0.819).sin() * 43_758.547).fract();
            let z = 280.0 + 3.0 * (column as f32 * 0.01).sin() * (row as f32 * 0.013).cos() + noise;
            [u * z, v * z, z].into_iter().flat_map(f32::to_le_bytes)
        })
    });
    let capture = Capture {
        trigger_id: TriggerId(0),
        width_px: width,
        height_px: height,
        valid_count: width * height,
        saturated_count: 0,
        points: CapturedPoints::Xyz(xyz.collect()),
        intensity: None,
        confidence: None,
        mask: vec![0; count],
    };
    writeln!(out, "\na frame of {count} valid points on one core (ms)")?;
    let (decode_s, grid) = best_of(arguments.repeats(), || capture.grid());
    writeln!(out, "  {:<26} {:>7.1}", "camera decode", decode_s * 1e3)?;
    for kernel in Kernel::available() {
        let judged = || {
            let grid = grid.clone();
            let begun = Instant::now();
            let judged = cleaning::judge(grid, &cleaning::Settings::default(), kernel);
            (begun.elapsed().as_secs_f64(), judged)
        };
        let clean_s = (0..arguments.repeats())
            .map(|_| judged().0)
            .fold(f64::INFINITY, f64::min);
        writeln!(
            out,
            "  {:<26} {:>7.1}",
            format!("clean, normals ({})", kernel.name()),
            clean_s * 1e3
        )?;
    }
    let judged = cleaning::judge(grid, &cleaning::Settings::default(), Kernel::fastest());
    let (cloud_s, cloud) = best_of(arguments.repeats(), || judged.cloud());
    writeln!(out, "  {:<26} {:>7.1}  {} points", "cloud", cloud_s * 1e3, cloud.len())
}

/// The stages of one view of 50,000 points registered to a model of 400,000, from a start like the robot's.
fn view(arguments: &BenchArguments, out: &mut impl Write) -> std::io::Result<()> {
    let oriented = |points: Vec<Point3<f64>>| {
        let cloud = PointCloud::from_measured(points).cloud;
        let tree = NearestPoints::new(cloud.points());
        with_estimated_normals(&cloud, &tree, 20, Some(&Point3::new(0.0, 0.0, 1e6)))
    };
    let scaled = |count, phase| blade(count, phase).into_iter().map(|point| point * 40.0).collect();
    let tenth = if arguments.quick { 1 } else { 10 };
    let model = oriented(scaled(40_000 * tenth, 0.0));
    let in_sight: Vec<Point3<f64>> = scaled(14_000 * tenth, 0.5);
    // Noise of a scanner, up to 0.02 mm either way along each axis.
    let noise = |i: usize, rate: f64| 0.04 * ((i as f64 * rate).sin() * 43_758.545).fract();
    let measured = in_sight.into_iter().filter(|point| point.y > 4.0).enumerate();
    let measured =
        measured.map(|(i, point)| point + Vector3::new(noise(i, 0.819), noise(i, 0.671), noise(i, 0.549)) * 0.5);
    let half = oriented(measured.collect());
    let start = Isometry3::new(Vector3::new(0.2, -0.2, 0.1), Vector3::new(0.002, -0.001, 0.002));
    writeln!(
        out,
        "\none view of {} points to a model of {}, start wrong by 0.3 mm and 0.17 deg, {} threads (ms)",
        half.len(),
        model.len(),
        arguments.threads
    )?;
    let (reference_s, reference) = best_of(arguments.repeats(), || Reference::new(&model));
    let reference = reference.map_err(std::io::Error::other)?;
    writeln!(
        out,
        "  {:<10} {:>7.1}  (in the next view's job, not in the total)",
        "reference",
        reference_s * 1e3
    )?;
    let settings = Settings {
        search: Search::NearPart { reach_factor: 0.25 },
        ..Settings::default()
    };
    let (total_s, (stages, found)) = best_of(arguments.repeats(), || {
        let mut stages = Vec::new();
        let mut begun = Instant::now();
        let rng = Seed(arguments.seed).stream(Stream::Sampling { view_index: 0 });
        let found = register_from(&half, &reference, &start, &settings, rng, &mut |stage| {
            stages.push((stage.name, stage.iterations, begun.elapsed().as_secs_f64()));
            begun = Instant::now();
        });
        (stages, found)
    });
    for (name, iterations, seconds) in stages {
        writeln!(out, "  {name:<10} {:>7.1}  {iterations} iterations", seconds * 1e3)?;
    }
    let error = found.reference_from_template;
    writeln!(
        out,
        "  {:<10} {:>7.1}  {:?}, off by {:.5} deg and {:.5} mm",
        "register",
        total_s * 1e3,
        found.status,
        error.rotation.angle().to_degrees(),
        error.translation.vector.norm()
    )?;
    Ok(())
}

/// Operations of a pair of points: 3 differences, 3 squares, 3 sums, a root, a sum, 2 products, a quotient, and for the
/// three forces and the potential 5 products and 4 sums.
const PAIR_OPERATIONS: f64 = 23.0;
