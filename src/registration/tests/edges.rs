//! Clouds at the edge of sense: each has a clear outcome, and nothing panics.

use super::super::testing::{blade, noisy};
use super::*;

/// Registers from the identity with nothing known, as `register` does.
fn outcome(template: &PointCloud, reference: &PointCloud) -> Result<Registration, RegisterError> {
    let found = register(template, reference, &Settings::default());
    if let Ok(found) = &found {
        assert_all_finite(found);
    }
    found
}

#[track_caller]
fn assert_all_finite(found: &Registration) {
    let pose = found.reference_from_template.to_homogeneous();
    assert!(pose.iter().all(|value| value.is_finite()), "{found:?}");
    assert!(found.rmse.is_finite() && found.overlap.fraction <= 1.0, "{found:?}");
    if let Some(covariance) = &found.covariance {
        assert!(covariance.iter().all(|value| value.is_finite()), "{found:?}");
    }
    for weak in &found.weak_directions {
        assert!(weak.sigma.is_finite() && weak.direction.iter().all(|value| value.is_finite()));
    }
}

fn cloud(points: impl IntoIterator<Item = [f64; 3]>) -> PointCloud {
    PointCloud::from_measured(points.into_iter().map(Point3::from)).cloud
}

/// A square grid in the plane z = 0.
fn plane(side_count: u32) -> PointCloud {
    let count = side_count * side_count;
    cloud((0..count).map(|i| [f64::from(i % side_count), f64::from(i / side_count), 0.0]))
}

fn line(count: u32) -> PointCloud {
    cloud((0..count).map(|i| [f64::from(i), 2.0 * f64::from(i), -f64::from(i)]))
}

fn one_place(count: usize) -> PointCloud {
    cloud(vec![[0.1, 0.2, 0.3]; count])
}

#[test]
fn fewer_than_ten_points_are_refused_on_either_side() {
    let whole = blade(500, 0.0);
    for count in [0, 1, 2, 3, 9] {
        let few = whole.select(&(0..count).collect::<Vec<_>>());
        let refused = Err(RegisterError::TooFewPoints { count, needed: 10 });
        assert_eq!(outcome(&few, &whole), refused);
        assert_eq!(outcome(&whole, &few), refused);
        let found = run(&few, &whole, &motion(), &Settings::default());
        assert_eq!(
            (found.status, found.reference_from_template),
            (Status::Failed, motion())
        );
    }
}

#[test]
fn points_in_one_place_are_refused_on_either_side() {
    let whole = blade(500, 0.0);
    for count in [10, 1000] {
        let refused = Err(RegisterError::NoExtent { count });
        assert_eq!(outcome(&one_place(count), &whole), refused);
        assert_eq!(outcome(&whole, &one_place(count)), refused);
        let found = run(&one_place(count), &whole, &motion(), &Settings::default());
        assert_eq!(
            (found.status, found.reference_from_template),
            (Status::Failed, motion())
        );
    }
}

#[test]
fn points_apart_by_rounding_alone_are_refused() {
    let step = 1e9 * f64::EPSILON;
    let rounded = cloud((0..100).map(|i| [1e9 + f64::from(i % 3) * step, 1e9, 1e9]));
    assert_eq!(
        outcome(&rounded, &blade(500, 0.0)),
        Err(RegisterError::NoExtent { count: 100 })
    );
}

#[test]
fn points_on_a_line_never_converge() {
    let whole = blade(1000, 0.0);
    for (template, reference) in [
        (line(50), line(50)),
        (line(1000), line(500)),
        (line(1000), whole.clone()),
        (whole, line(1000)),
    ] {
        let found = outcome(&template, &reference).unwrap();
        assert_ne!(found.status, Status::Converged, "{found:?}");
    }
}

#[test]
fn points_in_a_plane_never_converge() {
    let whole = blade(1000, 0.0);
    for (template, reference) in [
        (plane(10), plane(10)),
        (plane(40), plane(30)),
        (plane(30), whole.clone()),
        (whole, plane(30)),
    ] {
        let found = outcome(&template, &reference).unwrap();
        assert_ne!(found.status, Status::Converged, "{found:?}");
    }
}

#[test]
fn ten_points_anywhere_have_a_status() {
    for seed in 0..20 {
        let few = noisy(&one_place(10), 1.0, seed);
        let other = noisy(&one_place(12), 1.0, 100 + seed);
        let found = outcome(&few, &other).unwrap();
        assert_ne!(found.status, Status::Converged, "seed {seed}: {found:?}");
    }
}

#[test]
fn points_that_are_not_finite_are_dropped_and_counted() {
    let whole = blade(3000, 0.0);
    let broken = whole.points().iter().enumerate().flat_map(|(i, point)| {
        let wrong = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][i % 3];
        [*point, Point3::new(point.x, wrong, point.z)]
    });
    let measured = PointCloud::from_measured(broken);
    assert_eq!((measured.dropped_count, &measured.cloud), (whole.len(), &whole));
}

#[test]
fn coordinates_whose_powers_cannot_be_held_are_refused_on_either_side() {
    let whole = blade(1000, 0.0);
    for factor in [f64::MAX / 2.0, 1e150, 1e60, 1e-60, 1e-150, 1e-300] {
        let extreme = scaled(&whole, factor);
        let count = whole.len();
        let refused = Err(RegisterError::OutOfRange { count });
        assert_eq!(outcome(&extreme, &whole), refused, "{factor:e}");
        assert_eq!(outcome(&whole, &extreme), refused, "{factor:e}");
        let found = run(&extreme, &whole, &motion(), &Settings::default());
        assert_eq!(
            (found.status, found.reference_from_template),
            (Status::Failed, motion())
        );
    }
}

#[test]
fn one_point_very_far_away_does_not_move_the_answer() {
    let template = blade(3000, 0.0);
    let reference = blade(3000, 0.5).transformed(&motion());
    for far in [1e6, 1e40] {
        let with_far = |cloud: &PointCloud| {
            let far = Point3::new(far, 0.0, 0.0);
            PointCloud::from_measured(cloud.points().iter().copied().chain([far])).cloud
        };
        for found in [
            outcome(&with_far(&template), &reference).unwrap(),
            outcome(&template, &with_far(&reference)).unwrap(),
        ] {
            let (turn, shift) = errors(&motion(), &found);
            let right = turn < 5e-3 && shift < 5e-3;
            assert!(
                right || found.status != Status::Converged,
                "{far:e}: {turn} {shift} {found:?}"
            );
        }
    }
}

#[test]
fn clouds_a_million_apart_are_laid_on_each_other_or_not_called_converged() {
    let away = Isometry3::translation(1e6, -2e6, 0.5e6);
    let found = outcome(&blade(3000, 0.0), &blade(3000, 0.5).transformed(&away)).unwrap();
    let (turn, shift) = errors(&away, &found);
    // Coordinates of 1e6 keep ten digits after the point, and a turn is about the origin.
    let right =
        turn < 5e-3 && (found.reference_from_template * Point3::origin() - away * Point3::origin()).norm() < 1e-2;
    assert!(right || found.status != Status::Converged, "{turn} {shift} {found:?}");
}

#[test]
fn different_shapes_do_not_converge() {
    let ball = |radius: f64| {
        let golden = 2.399_963_229_728_653;
        cloud((0..2000).map(|i| {
            let z = (f64::from(i) + 0.5) / 1000.0 - 1.0;
            let (sin, cos) = (golden * f64::from(i)).sin_cos();
            let across = (1.0 - z * z).sqrt();
            [radius * across * cos, radius * across * sin, radius * z]
        }))
    };
    let whole = blade(2000, 0.0);
    for (template, reference) in [
        (ball(0.5), whole.clone()),
        (whole.clone(), ball(0.5)),
        (ball(1.0), ball(1.0)),
        (ball(1.0), scaled(&ball(1.0), 0.5)),
    ] {
        let found = outcome(&template, &reference).unwrap();
        assert_ne!(found.status, Status::Converged, "{found:?}");
    }
}

#[test]
fn a_speck_beside_a_blade_does_not_converge() {
    let whole = blade(2000, 0.0);
    for factor in [1e-2, 1e-6, 1e-12] {
        for (template, reference) in [
            (scaled(&whole, factor), whole.clone()),
            (whole.clone(), scaled(&whole, factor)),
        ] {
            let found = outcome(&template, &reference).unwrap();
            assert_ne!(found.status, Status::Converged, "{factor:e}: {found:?}");
        }
    }
}

#[test]
fn a_start_that_is_not_finite_fails() {
    let whole = blade(500, 0.0);
    let start = Isometry3::translation(f64::NAN, 0.0, 0.0);
    let found = run(&whole, &whole, &start, &Settings::default());
    assert_eq!((found.status, found.overlap.count), (Status::Failed, 0));
    assert!(found.rmse.is_finite() && found.covariance.is_none(), "{found:?}");
}
