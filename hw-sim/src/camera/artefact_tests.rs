//! Each term of the artefact model by itself, on bodies where it is known what it must do.

use super::*;
use nalgebra::Vector3;

const DRAWS: Draws = Draws {
    seed: 5,
    trigger_id: 2 << 16,
};

/// A square of the given half side about the origin, facing -z.
fn square(half_mm: f64) -> Mesh {
    strip([half_mm; 2])
}

/// A rectangle of the given half sides.
fn strip([x_mm, y_mm]: [f64; 2]) -> Mesh {
    let corner = |x: f64, y: f64| Point3::new(x * x_mm, y * y_mm, 0.0);
    Mesh {
        vertices: vec![
            corner(-1.0, -1.0),
            corner(-1.0, 1.0),
            corner(1.0, 1.0),
            corner(1.0, -1.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// Two walls at a right angle that open towards the camera; the crease lies along y through the origin.
fn corner() -> Mesh {
    let point = |x: f64, y: f64, z: f64| Point3::new(x * 40.0, y * 40.0, z * 40.0);
    let vertices = [-1.0, 0.0, 1.0]
        .iter()
        .flat_map(|&x: &f64| [point(x, -1.0, -x.abs()), point(x, 1.0, -x.abs())])
        .collect();
    Mesh {
        vertices,
        triangles: vec![[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]],
    }
}

/// Polished, with these terms alone.
fn polished(terms: &[Term]) -> Surface {
    Surface {
        terms: terms.to_vec().into(),
        ..Surface::polished()
    }
}

fn capture() -> Capture {
    Capture {
        roi: Roi {
            width_px: 640,
            height_px: 480,
            offset_x_px: 400,
            offset_y_px: 300,
        },
        ..Capture::default()
    }
}

fn take(mesh: &Mesh, surface: Surface, capture: &Capture, draws: Draws) -> (Frame, Vec<PixelTruth>) {
    Renderer::new(mesh, surface).unwrap().render_with_truth(
        &Optics::medium(),
        &Isometry3::translation(0.0, 0.0, 600.0),
        capture,
        &draws,
    )
}

/// How far each valid pixel is off along the ray, mm; `None` for an invalid one.
fn errors_mm(frame: &Frame, truth: &[PixelTruth]) -> Vec<Option<f64>> {
    let along = |(point, truth): (&[f32; 3], &PixelTruth)| {
        let true_mm = Vector3::from(truth.point_mm);
        let error_mm = Vector3::from(point.map(f64::from)) - true_mm;
        (!point[0].is_nan()).then(|| error_mm.dot(&true_mm.normalize()))
    };
    frame.xyz_mm.iter().zip(truth).map(along).collect()
}

const ROUNDING_MM: f64 = 1e-4;

#[test]
fn a_highlight_leaves_one_compact_hole_and_a_dark_pass_closes_it() {
    let surface = polished(&[Term::Shadows, Term::Highlights, Term::Score]);
    let (single, _) = take(&square(100.0), surface, &capture(), DRAWS);
    let hole = single.saturated_count;
    assert!((50_000..250_000).contains(&hole), "{hole}");
    assert_eq!(single.valid_count + hole, 640 * 480);
    // In every row that it touches the hole is one piece.
    for row in single.mask.chunks(640) {
        let changes = row.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(changes <= 2, "{changes}");
    }
    let hdr = Capture {
        hdr_us: [250, 0],
        ..capture()
    };
    let (fused, _) = take(&square(100.0), surface, &hdr, DRAWS);
    assert_eq!((fused.valid_count, fused.saturated_count), (640 * 480, 0));
    // The picture stays that of the main pass.
    assert_eq!(fused.intensity, single.intensity);
}

#[test]
fn ripple_stays_beside_the_step_within_three_sigma_and_changes_sign_across_it() {
    let surface = polished(&[Term::Shadows, Term::Highlights, Term::Score, Term::Ripple]);
    let hdr = Capture {
        hdr_us: [250, 0],
        ..capture()
    };
    let (frame, truth) = take(&square(100.0), surface, &hdr, DRAWS);
    let single = take(&square(100.0), surface, &capture(), DRAWS).0;
    let errors = errors_mm(&frame, &truth);
    let mut touched_count = 0;
    for (y, row) in single.mask.chunks(640).enumerate() {
        let steps: Vec<usize> = (1..640).filter(|&x| row[x] != row[x - 1]).collect();
        for x in 0..640 {
            let index = y * 640 + x;
            let (error_mm, truth) = (errors[index].unwrap(), truth[index]);
            let near = steps.iter().any(|&step| (step.max(4) - 4..step + 4).contains(&x));
            assert_eq!(truth.touched == TOUCHED_RIPPLE, near, "{x} {y}");
            touched_count += usize::from(near);
            assert!(error_mm.abs() < 3.0 * truth.sigma_mm + ROUNDING_MM, "{error_mm}");
            assert!(near || error_mm.abs() < ROUNDING_MM, "{error_mm}");
        }
        for step in steps {
            let sides = [step - 1, step].map(|x| errors[y * 640 + x].unwrap() / truth[y * 640 + x].sigma_mm);
            assert!(sides[0] * sides[1] < 0.0 && sides[0].abs() > 0.9, "{sides:?}");
        }
    }
    assert!(touched_count > 500, "{touched_count}");
}

#[test]
fn at_a_silhouette_half_the_pixels_are_lost_and_a_third_fly() {
    // 250 × 250 px of the grid, in empty space.
    let surface = polished(&[Term::Shadows, Term::Silhouettes]);
    let (frame, truth) = take(&square(25.0), surface, &capture(), DRAWS);
    let errors = errors_mm(&frame, &truth);
    let hits: Vec<usize> = (0..truth.len()).filter(|&index| truth[index].is_seen).collect();
    let (left, right) = (hits[0] % 640, hits[hits.len() - 1] % 640);
    let (top, bottom) = (hits[0] / 640, hits[hits.len() - 1] / 640);
    let mut counts = [[0.0; 3]; 3];
    for &index in &hits {
        let (x, y) = (index % 640, index / 640);
        let inset = (x - left).min(right - x).min(y - top).min(bottom - y).min(2);
        let fate = match errors[index] {
            None => 0,
            Some(error_mm) if error_mm > ROUNDING_MM => 1,
            Some(_) => 2,
        };
        counts[inset][fate] += 1.0;
        assert!(errors[index].is_none_or(|error_mm| error_mm > -ROUNDING_MM && error_mm < 3.1));
    }
    let shares = counts.map(|counts| counts.map(|count| count / counts.iter().sum::<f64>()));
    for (share, expected) in shares[0].iter().zip([0.5, 0.3, 0.2]) {
        assert!((share - expected).abs() < 0.05, "{shares:?}");
    }
    for (share, expected) in shares[1].iter().zip([0.25, 0.15, 0.6]) {
        assert!((share - expected).abs() < 0.05, "{shares:?}");
    }
    assert_eq!(shares[2], [0.0, 0.0, 1.0]);
}

#[test]
fn flying_pixels_lie_between_the_two_surfaces() {
    let mut scene = square(100.0);
    let mut screen = square(20.0);
    screen.translate(Vector3::new(0.0, 0.0, -50.0));
    scene.append(screen);
    let (frame, truth) = take(&scene, polished(&[Term::Silhouettes]), &capture(), DRAWS);
    let depths = frame.xyz_mm.iter().zip(&truth).filter(|(point, truth)| {
        let moved = (f64::from(point[2]) - truth.point_mm[2]).abs() > ROUNDING_MM;
        assert!(!moved || truth.touched == TOUCHED_SILHOUETTE);
        moved
    });
    let depths: Vec<f32> = depths.map(|(point, _)| point[2]).collect();
    assert!(depths.len() > 200, "{}", depths.len());
    assert!(depths.iter().all(|depth_mm| (549.9..600.1).contains(depth_mm)));
    let middle = depths.iter().filter(|&&depth_mm| depth_mm < 575.0).count();
    assert!((middle as f64 / depths.len() as f64 - 0.5).abs() < 0.1, "{middle}");
}

#[test]
fn what_is_thinner_than_two_pixels_is_mostly_lost() {
    let (frame, truth) = take(&strip([0.15, 40.0]), polished(&[Term::Silhouettes]), &capture(), DRAWS);
    let seen = truth.iter().filter(|truth| truth.is_seen).count();
    let share = f64::from(frame.valid_count) / seen as f64;
    assert!(seen > 300 && (share - 0.2).abs() < 0.06, "{share} of {seen}");
}

#[test]
fn a_second_bounce_lowers_the_score_in_a_corner_and_nowhere_else() {
    let both = [Term::Shadows, Term::Score, Term::SecondBounce];
    let (with, truth) = take(&corner(), polished(&both), &capture(), DRAWS);
    let (without, _) = take(&corner(), polished(&both[..2]), &capture(), DRAWS);
    let (mut near_count, mut lost_count) = (0, 0);
    for (index, truth) in truth.iter().enumerate().filter(|(_, truth)| truth.is_seen) {
        let crease_mm = truth.point_mm[0].hypot(truth.point_mm[2] - 600.0);
        let is_touched = truth.touched == TOUCHED_SECOND_BOUNCE;
        assert!(is_touched == (with.confidence[index] < without.confidence[index]) || crease_mm > 5.0);
        assert!(crease_mm < 15.0 || !is_touched, "{crease_mm}");
        near_count += usize::from(crease_mm < 1.0);
        lost_count += usize::from(crease_mm < 1.0 && with.mask[index] != 0 && without.mask[index] == 0);
    }
    assert!(
        near_count > 1000 && lost_count > near_count / 2,
        "{lost_count} of {near_count}"
    );
    let (plane, truth) = take(&square(60.0), polished(&both), &capture(), DRAWS);
    assert!(plane.valid_count > 0 && truth.iter().all(|truth| truth.touched == 0));
}

#[test]
fn ghosts_are_up_to_three_patches_in_corners() {
    let surface = polished(&[Term::Shadows, Term::Ghosts]);
    let mut frames_with = 0;
    for trigger_id in 0..12 {
        let (frame, truth) = take(&corner(), surface, &capture(), Draws { trigger_id, ..DRAWS });
        let errors = errors_mm(&frame, &truth);
        let touched = (0..truth.len()).filter(|&index| truth[index].touched == TOUCHED_GHOST);
        let moved: Vec<f64> = touched.map(|index| errors[index].unwrap()).collect();
        assert!(moved.len() <= 900);
        assert!(moved.iter().all(|error_mm| (0.49..5.01).contains(&error_mm.abs())));
        let mut sizes: Vec<i64> = moved.iter().map(|error_mm| (error_mm * 100.0).round() as i64).collect();
        sizes.sort_unstable();
        sizes.dedup();
        assert!(sizes.len() <= 3, "{sizes:?}");
        assert!(moved.is_empty() || moved.len() >= 20);
        frames_with += usize::from(!moved.is_empty());
        assert_eq!(
            errors
                .iter()
                .flatten()
                .filter(|error_mm| error_mm.abs() > ROUNDING_MM)
                .count(),
            moved.len()
        );
    }
    assert!((6..=12).contains(&frames_with), "{frames_with}");
    assert!(
        take(&square(60.0), surface, &capture(), DRAWS)
            .1
            .iter()
            .all(|truth| truth.touched == 0)
    );
}

#[test]
fn outliers_are_as_many_as_the_filter_leaves_and_gross() {
    for (outlier_filter, share) in [
        (OutlierFilter::Disabled, 0.002),
        (OutlierFilter::Permissive, 0.0005),
        (OutlierFilter::Balanced, 0.0002),
        (OutlierFilter::Strict, 0.0001),
    ] {
        let capture = Capture {
            outlier_filter,
            ..Capture::default()
        };
        let (frame, truth) = take(&square(200.0), polished(&[Term::Outliers]), &capture, DRAWS);
        let errors = errors_mm(&frame, &truth);
        let gross = errors.iter().zip(&truth).filter(|(error_mm, truth)| {
            let sigmas = error_mm.unwrap().abs() / truth.sigma_mm;
            assert!(sigmas < 0.1 || (14.9..501.0).contains(&sigmas), "{sigmas}");
            assert_eq!(truth.touched == TOUCHED_OUTLIER, sigmas > 1.0);
            sigmas > 1.0
        });
        let found = gross.count() as f64 / errors.len() as f64;
        assert!((found / share - 1.0).abs() < 0.25, "{found} for {share}");
    }
}

#[test]
fn the_bowl_is_a_bowl_and_the_scale_is_the_cameras_and_fades_to_it() {
    let capture = Capture {
        binning: true,
        ..Capture::default()
    };
    let depth_mm = |terms: &[Term], trigger_id: u64, index: usize| {
        let draws = Draws {
            seed: trigger_id,
            trigger_id,
        };
        let (frame, truth) = take(&square(200.0), polished(terms), &capture, draws);
        assert!((f64::from(frame.xyz_mm[index][2]) - truth[index].point_mm[2]).abs() < ROUNDING_MM);
        truth[index].point_mm[2]
    };
    let (corner, middle) = (0, 270 * 720 + 360);
    let bowl = [Term::Bowl];
    let valley_mm = depth_mm(&bowl, 0, corner) - depth_mm(&bowl, 0, middle);
    // 0.36 of the spacing of 0.2 mm along the ray; the corner's ray stands a little off the axis.
    assert!((valley_mm - 0.072).abs() < 0.002, "{valley_mm}");
    let scale = |terms: &[Term], view: u64| depth_mm(terms, view << 16, middle) / 600.0 - 1.0;
    let fixed = scale(&[Term::Scale], 0);
    assert!(fixed.abs() <= 1.25e-3 && fixed.abs() > 1e-5, "{fixed}");
    assert_eq!(fixed, scale(&[Term::Scale], 30));
    let warm_up = [0, 72, 720].map(|view| scale(&[Term::WarmUp], view));
    assert!((warm_up[0] - 5e-4).abs() < 1e-9 && (warm_up[1] - 5e-4 / 1_f64.exp()).abs() < 1e-9);
    assert!(warm_up[2] < 1e-7, "{warm_up:?}");
}

#[test]
fn the_fate_of_grazing_pixels_is_shared_by_neighbours_on_shiny_surfaces() {
    let pose = Isometry3::new(
        Vector3::new(0.0, 0.0, 600.0),
        Vector3::new(66_f64.to_radians(), 0.0, 0.0),
    );
    let alike = |roll_off_px: f64| {
        let mut surface = polished(&[Term::Incidence]);
        surface.noise.roll_off_px = roll_off_px;
        let renderer = Renderer::new(&square(300.0), surface).unwrap();
        let frame = renderer.render(&Optics::medium(), &pose, &capture(), &DRAWS);
        let pairs = frame.mask.windows(2).filter(|pair| pair[0] == pair[1]).count();
        (
            f64::from(frame.valid_count) / (640.0 * 480.0),
            pairs as f64 / (640.0 * 480.0),
        )
    };
    let ((single_share, single), (shared_share, shared)) = (alike(0.0), alike(2.5));
    assert!(
        (single_share - shared_share).abs() < 0.03,
        "{single_share} {shared_share}"
    );
    assert!(single < 0.6 && shared > 0.85, "{single} {shared}");
}

#[test]
fn the_extended_volume_measures_without_camera_2_at_twice_the_noise() {
    let mut scene = square(100.0);
    let mut screen = square(10.0);
    screen.translate(Vector3::new(0.0, 0.0, -50.0));
    scene.append(screen);
    let with = |working_volume| {
        let capture = Capture {
            working_volume,
            ..capture()
        };
        take(&scene, Surface::matte(), &capture, DRAWS)
    };
    let (standard, extended) = (with(WorkingVolume::Standard), with(WorkingVolume::Extended));
    let gained = (0..standard.1.len()).filter(|&index| extended.1[index].is_seen && !standard.1[index].is_seen);
    let sigmas: Vec<f64> = gained.map(|index| extended.1[index].sigma_mm).collect();
    assert!(sigmas.len() > 2_000, "{}", sigmas.len());
    let usual_mm = standard.1.iter().map(|truth| truth.sigma_mm).fold(0.0, f64::max);
    assert!(
        sigmas
            .iter()
            .all(|sigma_mm| (1.8..2.1).contains(&(sigma_mm / usual_mm)))
    );
    let shadowed = standard
        .0
        .mask
        .iter()
        .filter(|&&mask| mask & MASK_OCCLUDED != 0)
        .count();
    let still = extended
        .0
        .mask
        .iter()
        .filter(|&&mask| mask & MASK_OCCLUDED != 0)
        .count();
    assert_eq!(shadowed - still, sigmas.len());
}

#[test]
fn a_polished_blade_has_the_same_bits_on_1_2_and_8_threads() {
    let renderer = Renderer::new(&crate::blade::Builtin::HptB.mesh(), Surface::polished()).unwrap();
    let pose = Isometry3::new(Vector3::new(0.0, 0.0, 600.0), Vector3::new(0.3, 1.4, 0.1));
    let capture = Capture {
        binning: true,
        hdr_us: [250, 0],
        ..Capture::default()
    };
    let bits = |thread_count| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(thread_count)
            .build()
            .unwrap();
        let frame = pool.install(|| renderer.render(&Optics::medium(), &pose, &capture, &DRAWS));
        assert!(frame.valid_count > 5_000, "{}", frame.valid_count);
        let xyz: Vec<[u32; 3]> = frame.xyz_mm.iter().map(|point| point.map(f32::to_bits)).collect();
        (xyz, frame.mask, frame.intensity, frame.confidence)
    };
    let one = bits(1);
    assert!(one == bits(2) && one == bits(8));
}
