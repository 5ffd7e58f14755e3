//! Every view of a blade laid on the growing model, one after the other.

use std::time::Instant;

use bladescan::geometry::PointCloud;
use bladescan::geometry::nearest::NearestPoints;
use bladescan::geometry::normals::with_estimated_normals;
use bladescan::reconstruction::{Decision, Model, ViewSettings, register_view};
use bladescan::seed::{Seed, Stream};
use nalgebra::{Isometry3, Point3};

use super::Effort;
use crate::generate::Surface;
use crate::generate::views::{AROUND_COUNT, VIEW_POINT_COUNT, View};
use crate::methods::product::{mpe, register};

/// One view where each stage has laid it; all poses are model_from_view, mm.
pub(crate) struct Placed {
    pub(crate) cloud: PointCloud,
    pub(crate) truth: Isometry3<f64>,
    /// What MPE by itself makes of it, from where the view before it was found.
    pub(crate) coarse: Isometry3<f64>,
    pub(crate) fine: Isometry3<f64>,
    /// Whether the product merged it; if not, `fine` is the start that the view before it gave.
    pub(crate) decision: Decision,
    /// From the points to the merged model, without `coarse`.
    pub(crate) seconds: f64,
}

/// Views of a blade in order, 10 degrees apart, and the pose of the first, whose frame is the model's.
pub(crate) struct Chain {
    pub(crate) views: Vec<Placed>,
    pub(crate) model_from_blade: Isometry3<f64>,
}

impl Chain {
    /// Registers all views. No robot tells where a view lies: the product registers it to the view before it, and from there
    /// to the model.
    pub(crate) fn new(effort: &Effort, blade: &str, surface: &Surface) -> Self {
        let mut views: Vec<Placed> = Vec::new();
        let mut model = Model::default();
        let mut model_from_blade = Isometry3::identity();
        for index in 0..view_count(effort) {
            let view = view(effort, blade, surface, index);
            if index == 0 {
                model_from_blade = view.view_from_blade;
            }
            let truth = model_from_blade * view.view_from_blade.inverse();
            let begun = Instant::now();
            let cloud = with_normals(view.points);
            let start = views
                .last()
                .map_or(truth, |last| last.fine * register(&cloud, &last.cloud));
            let stream = Seed(effort.seed).stream(Stream::Sampling { view_index: index });
            let found = register_view(&cloud, &model, &start, &ViewSettings::default(), stream, &mut |_| ());
            if found.decision == Decision::Merge {
                model = model.merged_with(&cloud, &found.model_from_view, COINCIDENT_MM);
            }
            let seconds = begun.elapsed().as_secs_f64();
            let coarse = views.last().map_or(truth, |last| {
                last.fine * mpe(&cloud, &last.cloud, &Isometry3::identity())
            });
            views.push(Placed {
                cloud,
                truth,
                coarse,
                fine: found.model_from_view,
                decision: found.decision,
                seconds,
            });
        }
        Self {
            views,
            model_from_blade,
        }
    }
}

/// One of the views all around.
pub(crate) fn view(effort: &Effort, blade: &str, surface: &Surface, index: u32) -> View {
    let point_count = if effort.quick {
        QUICK_POINT_COUNT
    } else {
        VIEW_POINT_COUNT
    };
    View::new(surface, blade, effort.seed, index, point_count)
}

/// How many views go around, or as many as a quick look takes.
fn view_count(effort: &Effort) -> u32 {
    if effort.quick { QUICK_VIEW_COUNT } else { AROUND_COUNT }
}

/// With normals towards the camera, which is far up the z axis of a view's frame.
fn with_normals(points: Vec<Point3<f64>>) -> PointCloud {
    let cloud = PointCloud::from_measured(points).cloud;
    let tree = NearestPoints::new(cloud.points());
    with_estimated_normals(&cloud, &tree, NEIGHBOUR_COUNT, Some(&Point3::new(0.0, 0.0, 1e6)))
}

/// As the recipes have it.
const COINCIDENT_MM: f64 = 0.15;
const NEIGHBOUR_COUNT: usize = 20;
const QUICK_POINT_COUNT: usize = 6000;
const QUICK_VIEW_COUNT: u32 = 10;
