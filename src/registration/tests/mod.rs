//! Known motions, laws and edges of whole registrations.

mod edges;
mod laws;

use nalgebra::{Isometry3, Point3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::testing::{blade, extruded, noisy};
use super::*;

fn motion() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.05, -0.04, 0.03), Vector3::new(0.05, -0.08, 0.15))
}

fn run(template: &PointCloud, reference: &PointCloud, start: &Isometry3<f64>, settings: &Settings) -> Registration {
    let reference = Reference::new(reference).unwrap();
    register_from(
        template,
        &reference,
        start,
        settings,
        ChaCha8Rng::seed_from_u64(5),
        &mut |_| {},
    )
}

fn scaled(cloud: &PointCloud, factor: f64) -> PointCloud {
    PointCloud::from_measured(cloud.points().iter().map(|point| point * factor)).cloud
}

fn errors(truth: &Isometry3<f64>, found: &Registration) -> (f64, f64) {
    let error = truth.inverse() * found.reference_from_template;
    (error.rotation.angle(), error.translation.vector.norm())
}

#[test]
fn a_known_motion_is_found_from_the_identity() {
    let truth = motion();
    let reference = blade(6000, 0.5).transformed(&truth);
    let found = run(
        &blade(5000, 0.0),
        &reference,
        &Isometry3::identity(),
        &Settings::default(),
    );
    let (turn, shift) = errors(&truth, &found);
    assert_eq!(found.status, Status::Converged, "{found:?}");
    assert!(turn < 1e-3 && shift < 1e-3, "{turn} {shift}");
    assert!(found.overlap.fraction > 0.9 && found.rmse < 0.01, "{found:?}");
    let names: Vec<_> = found.stages.iter().map(|stage| stage.name).collect();
    assert_eq!(names, ["prepare", "mpe", "coarse", "fine"]);
}

#[test]
fn among_noise_any_number_of_threads_gives_the_same_bits() {
    let a = blade(1200, 0.0);
    let b = noisy(&a.transformed(&motion()), 0.06, 7);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&a, &b, &Isometry3::identity(), &Settings::default()))
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(8));
    let (turn, shift) = errors(&motion(), &one);
    assert!(turn < 0.04 && shift < 0.03, "{turn} {shift} {one:?}");
}

#[test]
fn points_that_repeat_among_outliers_are_laid_on_each_other() {
    let a = blade(2000, 0.0);
    let sigma = 0.004;
    let repeated = noisy(&a.transformed(&motion()), sigma, 7);
    let anywhere = noisy(&blade(1200, 0.3), 0.8, 8);
    let points = repeated.points().iter().chain(anywhere.points()).copied();
    let b = PointCloud::from_measured(points).cloud;
    let found = run(&a, &b, &Isometry3::identity(), &Settings::default());
    let squared: f64 = a
        .points()
        .iter()
        .map(|point| (found.reference_from_template * point - motion() * point).norm_squared())
        .sum();
    let (rmse, bound) = ((squared / 2000.0).sqrt(), sigma * (6.0f64 / 2000.0).sqrt());
    assert!(rmse < 2.0 * bound, "{rmse} against {bound}: {found:?}");
    assert_eq!(found.status, Status::Converged);
}

#[test]
fn other_points_of_the_same_surface_are_not_taken_for_the_same_points() {
    // Point by point the error would be of the order of the spacing over the root of the count; the surfaces are exact.
    let reference = blade(3000, 0.5).transformed(&motion());
    let found = run(
        &blade(3000, 0.0),
        &reference,
        &Isometry3::identity(),
        &Settings::default(),
    );
    let pointwise = Settings {
        fine: FineStage::Pointwise,
        ..Settings::default()
    };
    let by_points = run(&blade(3000, 0.0), &reference, &Isometry3::identity(), &pointwise);
    let by_surface = Settings {
        fine: FineStage::SurfaceToSurface,
        ..Settings::default()
    };
    let by_surface = run(&blade(3000, 0.0), &reference, &Isometry3::identity(), &by_surface);
    assert_eq!(found, by_surface);
    assert_ne!(found.reference_from_template, by_points.reference_from_template);
}

#[test]
fn an_extruded_section_is_weak_along_its_span_and_keeps_the_start_there() {
    let start = Isometry3::translation(0.0, 0.0, 0.02);
    let truth = Isometry3::new(Vector3::new(0.01, 0.012, -0.05), Vector3::new(0.0, 0.0, 0.03));
    let reference = extruded(8000, 0.5).transformed(&truth);
    let found = run(&extruded(6000, 0.0), &reference, &start, &Settings::default());
    assert_eq!(found.status, Status::Weak, "{found:?}");
    assert_eq!(found.weak_directions.len(), 1, "{found:?}");
    let direction = found.weak_directions[0].direction;
    assert!(direction[5].abs() > 0.99, "{direction:?}");
    let shift = found.reference_from_template.translation.vector;
    assert!((shift.z - 0.02).abs() < 2e-3, "{shift:?}");
    assert!(
        (shift.x - 0.01).abs() < 2e-3 && (shift.y - 0.012).abs() < 2e-3,
        "{shift:?}"
    );
    assert!((found.reference_from_template.rotation.angle() - 0.03).abs() < 2e-3);
}

#[test]
fn a_good_start_is_never_made_worse() {
    // A view that covers a quarter of the reference: MPE alone would pull it to the middle.
    let truth = motion();
    let whole = blade(20_000, 0.5);
    let view: Vec<usize> = (0..whole.len())
        .filter(|&i| whole.points()[i].z < -0.3 && whole.points()[i].y > 0.0)
        .collect();
    let view = whole.select(&view).transformed(&truth.inverse());
    let reference = blade(15_000, 0.1);
    let found = run(&view, &reference, &truth, &Settings::default());
    let (turn, shift) = errors(&truth, &found);
    assert!(turn < 3e-3 && shift < 3e-3, "{turn} {shift} {:?}", found.status);
}

#[test]
fn clouds_that_have_nothing_in_common_fail_and_return_the_start() {
    let start = Isometry3::translation(0.3, 0.0, 0.0);
    let far = Isometry3::translation(1e4, 0.0, 0.0);
    let settings = Settings {
        search: Search::StartOnly,
        ..Settings::default()
    };
    let found = run(
        &blade(2000, 0.0),
        &blade(2000, 0.0).transformed(&far),
        &start,
        &settings,
    );
    assert_eq!((found.status, found.reference_from_template), (Status::Failed, start));
    assert_eq!(found.overlap.count, 0);
    let few = PointCloud::from_measured((0..5).map(|i| Point3::new(f64::from(i), 0.0, 0.0))).cloud;
    let found = run(&few, &blade(2000, 0.0), &start, &Settings::default());
    assert_eq!((found.status, found.reference_from_template), (Status::Failed, start));
}

#[test]
fn a_rotation_from_anywhere_is_found_by_searching_everywhere() {
    let truth = Isometry3::new(Vector3::new(0.5, -1.0, 2.0), Vector3::new(1.5, -1.2, 0.9));
    let reference = blade(3000, 0.5).transformed(&truth);
    let settings = Settings {
        search: Search::Everywhere,
        ..Settings::default()
    };
    let found = run(&blade(3000, 0.0), &reference, &Isometry3::identity(), &settings);
    let (turn, shift) = errors(&truth, &found);
    assert!(turn < 5e-3 && shift < 5e-2, "{turn} {shift} {found:?}");
}

#[test]
fn noise_does_not_feign_information_along_a_weak_direction() {
    for seed in 0..4 {
        let reference = noisy(&extruded(30_000, 0.5), 0.002, seed);
        let template = noisy(&extruded(20_000, 0.0), 0.002, 100 + seed);
        let start = Isometry3::new(Vector3::new(0.004, -0.003, 0.01), Vector3::new(0.0, 0.0, 0.01));
        let found = run(&template, &reference, &start, &Settings::default());
        assert_eq!(found.status, Status::Weak, "seed {seed}: {found:?}");
        let shift = found.reference_from_template.translation.vector;
        assert!(
            (shift.z - 0.01).abs() < 1e-3 && shift.xy().norm() < 5e-4,
            "seed {seed}: {shift:?}"
        );
    }
}

#[test]
fn two_walls_that_fit_the_wrong_way_round_are_not_called_converged() {
    // Half a blade against another half: what little fits leaves residuals that noise does not explain.
    let whole = blade(20_000, 0.0);
    let part = |keep: &dyn Fn(&Point3<f64>) -> bool| {
        let indices: Vec<usize> = (0..whole.len()).filter(|&i| keep(&whole.points()[i])).collect();
        whole.select(&indices)
    };
    let (upper, lower) = (part(&|p| p.z > 0.3), part(&|p| p.z < -0.3));
    let found = run(&upper, &lower, &Isometry3::identity(), &Settings::default());
    assert_ne!(found.status, Status::Converged, "{found:?}");
}

#[test]
fn a_start_of_known_certainty_holds_a_weak_direction_softly_and_yields_in_the_others() {
    let truth = Isometry3::new(Vector3::new(0.01, 0.012, -0.05), Vector3::new(0.0, 0.0, 0.03));
    let reference = noisy(&extruded(8000, 0.5).transformed(&truth), 0.002, 1);
    let template = noisy(&extruded(6000, 0.0), 0.002, 2);
    let start = Isometry3::translation(0.0, 0.0, 0.02);
    let with = |weak_directions| {
        let settings = Settings {
            weak_directions,
            ..Settings::default()
        };
        run(&template, &reference, &start, &settings)
    };
    let free = with(WeakDirections::Report);
    assert_eq!(free.status, Status::Weak, "{free:?}");
    let of_surfaces = free.weak_directions[0].sigma;
    let z = |found: &Registration| found.reference_from_template.translation.vector.z;
    let away = z(&free) - 0.02;
    assert!(away.abs() > 1e-3, "the surfaces have a wish of their own: {away}");
    for factor in [0.01, 1.0, 100.0] {
        let found = with(WeakDirections::Weigh(StartSigma {
            turn_rad: 0.1,
            shift: factor * of_surfaces,
        }));
        let expected = 0.02 + away * factor * factor / (factor * factor + 1.0);
        assert!(
            (z(&found) - expected).abs() < 0.1 * away.abs(),
            "{factor}: {} is not {expected}",
            z(&found)
        );
        assert_eq!(found.status, Status::Weak);
        let sigma = found.covariance.unwrap()[(5, 5)].sqrt();
        let expected = of_surfaces * factor / (factor * factor + 1.0).sqrt();
        assert!(
            (sigma / expected - 1.0).abs() < 0.1,
            "{factor}: {sigma} is not {expected}"
        );
        if factor >= 1.0 {
            let shift = found.reference_from_template.translation.vector;
            assert!((shift.xy() - truth.translation.vector.xy()).norm() < 2e-3, "{shift:?}");
        }
    }
}

#[test]
fn where_points_repeat_too_a_certain_start_is_kept_and_an_uncertain_one_is_not() {
    keeps_a_certain_start_only(0.01);
}

#[test]
fn among_noise_too_a_certain_start_is_kept_and_an_uncertain_one_is_not() {
    keeps_a_certain_start_only(0.08);
}

fn keeps_a_certain_start_only(noise: f64) {
    let template = blade(1500, 0.0);
    let reference = noisy(&template, noise, 3);
    let start = Isometry3::translation(0.03, 0.0, 0.0);
    let with = |sigma: f64| {
        let settings = Settings {
            weak_directions: WeakDirections::Weigh(StartSigma {
                turn_rad: sigma,
                shift: sigma,
            }),
            ..Settings::default()
        };
        run(&template, &reference, &start, &settings).reference_from_template
    };
    assert!((with(1e-6).translation.vector.x - 0.03).abs() < 1e-3);
    assert!(with(10.0).translation.vector.norm() < 0.015, "{:?}", with(10.0));
}

/// The half of a blade that a camera far away towards `direction` has before the blade's middle.
fn half(phase: f64, direction: &Vector3<f64>) -> PointCloud {
    let whole = blade(6000, phase);
    let centroid = whole.centroid();
    let kept: Vec<usize> = (0..whole.len())
        .filter(|&i| (whole.points()[i] - centroid).dot(direction) > 0.0)
        .collect();
    whole.select(&kept)
}

#[test]
fn views_turned_at_will_are_found_or_said_to_be_ambiguous() {
    let camera = |azimuth: f64| Vector3::new(azimuth.cos(), azimuth.sin(), 0.4).normalize();
    let settings = Settings {
        search: Search::Automatic,
        ..Settings::default()
    };
    let mut found_count = 0;
    for turn in [Vector3::new(2.0, -1.0, 0.5), Vector3::new(-0.3, 0.4, 3.0)] {
        let truth = Isometry3::new(Vector3::new(0.4, -0.8, 1.5), turn);
        let reference = half(0.5, &camera(1.2)).transformed(&truth);
        let found = run(&half(0.0, &camera(0.9)), &reference, &Isometry3::identity(), &settings);
        let (turned, shifted) = errors(&truth, &found);
        let is_right = turned < 0.02 && shifted < 0.05;
        assert!(
            is_right || found.status != Status::Converged,
            "{turn}: {turned} {shifted} {found:?}"
        );
        found_count += usize::from(is_right);
    }
    assert_eq!(found_count, 2);
}
