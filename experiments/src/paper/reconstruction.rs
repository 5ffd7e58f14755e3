//! Views before registration, after its coarse and after its fine stage, as pictures (Fig. fig52).

use std::error::Error;

use bladescan::reconstruction::{Decision, DiscardReason};
use hw_sim::blade::Builtin;
use nalgebra::{Isometry3, Point3, Rotation3, Vector3};

use super::Effort;
use super::chain::{Chain, Placed};
use super::item::{Item, Summary, short};
use super::scene::{Panel, Scene};
use crate::cases::{median, rmse};
use crate::generate::{Surface, extents, stream};

/// Which pose of a view is shown.
type Stage = fn(&Placed) -> Isometry3<f64>;

pub(crate) fn measure(effort: &Effort) -> Result<Item, Box<dyn Error>> {
    let mut item = Item::new(
        &["blade", "view", "decision", "coarse_rms_mm", "fine_rms_mm"],
        "36 dense views, one after the other, with no robot to tell where they lie. Coarse: MPE by itself, on samples of 500 points of the view and the one before it. Fine: the \
         product, to the view before and then to the growing model. RMS over a view's points between found and true place. The first three pictures show four views; the last two the section at mid height of all views, about its leading edge.",
    );
    for blade in Builtin::ALL {
        let surface = Surface::of_builtin(blade)?;
        let chain = Chain::new(effort, blade.name(), &surface);
        let stages: [Stage; 2] = [|view| view.coarse, |view| view.fine];
        let mut errors = [Vec::new(), Vec::new()];
        for (index, view) in chain.views.iter().enumerate().skip(1) {
            let truth = view.truth.to_homogeneous();
            let of_view = stages.map(|stage| rmse(&view.cloud, &stage(view).to_homogeneous(), &truth));
            item.rows.push(vec![
                blade.name().to_owned(),
                index.to_string(),
                said(view.decision).to_owned(),
                format!("{:.6}", of_view[0]),
                format!("{:.6}", of_view[1]),
            ]);
            for (errors, error) in errors.iter_mut().zip(of_view) {
                errors.push(error);
            }
        }
        let count = |what: &str| chain.views.iter().filter(|view| said(view.decision) == what).count();
        let merged_count = count(MERGED);
        let largest = errors[1].iter().copied().fold(0.0, f64::max);
        let [coarse, fine] = errors.map(median);
        item.summary.push(Summary::new(
            blade.name(),
            "coarse, then fine",
            format!(
                "{merged_count} of {} merged{}; coarse {} mm, fine {} mm (median), {} mm (largest)",
                chain.views.len(),
                DISCARDED
                    .iter()
                    .map(|what| (what, count(what)))
                    .filter(|(_, count)| *count > 0)
                    .map(|(what, count)| format!(", {count} {what}"))
                    .collect::<String>(),
                short(coarse),
                short(fine),
                short(largest)
            ),
            if merged_count == chain.views.len() && fine < coarse {
                "as the paper says"
            } else {
                "not so"
            },
        ));
        item.pictures.push((
            blade.name().to_owned(),
            scene(effort, blade.name(), &surface, &chain).svg(),
        ));
    }
    Ok(item)
}

fn said(decision: Decision) -> &'static str {
    match decision {
        Decision::Merge => MERGED,
        Decision::Discard(DiscardReason::TooLittleOverlap { .. }) => DISCARDED[0],
        Decision::Discard(DiscardReason::Ambiguous { .. }) => DISCARDED[1],
        Decision::Discard(_) => DISCARDED[2],
    }
}

fn scene(effort: &Effort, blade: &str, surface: &Surface, chain: &Chain) -> Scene {
    let step = (chain.views.len() / SHOWN_COUNT).clamp(1, SHOWN_STEP);
    let (shown, others): (Vec<_>, Vec<_>) =
        (0..chain.views.len()).partition(|index| index % step == 0 && index / step < SHOWN_COUNT);
    let order: Vec<usize> = shown.iter().chain(&others).copied().collect();
    let initial: Stage = |_| Isometry3::identity();
    let (coarse, fine): (Stage, Stage) = (|view| view.coarse, |view| view.fine);
    let solid = |caption: &str, stage: Stage| Panel {
        caption: caption.to_owned(),
        clouds: shown.iter().map(|&index| seen(chain, index, stage)).collect(),
        window: None,
        bar_mm: 20.0,
    };
    let sampled = surface.sample(
        SURFACE_SAMPLE_COUNT,
        &mut stream(effort.seed, &format!("fig52 {blade}")),
    );
    let (low, high) = extents(&sampled);
    let is_in_slab = |point: &Point3<f64>| (point.z - (low.z + high.z) / 2.0).abs() < SLAB_HALF_MM;
    let section = |index: &usize, stage: Stage| -> Vec<[f64; 2]> {
        let points = in_blade(chain, &chain.views[*index], stage).filter(is_in_slab);
        points.map(|point| [point.x, point.y]).collect()
    };
    let edge = sampled
        .iter()
        .filter(|point| is_in_slab(point))
        .min_by(|a, b| a.x.total_cmp(&b.x))
        .map_or([0.0; 2], |point| [point.x, point.y]);
    let detail = |caption: &str, stage: Stage| Panel {
        caption: caption.to_owned(),
        clouds: order.iter().map(|index| section(index, stage)).collect(),
        window: Some(([edge[0] + 0.8 * DETAIL_HALF_MM, edge[1]], DETAIL_HALF_MM)),
        bar_mm: 1.0,
    };
    Scene {
        title: format!("{blade}: multiview reconstruction"),
        legend: shown.iter().map(|index| format!("view {index}")).collect(),
        panels: vec![
            solid("as measured", initial),
            solid("coarse", coarse),
            solid("fine", fine),
            detail("section, coarse", coarse),
            detail("section, fine", fine),
        ],
    }
}

/// Some points of a view as one sees the blade from the side and a little above.
fn seen(chain: &Chain, index: usize, stage: Stage) -> Vec<[f64; 2]> {
    let view = &chain.views[index];
    let look = Rotation3::from_euler_angles(LOOK_DOWN_RAD, 0.0, 0.0)
        * Rotation3::from_axis_angle(&Vector3::z_axis(), LOOK_AROUND_RAD);
    let step = view.cloud.len().div_ceil(DOT_COUNT);
    let points = in_blade(chain, view, stage).step_by(step);
    points
        .map(|point| {
            let place = look * point;
            [place.x, place.z]
        })
        .collect()
}

/// The points of a view where a stage has laid them, in the blade's frame.
fn in_blade<'a>(chain: &Chain, view: &'a Placed, stage: Stage) -> impl Iterator<Item = Point3<f64>> + 'a {
    let blade_from_view = chain.model_from_blade.inverse() * stage(view);
    view.cloud.points().iter().map(move |point| blade_from_view * point)
}

const MERGED: &str = "merged";
/// Why a view is not.
const DISCARDED: [&str; 3] = ["overlap too little", "ambiguous", "failed"];
/// Points that tell where the surface is.
const SURFACE_SAMPLE_COUNT: usize = 100_000;
/// Views of the first pictures, and how far apart they are.
const SHOWN_COUNT: usize = 4;
const SHOWN_STEP: usize = 3;
/// Dots of a view.
const DOT_COUNT: usize = 900;
const LOOK_DOWN_RAD: f64 = 0.35;
/// Brings what the first ten views see most of to the front.
const LOOK_AROUND_RAD: f64 = -0.75 * std::f64::consts::PI;
const SLAB_HALF_MM: f64 = 0.25;
/// Half the side of the enlarged part.
const DETAIL_HALF_MM: f64 = 3.0;
