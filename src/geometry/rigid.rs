//! Rigid motions in the forms that files and robots use: fixed-axis angles and 4 × 4 matrices.
//!
//! Angles follow the robot's convention: turn by Rx about the fixed x axis, then Ry about the fixed y axis, then Rz about
//! the fixed z axis, so `R = Rz · Ry · Rx`. Lengths keep the caller's unit; angles are radians.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The rotation `Rz · Ry · Rx` (about the fixed axes x, then y, then z), angles in radians, any finite value.
pub fn rotation_from_fixed_xyz(rx_rad: f64, ry_rad: f64, rz_rad: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rz_rad)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), ry_rad)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), rx_rad)
}

/// The angles `[rx, ry, rz]` in radians that [`rotation_from_fixed_xyz`] turns back into `rotation`.
///
/// `rx` and `rz` lie in (-π, π], `ry` in [-π/2, π/2]. Where `ry` is ±π/2 only the sum or difference of the other two is
/// determined; then `rx` is 0.
pub fn fixed_xyz_from_rotation(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    let rotation = rotation.to_rotation_matrix();
    let r = rotation.matrix();
    let cos_ry = r[(0, 0)].hypot(r[(1, 0)]);
    let ry_rad = (-r[(2, 0)]).atan2(cos_ry);
    let rx_rad = if cos_ry < GIMBAL_COSINE {
        0.0
    } else {
        r[(2, 1)].atan2(r[(2, 2)])
    };
    // Taking rz from what is left after rx keeps the product right when both are poorly determined near the gimbal.
    let (sin_rx, cos_rx) = rx_rad.sin_cos();
    let minus_sin_rz = cos_rx * r[(0, 1)] - sin_rx * r[(0, 2)];
    let cos_rz = cos_rx * r[(1, 1)] - sin_rx * r[(1, 2)];
    let rz_rad = (-minus_sin_rz).atan2(cos_rz);
    [half_open(rx_rad), ry_rad, half_open(rz_rad)]
}

/// The angle in radians, 0 to π, of the rotation that takes `a` to `b`. Accurate for angles near 0, unlike the arc cosine.
pub fn rotation_angle_between(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    let b_from_a = a.inverse() * b;
    2.0 * b_from_a.imag().norm().atan2(b_from_a.w.abs())
}

/// The rows of the 4 × 4 matrix of `target_from_source`; the last row is 0 0 0 1.
pub fn matrix_rows(target_from_source: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let matrix = target_from_source.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

/// The rigid motion with the matrix `rows`, its rotation replaced by the nearest exact one.
///
/// # Errors
///
/// Refuses a matrix that is not finite, whose last row is not 0 0 0 1, whose rotation differs from an orthonormal one by
/// more than 1e-6 in an element of `Rᵀ R`, or that mirrors.
pub fn isometry_from_rows(rows: &[[f64; 4]; 4]) -> Result<Isometry3<f64>, NotRigid> {
    if rows.iter().flatten().any(|value| !value.is_finite()) {
        return Err(NotRigid::NotFinite);
    }
    let last_row = rows[3];
    let last_row_is_affine = last_row
        .iter()
        .zip([0.0, 0.0, 0.0, 1.0])
        .all(|(value, expected)| (value - expected).abs() <= ORTHONORMAL_TOLERANCE);
    if !last_row_is_affine {
        return Err(NotRigid::LastRow { last_row });
    }
    let linear = Matrix3::from_fn(|row, column| rows[row][column]);
    let deviation = (linear.transpose() * linear - Matrix3::identity()).amax();
    if deviation > ORTHONORMAL_TOLERANCE {
        return Err(NotRigid::NotOrthonormal { deviation });
    }
    if linear.determinant() < 0.0 {
        return Err(NotRigid::Mirrors);
    }
    let rotation = Rotation3::from_matrix_unchecked(orthonormalised(&linear));
    Ok(Isometry3::from_parts(
        Translation3::new(rows[0][3], rows[1][3], rows[2][3]),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

/// Why a 4 × 4 matrix is no rigid motion.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NotRigid {
    /// An element is NaN or infinite.
    #[error("the matrix has an element that is not a finite number")]
    NotFinite,
    /// The last row is not 0 0 0 1.
    #[error("the last row of the matrix is {last_row:?}, not [0, 0, 0, 1]")]
    LastRow {
        /// What it is.
        last_row: [f64; 4],
    },
    /// The upper left 3 × 3 part is no rotation.
    #[error("the rotation part is not orthonormal: RᵀR differs from the identity by {deviation:.2e}, allowed is 1e-6")]
    NotOrthonormal {
        /// The largest element of `|Rᵀ R - 1|`.
        deviation: f64,
    },
    /// The upper left 3 × 3 part is a mirror image of a rotation.
    #[error("the rotation part mirrors (its determinant is -1)")]
    Mirrors,
}

/// The nearest orthonormal matrix, by the Newton–Schulz iteration; two of the three steps bring 1e-6 below rounding.
fn orthonormalised(linear: &Matrix3<f64>) -> Matrix3<f64> {
    (0..3).fold(*linear, |r, _| {
        0.5 * r * (3.0 * Matrix3::identity() - r.transpose() * r)
    })
}

/// -π and π are the same turn; π stands for both.
fn half_open(angle_rad: f64) -> f64 {
    if angle_rad <= -PI { PI } else { angle_rad }
}

/// Below this cosine of ry the axes x and z are taken to coincide; the rotation is then wrong by less than this angle.
const GIMBAL_COSINE: f64 = 1e-9;

const ORTHONORMAL_TOLERANCE: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_rotation(generator: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
        let mut angle = || (generator.random::<f64>() * 2.0 - 1.0) * PI;
        rotation_from_fixed_xyz(angle(), angle(), angle())
    }

    #[test]
    fn the_first_turn_is_about_x_and_all_axes_are_fixed() {
        let rotation = rotation_from_fixed_xyz(FRAC_PI_2, 0.0, FRAC_PI_2);
        // y goes to z about x, and z stays when turned about the fixed z.
        assert!((rotation * Vector3::y() - Vector3::z()).norm() < 1e-15);
        // x stays about x, then goes to y about z.
        assert!((rotation * Vector3::x() - Vector3::y()).norm() < 1e-15);
    }

    #[test]
    fn angles_of_a_random_rotation_give_it_back() {
        for seed in 0..1000 {
            let rotation = random_rotation(&mut ChaCha8Rng::seed_from_u64(seed));
            let [rx, ry, rz] = fixed_xyz_from_rotation(&rotation);
            let error = rotation_angle_between(&rotation, &rotation_from_fixed_xyz(rx, ry, rz));
            assert!(error < 1e-14, "seed {seed}: off by {error}");
            assert!(
                rx > -PI && rx <= PI && rz > -PI && rz <= PI && ry.abs() <= FRAC_PI_2,
                "seed {seed}"
            );
        }
    }

    #[test]
    fn angles_at_and_near_the_gimbal_give_the_rotation_back() {
        for (seed, offset_rad) in [0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4].into_iter().enumerate() {
            for side in [-1.0, 1.0] {
                let mut generator = ChaCha8Rng::seed_from_u64(seed as u64);
                let mut angle = || (generator.random::<f64>() * 2.0 - 1.0) * PI;
                let rotation = rotation_from_fixed_xyz(angle(), side * (FRAC_PI_2 - offset_rad), angle());
                let [rx, ry, rz] = fixed_xyz_from_rotation(&rotation);
                let error = rotation_angle_between(&rotation, &rotation_from_fixed_xyz(rx, ry, rz));
                assert!(error < 2e-9, "offset {offset_rad}: off by {error}");
                if offset_rad < 1e-11 {
                    assert_eq!(rx, 0.0);
                }
            }
        }
    }

    #[test]
    fn half_a_turn_is_plus_pi() {
        let [rx, _, _] = fixed_xyz_from_rotation(&rotation_from_fixed_xyz(-PI, 0.0, 0.0));
        assert!((rx - PI).abs() < 1e-15);
        let [_, _, rz] = fixed_xyz_from_rotation(&rotation_from_fixed_xyz(0.0, 0.0, -PI));
        assert!((rz - PI).abs() < 1e-15);
    }

    #[test]
    fn a_tiny_angle_between_rotations_keeps_its_digits() {
        let a = rotation_from_fixed_xyz(0.3, -0.2, 1.1);
        for angle_rad in [1e-12, 1e-9, 1e-3, 3.0] {
            let b = a * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad);
            let error = (rotation_angle_between(&a, &b) - angle_rad).abs();
            assert!(error < 1e-15, "{angle_rad}: off by {error}");
        }
        let negated = UnitQuaternion::new_unchecked(-a.into_inner());
        assert!(rotation_angle_between(&a, &negated) < 1e-15);
    }

    #[test]
    fn a_matrix_written_and_read_is_the_same_motion() {
        for seed in 0..100 {
            let mut generator = ChaCha8Rng::seed_from_u64(seed);
            let rotation = random_rotation(&mut generator);
            let target_from_source = Isometry3::from_parts(Translation3::new(1.5, -2.0, 900.25), rotation);
            let again = isometry_from_rows(&matrix_rows(&target_from_source)).unwrap();
            assert_eq!(again.translation, target_from_source.translation, "seed {seed}");
            assert!(
                rotation_angle_between(&rotation, &again.rotation) < 1e-15,
                "seed {seed}"
            );
        }
    }

    #[test]
    fn a_rounded_matrix_is_orthonormalised() {
        let rotation = rotation_from_fixed_xyz(0.1, 0.2, 0.3);
        let mut rows = matrix_rows(&Isometry3::from_parts(Translation3::identity(), rotation));
        for value in rows.iter_mut().flatten() {
            *value = (*value * 1e7).round() / 1e7;
        }
        let again = isometry_from_rows(&rows).unwrap();
        assert!((again.rotation.norm() - 1.0).abs() < 1e-15);
        assert!(rotation_angle_between(&rotation, &again.rotation) < 2e-7);
    }

    #[test]
    fn matrices_that_are_no_motions_are_refused() {
        let identity = matrix_rows(&Isometry3::identity());
        let with = |row: usize, column: usize, value: f64| {
            let mut rows = identity;
            rows[row][column] = value;
            isometry_from_rows(&rows)
        };
        assert_eq!(with(0, 3, f64::NAN), Err(NotRigid::NotFinite));
        assert_eq!(
            with(3, 0, 1.0),
            Err(NotRigid::LastRow {
                last_row: [1.0, 0.0, 0.0, 1.0]
            })
        );
        assert!(matches!(with(1, 1, 1.00001), Err(NotRigid::NotOrthonormal { .. })));
        assert_eq!(with(2, 2, -1.0), Err(NotRigid::Mirrors));
    }
}
