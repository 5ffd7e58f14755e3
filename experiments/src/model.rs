//! A whole chain: every view of a folder registered to the growing model and merged.

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use bladescan::reconstruction::{Decision, Model, ViewSettings, register_view};
use bladescan::seed::{Seed, Stream};
use clap::Args;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::cases;

/// Registers `view_NN.ply` in order, each from its true pose (`pose_NN.txt`, view_from_blade) disturbed a little.
#[derive(Args)]
pub(crate) struct ModelArguments {
    /// The folder with the views.
    folder: PathBuf,
    /// How many views.
    #[arg(long, default_value_t = 36)]
    views: u32,
    /// The distance within which points are merged, mm.
    #[arg(long, default_value_t = 0.15)]
    coincident_mm: f64,
    /// How wrong the start is, mm, along a fixed direction, and the same number in tenths of a degree.
    #[arg(long, default_value_t = 0.3)]
    start_error_mm: f64,
    /// Where to write a row for each view: `rms_mm` between the true and the found place of its points, `seconds` for all that
    /// it takes but reading.
    #[arg(long)]
    csv: Option<PathBuf>,
}

pub(crate) fn run(arguments: &ModelArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut model = Model::default();
    let mut first = None;
    let mut rows = String::from(COLUMNS);
    let pose = |view: u32| -> Result<Isometry3<f64>, Box<dyn Error>> {
        let path = arguments.folder.join(format!("pose_{view:02}.txt"));
        Ok(cases::isometry(&cases::matrix(&path)?))
    };
    for view_index in 0..arguments.views {
        let view = cases::cloud(&arguments.folder.join(format!("view_{view_index:02}.ply")))?;
        let view_0_from_blade = match first {
            Some(pose) => pose,
            None => *first.insert(pose(view_index)?),
        };
        let truth = view_0_from_blade * pose(view_index)?.inverse();
        // The camera looks along -z of these frames or +z, whichever most normals say: give it a far viewpoint.
        let begun = Instant::now();
        let view = with_normals(&view);
        let normals_s = begun.elapsed().as_secs_f64();
        let turn = Vector3::new(0.5, -0.3, 0.8).normalize() * (0.1 * arguments.start_error_mm).to_radians();
        let wrong = Isometry3::new(Vector3::new(0.6, 0.64, -0.48) * arguments.start_error_mm, turn);
        let start = if view_index == 0 { truth } else { truth * wrong };
        let begun = Instant::now();
        let rng = Seed(1).stream(Stream::Sampling { view_index });
        if !model.is_empty() {
            model.reference()?;
        }
        let reference_s = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        let mut stages = Vec::new();
        let result = register_view(&view, &model, &start, &ViewSettings::default(), rng, &mut |stage| {
            stages.push(format!(
                "{} {} {:.0}ms",
                stage.name,
                stage.iterations,
                begun.elapsed().as_secs_f64() * 1e3
            ));
        });
        let register_s = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        if result.decision == Decision::Merge {
            model = model.merged_with(&view, &result.model_from_view, arguments.coincident_mm);
        }
        let merge_s = begun.elapsed().as_secs_f64();
        let squared: f64 = view
            .points()
            .iter()
            .map(|point: &Point3<f64>| (truth * point - result.model_from_view * point).norm_squared())
            .sum();
        let rms_mm = (squared / view.len() as f64).sqrt();
        rows += &format!(
            "bladescan,{},0,{view_index},{},{rms_mm:.9},{:.4}\n",
            rayon::current_num_threads(),
            u8::from(result.decision == Decision::Merge),
            normals_s + reference_s + register_s + merge_s,
        );
        writeln!(
            out,
            "view {view_index:02} {:?} {:?} surface rms {:.1} um, {} points -> {}; ms: normals {:.0}, reference {:.0}, register {:.0}, merge {:.0} [{}]",
            result.decision,
            result.registration.as_ref().map(|r| r.status),
            1e3 * rms_mm,
            view.len(),
            model.len(),
            1e3 * normals_s,
            1e3 * reference_s,
            1e3 * register_s,
            1e3 * merge_s,
            stages.join(", "),
        )?;
    }
    if let Some(path) = &arguments.csv {
        fs::write(path, rows)?;
    }
    Ok(())
}

/// Normals that face a camera far up the z axis.
fn with_normals(view: &bladescan::geometry::PointCloud) -> bladescan::geometry::PointCloud {
    let tree = bladescan::geometry::nearest::NearestPoints::new(view.points());
    let camera = Point3::new(0.0, 0.0, 1e6);
    bladescan::geometry::normals::with_estimated_normals(view, &tree, 20, Some(&camera))
}

/// As `experiments/peers/chain.py` writes them, which sets the repeat.
const COLUMNS: &str = "method,threads,repeat,view,merged,rms_mm,seconds\n";
