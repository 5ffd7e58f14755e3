//! `sim score`: how far estimated poses lie from the truth.

use crate::truth::{Rows, Truth, ViewTruth, motion_from_rows};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// `poses.json` as far as it is needed here; other keys are passed over.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Poses {
    /// Every planned view once.
    pub views: Vec<ViewPose>,
}

/// The estimated pose of one planned view.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ViewPose {
    /// Index of the view in the plan.
    pub index: u32,
    /// Which acquisition of the view was merged; the last when absent.
    #[serde(default)]
    pub attempt: Option<u32>,
    /// From this camera view into the model; `None` for a view without a pose.
    #[serde(default)]
    pub model_from_view: Option<Rows>,
}

/// Errors of the estimated poses, the best common rigid motion taken out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// Views with a pose, by index.
    pub views: Vec<ViewScore>,
    /// Neighbours in the plan and last-to-first, where both have a pose.
    pub pairs: Vec<PairScore>,
    /// The run in five numbers.
    pub summary: Summary,
}

/// Error of one view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewScore {
    /// Index of the view in the plan.
    pub index: u32,
    /// Angle of the rotation between estimated and true pose, degrees.
    pub rotation_error_deg: f64,
    /// RMS distance between estimated and true positions of the view's surface points, mm.
    pub surface_rms_mm: f64,
}

/// Error of the motion from one view to another; it needs no common motion taken out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairScore {
    /// Index of the first view.
    pub from: u32,
    /// Index of the second view.
    pub to: u32,
    /// Angle of the rotation between estimated and true motion, degrees.
    pub rotation_error_deg: f64,
    /// Distance between the estimated and the true image of the first view's centroid, mm.
    pub translation_error_mm: f64,
}

/// The run in five numbers. Pair figures are `None` without pairs; a median of evenly many is the mean of the middle two.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Median over pairs, degrees.
    pub pair_rotation_median_deg: Option<f64>,
    /// Greatest over pairs, degrees.
    pub pair_rotation_max_deg: Option<f64>,
    /// Median over pairs, mm.
    pub pair_translation_median_mm: Option<f64>,
    /// RMS over all surface points of all posed views, mm.
    pub surface_rms_mm: f64,
    /// Greatest distance of any surface point, mm.
    pub surface_max_mm: f64,
}

/// Why there is no score.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// A file cannot be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// A file is not the JSON it should be.
    #[error("{} is not as expected: {source}", path.display())]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// No view has a pose.
    #[error("no view has a pose")]
    NoPoses,
    /// Two entries for one view.
    #[error("view {index} occurs twice among the poses")]
    Repeated {
        /// Index of the view.
        index: u32,
    },
    /// A matrix is no rigid motion.
    #[error("the {which} pose of view {index} is not a rigid motion")]
    NotRigid {
        /// Index of the view.
        index: u32,
        /// `estimated` or `true`.
        which: &'static str,
    },
    /// The truth does not know the acquisition.
    #[error("the truth has no acquisition of view {index}{}", attempt.map_or(String::new(), |n| format!(", attempt {n}")))]
    NotCaptured {
        /// Index of the view.
        index: u32,
        /// The attempt asked for.
        attempt: Option<u32>,
    },
    /// The truth has no surface points for a view with a pose.
    #[error("the truth has no surface points of view {index}")]
    NoSurface {
        /// Index of the view.
        index: u32,
    },
}

/// Scores `poses.json` and `truth.json` of a run's folder.
pub fn score_folder(folder: &Path) -> Result<Score, ScoreError> {
    score(&read(&folder.join("poses.json"))?, &read(&folder.join("truth.json"))?)
}

/// Scores poses against the truth.
///
/// One rigid motion, the least-squares one over all surface points of all posed views (Kabsch, 1976), maps the estimated
/// model onto the true one before views are compared; pairs are compared as they are.
pub fn score(poses: &Poses, truth: &Truth) -> Result<Score, ScoreError> {
    let mut planned: Vec<_> = poses.views.iter().collect();
    planned.sort_by_key(|view| view.index);
    if let Some(pair) = planned.windows(2).find(|pair| pair[0].index == pair[1].index) {
        return Err(ScoreError::Repeated { index: pair[0].index });
    }
    let posed: Vec<Option<Posed>> = planned
        .iter()
        .map(|view| Posed::new(view, truth))
        .collect::<Result<_, _>>()?;
    let present: Vec<&Posed> = posed.iter().flatten().collect();
    if present.is_empty() {
        return Err(ScoreError::NoPoses);
    }
    let truth_from_model = best_common_motion(&present);
    let mut squares_mm2 = Vec::new();
    let mut views = Vec::new();
    for view in &present {
        let estimated = truth_from_model * view.estimated;
        let first = squares_mm2.len();
        squares_mm2.extend(
            view.surface
                .iter()
                .map(|point| (estimated * point - view.true_pose * point).norm_squared()),
        );
        views.push(ViewScore {
            index: view.index,
            rotation_error_deg: rotation_between_deg(&estimated, &view.true_pose),
            surface_rms_mm: root_mean(&squares_mm2[first..]),
        });
    }
    let pairs = pairs(&posed);
    let rotations_deg: Vec<_> = pairs.iter().map(|pair| pair.rotation_error_deg).collect();
    let summary = Summary {
        pair_rotation_median_deg: median(&rotations_deg),
        pair_rotation_max_deg: rotations_deg.iter().copied().reduce(f64::max),
        pair_translation_median_mm: median(&pairs.iter().map(|pair| pair.translation_error_mm).collect::<Vec<_>>()),
        surface_rms_mm: root_mean(&squares_mm2),
        surface_max_mm: squares_mm2.iter().copied().fold(0.0, f64::max).sqrt(),
    };
    Ok(Score { views, pairs, summary })
}

/// A view with a pose, and its truth.
struct Posed {
    index: u32,
    estimated: Isometry3<f64>,
    true_pose: Isometry3<f64>,
    surface: Vec<Point3<f64>>,
}

impl Posed {
    fn new(view: &ViewPose, truth: &Truth) -> Result<Option<Posed>, ScoreError> {
        let index = view.index;
        let Some(model_from_view) = &view.model_from_view else {
            return Ok(None);
        };
        let wanted = |entry: &&ViewTruth| {
            entry.view_index == index && view.attempt.is_none_or(|attempt| attempt == entry.attempt)
        };
        let entry = truth.views.iter().rev().find(wanted);
        let entry = entry.ok_or(ScoreError::NotCaptured {
            index,
            attempt: view.attempt,
        })?;
        if entry.surface_points_mm.is_empty() {
            return Err(ScoreError::NoSurface { index });
        }
        let motion = |rows, which| motion_from_rows(rows).ok_or(ScoreError::NotRigid { index, which });
        Ok(Some(Posed {
            index,
            estimated: motion(model_from_view, "estimated")?,
            true_pose: motion(&entry.model_from_view, "true")?,
            surface: entry
                .surface_points_mm
                .iter()
                .map(|&point| Point3::from(point))
                .collect(),
        }))
    }
}

/// The rigid motion that brings the estimated surface points closest to the true ones in the least-squares sense.
fn best_common_motion(views: &[&Posed]) -> Isometry3<f64> {
    let mut placed: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::new();
    for view in views {
        let both = |point: &Point3<f64>| ((view.estimated * point).coords, (view.true_pose * point).coords);
        placed.extend(view.surface.iter().map(both));
    }
    let count = placed.len() as f64;
    let from = placed.iter().map(|(from, _)| from).sum::<Vector3<f64>>() / count;
    let to = placed.iter().map(|(_, to)| to).sum::<Vector3<f64>>() / count;
    let products = placed.iter().map(|(a, b)| (b - to) * (a - from).transpose());
    let covariance: Matrix3<f64> = products.sum();
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u.expect("U was asked for"), svd.v_t.expect("V was asked for"));
    // nalgebra orders the singular values downward, so a mirror is taken out along the last.
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * mirror * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Isometry3::from_parts((to - rotation * from).into(), rotation)
}

fn pairs(posed: &[Option<Posed>]) -> Vec<PairScore> {
    // Two views have one pair, not one in each direction.
    let pair_count = if posed.len() > 2 { posed.len() } else { posed.len() - 1 };
    (0..pair_count)
        .filter_map(|i| {
            let (from, to) = (posed[i].as_ref()?, posed[(i + 1) % posed.len()].as_ref()?);
            let estimated = to.estimated.inv_mul(&from.estimated);
            let true_motion = to.true_pose.inv_mul(&from.true_pose);
            let sum = from
                .surface
                .iter()
                .fold(Vector3::zeros(), |sum, point| sum + point.coords);
            let centroid = Point3::from(sum / from.surface.len() as f64);
            Some(PairScore {
                from: from.index,
                to: to.index,
                rotation_error_deg: rotation_between_deg(&estimated, &true_motion),
                translation_error_mm: (estimated * centroid - true_motion * centroid).norm(),
            })
        })
        .collect()
}

/// The angle `arccos((tr(Aᵀ B) - 1) / 2)` of the paper's eq. 11, in degrees.
///
/// Taken from the quaternion, because the arc cosine loses half the digits of small angles (1e-8 rad becomes 0).
fn rotation_between_deg(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let difference = a.rotation.inverse() * b.rotation;
    (2.0 * difference.imag().norm().atan2(difference.w.abs())).to_degrees()
}

fn root_mean(squares: &[f64]) -> f64 {
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let upper = *sorted.get(sorted.len() / 2)?;
    Some((sorted[(sorted.len() - 1) / 2] + upper) / 2.0)
}

fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ScoreError> {
    let text = fs::read(path).map_err(|source| ScoreError::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    serde_json::from_slice(&text).map_err(|source| ScoreError::Malformed {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::render::Surface;
    use crate::truth::{PoseErrorSize, rows_from_motion};

    /// A blade-like run: views 10° apart about z, each with points on a small patch before the camera.
    fn truth(view_count: u32) -> Truth {
        let mut truth = Truth::new("lpt", 1, "wide", Surface::matte(), PoseErrorSize::default());
        for view in 0..view_count {
            let turn = Isometry3::rotation(Vector3::z() * f64::from(view) * 10_f64.to_radians());
            let camera_from_blade = Isometry3::new(Vector3::new(1.0, 2.0, 600.0), Vector3::new(0.3, 1.2, 0.0)) * turn;
            let surface = (0..50)
                .map(|i| {
                    [
                        f64::from(i % 10) * 4.0 - 18.0,
                        f64::from(i / 10) * 5.0 - 10.0,
                        590.0 + f64::from(i * i % 7),
                    ]
                })
                .collect();
            truth.record(u64::from(view) << 16, &camera_from_blade, surface, false);
        }
        truth
    }

    fn exact(truth: &Truth, common: &Isometry3<f64>) -> Poses {
        let pose = |view: &ViewTruth| ViewPose {
            index: view.view_index,
            attempt: None,
            model_from_view: Some(rows_from_motion(
                &(common * motion_from_rows(&view.model_from_view).unwrap()),
            )),
        };
        Poses {
            views: truth.views.iter().map(pose).collect(),
        }
    }

    fn move_view(poses: &mut Poses, index: usize, model_from_model: &Isometry3<f64>) {
        let rows = poses.views[index].model_from_view.as_mut().unwrap();
        *rows = rows_from_motion(&(model_from_model * motion_from_rows(rows).unwrap()));
    }

    #[test]
    fn exact_poses_score_zero_whatever_the_common_motion() {
        let truth = truth(36);
        for common in [
            Isometry3::identity(),
            Isometry3::new(Vector3::new(40.0, -900.0, 3.0), Vector3::new(2.0, -1.0, 0.4)),
        ] {
            let score = score(&exact(&truth, &common), &truth).unwrap();
            assert_eq!((score.views.len(), score.pairs.len()), (36, 36));
            assert_eq!((score.pairs[35].from, score.pairs[35].to), (35, 0));
            assert!(score.summary.surface_max_mm < 1e-9, "{}", score.summary.surface_max_mm);
            assert!(score.summary.pair_rotation_max_deg.unwrap() < 1e-9);
            assert!(score.views.iter().all(|view| view.rotation_error_deg < 1e-9));
        }
    }

    #[test]
    fn a_shifted_view_shows_in_its_two_pairs_and_in_the_surface() {
        let truth = truth(36);
        let mut poses = exact(&truth, &Isometry3::identity());
        move_view(&mut poses, 7, &Isometry3::translation(0.3, 0.0, 0.0));
        let score = score(&poses, &truth).unwrap();
        for pair in &score.pairs {
            let expected_mm = if pair.from == 7 || pair.to == 7 { 0.3 } else { 0.0 };
            assert!((pair.translation_error_mm - expected_mm).abs() < 1e-9);
            assert!(pair.rotation_error_deg < 1e-9);
        }
        assert!(score.summary.pair_translation_median_mm.unwrap() < 1e-9);
        // The common motion can only lower the RMS over all points below that of the shift alone.
        assert!(score.summary.surface_rms_mm <= 0.3 / 6.0 + 1e-12 && score.summary.surface_rms_mm > 0.03);
        assert!(
            (score.views[7].surface_rms_mm - 0.29).abs() < 0.03,
            "{}",
            score.views[7].surface_rms_mm
        );
    }

    #[test]
    fn a_tiny_turn_of_one_view_is_measured_exactly() {
        let truth = truth(12);
        for angle_rad in [1e-9_f64, 1e-4, 0.5, 3.0] {
            let mut poses = exact(&truth, &Isometry3::identity());
            move_view(
                &mut poses,
                3,
                &Isometry3::rotation(Vector3::new(0.6, 0.0, 0.8) * angle_rad),
            );
            let score = score(&poses, &truth).unwrap();
            let measured_deg = score.pairs[3].rotation_error_deg;
            assert!(
                (measured_deg / angle_rad.to_degrees() - 1.0).abs() < 1e-5,
                "{measured_deg} for {angle_rad} rad"
            );
        }
    }

    #[test]
    fn two_views_apart_by_a_known_shift_share_it_between_them() {
        let truth = truth(2);
        let mut poses = exact(&truth, &Isometry3::identity());
        move_view(&mut poses, 1, &Isometry3::translation(0.0, 0.0, 0.2));
        let score = score(&poses, &truth).unwrap();
        assert_eq!(score.pairs.len(), 1);
        assert!((score.pairs[0].translation_error_mm - 0.2).abs() < 1e-9);
        assert!(score.summary.surface_rms_mm <= 0.1 + 1e-9);
    }

    #[test]
    fn pairs_with_a_missing_view_are_left_out() {
        let truth = truth(36);
        let mut poses = exact(&truth, &Isometry3::identity());
        poses.views[0].model_from_view = None;
        poses.views[20].model_from_view = None;
        let score = score(&poses, &truth).unwrap();
        assert_eq!((score.views.len(), score.pairs.len()), (34, 32));
        assert!(
            score
                .pairs
                .iter()
                .all(|pair| ![0, 20].contains(&pair.from) && ![0, 20].contains(&pair.to))
        );
    }

    #[test]
    fn the_named_attempt_is_scored_and_the_last_without_a_name() {
        let mut truth = truth(3);
        let retake = Isometry3::translation(0.0, 5.0, 600.0);
        truth.record(
            1 << 16 | 1,
            &retake,
            vec![[0.0, 0.0, 600.0], [9.0, 0.0, 600.0], [0.0, 9.0, 600.0]],
            false,
        );
        let mut poses = exact(&truth, &Isometry3::identity());
        poses.views.pop();
        assert!(score(&poses, &truth).unwrap().summary.surface_max_mm > 0.5);
        poses.views[1].attempt = Some(0);
        assert!(score(&poses, &truth).unwrap().summary.surface_max_mm < 1e-9);
        poses.views[1].attempt = Some(2);
        let error = score(&poses, &truth).unwrap_err();
        assert_eq!(error.to_string(), "the truth has no acquisition of view 1, attempt 2");
    }

    #[test]
    fn missing_files_and_runs_without_poses_are_told_apart() {
        let error = score_folder(Path::new("/nonexistent")).unwrap_err();
        assert!(
            error.to_string().starts_with("cannot read /nonexistent/poses.json"),
            "{error}"
        );
        let truth = truth(3);
        assert!(matches!(
            score(&Poses { views: vec![] }, &truth),
            Err(ScoreError::NoPoses)
        ));
        let mut poses = exact(&truth, &Isometry3::identity());
        poses.views[2].index = 1;
        assert!(matches!(score(&poses, &truth), Err(ScoreError::Repeated { index: 1 })));
    }

    #[test]
    fn the_documented_poses_file_is_read_with_its_further_keys() {
        let text = r#"{"frame":"view_0","views":[
            {"index":0,"model_from_view":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]],"status":"merged","reason":null},
            {"index":1,"attempt":2,"model_from_view":null,"status":"missing","reason":"aborted"}]}"#;
        let poses: Poses = serde_json::from_str(text).unwrap();
        assert!(poses.views[0].model_from_view.is_some() && poses.views[0].attempt.is_none());
        assert_eq!(
            poses.views[1],
            ViewPose {
                index: 1,
                attempt: Some(2),
                model_from_view: None
            }
        );
    }
}
