//! Laws that hold whatever the clouds are: of the swap, of rigid motions, of scale, of order, of repetition.
//!
//! Poses are compared by how far apart they put the template's points, root mean square, over what the noise of the
//! points explains: it moves a least-squares motion by `σ √(6/n)`.

use std::sync::OnceLock;

use super::super::testing::{blade, extruded, noisy};
use super::*;

/// Two clouds that determine the motion between them.
struct Pair {
    name: String,
    template: PointCloud,
    reference: PointCloud,
    /// How far noise moves the answer.
    explained: f64,
}

/// Clouds of each kind: another sampling, the same points among noise, outliers, two parts that overlap.
fn pairs(seed: u64) -> Vec<Pair> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = |most: f64| Vector3::from_fn(|_, _| most * (2.0 * rand::RngExt::random::<f64>(&mut rng) - 1.0));
    let truth = Isometry3::new(draw(0.1), draw(0.15));
    let outliers: Vec<Point3<f64>> = (0..500).map(|_| Point3::from(draw(1.0))).collect();
    let part = |cloud: &PointCloud, keep: &dyn Fn(&Point3<f64>) -> bool| {
        let kept: Vec<usize> = (0..cloud.len()).filter(|&i| keep(&cloud.points()[i])).collect();
        cloud.select(&kept)
    };
    let same = blade(1500, 0.0);
    let rough = noisy(&same, 0.005, seed);
    let with_outliers = rough.points().iter().copied().chain(outliers);
    let (left, right) = (
        part(&blade(4000, 0.0), &|p| p.y > -0.1),
        part(&blade(4500, 0.5), &|p| p.x > -0.3),
    );
    let kinds = [
        (
            "resampled",
            blade(2500, 0.0),
            noisy(&blade(2500, 0.5), 0.003, seed),
            0.003,
        ),
        ("noise", same.clone(), noisy(&same, 0.05, seed), 0.05),
        ("outliers", same, PointCloud::from_measured(with_outliers).cloud, 0.005),
        ("parts", left, noisy(&right, 0.002, seed), 0.002),
    ];
    kinds
        .into_iter()
        .map(|(kind, template, reference, sigma)| Pair {
            name: format!("{kind}, seed {seed}"),
            explained: sigma * (6.0 / template.len() as f64).sqrt(),
            template,
            reference: reference.transformed(&truth),
        })
        .collect()
}

/// Every pair and what it comes to from the identity.
fn each(law: &dyn Fn(&Pair, &Registration)) {
    static FOUND: OnceLock<Vec<(Pair, Registration)>> = OnceLock::new();
    let found = FOUND.get_or_init(|| {
        let found = |pair: Pair| {
            let found = from_identity(&pair.template, &pair.reference);
            assert_ne!(found.status, Status::Failed, "{}: {found:?}", pair.name);
            (pair, found)
        };
        pairs(1).into_iter().map(found).collect()
    });
    found.iter().for_each(|(pair, found)| law(pair, found));
}

fn from_identity(template: &PointCloud, reference: &PointCloud) -> Registration {
    run(template, reference, &Isometry3::identity(), &reporting())
}

/// Weak directions are not held, so that the start leaves no trace.
fn reporting() -> Settings {
    Settings {
        weak_directions: WeakDirections::Report,
        ..Settings::default()
    }
}

/// How far apart two poses put the points of the template.
fn apart(template: &PointCloud, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let squared: f64 = template.points().iter().map(|p| (a * p - b * p).norm_squared()).sum();
    (squared / template.len() as f64).sqrt()
}

#[track_caller]
fn assert_near(pair: &Pair, allowed: f64, expected: &Isometry3<f64>, found: &Isometry3<f64>) {
    let apart = apart(&pair.template, expected, found);
    let share = apart / pair.explained;
    assert!(share <= allowed, "{}: {share} > {allowed}", pair.name);
}

#[test]
fn swapping_the_clouds_inverts_the_motion() {
    each(&|pair, there| {
        let back = from_identity(&pair.reference, &pair.template);
        assert_near(
            pair,
            ANOTHER_SAMPLE,
            &back.reference_from_template.inverse(),
            &there.reference_from_template,
        );
    });
}

#[test]
fn moving_the_reference_moves_the_answer() {
    let moved = Isometry3::new(Vector3::new(3.0, -5.0, 7.0), Vector3::new(0.7, 0.2, -0.4));
    each(&|pair, here| {
        let there = run(
            &pair.template,
            &pair.reference.transformed(&moved),
            &moved,
            &reporting(),
        );
        let expected = moved * here.reference_from_template;
        assert_near(pair, SAME_SAMPLE, &expected, &there.reference_from_template);
        assert_eq!(here.status, there.status, "{}", pair.name);
    });
}

#[test]
fn moving_the_template_moves_the_answer_the_other_way() {
    let moved = Isometry3::new(Vector3::new(-2.0, 6.0, 1.0), Vector3::new(-0.3, 0.8, 0.5));
    each(&|pair, here| {
        let there = run(
            &pair.template.transformed(&moved),
            &pair.reference,
            &moved.inverse(),
            &reporting(),
        );
        let found = there.reference_from_template * moved;
        assert_near(pair, SAME_SAMPLE, &here.reference_from_template, &found);
        assert_eq!(here.status, there.status, "{}", pair.name);
    });
}

#[test]
fn the_order_of_the_points_hardly_matters() {
    let shuffled = |cloud: &PointCloud| {
        // A stride that shares no factor with the count visits every point once.
        let stride = (cloud.len() / 3..).find(|stride| gcd(*stride, cloud.len()) == 1);
        let stride = stride.unwrap();
        let order: Vec<usize> = (0..cloud.len()).map(|i| i * stride % cloud.len()).collect();
        cloud.select(&order)
    };
    each(&|pair, here| {
        let there = from_identity(&shuffled(&pair.template), &shuffled(&pair.reference));
        assert_near(
            pair,
            ANOTHER_SAMPLE,
            &here.reference_from_template,
            &there.reference_from_template,
        );
        assert_eq!(here.status, there.status, "{}", pair.name);
    });
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[test]
fn another_unit_gives_the_same_motion() {
    for factor in [1e9, 1e-9] {
        each(&|pair, here| {
            let there = from_identity(&scaled(&pair.template, factor), &scaled(&pair.reference, factor));
            let mut found = there.reference_from_template;
            found.translation.vector /= factor;
            assert_near(pair, SAME_SAMPLE, &here.reference_from_template, &found);
            assert_eq!(here.status, there.status, "{} x {factor:e}", pair.name);
            assert!((here.overlap.fraction - there.overlap.fraction).abs() < 0.01);
            assert!((there.rmse / factor / here.rmse - 1.0).abs() < 0.02, "{}", pair.name);
        });
    }
}

#[test]
fn points_given_twice_hardly_change_the_answer() {
    let twice = |cloud: &PointCloud| {
        let indices: Vec<usize> = (0..2 * cloud.len()).map(|i| i / 2).collect();
        cloud.select(&indices)
    };
    each(&|pair, here| {
        let there = from_identity(&twice(&pair.template), &twice(&pair.reference));
        assert_near(
            pair,
            ANOTHER_SAMPLE,
            &here.reference_from_template,
            &there.reference_from_template,
        );
        assert_ne!(there.status, Status::Failed, "{}", pair.name);
    });
}

#[test]
fn a_cloud_lies_on_itself() {
    for pair in pairs(3) {
        let found = from_identity(&pair.reference, &pair.reference);
        assert_eq!(found.status, Status::Converged, "{}: {found:?}", pair.name);
        let off = apart(&pair.reference, &Isometry3::identity(), &found.reference_from_template);
        assert!(off < 1e-3 * pair.explained, "{}: {off:e}", pair.name);
        assert_eq!(found.overlap.fraction, 1.0, "{}", pair.name);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let weak = Pair {
        name: "weak".to_owned(),
        template: extruded(1500, 0.0),
        reference: extruded(2000, 0.5).transformed(&motion()),
        explained: 1.0,
    };
    for pair in pairs(4).into_iter().chain([weak]) {
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| from_identity(&pair.template, &pair.reference))
        };
        let one = with(1);
        assert_eq!(one, with(2), "{}", pair.name);
        assert_eq!(one, with(8), "{}", pair.name);
    }
}

/// In multiples of what noise explains, how far apart answers may be that come from the same samples, but for rounding.
const SAME_SAMPLE: f64 = 1.0;
/// The same for answers from other samples, or where surfaces are met at other places.
const ANOTHER_SAMPLE: f64 = 8.0;
