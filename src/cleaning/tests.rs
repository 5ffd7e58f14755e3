use super::*;

const WIDTH: usize = 120;
const HEIGHT: usize = 90;
const NOISE_MM: f32 = 0.01;

/// A number between -1 and 1 that depends on nothing but its arguments.
fn noise(row: usize, column: usize, salt: u64) -> f32 {
    let mut bits = (row as u64) << 40 ^ (column as u64) << 8 ^ salt.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    for _ in 0..3 {
        bits ^= bits >> 31;
        bits = bits.wrapping_mul(0xD6E8_FEB8_6659_FD93);
    }
    ((bits >> 40) as f32 / (1u64 << 23) as f32) - 1.0
}

/// A slanted, slightly curved sheet 300 mm before the camera, 0.1 mm between points, with noise; `change` gets the depth
/// that each pixel would have and gives what it has.
fn grid(change: impl Fn(usize, usize, f32) -> f32 + Sync) -> Grid {
    Grid::from_rows(WIDTH, HEIGHT, |row, out| {
        for column in 0..WIDTH {
            let [u, v] = [(column as f32 - 60.0) / 3000.0, (row as f32 - 45.0) / 3000.0];
            let z = 300.0 + 200.0 * u + 300.0 * v * v + NOISE_MM * 1.7 * noise(row, column, 1);
            let z = change(row, column, z);
            (out.x[column], out.y[column], out.z[column]) = (u * z, v * z, z);
        }
    })
}

fn judged(change: impl Fn(usize, usize, f32) -> f32 + Sync) -> Judged {
    judge(grid(change), &Settings::default(), Kernel::fastest())
}

fn verdict(judged: &Judged, row: usize, column: usize) -> Verdict {
    judged.verdicts()[row * WIDTH + column]
}

fn kept_count(judged: &Judged) -> usize {
    judged
        .verdicts()
        .iter()
        .filter(|verdict| **verdict == Verdict::Kept)
        .count()
}

#[test]
fn a_clean_sheet_loses_nothing_and_its_normals_face_the_camera() {
    let judged = judged(|_, _, z| z);
    assert!(
        kept_count(&judged) >= WIDTH * HEIGHT - 5,
        "{:?}",
        judged.removed_counts()
    );
    let cloud = judged.cloud();
    let expected = Vector3::new(200.0 / 300.0, 0.0, -1.0).normalize();
    let at = cloud
        .points()
        .iter()
        .position(|point| point.y.abs() < 0.01 && point.x.abs() < 0.01)
        .unwrap();
    let normal = cloud.normals().unwrap()[at];
    assert!(normal.angle(&expected) < 0.05, "{normal:?}");
    for (point, normal) in cloud.points().iter().zip(cloud.normals().unwrap()) {
        assert!(normal.dot(&point.coords) < 0.0 && (normal.norm() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn single_wrong_points_are_taken_out_alone() {
    let wrong = |row: usize, column: usize| row % 17 == 8 && column % 19 == 9;
    let shifts = [0.12, -0.3, 1.0, -8.0];
    let judged = judged(|row, column, z| if wrong(row, column) { z + shifts[row % 4] } else { z });
    let (mut missed, mut lost) = (0, 0);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let is_kept = verdict(&judged, row, column) == Verdict::Kept;
            missed += usize::from(wrong(row, column) && is_kept);
            lost += usize::from(!wrong(row, column) && !is_kept);
        }
    }
    assert_eq!(missed, 0);
    assert!(lost <= 5, "{lost}");
}

#[test]
fn a_floating_patch_is_taken_out_and_its_surroundings_stay() {
    let inside = |row: usize, column: usize| (row as i32 - 40).pow(2) + (column as i32 - 70).pow(2) <= 36;
    for shift in [0.15, -0.5, 3.0] {
        let judged = judged(|row, column, z| if inside(row, column) { z + shift } else { z });
        let (mut missed, mut lost) = (0, 0);
        for row in 0..HEIGHT {
            for column in 0..WIDTH {
                let is_kept = verdict(&judged, row, column) == Verdict::Kept;
                missed += usize::from(inside(row, column) && is_kept);
                lost += usize::from(!inside(row, column) && !is_kept);
            }
        }
        assert!(missed == 0 && lost <= 90, "{shift}: {missed} missed, {lost} lost");
        assert_eq!(verdict(&judged, 40, 70), Verdict::Patch);
    }
}

#[test]
fn without_a_limit_on_patches_they_stay() {
    let inside = |row: usize, column: usize| (30..40).contains(&row) && (60..70).contains(&column);
    let settings = Settings {
        patch_max_count: 0,
        ..Settings::default()
    };
    let grid = grid(|row, column, z| if inside(row, column) { z + 3.0 } else { z });
    let judged = judge(grid, &settings, Kernel::fastest());
    assert_eq!(verdict(&judged, 35, 65), Verdict::Kept);
}

#[test]
fn points_between_two_surfaces_are_flying() {
    // The right half lies 20 mm behind; at the jump every third point is somewhere between, every second is lost.
    let judged = judged(|row, column, z| match column {
        58 | 59 if row % 2 == 0 => f32::NAN,
        59 if row % 3 == 0 => z + 3.0 + 14.0 * noise(row, column, 2).abs(),
        60.. => z + 20.0,
        _ => z,
    });
    for row in (3..HEIGHT - 3).filter(|row| row % 2 == 1 && row % 3 == 0) {
        let verdict = verdict(&judged, row, 59);
        assert!(
            matches!(verdict, Verdict::Flying | Verdict::Isolated),
            "{row}: {verdict:?}"
        );
    }
    assert!(
        kept_count(&judged) > WIDTH * HEIGHT - 2 * HEIGHT,
        "{:?}",
        judged.removed_counts()
    );
}

#[test]
fn what_juts_out_is_left_out_only_where_points_fly() {
    // The sheet ends at column 60; every sixth row is a pixel longer. Others of the last column may fly.
    let juts = |row: usize, column: usize| row % 6 == 2 && column == 60;
    let flies = |row: usize, column: usize| row % 6 == 5 && column == 59;
    let ending = |flying_mm: f32| {
        judged(move |row, column, z| match column {
            60.. if !juts(row, column) => f32::NAN,
            _ if flies(row, column) => z + flying_mm,
            _ => z,
        })
    };
    let (still, flying) = (ending(0.0), ending(0.3));
    for row in (2..HEIGHT - 2).step_by(6) {
        assert_eq!(verdict(&still, row, 60), Verdict::Kept, "{row}");
        assert_ne!(verdict(&flying, row, 60), Verdict::Kept, "{row}");
        assert_eq!(verdict(&flying, row + 3, 59), Verdict::Flying, "{row}");
        assert_eq!(verdict(&flying, row, 58), Verdict::Kept, "{row}");
    }
}

#[test]
fn grazing_points_are_left_out() {
    // 80 degrees: the depth grows by 5.7 times the way across.
    let grid = |slope: f32| {
        Grid::from_rows(WIDTH, HEIGHT, |row, out| {
            for column in 0..WIDTH {
                let [u, v] = [(column as f32 - 60.0) / 3000.0, (row as f32 - 45.0) / 3000.0];
                let z = 300.0 / (1.0 - slope * v);
                (out.x[column], out.y[column], out.z[column]) = (u * z, v * z, z);
            }
        })
    };
    let settings = Settings {
        incidence_max_rad: 70_f64.to_radians(),
        ..Settings::default()
    };
    let steep = judge(grid(3.7), &settings, Kernel::fastest());
    assert_eq!(verdict(&steep, 45, 60), Verdict::Grazing);
    assert_eq!(kept_count(&steep), 0);
    let less = judge(grid(2.0), &settings, Kernel::fastest());
    assert_eq!(verdict(&less, 45, 60), Verdict::Kept);
}

#[test]
fn grids_without_a_surface_give_nothing() {
    for (width, height) in [(0, 0), (1, 1), (3, 1), (1, 40)] {
        let grid = Grid::from_rows(width, height, |_, out| {
            out.x.fill(0.0);
            out.y.fill(0.0);
            out.z.fill(300.0);
        });
        let (cloud, removed) = clean(grid, &Settings::default());
        assert!(cloud.is_empty());
        assert_eq!(removed.total(), width * height);
    }
    let holes = Grid::from_rows(20, 20, |_, _| {});
    assert_eq!(clean(holes, &Settings::default()).1.total(), 0);
}

#[test]
fn kernels_and_numbers_of_threads_give_the_same_bits() {
    let spoilt = |row: usize, column: usize, z: f32| match noise(row, column, 3) {
        n if n > 0.98 => f32::NAN,
        n if n > 0.95 => z + 10.0 * noise(row, column, 4),
        _ if (20..28).contains(&row) && (30..44).contains(&column) => z + 1.0,
        _ => z,
    };
    let bits = |kernel: Kernel| {
        let judged = judge(grid(spoilt), &Settings::default(), kernel);
        let cloud = judged.cloud();
        let numbers = cloud
            .points()
            .iter()
            .map(|point| point.coords)
            .chain(cloud.normals().unwrap().iter().copied());
        let numbers: Vec<[u64; 3]> = numbers.map(|v| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits()]).collect();
        (numbers, judged.verdicts().to_vec())
    };
    let expected = bits(Kernel::fastest());
    assert!(expected.1.contains(&Verdict::Patch) && expected.1.contains(&Verdict::Outlier));
    for kernel in Kernel::available() {
        for threads in [1, 2, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert!(
                pool.install(|| bits(kernel)) == expected,
                "{} on {threads}",
                kernel.name()
            );
        }
    }
}
