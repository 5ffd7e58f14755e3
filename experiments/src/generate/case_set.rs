//! The benchmark of blade registration in plain files: every kind of case, a data card and checksums.

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use bladescan::job::sha256;
use clap::Args;
use hw_sim::blade::{Builtin, stl};

use super::surface::Surface;
use super::{GenerateArguments, Kind};

/// Writes the whole benchmark: four blades, dense views all around and the kinds of pairs.
#[derive(Args)]
pub(crate) struct CaseSetArguments {
    /// A folder that is empty or not there.
    out: PathBuf,
    /// Seeds everything drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Dense views of each blade, 10 degrees apart.
    #[arg(long, default_value_t = 36, value_parser = clap::value_parser!(u32).range(2..=36))]
    views: u32,
    /// Cases of each blade and level of the other kinds.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    count: u32,
}

pub(crate) fn run(arguments: &CaseSetArguments) -> Result<(), Box<dyn Error>> {
    let out = &arguments.out;
    fs::create_dir_all(out)?;
    if fs::read_dir(out)?.next().is_some() {
        return Err(format!("{} is not empty: nothing is overwritten", out.display()).into());
    }
    for kind in KINDS {
        super::run(&of_kind(arguments, kind, out.join(folder_of(kind)), None))?;
    }
    for blade in Builtin::ALL {
        let folder = out.join(folder_of(Kind::Views)).join(blade.name());
        super::run(&of_kind(arguments, Kind::Views, folder.clone(), Some(blade)))?;
        stl::write(&folder.join("blade.stl"), &Surface::of_builtin(blade)?.mesh())?;
    }
    fs::write(out.join("README.md"), card(arguments))?;
    let mut files = Vec::new();
    list(out, &mut files)?;
    files.sort();
    let mut sums = String::new();
    for path in &files {
        let name = path.strip_prefix(out)?.display();
        sums += &format!("{}  {name}\n", sha256(&fs::read(path)?));
    }
    fs::write(out.join("SHA256SUMS"), sums)?;
    writeln!(
        std::io::stdout(),
        "{}: {} files, README.md, SHA256SUMS",
        out.display(),
        files.len()
    )?;
    Ok(())
}

fn of_kind(arguments: &CaseSetArguments, kind: Kind, out: PathBuf, blade: Option<Builtin>) -> GenerateArguments {
    GenerateArguments {
        out,
        kind,
        blade: blade.map(|blade| blade.name().to_owned()).into_iter().collect(),
        mesh: Vec::new(),
        seed: arguments.seed,
        count: Some(match kind {
            Kind::Views => arguments.views,
            _ => arguments.count,
        }),
        level: None,
    }
}

fn folder_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Noise => "noise",
        Kind::Outlier => "outlier",
        Kind::Resample => "resample",
        Kind::Partial => "partial",
        Kind::Views => "views",
    }
}

fn list(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            list(&path, files)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}

/// What whoever uses the set must know.
fn card(arguments: &CaseSetArguments) -> String {
    let CaseSetArguments { seed, views, count, .. } = arguments;
    let version = env!("CARGO_PKG_VERSION");
    format!(
        r#"# Turbine blades: registration and multi-view reconstruction with known truth

Made by bladescan {version}: `experiments case-set OUT --seed {seed} --views {views} --count {count}`. The same command gives the same bytes on the same
kind of machine; `sha256sum -c SHA256SUMS` checks them. Synthetic: four lofted blades (`lpt` a slender low-pressure blade without platform, `hpt-a`, `hpt-b`, `hpt-c` high-pressure
blades), no real part, no person. May be used as the program may: MIT or Apache-2.0.

## A case

A folder with `source.ply`, `target.ply` (binary PLY, float32 x y z, no order that means anything), `gt.txt` (4 x 4, row-major: target_from_source) and `meta.txt`
(`exp`, `model`, `level`, `seed`; `diag` where clouds are in mm, `overlap` of two single views). A `.ply` whose text is a path stands for the file there.

Right is a rotation within 2 degrees and a translation within 0.02 (of views in mm: 1 % of half `diag`). RMSE is that of the source's points, laid by the estimate and by the truth.

| folder | cases of each blade and level | what | levels |
|---|---|---|---|
| `noise` | {count} | the same 3,000 points, Gaussian noise on each axis of the target, shuffled | sigma 0.01 to 0.14 |
| `outlier` | {count} | the same 3,000 points, sigma 0.005, and points drawn evenly from the cube around | 200, 950, 2000, 2800 points |
| `resample` | {count} | two independent samples of 3,000 points, sigma 0.01 on the target | 0.01 |
| `partial` | {count} | what two cameras see, 3,000 points each, sigma 0.002, camera 45 degrees above | 10, 30, 60, 90 degrees apart about z |
| `views/BLADE` | | {views} dense views and the pairs that link them | 10, 30, 60 degrees apart |

All but `views` are of a blade whose longest half extent is 1; the truth turns by at most 90 degrees and shifts by at most 0.5 along each axis.

## Dense views

`view_NN.ply`: about 52,000 points in mm, in a frame of its own (origin within 2.5 mm of the blade's middle on each axis, z towards the camera). `pose_NN.txt`: 4 x 4, view_from_blade.
`blade.stl`: the surface, mm, in the blade's frame (middle of its box, longest side along z). View NN is taken at azimuth 10 x NN degrees and elevation 45 degrees, both and the roll off by up to 3 degrees.

Noise of a point: 0.02 mm (one standard deviation) along its ray and 0.005 mm on every axis; 0.5 % of the points lie anywhere along their ray, up to 0.3 half diagonals from the
surface; below a cosine of the incidence of 0.3 ever fewer points; 12 round holes of 0.005 to 0.02 half diagonals. Left out: bias, speckle, reflections, the grid of pixels, the calibration's error. Results here are
therefore a bound on what real scans give.
"#
    )
}

const KINDS: [Kind; 4] = [Kind::Noise, Kind::Outlier, Kind::Resample, Kind::Partial];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_set_is_whole_and_its_sums_are_right() {
        let arguments = CaseSetArguments {
            out: std::env::temp_dir().join(format!("bladescan-case-set-{}", std::process::id())),
            seed: 1,
            views: 2,
            count: 1,
        };
        run(&arguments).unwrap();
        let sums = fs::read_to_string(arguments.out.join("SHA256SUMS")).unwrap();
        for name in [
            "README.md",
            "noise/lpt_s0.14_0/gt.txt",
            "partial/hpt-c_g90_0/target.ply",
            "views/hpt-a/blade.stl",
            "views/hpt-a/view_01.ply",
            "views/hpt-a/pair_00_01/meta.txt",
        ] {
            let line = sums.lines().find(|line| line.ends_with(&format!("  {name}")));
            let sum = sha256(&fs::read(arguments.out.join(name)).unwrap());
            assert!(line.is_some_and(|line| line.starts_with(&sum)), "{name}");
        }
        let again = run(&arguments).unwrap_err().to_string();
        assert!(again.contains("nothing is overwritten"), "{again}");
        fs::remove_dir_all(&arguments.out).unwrap();
    }
}
