//! The merged cloud of all accepted views.

use std::sync::OnceLock;

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use crate::geometry::PointCloud;
use crate::geometry::nearest::NearestPoints;
use crate::geometry::normals::with_estimated_normals;
use crate::registration::{Reference, RegisterError};

/// The model so far: merged points with normals in the camera frame of view 0, each with the number of measured points
/// that it stands for. Empty before the first view.
///
/// A model point is matched by where it was first measured, its *anchor*, while its position is the mean of all that was
/// merged into it. So merging a view a second time adds no points, whatever the noise.
#[derive(Clone, Default)]
pub struct Model {
    anchors: Vec<Anchor>,
    points: Vec<ModelPoint>,
    view_count: usize,
    reference: OnceLock<std::sync::Arc<Reference>>,
}

/// One merged point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelPoint {
    /// Mean of the measured points, in the model's frame.
    pub position: Point3<f64>,
    /// Unit mean of their normals.
    pub normal: Vector3<f64>,
    /// How many measured points it stands for.
    pub weight: u32,
}

#[derive(Clone, Copy)]
struct Anchor {
    position: Point3<f64>,
    normal: Vector3<f64>,
}

impl std::fmt::Debug for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Model")
            .field("point_count", &self.points.len())
            .field("view_count", &self.view_count)
            .finish_non_exhaustive()
    }
}

impl Model {
    /// The model with one more view: measured points that coincide with a model point are merged into it, the others are
    /// added in the view's order.
    ///
    /// `view` is in its camera's frame, with normals that face the camera; without normals they are estimated, facing
    /// the frame's origin. A point coincides with the nearest model point (by anchor) within `coincident_distance`
    /// whose normal differs from its own by less than 60 degrees: the two sides of a thin trailing edge stay two
    /// sides. Points of one view are never merged with each other. Positions are weighted means, normals are averaged
    /// and made unit again. The order in which *views* are merged decides which points are anchors, so the results of
    /// two orders agree to within `coincident_distance`, not bit for bit; the order of points within a view does not
    /// change which points are merged.
    pub fn merged_with(&self, view: &PointCloud, model_from_view: &Isometry3<f64>, coincident_distance: f64) -> Self {
        let view = with_normals(view).transformed(model_from_view);
        let normals = view.normals().unwrap_or(&[]);
        let tree = NearestPoints::new(&self.anchors.iter().map(|anchor| anchor.position).collect::<Vec<_>>());
        let targets: Vec<Option<usize>> = view
            .points()
            .par_iter()
            .zip(normals)
            .with_min_len(1024)
            .map(|(point, normal)| self.coincident(&tree, point, normal, coincident_distance))
            .collect();
        let mut sums: Vec<Sum> = vec![Sum::default(); self.points.len()];
        let mut points = self.points.clone();
        let mut anchors = self.anchors.clone();
        for ((position, normal), target) in view.points().iter().zip(normals).zip(&targets) {
            match *target {
                Some(index) => sums[index].add(position, normal),
                None => {
                    anchors.push(Anchor {
                        position: *position,
                        normal: *normal,
                    });
                    points.push(ModelPoint {
                        position: *position,
                        normal: *normal,
                        weight: 1,
                    });
                }
            }
        }
        for (point, sum) in points.iter_mut().zip(&sums) {
            *point = point.with(sum);
        }
        Self {
            anchors,
            points,
            view_count: self.view_count + 1,
            reference: OnceLock::new(),
        }
    }

    fn coincident(
        &self,
        tree: &NearestPoints,
        point: &Point3<f64>,
        normal: &Vector3<f64>,
        reach: f64,
    ) -> Option<usize> {
        let agrees = |index: usize| self.anchors[index].normal.dot(normal) > SAME_SIDE_COSINE;
        let nearest = tree.nearest_within(point, reach)?;
        if agrees(nearest.index) {
            return Some(nearest.index);
        }
        // The other side of a thin wall may be nearer than this one.
        tree.all_within(point, reach)
            .into_iter()
            .map(|found| found.index)
            .find(|&index| agrees(index))
    }

    /// The merged points.
    pub fn points(&self) -> &[ModelPoint] {
        &self.points
    }

    /// How many merged points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether nothing has been merged yet.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// How many views have been merged.
    pub fn view_count(&self) -> usize {
        self.view_count
    }

    /// The merged points and normals as a cloud, in the model's frame.
    pub fn cloud(&self) -> PointCloud {
        let cloud = PointCloud::from_measured(self.points.iter().map(|point| point.position)).cloud;
        let normals = self.points.iter().map(|point| point.normal).collect();
        cloud.clone().with_normals(normals).unwrap_or(cloud)
    }

    /// The model prepared for registration; made on the first call, then kept.
    ///
    /// # Errors
    /// When the model is too small to register to.
    pub fn reference(&self) -> Result<&Reference, RegisterError> {
        if let Some(reference) = self.reference.get() {
            return Ok(reference);
        }
        let made = std::sync::Arc::new(Reference::new(&self.cloud())?);
        Ok(self.reference.get_or_init(|| made))
    }
}

impl ModelPoint {
    fn with(&self, sum: &Sum) -> Self {
        if sum.count == 0 {
            return *self;
        }
        let weight = self.weight.saturating_add(sum.count);
        let share = f64::from(sum.count) / f64::from(weight);
        let mean = sum.offset(&self.position) / f64::from(sum.count);
        let normal = self.normal * f64::from(self.weight) + sum.normal;
        Self {
            position: self.position + mean * share,
            normal: normal.try_normalize(0.0).unwrap_or(self.normal),
            weight,
        }
    }
}

#[derive(Clone, Default)]
struct Sum {
    count: u32,
    position: Vector3<f64>,
    normal: Vector3<f64>,
}

impl Sum {
    fn add(&mut self, position: &Point3<f64>, normal: &Vector3<f64>) {
        self.count += 1;
        self.position += position.coords;
        self.normal += normal;
    }

    /// The sum of the offsets from `origin`.
    fn offset(&self, origin: &Point3<f64>) -> Vector3<f64> {
        self.position - origin.coords * f64::from(self.count)
    }
}

pub(super) fn with_normals(view: &PointCloud) -> PointCloud {
    if view.normals().is_some() || view.is_empty() {
        return view.clone();
    }
    let tree = NearestPoints::new(view.points());
    with_estimated_normals(view, &tree, NORMAL_NEIGHBOUR_COUNT, Some(&Point3::origin()))
}

/// Cosine of the angle up to which two normals can belong to the same side.
const SAME_SIDE_COSINE: f64 = 0.5;
const NORMAL_NEIGHBOUR_COUNT: usize = 20;

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet at height `z` with normals along `side · z`.
    fn sheet(z: f64, side: f64, shift: f64) -> PointCloud {
        let points = (0..2500).map(|i| Point3::new(f64::from(i % 50) + shift, f64::from(i / 50) + shift, z));
        let cloud = PointCloud::from_measured(points).cloud;
        let normals = vec![Vector3::z() * side; cloud.len()];
        cloud.with_normals(normals).unwrap()
    }

    #[test]
    fn merging_a_view_twice_adds_no_points_and_doubles_the_weights() {
        let view = sheet(0.0, 1.0, 0.0);
        let pose = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.1, 0.2, 0.3));
        let once = Model::default().merged_with(&view, &pose, 0.4);
        let twice = once.merged_with(&view, &pose, 0.4);
        assert_eq!((once.len(), twice.len(), twice.view_count()), (2500, 2500, 2));
        assert!(twice.points().iter().all(|point| point.weight == 2));
        for (a, b) in once.points().iter().zip(twice.points()) {
            assert!((a.position - b.position).norm() < 1e-12 && (a.normal - b.normal).norm() < 1e-12);
        }
    }

    #[test]
    fn the_model_stays_bounded_under_noisy_views() {
        let mut model = Model::default();
        for view in 0..20 {
            let noise = 0.3 * (f64::from(view) * 1.7).sin();
            model = model.merged_with(&sheet(noise, 1.0, 0.2 * noise), &Isometry3::identity(), 0.8);
        }
        assert_eq!(model.len(), 2500);
        let again = model.merged_with(&sheet(-0.3, 1.0, 0.0), &Isometry3::identity(), 0.8);
        assert_eq!(again.len(), 2500);
    }

    #[test]
    fn the_two_sides_of_a_thin_wall_are_never_merged() {
        let front = Model::default().merged_with(&sheet(0.05, 1.0, 0.0), &Isometry3::identity(), 0.4);
        let both = front.merged_with(&sheet(-0.05, -1.0, 0.0), &Isometry3::identity(), 0.4);
        assert_eq!(both.len(), 5000);
        let again = both.merged_with(&sheet(0.05, 1.0, 0.01), &Isometry3::identity(), 0.4);
        assert_eq!(again.len(), 5000);
        assert!(
            again
                .points()
                .iter()
                .all(|p| p.normal.z.signum() == p.position.z.signum())
        );
    }

    #[test]
    fn positions_are_weighted_means() {
        let still = Isometry3::identity();
        let model = Model::default()
            .merged_with(&sheet(0.0, 1.0, 0.0), &still, 0.5)
            .merged_with(&sheet(0.0, 1.0, 0.0), &still, 0.5)
            .merged_with(&sheet(0.3, 1.0, 0.0), &still, 0.5);
        assert!(
            model
                .points()
                .iter()
                .all(|point| (point.position.z - 0.1).abs() < 1e-12)
        );
    }

    #[test]
    fn any_number_of_threads_gives_the_same_model() {
        let build = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                Model::default()
                    .merged_with(&sheet(0.0, 1.0, 0.0), &Isometry3::identity(), 0.5)
                    .merged_with(&sheet(0.1, 1.0, 0.4), &Isometry3::identity(), 0.5)
            })
        };
        assert_eq!(build(1).points(), build(2).points());
        assert_eq!(build(1).points(), build(8).points());
    }

    #[test]
    fn an_empty_model_has_no_reference() {
        assert!(Model::default().reference().is_err());
        assert!(Model::default().cloud().is_empty());
        let model = Model::default().merged_with(&sheet(0.0, 1.0, 0.0), &Isometry3::identity(), 0.5);
        assert!(model.reference().unwrap().is_oriented());
    }
}
