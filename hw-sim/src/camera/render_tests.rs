use super::*;
use crate::blade::Builtin;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

const DRAWS: Draws = Draws {
    seed: 11,
    trigger_id: 5 << 16,
};

/// A square of the given half side about the origin, facing -z.
fn square(half_mm: f64) -> Mesh {
    let corner = |x: f64, y: f64| Point3::new(x * half_mm, y * half_mm, 0.0);
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

fn sphere(radius_mm: f64, step_count: u32) -> Mesh {
    let point = |i: u32, j: u32| {
        let polar_rad = PI * f64::from(i) / f64::from(step_count);
        let azimuth_rad = PI * f64::from(j) / f64::from(step_count);
        Point3::new(
            polar_rad.sin() * azimuth_rad.cos(),
            polar_rad.sin() * azimuth_rad.sin(),
            polar_rad.cos(),
        ) * radius_mm
    };
    let column_count = 2 * step_count;
    let vertices = (0..=step_count)
        .flat_map(|i| (0..column_count).map(move |j| point(i, j)))
        .collect();
    let triangles = (0..step_count)
        .flat_map(|i| {
            (0..column_count).flat_map(move |j| {
                let (a, b) = (i * column_count + j, i * column_count + (j + 1) % column_count);
                let (c, d) = (a + column_count, b + column_count);
                [[a, c, d], [a, d, b]]
            })
        })
        .collect();
    Mesh { vertices, triangles }
}

fn matte_with(noise: SurfaceNoise) -> Surface {
    Surface {
        noise,
        ..Surface::matte()
    }
}

fn render(mesh: &Mesh, noise: SurfaceNoise, camera_from_blade: &Isometry3<f64>, capture: &Capture) -> Frame {
    Renderer::new(mesh, matte_with(noise))
        .unwrap()
        .render(&Optics::medium(), camera_from_blade, capture, &DRAWS)
}

fn tilted(distance_mm: f64, angle_rad: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.0, 0.0, distance_mm), Vector3::new(angle_rad, 0.0, 0.0))
}

fn valid_points(frame: &Frame) -> Vec<Point3<f64>> {
    frame
        .xyz_mm
        .iter()
        .filter(|point| !point[0].is_nan())
        .map(|point| Point3::from(*point).cast())
        .collect()
}

#[test]
fn a_plane_across_the_axis_is_a_grid_of_the_stated_spacing_at_its_depth() {
    let frame = render(
        &square(200.0),
        SurfaceNoise::none(),
        &tilted(600.0, 0.0),
        &Capture::default(),
    );
    assert_eq!((frame.width_px, frame.height_px), (1440, 1080));
    assert_eq!(frame.valid_count, 1440 * 1080);
    let [first, next] = [frame.xyz_mm[0], frame.xyz_mm[1]];
    assert_eq!(first[2], 600.0);
    assert!(
        (first[0] + 143.9).abs() < 1e-4 && (first[1] + 107.9).abs() < 1e-4,
        "{first:?}"
    );
    assert!((next[0] - first[0] - 0.2).abs() < 1e-4);
}

#[test]
fn a_region_of_interest_is_that_part_of_the_full_frame_and_binning_the_mean_of_four_pixels() {
    let (mesh, pose) = (sphere(60.0, 90), tilted(600.0, 0.3));
    let full = render(&mesh, SurfaceNoise::none(), &pose, &Capture::default());
    let roi = Roi {
        width_px: 160,
        height_px: 80,
        offset_x_px: 640,
        offset_y_px: 500,
    };
    let part = render(
        &mesh,
        SurfaceNoise::none(),
        &pose,
        &Capture {
            roi,
            ..Capture::default()
        },
    );
    let binned = render(
        &mesh,
        SurfaceNoise::none(),
        &pose,
        &Capture {
            binning: true,
            ..Capture::default()
        },
    );
    assert_eq!(
        (part.width_px, part.height_px, binned.width_px, binned.height_px),
        (160, 80, 720, 540)
    );
    assert_eq!(part.xyz_mm[160 + 2], full.xyz_mm[501 * 1440 + 642]);
    let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| full.xyz_mm[(540 + y) * 1440 + 720 + x]);
    for axis in 0..3 {
        let mean = four.iter().map(|point| point[axis]).sum::<f32>() / 4.0;
        assert!((binned.xyz_mm[270 * 720 + 360][axis] - mean).abs() < 1e-3);
    }
}

#[test]
fn a_sphere_has_its_radius_wherever_it_is_seen() {
    let centre = Vector3::new(30.0, -20.0, 580.0);
    let frame = render(
        &sphere(50.0, 360),
        SurfaceNoise::none(),
        &Isometry3::translation(30.0, -20.0, 580.0),
        &Capture::default(),
    );
    let points = valid_points(&frame);
    assert!(points.len() > 100_000, "{}", points.len());
    for point in points {
        let radius_mm = (point.coords - centre).norm();
        assert!((radius_mm - 50.0).abs() < 0.005, "{radius_mm}");
    }
}

#[test]
fn a_second_body_throws_the_shadows_of_camera_2_and_of_the_projector() {
    let mut scene = square(100.0);
    let mut screen = square(10.0);
    screen.translate(Vector3::new(0.0, 0.0, -50.0));
    scene.append(screen);
    let frame = render(&scene, SurfaceNoise::none(), &tilted(600.0, 0.0), &Capture::default());
    // The screen spans -10 to 10 mm at 550 mm. Seen from camera 2 (x = 240) and the projector (x = 120) its shadow on
    // the plane at 600 mm is moved by -50/550 of these, and camera 1 itself sees -10.9 to 10.9 mm covered.
    let scale = 600.0 / 550.0;
    let shadow = |device_x_mm: f64| [-10.0, 10.0].map(|x: f64| device_x_mm + (x - device_x_mm) * scale);
    let mask_at = |x_mm: f64| {
        let column = (x_mm / 0.2 + 719.5).round() as usize;
        frame.mask[540 * 1440 + column]
    };
    for step in -450..450 {
        let x_mm = f64::from(step) * 0.2;
        let inside = |[low, high]: [f64; 2]| low + 0.3 < x_mm && x_mm < high - 0.3;
        let outside = |[low, high]: [f64; 2]| x_mm < low - 0.3 || high + 0.3 < x_mm;
        if outside(shadow(0.0)) && (inside(shadow(240.0)) || inside(shadow(120.0))) {
            assert_eq!(mask_at(x_mm), MASK_INVALID | MASK_OCCLUDED, "at {x_mm} mm");
        } else if outside(shadow(240.0)) && outside(shadow(120.0)) {
            assert_eq!(mask_at(x_mm), 0, "at {x_mm} mm");
        }
    }
}

#[test]
fn the_measured_noise_of_a_plane_is_the_models() {
    for angle_rad in [0.0, FRAC_PI_4] {
        let noise = SurfaceNoise {
            lateral_fraction: 0.0,
            dropout_fraction: 0.0,
            ..SurfaceNoise::matte()
        };
        let capture = Capture {
            roi: Roi {
                width_px: 320,
                height_px: 240,
                offset_x_px: 560,
                offset_y_px: 420,
            },
            ..Capture::default()
        };
        let pose = tilted(600.0, angle_rad);
        let frame = render(&square(300.0), noise, &pose, &capture);
        let points = valid_points(&frame);
        assert_eq!(points.len(), 320 * 240);
        let offsets = points.iter().map(|point| pose.inverse_transform_point(point).z);
        let sigma_mm = (offsets.map(|offset_mm| offset_mm * offset_mm).sum::<f64>() / points.len() as f64).sqrt();
        // Sheet 4.2 step 6 on the axis: 0.25 * 0.2 mm, brightness with the cosine to the projector and the square of
        // its distance, over the cosine of the incidence; seen along the normal it shrinks by that cosine again.
        let distance_mm = 600_f64.hypot(120.0);
        let brightness = 600.0 * angle_rad.cos() / distance_mm * (600.0 / distance_mm).powi(2);
        let model_mm = 0.05 / brightness.sqrt();
        assert!(
            (sigma_mm / model_mm - 1.0).abs() < 0.05,
            "{sigma_mm} for {model_mm} at {angle_rad}"
        );
    }
}

#[test]
fn a_surface_at_a_grazing_angle_is_lost() {
    let noise = SurfaceNoise {
        dropout_fraction: 0.0,
        ..SurfaceNoise::matte()
    };
    let capture = Capture {
        roi: Roi {
            width_px: 80,
            height_px: 80,
            offset_x_px: 680,
            offset_y_px: 500,
        },
        ..Capture::default()
    };
    let share = |angle_deg: f64| {
        let frame = render(&square(300.0), noise, &tilted(600.0, angle_deg.to_radians()), &capture);
        f64::from(frame.valid_count) / 6400.0
    };
    assert_eq!(share(55.0), 1.0);
    // Towards camera 2 the incidence at 69° is acos(cos 69° * cos 21.8°) = 70.6°.
    assert!((share(69.0) - (78.0 - 70.6) / 18.0).abs() < 0.05, "{}", share(69.0));
    assert_eq!(share(80.0), 0.0);
}

#[test]
fn long_exposures_saturate_and_short_ones_lose_modulation() {
    let with = |exposure_us| {
        let capture = Capture {
            binning: true,
            exposure_us,
            ..Capture::default()
        };
        render(&square(50.0), SurfaceNoise::none(), &tilted(600.0, 0.0), &capture)
    };
    let (short, long) = (with(20.0), with(5000.0));
    assert_eq!((short.valid_count, long.valid_count), (0, 0));
    assert_eq!(short.mask[270 * 720 + 360], MASK_INVALID | MASK_LOW_MODULATION);
    assert_eq!(long.mask[270 * 720 + 360], MASK_INVALID | MASK_SATURATED);
    assert_eq!(long.intensity[270 * 720 + 360], 255);
    assert_eq!(long.saturated_count, 250 * 250);
}

#[test]
fn the_same_draws_give_the_same_bits_on_1_2_and_8_threads() {
    let renderer = Renderer::new(&Builtin::HptB.mesh(), Surface::matte()).unwrap();
    let pose = Isometry3::from_parts(
        Vector3::new(0.0, 0.0, 600.0).into(),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_euler_angles(0.4, FRAC_PI_2, 0.1)),
    );
    let capture = Capture {
        binning: true,
        ..Capture::default()
    };
    let bits = |thread_count| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(thread_count)
            .build()
            .unwrap();
        let frame = pool.install(|| renderer.render(&Optics::medium(), &pose, &capture, &DRAWS));
        assert!(frame.valid_count > 5_000, "{}", frame.valid_count);
        (
            frame
                .xyz_mm
                .iter()
                .map(|point| point.map(f32::to_bits))
                .collect::<Vec<_>>(),
            frame.mask,
            frame.intensity,
            frame.surface_points_mm,
        )
    };
    let one = bits(1);
    assert!(one == bits(2) && one == bits(8));
}

#[test]
fn another_trigger_draws_other_noise_on_the_same_geometry() {
    let renderer = Renderer::new(
        &square(100.0),
        matte_with(SurfaceNoise {
            dropout_fraction: 0.0,
            ..SurfaceNoise::matte()
        }),
    )
    .unwrap();
    let capture = Capture {
        binning: true,
        ..Capture::default()
    };
    let take = |trigger_id| {
        renderer.render(
            &Optics::medium(),
            &tilted(600.0, 0.5),
            &capture,
            &Draws { trigger_id, ..DRAWS },
        )
    };
    let (first, second) = (take(1), take(2));
    assert_eq!(first.surface_points_mm, second.surface_points_mm);
    assert_eq!(first.surface_points_mm.len(), SURFACE_POINT_COUNT);
    assert_eq!(first.mask, second.mask);
    assert_ne!(valid_points(&first), valid_points(&second));
    for (a, b) in valid_points(&first).iter().zip(valid_points(&second)) {
        assert!((a - b).norm() < 1.0, "{a} {b}");
    }
}

#[test]
fn a_body_behind_the_camera_or_beside_the_field_gives_an_empty_frame() {
    for (x_mm, z_mm) in [(0.0, -600.0), (2000.0, 600.0), (0.0, 900.0)] {
        let frame = render(
            &square(50.0),
            SurfaceNoise::none(),
            &Isometry3::translation(x_mm, 0.0, z_mm),
            &Capture::default(),
        );
        assert_eq!(frame.valid_count, 0);
        assert!(frame.surface_points_mm.is_empty());
        assert!(frame.mask.iter().all(|mask| mask & MASK_INVALID != 0));
    }
}

#[test]
fn every_built_in_blade_fits_the_optics_meant_for_it_and_fills_the_frame() {
    for (blade, optics, binning, distance_mm, exposure_us) in [
        (Builtin::Lpt, Optics::wide(), false, 1100.0, 1000.0),
        (Builtin::HptA, Optics::fine(), true, 280.0, 1000.0),
        (Builtin::HptB, Optics::medium(), false, 600.0, 1000.0),
        (Builtin::HptC, Optics::medium(), false, 450.0, 750.0),
    ] {
        let (name, mesh) = (blade.name(), blade.mesh());
        let renderer = Renderer::new(&mesh, Surface::matte()).unwrap();
        let capture = Capture {
            binning,
            exposure_us,
            ..Capture::default()
        };
        for angle_rad in [0.0, FRAC_PI_2, PI] {
            // Blade z along the wide side of the image, blade x towards the far side at angle 0.
            let x_along_z =
                Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0));
            let fixture = Isometry3::from_parts(
                Vector3::new(0.0, 0.0, distance_mm).into(),
                UnitQuaternion::from_rotation_matrix(&x_along_z),
            );
            let pose = fixture * Isometry3::rotation(Vector3::z() * angle_rad);
            assert!(optics.covers(&pose, &mesh.vertices), "{name}");
            let frame = renderer.render(&optics, &pose, &capture, &DRAWS);
            let count = frame.valid_count;
            assert!(
                (40_000..200_000).contains(&count),
                "{name}: {count} points at {angle_rad} rad"
            );
            assert_eq!(frame.saturated_count, 0, "{name}");
            assert_eq!(frame.mask.iter().filter(|&&mask| mask == 0).count(), count as usize);
        }
    }
}

/// Golden: pins that further terms of the model leave a matte frame without them as it is.
#[test]
fn a_matte_frame_has_the_same_bits_as_ever() {
    let renderer = Renderer::new(&Builtin::HptC.mesh(), Surface::matte()).unwrap();
    let pose = Isometry3::from_parts(
        Vector3::new(3.0, -4.0, 450.0).into(),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_euler_angles(0.4, FRAC_PI_2, 0.1)),
    );
    let capture = Capture {
        binning: true,
        ..Capture::default()
    };
    let frame = renderer.render(&Optics::medium(), &pose, &capture, &DRAWS);
    let xyz: Vec<u8> = frame.xyz_mm.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let sums = [&xyz, &frame.mask, &frame.intensity].map(|bytes| crc32c::crc32c(bytes));
    assert_eq!(
        (frame.valid_count, sums),
        (13_661, [3_593_005_873, 2_540_205_171, 2_794_027_772])
    );
}
